"""The emulated controller as a running process: sockets, knobs while it runs, trace, commands."""

import asyncio
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mrnav_server.cli.main import main
from mrnav_server.core.errors import ConfigError
from mrnav_server.devices.sensapex.emulated_device import EmulatedDevice
from mrnav_server.devices.sensapex.emulated_registers import DeviceModel
from mrnav_server.devices.sensapex.emulator import Emulator
from mrnav_server.devices.sensapex.smcp1 import (
    ALL_DEVICES,
    COMMAND,
    MOVE,
    QUERY,
    UNDEFINED,
    Block,
    Kind,
    Message,
    Option,
    decode,
    encode,
)
from tests.devices.emulator_process import MRNAV, EmulatorProcess, own_host

Mrnav = Callable[..., tuple[int, str, str]]
PC = 0x0257
SILENCE_S = 0.15


class Client:
    """A plain socket that speaks to the emulator."""

    def __init__(self, emulator: EmulatorProcess) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self._to = (emulator.host, emulator.port)
        self._number = 0

    def close(self) -> None:
        self.socket.close()

    def send(self, kind: Kind, *values: int, options: Option = QUERY, receiver: int = 1) -> int:
        self._number += 1
        blocks = (Block(values),) if values else ()
        self.socket.sendto(encode(Message(receiver, PC, self._number, options, kind, blocks)), self._to)
        return self._number

    def hear(self, longest_s: float = 5.0) -> Message | None:
        self.socket.settimeout(longest_s)
        try:
            return decode(self.socket.recv(2000))
        except TimeoutError:
            return None

    def ask(self, kind: Kind, *values: int, options: Option = QUERY, receiver: int = 1) -> Message:
        """Send a request and return its answer with data, or its ACK if it asks for no data."""
        number = self.send(kind, *values, options=options, receiver=receiver)
        wanted = Option.REPLY if options & Option.REQ_RESP else Option.ACK
        while (message := self.hear()) is not None:
            if message.id == number and message.options & ~Option.ERROR == wanted:
                return message
        raise AssertionError("no answer")

    def x_um(self) -> float:
        return self.ask(Kind.GET_POSITIONS).values[0] / 1000

    def goto_x(self, x_um: float, um_per_s: int = 5000) -> None:
        there = (round(x_um * 1000), UNDEFINED, UNDEFINED, UNDEFINED, um_per_s, 1)
        self.send(Kind.GOTO, *there, options=MOVE)

    def until(self, kind: Kind) -> list[Message]:
        """Return what is heard up to a message of this kind."""
        heard = []
        while (message := self.hear()) is not None:
            heard.append(message)
            if message.kind == kind:
                return heard
        raise AssertionError(f"no {kind.name}")


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorProcess]:
    with EmulatorProcess(tmp_path_factory.mktemp("emulator"), "--id", "1", "--id", "2") as emulator:
        yield emulator


@pytest.fixture
def emulator(process: EmulatorProcess) -> Iterator[EmulatorProcess]:
    before = process.turn()["knobs"]
    yield process
    process.turn(**before)
    with closing(Client(process)) as client:
        client.ask(Kind.STOP, options=COMMAND)
    while process.turn()["moving"]:
        time.sleep(0.005)


@pytest.fixture
def client(emulator: EmulatorProcess) -> Iterator[Client]:
    with closing(Client(emulator)) as plain:
        yield plain


def test_several_devices_answer_on_one_socket(client: Client) -> None:
    client.send(Kind.PING, options=COMMAND, receiver=ALL_DEVICES)
    heard = [client.hear(), client.hear()]
    assert {message.sender for message in heard if message} == {1, 2}
    assert client.ask(Kind.GET_PARAMETER, 3, receiver=2).values == (3, 2)


def test_a_device_that_is_not_there_is_silent(client: Client) -> None:
    client.send(Kind.PING, options=COMMAND, receiver=9)
    assert client.hear(SILENCE_S) is None


def test_a_goto_runs_in_real_time(emulator: EmulatorProcess, client: Client) -> None:
    start_um = client.x_um()
    began_s = time.monotonic()
    client.goto_x(start_um + 200.0, 1000)
    heard = client.until(Kind.GOTO_DONE)
    assert time.monotonic() - began_s >= 0.2 + 1000 / 50_000 - 0.001
    assert sum(message.kind == Kind.POSITION for message in heard) >= 10
    assert client.x_um() == pytest.approx(start_um + 200.0, abs=0.5)


