"""Faults injected into running processes; `make faults` measures what is only ordered and bounded here."""

import math
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from mrnav_server.client.errors import ConnectionEndedError
from mrnav_server.client.hand import HandLink
from mrnav_server.loops.trial_log import LOG_NAME, read_log
from mrnav_server.study.replay import replay_trial
from tests.led_study import LedStudy
from tests.rig_process import RigProcess, wait_for

CEILING_S = 1.0


def drive(rig: RigProcess, mode: str) -> None:
    """Bring the rig into MANUAL or AUTO, in motion where the mode moves by itself."""
    if mode == "AUTO":
        rig.ask("auto")
        rig.until(lambda s: s["mode"] == "AUTO", "AUTO")
        time.sleep(0.5)
    else:
        rig.until(lambda s: s["mode"] == "MANUAL", "MANUAL")
        time.sleep(0.2)


def follow(
    hand: HandLink, condition: Callable[[dict[str, Any]], bool], *, clutch: bool, for_s: float = 20.0
) -> dict[str, Any]:
    """Move a hand to the right, 10 mm a second, until a twin is as it should be."""
    began_s, twin = time.monotonic(), None
    while (now_s := time.monotonic() - began_s) < for_s:
        hand.send((0.01 * now_s, 0.0, 0.0), clutch=clutch)
        for twin in hand.twins(for_s=1 / 60):
            if condition(twin):
                return twin
    raise AssertionError(f"not within {for_s} s: {twin}")


def again(link: Callable[[], HandLink]) -> HandLink:
    """Connect as soon as somebody listens again."""
    links: list[HandLink] = []

    def connects() -> bool:
        with suppress(ConnectionEndedError):
            links.append(link())
        return bool(links)

    wait_for(connects, 20.0, "the hand link of the next rig")
    return links[0]


@pytest.mark.parametrize("mode", ["MANUAL", "AUTO"])
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_an_operator_that_dies_or_freezes_holds_the_rig(
    rig_process: RigProcess, mode: str, how: signal.Signals
) -> None:
    rig = rig_process
    rig.start_operator()
    trial = rig.begin_trial()
    drive(rig, mode)
    assert rig.operator is not None
    rig.operator.send_signal(how)
    rig.until(lambda s: s["mode"] == "HOLD", "HOLD", 5.0)
    rig.post(f"/api/v1/trials/{trial}/end", {})
    lines = rig.log(trial)
    hold = next(line for line in lines if line.topic == "mode" and line.data["mode"] == "HOLD")
    heard_s = max(line.data["received_s"] for line in lines if line.topic == "hand" and line.t_s < hold.t_s)
    assert 0.0 < hold.t_s - heard_s < CEILING_S
    assert all(line.data["ahead_ms"] <= 100.0 for line in lines if line.topic == "command")
    after = [line for line in lines if line.topic == "command" and line.t_s > hold.t_s + 0.5]
    assert after == []


def test_sigterm_stops_the_manipulator_and_exits_cleanly(rig_process: RigProcess) -> None:
    rig = rig_process
    rig.start_operator()
    trial = rig.begin_trial()
    drive(rig, "AUTO")
    rig.process.send_signal(signal.SIGTERM)
    assert rig.process.wait(15) == 0
    lines = rig.log(trial)
    assert lines[-1].topic == "closed"
    stopped = [line for line in lines if line.topic == "event" and line.data["event"] == "rig_stopped"]
    assert len(stopped) == 1
    assert [line for line in lines if line.topic == "command" and line.t_s > stopped[0].t_s] == []


def test_stop_is_one_request_from_anyone_and_latches(rig_process: RigProcess) -> None:
    rig = rig_process
    rig.start_operator()
    rig.begin_trial()
    drive(rig, "AUTO")
    viewer = {"Authorization": f"Bearer {rig.ready['viewer_token']}"}
    assert rig.http.post("/api/v1/mode", json={"ask": "stop"}, headers=viewer).is_success
    rig.until(lambda s: s["mode"] == "STOP", "STOP", CEILING_S)
    refused = rig.http.post("/api/v1/mode", json={"ask": "auto"})
    assert refused.status_code == 409
    assert "reset" in refused.json()["detail"]
    rig.ask("reset")
    rig.until(lambda s: s["mode"] == "DISARMED", "DISARMED", CEILING_S)


def test_a_hand_is_told_of_another_vessel_and_drives_in_it(rig_process: RigProcess) -> None:
    rig = rig_process

    def link() -> HandLink:
        return HandLink("127.0.0.1", rig.ready["hand_port"], rig.ready["operator_token"], client="glove")

    rig.post("/api/v1/lease", {"client": "faults"})
    with link() as hand:
        rig.post("/api/v1/vessels/serpentine/choose", {})
        with pytest.raises(ConnectionEndedError, match="another vessel"):
            follow(hand, lambda _: False, clutch=False)
    with again(link) as hand:
        follow(hand, lambda twin: twin["track"]["state"] == "tracking", clutch=False)
        rig.http.headers["X-MRNAV-Session"] = hand.welcome["session"]
        rig.ask("arm")
        begun = follow(hand, lambda twin: twin["mode"] == "MANUAL", clutch=False)
        follow(hand, lambda twin: math.dist(twin["tip_um"], begun["tip_um"]) > 50.0, clutch=True)


def test_a_study_goes_on_after_its_server_was_killed_in_a_trial(tmp_path: Path) -> None:
    study = LedStudy(tmp_path)
    first, second = study.kill("drive", 1.0), study.kill("begin", 0.2)
    assert first.trial is not None
    lines = list(read_log(first.trial / LOG_NAME))
    # The promise is 0.25 s; the rest is for a test machine that schedules threads late.
    assert first.at_s - lines[-2].t_s < 0.25 + CEILING_S
    assert (lines[-1].topic, study.status(first.trial)) == ("closed", "interrupted")
    assert (second.step, second.again) == (first.step, True)
    assert not first.again
    replay = replay_trial(first.trial)
    assert replay.exact, str(replay.difference)
