"""The manipulator's path: setpoint to datagram, reading, STOP, and a server that dies or hangs.

Run from a checkout: ``python -m benchmarks.manipulator``. Prints one JSON object. The controller is emulated,
as a process of its own whose trace stamps every datagram on arrival; all figures are simulated.
"""

import argparse
import asyncio
import json
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.sdk import SdkManipulator
from mrnav_server.devices.sensapex.smcp1 import Kind
from mrnav_server.devices.sensapex.stop_until_rest import Tip
from mrnav_server.devices.sensapex.udp import UdpManipulator
from tests.devices.emulator_process import EmulatorProcess
from tests.devices.sensapex_rig import HAS_SDK
from tests.emulated_rig import EmulatedRig
from tests.hanging_server import COMMAND, HANG_S
from tests.rig_process import wait_for

SPEED_UM_PER_S = 2400.0
REPEAT_S = 0.02
"""The rig repeats a STOP after this time while it cannot see the tip rest."""


def summary(values: list[float], digits: int) -> dict[str, float]:
    """Return p50, p99 and the maximum."""
    p50, p99 = np.percentile(values, [50, 99])
    return {name: round(float(v), digits) for name, v in (("p50", p50), ("p99", p99), ("max", max(values)))}


def received(emulator: EmulatorProcess, kind: Kind) -> list[float]:
    """Return when datagrams of a kind reached the controller."""
    lines = emulator.trace()
    return [line["t"] for line in lines if line["dir"] == "rx" and line["kind"] == kind.name]


def goto_us(driver: type[UdpManipulator] | type[SdkManipulator], count: int) -> list[float]:
    """Return how long each setpoint took from ``move_to`` to its datagram, in µs.

    The UDP driver has put it on the wire when it stamps the command. The vendor's library sends from a thread
    and tells nobody when, so there it is the controller's stamp on arrival, which is later.
    """

    async def stream(emulator: EmulatorProcess) -> tuple[list[float], list[float]]:
        manipulator = driver(SensapexConfig(address=emulator.host), time.monotonic)
        await manipulator.open()
        asked_s, sent_s = [], []
        try:
            for step in range(count):
                # 100 setpoints a second, as the control loop sends them.
                await asyncio.sleep(0.01)
                target = StagePoint(10_000.0 + 20.0 * (step % 100), 10_000.0, 10_000.0)
                now_s = time.monotonic()
                command = manipulator.move_to(target, SPEED_UM_PER_S, now_s)
                asked_s.append(now_s)
                sent_s.append(command.sent_s)
            await asyncio.sleep(0.2)
        finally:
            await manipulator.close()
        return asked_s, sent_s

    with tempfile.TemporaryDirectory() as folder, EmulatorProcess(Path(folder)) as emulator:
        asked_s, sent_s = asyncio.run(stream(emulator))
        seen_s = received(emulator, Kind.GOTO)
    if driver is SdkManipulator:
        if len(seen_s) != len(asked_s):
            raise RuntimeError(f"of {len(asked_s)} setpoints {len(seen_s)} arrived: the machine is busy")
        sent_s = seen_s
    return [1e6 * (sent - asked) for asked, sent in zip(asked_s, sent_s, strict=True)]


def read_us(count: int) -> list[float]:
    """Return how long it takes to ask the controller for the position and to have it, in µs."""
    with tempfile.TemporaryDirectory() as folder, EmulatorProcess(Path(folder)) as emulator:
        tip = Tip((emulator.host, emulator.port), 1)
        took_us = []
        for _ in range(count):
            time.sleep(0.005)
            began_s = time.monotonic()
            if tip.position_um(0.5) is None:
                raise RuntimeError("the emulated controller gave no position")
            took_us.append(1e6 * (time.monotonic() - began_s))
    return took_us


def stop_ms(count: int, mute: bool) -> list[float]:
    """Return how long a STOP takes from a client's WebSocket message to the controller, in ms."""
    took_ms = []
    with tempfile.TemporaryDirectory() as folder, EmulatedRig(Path(folder)) as emulated:
        if mute:
            emulated.emulator.turn(mute=True)
            emulated.rig.until(lambda s: s["mode"] == "FAULT", "FAULT")
        stop = json.dumps({"type": "ask", "ask": "stop"})
        emulated.rig.send(stop)
        time.sleep(3.0)
        for _ in range(count):
            if mute:
                # Right after a repeat, so that the next one is not taken for the answer.
                wait_for(partial(repeated, emulated, time.monotonic()), 5.0, "a repeat")
            else:
                time.sleep(0.05)
            asked_s = time.monotonic()
            emulated.rig.send(stop)
            wait_for(partial(repeated, emulated, asked_s), 5.0, "STOP")
            took_ms.append(1e3 * (min(emulated.stops(asked_s)) - asked_s))
    return took_ms


