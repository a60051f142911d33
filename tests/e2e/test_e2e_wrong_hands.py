"""Hands that lie, flood and jump, over the real socket of a running server on the simulated rig."""

import itertools
import json
import math
import socket
import time
from collections.abc import Callable

from tests.rig_process import RigProcess

SPEED_UM_PER_S = 3000.0
Line = Callable[[int, float], bytes]


def hand(seq: int, t_s: float, x_m: str | float, *, clutch: bool = True) -> bytes:
    fields = {"type": "hand", "seq": seq, "t": t_s, "p": ["@", 0, 0], "clutch": clutch, "valid": True}
    return json.dumps(fields).replace('"@"', str(x_m)).encode() + b"\n"


KINDS: dict[str, tuple[float, Line]] = {
    "teleport": (60.0, lambda k, t_s: hand(k, t_s, 2.0 * (-1) ** (k // 6))),
    "not a number": (60.0, lambda k, t_s: hand(k, t_s, "NaN")),
    "huge": (60.0, lambda k, t_s: hand(k, t_s, "1e308")),
    "beyond any number": (60.0, lambda k, t_s: hand(k, t_s, "1e999")),
    "flood": (1000.0, lambda k, t_s: hand(k, t_s, 0.001 * k)),
    "frozen clock": (60.0, lambda k, _: hand(k, 0.0, 0.002 * k)),
    "backward clock": (60.0, lambda k, t_s: hand(k, -t_s, 0.002 * k)),
    "clock that leaps": (60.0, lambda k, _: hand(k, 1e6 * k, 0.05 * k)),
    "replay": (60.0, lambda k, t_s: hand(k % 20, t_s, 0.002 * (k % 20))),
}


def send_all(rig: RigProcess, hz: float, line: Line) -> None:
    """Close the clutch like an honest hand, then send one second of the wrong kind."""
    with socket.create_connection(("127.0.0.1", rig.ready["hand_port"])) as link:
        hello = {"type": "hello", "v": 1, "role": "operator", "token": rig.ready["operator_token"]}
        rest = {"client": "wrong", "frame": "webxr", "rate_hz": 10, "simulated": True}
        link.sendall(json.dumps(hello | rest).encode() + b"\n")
        began_s = time.monotonic()
        for k in range(10):
            link.sendall(hand(k, k / 60, 0.0, clutch=k > 5))
            time.sleep(max(0.0, began_s + k / 60 - time.monotonic()))
        for k in range(10, 10 + int(hz)):
            due_s = began_s + 10 / 60 + (k - 10) / hz
            time.sleep(max(0.0, due_s - time.monotonic()))
            link.sendall(line(k, due_s - began_s))


def test_no_wrong_hand_breaks_a_limit_or_the_server(rig_process: RigProcess) -> None:
    rig = rig_process
    trial = rig.begin_trial()
    for name, (hz, line) in KINDS.items():
        seq = rig.state["seq"]
        send_all(rig, hz, line)
        rig.until(lambda s: not s["lease"]["hand"], f"the seat after {name}", 10.0)
        assert rig.state["seq"] > seq, name
        assert rig.state["mode"] in ("MANUAL", "HOLD"), (name, rig.state["reason"])
    rig.until(lambda s: s["mode"] == "HOLD" and s["rates_hz"]["tick"] > 20.0, "a server that ticks")
    rig.post(f"/api/v1/trials/{trial}/end", {})
    lines = rig.log(trial)
    told = [line.data["reason"] for line in lines if line.topic == "event" and line.data["event"] == "fault"]
    assert any("jump" in reason for reason in told)
    assert any("not finite" in reason for reason in told)
    commands = [line.data for line in lines if line.topic == "command"]
    assert len(commands) > 20
    for before, after in itertools.pairwise(commands):
        gap_um = math.dist(before["target_um"], after["target_um"])
        assert gap_um <= SPEED_UM_PER_S * (after["sent_s"] - before["sent_s"] + 0.05)
        assert all(0.0 <= at_um <= 20_000.0 for at_um in after["target_um"])
    assert {data["mode"] for data in commands} <= {"MANUAL", "HOLD"}
