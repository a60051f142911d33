"""The demonstration's own decisions; the whole of it runs in tests/e2e."""

import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from rich.console import Console

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.cli.children import mrnav_child
from mrnav_server.cli.console import TrialFailedError
from mrnav_server.cli.demo import CLEARANCE_UM, SHORTEST_UM, choose_site
from mrnav_server.cli.demo_result import Tally, empty_result, note_end, result_table
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.vessel_model import vessel_map

LEFT = VesselPoint(100.0, 300.0)


@pytest.fixture(scope="module")
def channel() -> VesselMap:
    mask: ByteArray = np.zeros((900, 900), dtype=np.uint8)
    mask[200:400, 20:880] = 255
    return vessel_map("channel", mask, suggested_areas=(VesselPoint(150.0, 300.0), VesselPoint(800.0, 300.0)))


def test_a_site_is_far_enough_and_roomy_and_seeded(channel: VesselMap) -> None:
    graph = GridGraph(channel, cell_px=8)
    sites = [choose_site(channel, LEFT, seed) for seed in range(12)]
    assert len(set(sites)) > 3
    assert VesselPoint(150.0, 300.0) not in sites
    for seed, site in enumerate(sites):
        path_px = graph.path(LEFT, site)
        assert channel.um_per_px * np.hypot(*np.diff(path_px, axis=0).T).sum() >= 0.95 * SHORTEST_UM
        assert channel.clearance_um(site) >= 0.9 * CLEARANCE_UM
        assert choose_site(channel, LEFT, seed) == site


def test_a_vessel_without_a_site_is_told() -> None:
    mask: ByteArray = np.zeros((300, 300), dtype=np.uint8)
    mask[80:220, 80:220] = 255
    with pytest.raises(TrialFailedError, match="no site"):
        choose_site(vessel_map("pond", mask), VesselPoint(150.0, 150.0), 1)


def state(mode: str, *, clutch: bool = False, track: str = "tracking") -> dict[str, Any]:
    return {"mode": mode, "clutch": clutch, "track": {"state": track}}


def told(*states: dict[str, Any]) -> Tally:
    tally = Tally()
    for shown in states:
        tally.note(shown)
    return tally


def test_the_tally_tells_a_handover_from_driving_by_hand() -> None:
    by_hand = state("MANUAL", clutch=True)
    assert told(by_hand) == Tally()
    assert told(by_hand, state("AUTO")) == Tally(drove=True)
    assert told(state("AUTO"), state("MANUAL")) == Tally(drove=True, handed_over=True)
    assert told(state("AUTO"), by_hand) == Tally(drove=True, handed_over=True, gripped=True)
    assert told(state("MANUAL", track="searching"), state("MANUAL")) == Tally(robot_lost=True)


def test_the_table_says_simulated_and_shows_what_is_known() -> None:
    result = empty_result("channel", 1, "trials")
    percentiles = {"p50": 1.5, "p99": 2.5}
    latencies = {"hand_to_command": percentiles, "frame_to_twin": percentiles, "tick": percentiles}
    note_end(
        {
            "final_distance_um": 71.2,
            "collisions": 0,
            "collisions_in_auto": 0,
            "latency_ms": latencies,
            "metrics": {"average_speed_um_per_s": 2400.6, "straightness": {"value": -4.45}},
        },
        result,
    )
    page = Console(file=io.StringIO(), width=100)
    page.print(result_table(result))
    assert isinstance(page.file, io.StringIO)
    text = page.file.getvalue()
    assert "simulated rig, simulated operator" in text
    for shown in ("2401", "-4.45", "71", "1.5 / 2.5", "–"):
        assert shown in text
    assert result["g"] == -4.45
    assert result["spl"] is None


def test_a_child_that_ended_is_told_and_none_is_left(tmp_path: Path) -> None:
    with mrnav_child("the helper", ["no-such-command"], {}, tmp_path / "log") as child:
        psutil.Process(child.pid).wait(60)
        with pytest.raises(TrialFailedError, match="the helper ended with"):
            child.check()
    assert not psutil.pid_exists(child.pid)


def test_a_child_that_will_not_stop_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stubborn = tmp_path / "stubborn"
    stubborn.write_text(
        f"#!{sys.executable}\nimport pathlib, signal\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        f"pathlib.Path({str(tmp_path / 'up')!r}).touch()\nsignal.pause()\n"
    )
    stubborn.chmod(0o755)
    monkeypatch.setattr("mrnav_server.cli.children.sys.executable", str(stubborn))
    monkeypatch.setattr("mrnav_server.cli.children._STOP_S", 0.2)
    with mrnav_child("the helper", [], {}, tmp_path / "log") as child:
        while not (tmp_path / "up").exists():
            child.check()
    assert not psutil.pid_exists(child.pid)
