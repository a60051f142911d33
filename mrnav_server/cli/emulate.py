"""``mrnav emulate``: an emulated manipulator controller, and the knobs of a running one."""

import asyncio
import json
import os
import signal
import socket
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mrnav_server.core.errors import ConfigError, DeviceError
from mrnav_server.devices.sensapex.emulated_device import EmulatedDevice
from mrnav_server.devices.sensapex.emulated_motion import TRAVEL_UM
from mrnav_server.devices.sensapex.emulated_registers import DeviceModel
from mrnav_server.devices.sensapex.emulator import Emulator, Ports
from mrnav_server.devices.sensapex.emulator_faults import Faults
from mrnav_server.devices.sensapex.smcp1 import BASE_PORT

if TYPE_CHECKING:
    from mrnav_server.settings import Settings

_ANSWER_S = 5.0

emulate = typer.Typer(no_args_is_help=True, help="Emulated devices, and what is wrong with them.")


@emulate.command()
def ump(
    host: Annotated[str, typer.Option(help="IPv4 address to listen on.")] = "127.0.0.1",
    group: Annotated[int, typer.Option(min=0, max=10, help="The UDP port is 55555 plus this.")] = 0,
    axes: Annotated[int, typer.Option(min=3, max=4, help="Axes of each device.")] = 4,
    device_ids: Annotated[
        list[int] | None,
        typer.Option("--id", help="A device's id, 1..254, or its serial number; repeatable."),
    ] = None,
    at: Annotated[
        str, typer.Option(help="Where the devices stand: X,Y,Z[,W] in µm; the settings' rig if left out.")
    ] = "",
    config: Annotated[
        Path | None,
        typer.Option("--config", help="TOML file with the settings of the rig that --at follows."),
    ] = None,
    trace: Annotated[Path | None, typer.Option(help="File that gets each datagram as a JSON line.")] = None,
    ready_file: Annotated[Path | None, typer.Option(help="File that gets the ports as JSON.")] = None,
    control_port: Annotated[
        int | None, typer.Option(help="TCP port of the knobs; the device port plus 1000 if left out.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the readings' noise.")] = 0,
    drop_acks: Annotated[int, typer.Option(min=0, help="Requests done but not answered.")] = 0,
    drop_requests: Annotated[int, typer.Option(min=0, help="Requests lost on their way.")] = 0,
    lose_completion: Annotated[bool, typer.Option(help="Never say that a goto is completed.")] = False,
    no_status: Annotated[bool, typer.Option(help="Never say that the status changed.")] = False,
    mute: Annotated[bool, typer.Option(help="Send nothing; do what is asked.")] = False,
    latency_ms: Annotated[float, typer.Option(help="Delay of everything sent.")] = 0.0,
    jitter_ms: Annotated[float, typer.Option(help="Random addition to the delay.")] = 0.0,
    stall: Annotated[str, typer.Option(help="Axes that are stuck: x, yz, ...")] = "",
    offset_um: Annotated[str, typer.Option(help="What readings are off by: DX,DY,DZ[,DW].")] = "",
    freeze_reading: Annotated[bool, typer.Option(help="Readings stay what they are.")] = False,
    calibration_lost: Annotated[bool, typer.Option(help="The zero is lost.")] = False,
    noise_um: Annotated[float, typer.Option(help="Standard deviation of a reading.")] = 0.05,
    silence_s: Annotated[float, typer.Option(help="How long a reboot takes.")] = 2.0,
) -> None:
    """Emulate a Sensapex controller with uMp manipulators until Ctrl-C; knobs can be turned meanwhile."""
    faults = Faults().changed(
        {
            "drop_acks": drop_acks,
            "drop_requests": drop_requests,
            "lose_completion": lose_completion,
            "no_status": no_status,
            "mute": mute,
            "latency_ms": latency_ms,
            "jitter_ms": jitter_ms,
            "stall": stall,
            "offset_um": _numbers("--offset-um", offset_um),
            "freeze_reading": freeze_reading,
            "calibration_lost": calibration_lost,
            "noise_um": noise_um,
            "silence_s": silence_s,
        }
    )
    if at:
        start_um = _numbers("--at", at)
    else:
        from mrnav_server.settings import load_settings

        start_um = start_of_the_rig(load_settings(config, os.environ))
    devices = [
        EmulatedDevice(DeviceModel(number, axes, start_um, port=BASE_PORT + group, seed=seed), faults)
        for number in device_ids or [1]
    ]
    with ExitStack() as stack:
        # Line by line, so that who reads the trace of a running emulator finds all of it.
        lines = stack.enter_context(trace.open("w", buffering=1)) if trace else None
        emulator = Emulator(devices, lines)
        asyncio.run(_run(emulator, host, BASE_PORT + group, control_port, ready_file, devices))


