import asyncio
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.recorder import Recorder, RecorderConfig
from mrnav_server.loops.trial_log import TrialHeader
from mrnav_server.study.trajectory_plot import trajectory_figure
from mrnav_server.study.trial_record import read_trial_record
from mrnav_server.study.trial_report import geodesic_um, route_graph, write_trial_report
from mrnav_server.vision.vessel_model import vessel_map

START_PX, TARGET_PX = (80.0, 200.0), (320.0, 200.0)


@pytest.fixture(scope="module")
def vessel() -> VesselMap:
    mask = np.zeros((400, 400), dtype=np.uint8)
    mask[120:281, 10:390] = 255
    return vessel_map("channel", mask, suggested_areas=(VesselPoint(*TARGET_PX),))


def header(vessel: VesselMap) -> TrialHeader:
    return TrialHeader(
        participant="P01",
        condition="with_autonomy",
        operator_kind="human",
        simulated_rig=True,
        software_version="0.1.0",
        configuration_sha256="c0",
        vessel=vessel.name,
        vessel_sha256=vessel.digest,
        um_per_px=vessel.um_per_px,
        calibration={},
        start_px=START_PX,
        area_id="area-1",
        area_px=TARGET_PX,
        area_epsilon_um=300.0,
    )


class Run:
    """A robot that goes straight from start to target at 300 µm/s, recorded as the rig records it."""

    def __init__(self, root: Path, head: TrialHeader) -> None:
        self.now_s = 50.0
        self.recorder = Recorder(root, lambda: self.now_s, RecorderConfig(min_free_mb=0.0))
        self.recorder.start_trial(head)

    def drive(self, *, seen: bool = True) -> None:
        """Rest for 1 s, go at 51 s, arrive 8 s later, end 1 s after that; the operator has the last third."""
        self.recorder.record("mode", {"mode": "AUTO", "reason": ""})
        for frame in range(300):
            self.now_s = 50.0 + frame / 30
            if frame == 30:
                self.recorder.record("trial", {"mark": "go", "t_s": self.now_s})
            if frame == 200:
                self.recorder.record("command", {"mode": "MANUAL"})
            x_px = START_PX[0] + 30.0 * min(max(self.now_s - 51.0, 0.0), 8.0)
            # A wall's touch between 4 s and 5 s.
            y_px = START_PX[1] + (32.0 if 54.0 < self.now_s < 55.0 else 0.0)
            place = [x_px, y_px] if seen else None
            self.recorder.record(
                "track", {"taken_s": self.now_s, "state": "tracking", "vessel": place, "sigma_um": 3.0}
            )

    def reach(self) -> None:
        self.recorder.record("trial", {"mark": "reached", "t_s": 59.0})

    def end(self) -> Path:
        self.recorder.record("trial", {"mark": "end"})
        folder = asyncio.run(self.recorder.end_trial())
        assert folder is not None
        return folder


def recorded(root: Path, head: TrialHeader) -> Path:
    run = Run(root, head)
    run.drive()
    run.reach()
    return run.end()


def test_a_trial_becomes_a_result_and_a_picture(tmp_path: Path, vessel: VesselMap) -> None:
    folder = recorded(tmp_path, header(vessel))
    result = write_trial_report(folder, vessel)
    assert json.loads((folder / "result.json").read_text()) == result
    assert (folder / "trajectory.png").read_bytes().startswith(b"\x89PNG")
    assert (result["id"], result["participant"], result["reached"]) == (folder.name, "P01", True)
    metrics = result["metrics"]
    assert metrics["completion_s"] == pytest.approx(8.0)
    assert metrics["first_motion_s"] == pytest.approx(0.0, abs=0.2)
    assert metrics["contacts"] == 1
    assert metrics["min_clearance_um"] < 0
    assert metrics["path_length_share"] == pytest.approx(2400 / metrics["path_um"], rel=0.02)
    assert result["direction"]["smoothness"] == "lower is smoother"


def test_what_motion_does_not_define_is_null(tmp_path: Path, vessel: VesselMap) -> None:
    run = Run(tmp_path, header(vessel))
    run.drive(seen=False)
    result = write_trial_report(run.end(), vessel)
    assert result["reached"] is False
    assert result["metrics"]["completion_s"] is None
    assert result["metrics"]["smoothness"]["value"] is None
    assert result["metrics"]["path_length_share"] == 0.0


def test_a_log_is_read_as_arrays(tmp_path: Path, vessel: VesselMap) -> None:
    record = read_trial_record(recorded(tmp_path, header(vessel)))
    assert record.vessel_px.shape == (300, 2)
    assert (round(record.go_s, 9), record.end_s, record.reached) == (51.0, 59.0, True)
    assert (record.modes[0], record.modes[199], record.modes[200]) == ("AUTO", "AUTO", "MANUAL")
    assert record.inside.sum() == pytest.approx(241, abs=1)
    clearance_um = record.clearance_um(vessel)
    assert clearance_um[0] == pytest.approx(vessel.clearance_um(VesselPoint(*START_PX)))


@pytest.mark.parametrize(
    ("simulated_rig", "operator_kind", "said"),
    [(True, "human", True), (False, "simulated", True), (False, "human", False)],
)
def test_the_picture_says_simulated_where_it_is(
    tmp_path: Path, vessel: VesselMap, simulated_rig: bool, operator_kind: str, said: bool
) -> None:
    head = replace(header(vessel), simulated_rig=simulated_rig, operator_kind=operator_kind)  # type: ignore[arg-type]
    record = read_trial_record(recorded(tmp_path, head))
    figure = trajectory_figure(record, record.clearance_um(vessel), vessel)
    assert ("simulated" in figure.axes[0].get_title()) is said
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["autonomy", "operator", "start", "critical area", "wall contact (1)"]


def test_drivers_differ_in_more_than_colour(tmp_path: Path, vessel: VesselMap) -> None:
    record = read_trial_record(recorded(tmp_path, header(vessel)))
    axes = trajectory_figure(record, record.clearance_um(vessel), vessel).axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert lines["autonomy"].get_linestyle() != lines["operator"].get_linestyle()
    x_mm = np.asarray(lines["autonomy"].get_xdata(), dtype=float)
    assert np.nanmin(x_mm) == pytest.approx(START_PX[0] / 100, abs=0.01)
    # The two pieces meet, and neither covers the other.
    assert np.nanmax(x_mm) == pytest.approx(
        np.nanmin(np.asarray(lines["operator"].get_xdata(), dtype=float)), abs=0.02
    )


def test_another_vessel_is_refused(tmp_path: Path, vessel: VesselMap) -> None:
    folder = recorded(tmp_path, replace(header(vessel), vessel_sha256="other"))
    with pytest.raises(RefusedError, match="another mask"):
        write_trial_report(folder, vessel)


def test_a_log_without_tracks_is_refused(tmp_path: Path, vessel: VesselMap) -> None:
    folder = Run(tmp_path, header(vessel)).end()
    with pytest.raises(RefusedError, match="no track"):
        write_trial_report(folder, vessel)


def test_the_geodesic_runs_from_start_to_area(vessel: VesselMap) -> None:
    routes = route_graph(vessel)
    assert geodesic_um(header(vessel), routes) == pytest.approx(2400.0, rel=0.01)
    assert math.isnan(geodesic_um(replace(header(vessel), start_px=None), routes))
    assert math.isnan(geodesic_um(replace(header(vessel), area_px=None), routes))
