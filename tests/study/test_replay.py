"""A recorded trial, fed through the deciders again, gives the same modes, setpoints and marks, exactly."""

from collections.abc import Callable
from pathlib import Path

import orjson
import pytest

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.errors import ConfigError, DeviceError, RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.guards import GuardConfig
from mrnav_server.loops.trial_log import LOG_NAME
from mrnav_server.study.replay import replay_trial
from tests.loops.conftest import bifurcation, planner
from tests.study.recorded_rig import SETTINGS, RecordedRig, drive

__all__ = ["bifurcation", "planner"]


@pytest.fixture
def rig(tmp_path: Path, bifurcation: VesselMap, planner: PathPlanner) -> RecordedRig:
    rig = RecordedRig(tmp_path, bifurcation, planner)
    rig.advance(0.5)
    return rig


def drive_by_hand(rig: RecordedRig, span_s: float) -> None:
    rig.clutch = False
    rig.advance(0.1)
    rig.clutch = True
    for _ in range(round(span_s / 0.01)):
        rig.hand_x_m += 0.0004
        rig.tick()


def arrives(rig: RecordedRig) -> None:
    rig.advance_until(Mode.MANUAL, 20.0)
    drive_by_hand(rig, 0.5)


def takes_over(rig: RecordedRig) -> None:
    rig.clutch = True
    rig.advance(0.3)
    assert rig.is_in(Mode.MANUAL)
    drive_by_hand(rig, 0.3)


def hand_dies(rig: RecordedRig) -> None:
    rig.hand_alive = False
    rig.advance(0.6)
    assert rig.is_in(Mode.HOLD)
    rig.advance(2.0)
    assert not rig.lease.held, "its seat was freed by its silence"
    rig.hand_alive = True
    rig.lease.take_hand("hand", "test", rig.now_s)
    drive_by_hand(rig, 0.3)


def camera_freezes(rig: RecordedRig) -> None:
    rig.camera_alive = False
    rig.advance(0.4)
    assert rig.is_in(Mode.HOLD)
    rig.camera_alive = True
    rig.advance(0.6)
    rig.start_auto()
    rig.advance(0.3)


def camera_fails(rig: RecordedRig) -> None:
    rig.camera_fault = "the camera's pictures stand still"
    rig.advance(0.4)
    assert rig.is_in(Mode.HOLD)
    rig.camera_fault = ""
    rig.advance(0.2)


def robot_is_lost(rig: RecordedRig) -> None:
    rig.camera_alive = False
    for _ in range(5):
        rig.lose_robot()
        rig.advance(0.03)
    assert rig.is_in(Mode.HOLD)
    rig.camera_alive = True
    rig.advance(0.3)


def is_stopped(rig: RecordedRig) -> None:
    rig.ask(Ask.STOP)
    rig.advance(0.5)
    with pytest.raises(RefusedError):
        rig.ask(Ask.AUTO)
    rig.ask(Ask.RESET)
    rig.advance(0.5)
    rig.ask(Ask.ARM)
    rig.advance(0.2)