def test_an_unknown_or_broken_datagram_is_survived(emulator: EmulatorProcess, client: Client) -> None:
    for data in (b"", b"x", b"\xff" * 1500, bytes(16), bytes.fromhex("1000" * 8)):
        client.socket.sendto(data, (emulator.host, emulator.port))
    assert client.ask(Kind.PING, options=COMMAND).options == Option.ACK


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=100), tail=st.binary(max_size=60))
def test_garbage_is_survived(emulator: EmulatorProcess, client: Client, data: bytes, tail: bytes) -> None:
    head = encode(Message(2, PC, 1, QUERY, Kind.GOTO, ()))[:14]
    for garbage in (data, head + tail):
        client.socket.sendto(garbage, (emulator.host, emulator.port))
    assert client.ask(Kind.PING, options=COMMAND).options == Option.ACK


def test_the_control_port_tells_knobs_and_truth(emulator: EmulatorProcess) -> None:
    state = emulator.turn(device=2, drop_acks=1)
    assert state["device"] == 2
    assert state["knobs"]["drop_acks"] == 1
    assert state["true_um"] == [10_000.0] * 4
    assert state["moving"] is False
    assert abs(state["t"] - time.monotonic()) < 5.0
    assert emulator.turn()["device"] == 1
    assert emulator.turn(device=2, drop_acks=0)["knobs"]["drop_acks"] == 0


@pytest.mark.parametrize(
    "line",
    [
        b"[]",
        b"{",
        b'{"device": 9}',
        b'{"device": []}',
        b'{"reboot": 1}',
        b'{"stall": "q"}',
        b"\xff",
        b"[" * 3000,
    ],
)
def test_a_wrong_line_at_the_control_port_is_told(emulator: EmulatorProcess, line: bytes) -> None:
    with socket.create_connection((emulator.host, emulator.control_port), 5.0) as connection:
        connection.sendall(line + b"\n{}\n")
        with connection.makefile("rb") as answers:
            assert json.loads(answers.readline())["error"]
            assert json.loads(answers.readline())["device"] == 1


def test_an_endless_line_at_the_control_port_ends_the_connection(emulator: EmulatorProcess) -> None:
    with socket.create_connection((emulator.host, emulator.control_port), 5.0) as connection:
        connection.sendall(b" " * 20_000)
        with connection.makefile("rb") as answers:
            assert answers.read() == b""
    assert emulator.turn()["device"] == 1


# Each knob, turned while it runs


def test_knob_drop_acks(emulator: EmulatorProcess, client: Client) -> None:
    emulator.turn(drop_acks=2)
    for _ in range(2):
        client.send(Kind.PING, options=COMMAND)
        assert client.hear(SILENCE_S) is None
    client.ask(Kind.PING, options=COMMAND)
    assert emulator.turn()["knobs"]["drop_acks"] == 0


def test_knob_drop_requests(emulator: EmulatorProcess, client: Client) -> None:
    emulator.turn(drop_requests=1)
    client.goto_x(5000.0)
    assert client.hear(SILENCE_S) is None
    assert emulator.turn()["moving"] is False
    client.goto_x(9000.0)
    client.until(Kind.STATUS)


def test_knob_lose_completion(emulator: EmulatorProcess, client: Client) -> None:
    emulator.turn(lose_completion=True)
    client.goto_x(client.x_um() + 20.0)
    while (message := client.hear(SILENCE_S)) is not None:
        assert message.kind != Kind.GOTO_DONE
    assert emulator.turn()["moving"] is False


def test_knob_no_status(emulator: EmulatorProcess, client: Client) -> None:
    emulator.turn(no_status=True)
    client.goto_x(client.x_um() + 20.0)
    assert {m.kind for m in client.until(Kind.GOTO_DONE)} == {Kind.GOTO, Kind.POSITION, Kind.GOTO_DONE}


def test_knob_mute(emulator: EmulatorProcess, client: Client) -> None:
    emulator.turn(mute=True)
    client.goto_x(5000.0)
    assert client.hear(SILENCE_S) is None
    assert emulator.turn()["moving"] is True


def test_knob_latency_and_jitter(emulator: EmulatorProcess, client: Client) -> None:
    emulator.turn(latency_ms=80, jitter_ms=20)
    began_s = time.monotonic()
    client.ask(Kind.PING, options=COMMAND)
    assert time.monotonic() - began_s >= 0.08