def kill() -> tuple[float, float]:
    """Kill a server at full speed; return the time to STOP in ms and the travel since in µm."""
    with tempfile.TemporaryDirectory() as folder, EmulatedRig(Path(folder)) as emulated:
        emulated.prepare()
        emulated.go()
        speed_up(emulated)
        truth = emulated.truth()
        killed_s = time.monotonic()
        emulated.rig.process.kill()
        wait_for(partial(repeated, emulated, killed_s), 10.0, "STOP")
        wait_for(lambda: not emulated.truth()["moving"], 5.0, "rest")
        rest_um = emulated.truth()["true_um"]
        stopped_s = min(emulated.stops(killed_s))
        at_um = at_kill(truth, killed_s, emulated)
    travel_um = float(np.linalg.norm(np.subtract(rest_um, at_um)[:3]))
    return 1e3 * (stopped_s - killed_s), travel_um


def again(measure: Callable[[], tuple[float, float]], say: Console) -> tuple[float, float]:
    """Measure; three times if the task did not come up to speed or the machine was too busy to tell."""
    for _ in range(2):
        try:
            return measure()
        except RuntimeError as error:
            say.print(f"measured again: {error}")
    return measure()


def speed_up(emulated: EmulatedRig) -> None:
    """Wait until the tip moves at full speed."""
    deadline_s = time.monotonic() + 5.0
    before = emulated.truth()
    while time.monotonic() < deadline_s:
        time.sleep(0.01)
        now = emulated.truth()
        if speed(before, now) >= SPEED_UM_PER_S:
            return
        before = now
    raise RuntimeError(f"the tip never reached {SPEED_UM_PER_S:g} µm/s")


def speed(before: dict[str, Any], now: dict[str, Any]) -> float:
    """Return the true speed between two looks, in µm/s."""
    way_um = np.linalg.norm(np.subtract(now["true_um"], before["true_um"])[:3])
    return float(way_um / max(now["t"] - before["t"], 1e-6))


def at_kill(truth: dict[str, Any], killed_s: float, emulated: EmulatedRig) -> list[float]:
    """Return where the tip was when the server was killed: the look was within a millisecond of it."""
    if killed_s - truth["t"] > 2e-3:
        raise RuntimeError("the machine is too busy to say where the tip was when the server was killed")
    return list(truth["true_um"])


def hang(count: int, progress: Console) -> list[float]:
    """Return the time from the last beat of a hanging server to STOP, in ms."""
    with (
        tempfile.TemporaryDirectory() as name,
        EmulatedRig(Path(name), command=COMMAND) as emulated,
    ):
        report = Path(name) / "trials" / "supervisor.jsonl"
        emulated.prepare()
        emulated.go()
        for round_ in track(range(count), "server hung", console=progress, transient=True):
            emulated.rig.process.send_signal(signal.SIGUSR1)
            wait_for(partial(reported, report, round_ + 1), HANG_S + 10.0, "the report")
            emulated.rig.until(lambda s: s["mode"] == "FAULT", "FAULT", 10.0)
            wait_for(partial(emulated.granted, "reset"), 10.0, "reset")
            if round_ + 1 < count:
                wait_for(partial(emulated.granted, "arm"), 10.0, "arm")
        lines = report.read_text().splitlines()
    return [json.loads(line)["silent_ms"] for line in lines if json.loads(line)["reason"] == "hung"]


def reported(file: Path, count: int) -> bool:
    """Tell whether the supervisor has written this many reports."""
    return file.exists() and len(file.read_text().splitlines()) >= count


def repeated(emulated: EmulatedRig, since_s: float) -> bool:
    """Tell whether another STOP came after a time."""
    return bool(emulated.stops(since_s))


def main() -> None:
    """Measure all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=50, help="of every fault; 20 times as many setpoints")
    repeats = parser.parse_args().repeats
    say = Console(file=sys.stderr)
    result: dict[str, object] = {
        "udp_goto_us": summary(goto_us(UdpManipulator, 20 * repeats), 1),
        "sdk_goto_us": summary(goto_us(SdkManipulator, 20 * repeats), 1) if HAS_SDK else None,
        "read_us": summary(read_us(20 * repeats), 1),
    }
    say.print_json(data=result)
    result["stop_idle_ms"] = summary(stop_ms(repeats, mute=False), 2)
    result["stop_mute_ms"] = summary(stop_ms(repeats, mute=True), 2)
    say.print_json(data=result)
    result["hang_stop_ms"] = summary(hang(repeats, say), 2)
    killed: list[tuple[float, float]] = []
    for _ in track(range(repeats), "server killed", console=say, transient=True):
        killed.append(again(kill, say))
    result["kill_stop_ms"] = summary([stop for stop, _ in killed], 2)
    result["kill_travel_um"] = summary([travel for _, travel in killed], 1)
    print(json.dumps(result | {"n": repeats, "simulated": True}))


if __name__ == "__main__":
    main()