@emulate.command("set")
def set_knobs(
    address: Annotated[str, typer.Argument(metavar="HOST:PORT", help="The emulator's control port.")],
    knobs: Annotated[list[str] | None, typer.Argument(metavar="KNOB=VALUE...")] = None,
    device: Annotated[int | None, typer.Option(help="Id of the device; the first if left out.")] = None,
    reboot: Annotated[bool, typer.Option("--reboot", help="Reboot it.")] = False,
) -> None:
    """Turn knobs of a running emulator, and print them all with where the device really is."""
    ask: dict[str, Any] = {"reboot": True} if reboot else {}
    if device is not None:
        ask["device"] = device
    ask.update(_knob(text) for text in knobs or ())
    answer = _asked(address, ask)
    if "error" in answer:
        raise ConfigError(answer["error"])
    typer.echo(json.dumps(answer))


async def _run(
    emulator: Emulator,
    host: str,
    port: int,
    control_port: int | None,
    ready_file: Path | None,
    devices: list[EmulatedDevice],
) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: loop.call_soon_threadsafe(ended.set))
    try:
        ports = await emulator.open(host, port, control_port)
        _announce(ports, [device.id for device in devices], ready_file)
        await ended.wait()
    finally:
        await emulator.close()


def _announce(ports: Ports, ids: list[int], ready_file: Path | None) -> None:
    typer.echo(
        f"Emulated controller on {ports.host}:{ports.port} (UDP), devices {', '.join(map(str, ids))}; "
        f"knobs on {ports.host}:{ports.control_port} (TCP). Ctrl-C stops."
    )
    if ready_file is not None:
        ready = {
            "host": ports.host,
            "port": ports.port,
            "control_port": ports.control_port,
            "devices": ids,
            "pid": os.getpid(),
        }
        part = ready_file.with_name(ready_file.name + ".part")
        part.write_text(json.dumps(ready) + "\n")
        part.replace(ready_file)


def start_of_the_rig(settings: "Settings") -> tuple[float, ...]:
    """Return where the tip of the settings' simulated rig begins, in µm, so that it meets the vessel."""
    from mrnav_server.sim.world import SimulatedWorld
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    vessel = load_vessel_model(find_model(settings.rig.vessel))
    tip = SimulatedWorld(settings.sim, vessel, settings.camera).tip
    return tip.x_um, tip.y_um, tip.z_um, TRAVEL_UM / 2


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise ConfigError(f"{option} is numbers with commas between, not {text!r}") from None


def _knob(text: str) -> tuple[str, Any]:
    name, sign, value = text.partition("=")
    if not sign:
        raise ConfigError(f"a knob is set as NAME=VALUE, not {text!r}")
    if name == "offset_um":
        return name, list(_numbers(name, value))
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def _asked(address: str, ask: dict[str, Any]) -> dict[str, Any]:
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host, int(port)), _ANSWER_S) as connection:
            connection.sendall(json.dumps(ask).encode() + b"\n")
            with connection.makefile("rb") as lines:
                answer: dict[str, Any] = json.loads(lines.readline())
                return answer
    except (OSError, ValueError) as error:
        raise DeviceError(
            f"no emulator answers at {address}: {error}; its ready file names the port"
        ) from None