def test_knob_stall(emulator: EmulatorProcess, client: Client) -> None:
    client.goto_x(client.x_um() - 5000.0, 1000)
    client.until(Kind.POSITION)
    stuck_um = emulator.turn(stall="x")["true_um"][0]
    time.sleep(0.05)
    state = emulator.turn()
    assert state["true_um"][0] == stuck_um
    assert state["moving"] is True
    emulator.turn(stall="")
    time.sleep(0.05)
    assert emulator.turn()["true_um"][0] < stuck_um - 5.0


def test_knob_offset(emulator: EmulatorProcess, client: Client) -> None:
    before_um = client.x_um()
    emulator.turn(offset_um=[25.0, 0, 0])
    assert client.x_um() == pytest.approx(before_um + 25.0, abs=0.5)


def test_knob_freeze_reading(emulator: EmulatorProcess, client: Client) -> None:
    before_um = client.x_um()
    emulator.turn(freeze_reading=True)
    client.goto_x(before_um + 50.0)
    client.until(Kind.GOTO_DONE)
    assert client.x_um() == pytest.approx(before_um, abs=0.5)
    assert emulator.turn()["true_um"][0] == pytest.approx(before_um + 50.0, abs=0.5)


def test_knob_calibration_lost(emulator: EmulatorProcess, client: Client) -> None:
    emulator.turn(calibration_lost=True)
    assert client.x_um() < -900_000.0


def test_knob_noise(emulator: EmulatorProcess, client: Client) -> None:
    emulator.turn(noise_um=0)
    assert client.x_um() == client.x_um()
    emulator.turn(noise_um=5)
    assert len({client.x_um() for _ in range(5)}) == 5


def test_reboot_through_the_control_port_and_over_the_wire(emulator: EmulatorProcess, client: Client) -> None:
    client.goto_x(client.x_um() - 3000.0, 1000)
    client.until(Kind.POSITION)
    state = emulator.turn(reboot=True, silence_s=0.2)
    assert (state["moving"], state["rebooting"]) == (False, True)
    assert client.until(Kind.HELLO)[-1].blocks == ()
    began_s = time.monotonic()
    client.ask(Kind.REBOOT, options=COMMAND)
    client.send(Kind.PING, options=COMMAND)
    assert [m.kind for m in client.until(Kind.HELLO)] == [Kind.HELLO]
    assert time.monotonic() - began_s >= 0.2


# Trace and commands


def test_the_trace_has_every_datagram_both_ways(emulator: EmulatorProcess, client: Client) -> None:
    before = len(emulator.trace())
    sent_s = time.monotonic()
    client.ask(Kind.PING, options=COMMAND)
    client.socket.sendto(b"\x01\x02", (emulator.host, emulator.port))
    client.ask(Kind.GET_VERSION)
    lines = emulator.trace()[before:]
    assert [(line["dir"], line["kind"].partition(":")[0]) for line in lines][:5] == [
        ("rx", "PING"),
        ("tx", "PING"),
        ("rx", "bad"),
        ("rx", "GET_VERSION"),
        ("tx", "GET_VERSION"),
    ]
    assert decode(bytes.fromhex(lines[1]["hex"])).options == Option.ACK
    assert lines[0]["peer"] == f"127.0.0.1:{client.socket.getsockname()[1]}"
    assert lines[2]["hex"] == "0102"
    assert sent_s <= lines[0]["t"] <= lines[1]["t"] <= time.monotonic()


@pytest.fixture
def mrnav(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Mrnav:
    """The command in this process: its exit code, what it says, and what errors it tells."""

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["mrnav", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, " ".join(said.err.split())

    return run


def test_emulate_set_turns_knobs(emulator: EmulatorProcess, mrnav: Mrnav) -> None:
    where = f"{emulator.host}:{emulator.control_port}"
    code, out, err = mrnav(
        "emulate", "set", where, "stall=y", "offset_um=1,2,3", "mute=true", "--device", "2"
    )
    assert code == 0, err
    knobs = json.loads(out)["knobs"]
    assert (knobs["stall"], knobs["offset_um"], knobs["mute"]) == ("y", [1.0, 2.0, 3.0], True)
    assert emulator.turn(device=2, stall="", offset_um=[], mute=False)["knobs"]["stall"] == ""


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("{where}", "mute=perhaps"), 2, "mute is true or false"),
        (("{where}", "mute"), 2, "NAME=VALUE"),
        (("127.0.0.1:1",), 1, "no emulator answers"),
    ],
)
def test_emulate_set_tells_what_is_wrong(
    emulator: EmulatorProcess, mrnav: Mrnav, arguments: tuple[str, ...], code: int, said: str
) -> None:
    where = f"{emulator.host}:{emulator.control_port}"
    ended, _, err = mrnav("emulate", "set", *(part.format(where=where) for part in arguments))
    assert ended == code
    assert said in err