def manipulator_stalls(rig: RecordedRig) -> None:
    def accepted(target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        return MotionCommand(now_s, target, speed_um_per_s)

    rig.manipulator.move_to = accepted  # type: ignore[method-assign]
    rig.world.set_target(rig.world.tip, 100.0)
    rig.advance_until(Mode.FAULT, 2.0)
    rig.advance(0.3)


def manipulator_refuses(rig: RecordedRig) -> None:
    def refused(target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        raise DeviceError("the axis is jammed")

    rig.manipulator.move_to = refused  # type: ignore[method-assign]
    rig.advance_until(Mode.FAULT, 1.0)
    rig.advance(0.1)


def manipulator_falls_silent(rig: RecordedRig) -> None:
    def failed() -> TipReading:
        raise DeviceError("no answer")

    rig.manipulator.tip = failed  # type: ignore[method-assign]
    rig.advance_until(Mode.FAULT, 1.0)
    rig.advance(0.1)


def process_stalls(rig: RecordedRig) -> None:
    rig.now_s += 0.3
    rig.world.advance(0.3)
    rig.advance(0.5)


def is_told_to_fail(rig: RecordedRig) -> None:
    rig.control.fail("the supervisor stopped the manipulator")
    rig.advance(0.3)
    assert rig.is_in(Mode.FAULT)


def scale_is_changed(rig: RecordedRig) -> None:
    rig.ask(Ask.HOLD)
    rig.hand.choose_scale("fine")
    rig.herald.announce("hand", {"scale": rig.hand.scale, "gain": rig.hand.gain})
    drive_by_hand(rig, 0.5)


def hand_leaves(rig: RecordedRig) -> None:
    takes_over(rig)
    rig.hand.lose()
    rig.herald.record("hand_left", {})
    rig.lease.give_back("hand")
    rig.control.step(rig.now_s)
    rig.hand_alive = False
    rig.advance(0.3)
    assert rig.is_in(Mode.HOLD)


EVENTS: list[Callable[[RecordedRig], None]] = [
    arrives,
    takes_over,
    hand_dies,
    camera_freezes,
    camera_fails,
    robot_is_lost,
    is_stopped,
    manipulator_stalls,
    manipulator_refuses,
    manipulator_falls_silent,
    process_stalls,
    is_told_to_fail,
    scale_is_changed,
    hand_leaves,
]


@pytest.mark.parametrize("happens", EVENTS, ids=lambda event: event.__name__)
def test_a_replay_is_exact_whatever_happened(
    rig: RecordedRig, happens: Callable[[RecordedRig], None]
) -> None:
    drive(rig)
    happens(rig)
    replay = replay_trial(rig.end())
    assert replay.difference is None, str(replay.difference)
    assert replay.exact
    assert replay.changed == ()
    assert replay.simulated
    assert replay.counts["steps"] > 90
    assert replay.counts["modes"] == len(rig.changes)
    assert replay.counts["commands"] == len(commands(rig)) > 50


def test_a_trial_may_begin_in_the_middle_of_a_task(rig: RecordedRig) -> None:
    rig.mark()
    rig.ask(Ask.ARM)
    rig.start_auto()
    rig.advance(0.9)
    assert rig.control.drive.shaper.speed_um_per_s > 1000.0
    rig.begin()
    rig.advance_until(Mode.MANUAL, 20.0)
    rig.advance(0.05)
    rig.end()
    rig.begin()
    rig.advance(1.0)
    rig.end()
    for folder in sorted(rig.root.iterdir()):
        replay = replay_trial(folder)
        assert replay.difference is None, str(replay.difference)
        assert replay.counts["steps"] > 90


def test_a_log_that_was_cut_off_is_replayed_to_where_it_ends(rig: RecordedRig) -> None:
    drive(rig)
    log = rig.end() / LOG_NAME
    whole = log.read_bytes()
    for share in (0.5, 0.7, 0.93):
        log.write_bytes(whole[: round(share * len(whole))])
        replay = replay_trial(log.parent)
        assert replay.difference is None, str(replay.difference)
        assert replay.counts["commands"] > 5


def test_a_log_that_ends_before_the_first_picture_is_replayed(rig: RecordedRig) -> None:
    rig.camera_alive = False
    rig.begin()
    rig.advance(0.05)
    replay = replay_trial(rig.end())
    assert replay.exact
    assert replay.counts["steps"] >= 5


@pytest.mark.parametrize(
    ("topic", "field"), [("command", "setpoint_um"), ("mode", "reason"), ("command", "asked_um_per_s")]
)
def test_the_first_difference_is_named(rig: RecordedRig, topic: str, field: str) -> None:
    drive(rig)
    log = rig.end() / LOG_NAME
    lines = [orjson.loads(line) for line in log.read_bytes().splitlines()]
    altered = [line for line in lines if line["topic"] == topic][1]
    value = altered["data"][field]
    altered["data"][field] = [value[0], value[1] + 1e-9, value[2]] if isinstance(value, list) else 7
    log.write_bytes(b"".join(orjson.dumps(line) + b"\n" for line in lines))
    replay = replay_trial(log.parent)
    assert not replay.exact
    assert replay.difference is not None
    assert replay.difference.seq == altered["seq"]
    assert replay.difference.topic == topic
    assert replay.difference.field.startswith(field)


@pytest.mark.parametrize("topic", ["command", "mode"])
def test_a_decision_that_is_missing_or_too_many_is_named(rig: RecordedRig, topic: str) -> None:
    drive(rig)
    log = rig.end() / LOG_NAME
    lines = log.read_bytes().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if orjson.loads(line)["topic"] == topic)
    log.write_bytes(b"".join(lines[:at] + lines[at + 1 :]))
    assert not replay_trial(log.parent).exact
    log.write_bytes(b"".join(lines[: at + 1] + lines[at:]))
    assert not replay_trial(log.parent).exact


def test_another_setting_is_named_as_the_reason(rig: RecordedRig) -> None:
    drive(rig)
    camera_freezes(rig)
    folder = rig.end()
    patient = SETTINGS.model_copy(update={"guards": GuardConfig(track_age_s=0.09)})
    replay = replay_trial(folder, settings=patient)
    assert not replay.exact
    assert replay.difference is not None
    assert "AUTO → HOLD" in str(replay.difference.replayed)
    assert replay.changed == ("setting guards.track_age_s: 0.1 → 0.09",)


def test_a_setting_that_was_not_known_then_is_named(rig: RecordedRig) -> None:
    drive(rig)
    log = rig.end() / LOG_NAME
    lines = [orjson.loads(line) for line in log.read_bytes().splitlines()]
    del lines[1]["data"]["handover"]["sharing"]["wall_um"], lines[1]["data"]["tip_watch"]
    log.write_bytes(b"".join(orjson.dumps(line) + b"\n" for line in lines))
    replay = replay_trial(log.parent)
    assert replay.exact
    named = [reason.partition(" → ")[0] for reason in replay.changed]
    assert sorted(named) == [
        "setting handover.sharing.wall_um: not known then",
        "setting tip_watch: not known then",
    ]


def test_a_setting_that_decides_nothing_changes_nothing(rig: RecordedRig) -> None:
    drive(rig)
    changed = SETTINGS.model_copy(update={"guards": GuardConfig(lead_um=4_000.0)})
    replay = replay_trial(rig.end(), settings=changed)
    assert replay.exact
    assert replay.changed


def test_another_calibration_is_named_as_the_reason(rig: RecordedRig) -> None:
    from dataclasses import replace

    drive(rig)
    x_um, y_um = rig.calibration.magnet_offset_um
    other = replace(rig.calibration, magnet_offset_um=(x_um + 40.0, y_um))
    replay = replay_trial(rig.end(), calibration=other)
    assert not replay.exact
    assert replay.changed == ("calibration",)


def test_another_policy_is_named(rig: RecordedRig) -> None:
    drive(rig)
    log = rig.end() / LOG_NAME
    head, _, rest = log.read_bytes().partition(b"\n")
    header = orjson.loads(head) | {"policy_sha256": "0" * 64}
    log.write_bytes(orjson.dumps(header) + b"\n" + rest)
    replay = replay_trial(log.parent)
    assert replay.exact, "its paths are recorded"
    assert [reason.split(":")[0] for reason in replay.changed] == ["policy of bifurcation"]


def test_another_result_is_a_difference(rig: RecordedRig) -> None:
    drive(rig)
    arrives(rig)
    folder = rig.end()
    from mrnav_server.study.trial_report import RESULT_NAME, write_trial_report

    write_trial_report(folder, rig.vessel)
    assert replay_trial(folder).exact
    result = orjson.loads((folder / RESULT_NAME).read_bytes())
    result["metrics"]["path_um"] += 1e-6
    (folder / RESULT_NAME).write_bytes(orjson.dumps(result))
    replay = replay_trial(folder)
    assert replay.difference is not None
    assert (replay.difference.topic, replay.difference.field) == ("result", "metrics.path_um")


def test_a_log_without_a_state_is_refused(rig: RecordedRig) -> None:
    drive(rig)
    log = rig.end() / LOG_NAME
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(lines[:2] + lines[3:]))
    with pytest.raises(ConfigError, match="without the state"):
        replay_trial(log.parent)


def commands(rig: RecordedRig) -> list[object]:
    folder = max(rig.root.iterdir())
    return [line for line in (folder / LOG_NAME).read_bytes().splitlines() if b'"topic":"command' in line]
