from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from mrnav_server.core.metrics import trial_metrics
from mrnav_server.loops.live_trial import LiveTrial
from mrnav_server.study.trial_report import write_trial_report
from tests.recorded_trials import END_S, GO_S, REACHED_S, RecordedTrial, shipped_vessel


def watched(recorded: RecordedTrial) -> LiveTrial:
    vessel = shipped_vessel()
    live = LiveTrial(vessel.um_per_px, vessel.clearance_um)
    live.begin()
    for track in recorded.tracks():
        live.on_track(track)
    return live


def test_the_metrics_at_the_end_are_those_of_the_report(tmp_path: Path) -> None:
    recorded = RecordedTrial(sway_px=25.0)
    afterwards = write_trial_report(recorded.record(tmp_path), shipped_vessel())["metrics"]
    trial = watched(recorded).trial(GO_S, REACHED_S)
    assert trial is not None
    live = asdict(trial_metrics(trial))
    # SPL needs the shortest path, which is found when the trial is over.
    assert np.isnan(live.pop("path_length_share"))
    assert afterwards.pop("path_length_share") == pytest.approx(1.0, abs=0.1)
    assert live.pop("flags") == tuple(afterwards.pop("flags"))
    assert live == afterwards
    assert live["contacts"] > 0


def test_a_trial_that_is_not_over_has_metrics_up_to_now() -> None:
    live = watched(RecordedTrial())
    trial = live.trial(GO_S, None)
    assert trial is not None
    assert trial.end_s == pytest.approx(END_S, abs=0.05)
    metrics = trial_metrics(trial)
    assert metrics.average_speed_um_per_s > 500.0
    assert np.isnan(metrics.completion_s)


def test_only_a_running_trial_is_kept() -> None:
    live = watched(RecordedTrial())
    track = next(RecordedTrial().tracks())
    live.end()
    live.on_track(track)
    assert live.trial(None, None) is None
    live.begin()
    live.on_track(replace(track, vessel=None))
    trial = live.trial(None, None)
    assert trial is not None
    assert trial.go_s == trial.end_s == track.taken_s
    assert np.isnan(trial.xy_um).all()
    assert np.isnan(trial.clearance_um).all()
    live.prepare()
    assert trial_metrics(trial).flags == ("nothing_moves", "not_reached")