def test_knobs_at_the_start_and_a_clean_end(tmp_path: Path) -> None:
    options = ("--axes", "3", "--at", "1000,2000,3000", "--stall", "xy", "--offset-um", "1,2", "--mute")
    with EmulatorProcess(tmp_path, *options, "--drop-acks", "3", "--silence-s", "0.5") as emulator:
        state = emulator.turn()
        assert state["true_um"] == [1000.0, 2000.0, 3000.0]
        knobs = state["knobs"]
        assert (knobs["stall"], knobs["mute"], knobs["drop_acks"]) == ("xy", True, 3)
        assert (knobs["offset_um"], knobs["silence_s"]) == ([1.0, 2.0], 0.5)
        emulator.process.send_signal(signal.SIGINT)
        assert emulator.process.wait(10.0) == 0


def test_two_emulators_on_one_address_are_told_so(emulator: EmulatorProcess) -> None:
    command = (*MRNAV, "emulate", "ump", "--host", emulator.host, "--at", "1,1,1")
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2
    assert "is another one running?" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--at", "a,b"), "--at is numbers"),
        (("--at", "1,2,30000"), "at is up to 4 positions"),
        (("--at", "1,1,1", "--stall", "q"), "stall is letters"),
        (("--at", "1,1,1", "--id", "400"), "id is 1..254"),
        (("--at", "1,1,1", "--id", "4", "--id", "4"), "same id"),
    ],
)
def test_a_wrong_option_is_told(mrnav: Mrnav, arguments: tuple[str, ...], said: str) -> None:
    code, _, err = mrnav("emulate", "ump", "--host", own_host(), *arguments)
    assert code == 2
    assert said in err


def test_without_a_place_it_stands_where_the_simulated_rig_begins(
    mrnav: Mrnav, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mrnav_server.settings import load_settings
    from mrnav_server.sim.world import SimulatedWorld
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    built: list[EmulatedDevice] = []

    async def keep(*arguments: list[EmulatedDevice]) -> None:
        built.extend(arguments[-1])

    monkeypatch.setattr("mrnav_server.cli.emulate._run", keep)
    assert mrnav("emulate", "ump")[0] == 0
    rig = load_settings(None, {})
    vessel = load_vessel_model(find_model(rig.rig.vessel))
    tip = SimulatedWorld(rig.sim, vessel, rig.camera).tip
    assert built[0].true_state(0.0)["true_um"] == pytest.approx([tip.x_um, tip.y_um, tip.z_um, 10_000.0])


def test_starting_imports_nothing_heavy() -> None:
    heavy = {"torch", "cv2", "numpy", "scipy", "pydantic", "mrnav_server.settings"}
    program = (
        f"import sys, mrnav_server.devices.sensapex.emulator;print(sorted({heavy!r} & set(sys.modules)))"
    )
    done = subprocess.run([MRNAV[0], "-c", program], capture_output=True, text=True, timeout=30, check=True)
    assert done.stdout.strip() == "[]"


# The shell inside this process


async def test_ports_are_given_back_and_closing_twice_is_harmless() -> None:
    for _ in range(2):
        emulator = Emulator([EmulatedDevice(DeviceModel())])
        ports = await emulator.open(own_host(), 55_555)
        assert ports.control_port == 56_555
        await emulator.close()
        await emulator.close()


async def test_free_ports_are_taken_on_wish() -> None:
    emulator = Emulator([EmulatedDevice(DeviceModel())])
    ports = await emulator.open("127.0.0.1", 0, 0)
    await emulator.close()
    assert 0 not in (ports.port, ports.control_port)


async def test_two_devices_of_one_id_are_refused() -> None:
    with pytest.raises(ConfigError, match="same id"):
        Emulator([EmulatedDevice(DeviceModel()), EmulatedDevice(DeviceModel())])


async def test_an_open_client_of_the_control_port_does_not_hold_the_end_up() -> None:
    emulator = Emulator([EmulatedDevice(DeviceModel())])
    ports = await emulator.open("127.0.0.1", 0, 0)
    reader, writer = await asyncio.open_connection(ports.host, ports.control_port)
    writer.write(b"{}\n")
    assert json.loads(await reader.readline())["device"] == 1
    await emulator.close()
    assert await reader.read() == b""
    writer.close()
