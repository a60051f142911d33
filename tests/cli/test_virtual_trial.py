"""A whole trial of a simulated operator in virtual time, over the real sockets."""

from pathlib import Path
from typing import Any

import pytest

from mrnav_server.app.virtual_run import run_in_virtual_time
from mrnav_server.cli.simulated_trial import SimulatedTrial
from mrnav_server.cli.virtual_trial import report_here, run_in_this_process
from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.trial_log import LOG_NAME, read_header, read_log
from mrnav_server.settings import load_settings

# The first runs of a policy in a process differ in the tenth digit from later ones; a geodesic never does.
GEODESIC = {"MRNAV_AUTOPILOT__SOURCE": "geodesic"}
TRIAL = SimulatedTrial(0, 0, 0, "with_autonomy", "bifurcation", 2500.0, "SIM00", "test", GEODESIC)


def lines(folder: Path) -> list[tuple[float, str, Any]]:
    """Return what a log says, but for the trial's id."""
    kept = {"track", "hand", "command", "mode", "event"}
    return [(line.t_s, line.topic, line.data) for line in read_log(folder / LOG_NAME) if line.topic in kept]


@pytest.mark.timeout(600)
def test_a_trial_is_done_and_comes_out_the_same_again(tmp_path: Path) -> None:
    seen: list[list[tuple[float, str, Any]]] = []
    # A packet that a busy kernel delivers late comes a tick later: then another run is needed to agree.
    for run in range(4):
        root = tmp_path / str(run)
        root.mkdir()
        led = run_in_this_process(TRIAL, root)
        assert (led["completed"], led["reason"]) == (True, "")
        assert led["operator"]["simulated"] is True
        ended = led["ended"]
        assert ended["latency_ms"]["tick"]["p99"] == pytest.approx(10.0, abs=0.01)
        assert ended["metrics"]["completion_s"] == pytest.approx(4.0, abs=1.5)
        header = read_header(Path(ended["folder"]) / LOG_NAME)
        assert (header.operator_kind, header.simulated_rig, header.participant) == (
            "simulated",
            True,
            "SIM00",
        )
        log = lines(Path(ended["folder"]))
        assert len(log) > 500
        if log in seen:
            return
        seen.append(log)
    pytest.fail("no two of four runs agree")


@pytest.mark.parametrize(
    ("variable", "value", "name"),
    [
        ("MRNAV_RIG__CAMERA", "usb", "rig.camera"),
        ("MRNAV_MANIPULATOR__DRIVER", "sensapex-udp", "manipulator.driver"),
    ],
)
def test_a_rig_that_takes_real_time_is_refused(variable: str, value: str, name: str) -> None:
    settings = load_settings(None, {variable: value})
    with pytest.raises(ConfigError, match=name):
        run_in_virtual_time(settings, report_here, lambda *_: None)
