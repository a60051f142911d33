"""A trial as its playback tells it: closed forms of a log that is written line by line."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrnav_server.app.playback import playback
from mrnav_server.loops.film_index import FilmFrame
from mrnav_server.loops.trial_log import LOG_NAME, header_line, log_line
from tests.recorded_trials import RecordedTrial

GO_S, TAKE_UP_S, ARRIVAL_S, END_S = 100.0, 101.0, 103.0, 105.0
PX_PER_S = 100.0


class Log:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        stage_from_vessel = [[10.0, 0.0, 500.0], [0.0, 10.0, -200.0]]
        header = replace(RecordedTrial().header(), calibration={"stage_from_vessel": stage_from_vessel})
        self._lines = [header_line(folder.name, header)]

    def note(self, at_s: float, topic: str, **data: Any) -> None:  # noqa: ANN401 - fields of any topic
        self._lines.append(log_line(len(self._lines), at_s, at_s, topic, data))

    def mode(self, at_s: float, before: str, mode: str) -> None:
        self.note(at_s, "mode", before=before, mode=mode, reason="")

    def write(self) -> Path:
        (self.folder / LOG_NAME).write_bytes(b"".join(self._lines))
        return self.folder


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """AUTO along x at 1000 µm/s, with the clutch closed for a second; an announced hand-over; the hand."""
    log = Log(tmp_path_factory.mktemp("trial"))
    log.note(GO_S - 1, "settings", handover={"blend_s": 0.8, "sharing": {"enabled": True}})
    events = {
        -0.5: lambda: log.mode(GO_S - 0.5, "DISARMED", "MANUAL"),
        -0.25: lambda: log.mode(GO_S - 0.25, "MANUAL", "AUTO"),
        -0.2: lambda: log.note(GO_S - 0.2, "path", points_px=[[float(x), 800.0] for x in range(1000)]),
        0.0: lambda: log.note(GO_S + 0.3, "trial", event="trial", mark="go", t_s=GO_S),
        1.0: lambda: log.note(TAKE_UP_S, "hand", clutch=True, valid=True),
        2.0: lambda: log.note(TAKE_UP_S + 1, "hand", clutch=True, valid=False),
        2.1: lambda: log.note(ARRIVAL_S - 0.9, "event", event="handover_announced", in_s=0.9),
        2.5: lambda: log.note(ARRIVAL_S - 0.5, "event", event="contact", mode="AUTO", count=1),
        3.0: lambda: log.mode(ARRIVAL_S, "AUTO", "MANUAL"),
        3.01: lambda: log.note(ARRIVAL_S + 0.01, "event", event="handover", by="arrival"),
    }
    for frame in range(round((END_S - GO_S + 1) * 20)):
        now_s = GO_S - 1 + frame / 20
        while events and min(events) <= now_s - GO_S:
            events.pop(min(events))()
        seen = None if 70 <= frame < 72 else [800.0 + PX_PER_S * (now_s - GO_S), 800.0]
        log.note(now_s, "step", tip_um=[1500.0, 800.0, 9000.0])
        log.note(now_s, "track", taken_s=now_s, frame=frame + 7, vessel=seen, sigma_um=3.0)
    film = [FilmFrame(GO_S - 1 + number / 10, 0, 0) for number in range(3)]
    return playback(log.write(), film)


def row(told: dict[str, Any], at_s: float) -> dict[str, Any]:
    """Return what the page shows at a moment after the go cue."""
    i = int(np.searchsorted(np.array(told["frames"]["t_s"]) + 1e-6, at_s))
    return {name: column[i] for name, column in told["frames"].items()}


def test_places_are_in_the_vessels_grid_and_motion_is_filtered(told: dict[str, Any]) -> None:
    now = row(told, 1.5)
    assert (now["number"], now["x_px"], now["y_px"]) == (57, 950.0, 800.0)
    assert (now["tip_x_px"], now["tip_y_px"]) == (100.0, 100.0)
    assert now["speed_um_per_s"] == pytest.approx(10.0 * PX_PER_S, abs=1.0)
    assert now["jerk_um_per_s3"] == pytest.approx(0.0, abs=5.0)
    goal_x, goal_y = told["areas"][0]["center_px"]
    assert now["distance_um"] == pytest.approx(10.0 * np.hypot(950.0 - goal_x, 800.0 - goal_y), abs=1.0)
    unseen = row(told, 2.5)
    assert (unseen["x_px"], unseen["distance_um"]) == (None, None)


@pytest.mark.parametrize(
    ("at_s", "share", "clutch"),
    [
        (-0.4, 1.0, False),
        (0.5, 0.0, False),
        (1.5, None, True),
        (2.2, 0.0, False),
        (3.2, 0.15625, False),
        (3.4, 0.5, False),
        (4.5, 1.0, False),
    ],
)
def test_the_hands_share_follows_modes_and_hand_over(
    told: dict[str, Any], at_s: float, share: float | None, *, clutch: bool
) -> None:
    now = row(told, at_s)
    assert now["hand"] == (None if share is None else pytest.approx(share, abs=1e-3))
    assert now["clutch"] is clutch


def test_modes_path_and_marks_lie_at_their_times(told: dict[str, Any]) -> None:
    assert [(each["t_s"], each["mode"]) for each in told["modes"]] == [
        (-1.0, "DISARMED"),
        (-0.5, "MANUAL"),
        (-0.25, "AUTO"),
        (3.0, "MANUAL"),
    ]
    (path,) = told["paths"]
    assert (path["t_s"], path["end_s"]) == (-0.2, 3.0)
    assert (path["points_px"][0], path["points_px"][-1]) == ([0.0, 800.0], [999.0, 800.0])
    assert len(path["points_px"]) < 300
    kinds = [(each["t_s"], each["kind"]) for each in told["marks"]]
    assert kinds == [
        (-0.5, "arm"),
        (-0.25, "auto"),
        (0.0, "go"),
        (2.1, "announced"),
        (2.5, "contact"),
        (3.01, "handover"),
    ]
    assert told["film_s"] == [-1.0, -0.9, -0.8]
    assert told["simulated"] is True
