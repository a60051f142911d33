import json
from pathlib import Path

import numpy as np
import pytest

from mrnav_server.study.trial_report import write_trial_report
from mrnav_server.vision.vessel_outline import walls_px
from tests.recorded_trials import GO_S, HANDOVER_S, REACHED_S, RecordedTrial, shipped_vessel, way_px


def test_what_a_page_draws_of_a_trial(tmp_path: Path) -> None:
    folder = RecordedTrial(sway_px=25.0).record(tmp_path)
    result = write_trial_report(folder, shipped_vessel())
    drawn = json.loads((folder / "trajectory.json").read_text())
    (part,) = drawn["parts"]
    assert len({len(part[name]) for name in ("t_s", "x_px", "y_px", "speed_um_per_s", "mode")}) == 1
    assert part["t_s"][0] == pytest.approx(0.0, abs=0.04)
    assert part["t_s"][-1] == pytest.approx(REACHED_S - GO_S, abs=0.04)
    assert (part["x_px"][-1], part["y_px"][-1]) == pytest.approx(tuple(way_px()[-1]), abs=1.0)
    assert max(part["speed_um_per_s"]) == pytest.approx(result["metrics"]["peak_speed_um_per_s"], abs=0.1)
    taken_over = part["t_s"][part["mode"].index("MANUAL")]
    assert taken_over == pytest.approx(HANDOVER_S - GO_S, abs=0.04)
    assert len(drawn["contacts"]) == result["metrics"]["contacts"] > 0
    assert drawn["simulated"] is True
    assert drawn["um_per_px"] == 10.0


def test_a_hole_in_the_tracks_is_a_hole_in_the_path(tmp_path: Path) -> None:
    folder = RecordedTrial().record(tmp_path)
    log = folder / "log.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    kept = [
        each for each in lines if not (each["topic"] == "track" and 54.0 < each["data"]["taken_s"] < 56.0)
    ]
    log.write_text("".join(f"{json.dumps(each)}\n" for each in kept))
    result = write_trial_report(folder, shipped_vessel())
    first, second = json.loads((folder / "trajectory.json").read_text())["parts"]
    assert second["t_s"][0] - first["t_s"][-1] > 2.0
    assert "gaps" in result["metrics"]["flags"]


def test_walls_enclose_the_lumen() -> None:
    vessel = shipped_vessel()
    walls = [np.array(wall, dtype=np.float64) for wall in walls_px(vessel)]
    # The shoelace formula; outlines run through pixel centres, so half a pixel is missing around.
    area = sum(
        abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2 for x, y in (wall.T for wall in walls)
    )
    assert area == pytest.approx(vessel.lumen.sum(), rel=0.03)
    assert sum(map(len, walls)) < 2000
