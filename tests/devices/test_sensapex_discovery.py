"""Which controllers are found, and what the settings accept."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.errors import DeviceError
from mrnav_server.devices.sensapex.config import SensapexConfig, device_id_of, is_device, wire_id
from mrnav_server.devices.sensapex.discovery import discover, find, is_emulated
from mrnav_server.devices.sensapex.smcp1 import Kind, Message, Option, decode, encode
from tests.devices.emulator_process import EmulatorProcess, own_host
from tests.devices.sensapex_rig import config_of, kinds, sound


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorProcess]:
    folder = tmp_path_factory.mktemp("found")
    with EmulatorProcess(folder, "--id", "2", "--id", "5", "--at", "1000,2000,3000,4000") as running:
        yield running


@pytest.fixture
def emulator(process: EmulatorProcess) -> EmulatorProcess:
    return sound(process, device=2)


async def test_all_that_answer_are_found_and_described(emulator: EmulatorProcess) -> None:
    found = await discover([own_host(), emulator.host], emulator.port, time.monotonic)
    assert [(one.device_id, one.address, one.port, one.axes) for one in found] == [
        (2, emulator.host, emulator.port, 4),
        (5, emulator.host, emulator.port, 4),
    ]
    for one in found:
        assert one.position_um == pytest.approx((1000.0, 2000.0, 3000.0, 4000.0), abs=0.5)
        assert one.version == ".".join(map(str, one.firmware))
        assert len(one.firmware) == 5
    asked = {row["kind"] for row in emulator.trace() if row["dir"] == "rx"}
    assert asked <= {"PING", "GET_VERSION", "GET_PARAMETER", "GET_POSITIONS", "SET_FEATURE"}


async def test_one_lost_ping_hides_nobody(emulator: EmulatorProcess) -> None:
    emulator.turn(device=5, drop_requests=1)
    found = await discover([emulator.host], emulator.port, time.monotonic)
    assert [one.device_id for one in found] == [2, 5]


async def test_nobody_answers() -> None:
    assert await discover([own_host()], 55555, time.monotonic, timeout_s=0.05) == []


async def test_the_settings_name_one(emulator: EmulatorProcess) -> None:
    assert (await find(config_of(emulator, device_id=5), time.monotonic)).device_id == 5
    assert kinds(emulator, "GOTO") == []


@pytest.fixture
def dumb() -> Iterator[str]:
    """A host with a device that answers pings alone."""
    host = own_host()
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as device:
        device.bind((host, 55555))

        def serve() -> None:
            while (said := device.recvfrom(2048))[0]:
                asked = decode(said[0])
                if asked.kind == Kind.PING:
                    device.sendto(encode(Message(asked.sender, 1, asked.id, Option.ACK, Kind.PING)), said[1])
                    touch_screen = Message(asked.sender, 0x101, asked.id, Option.ACK, Kind.PING)
                    device.sendto(encode(touch_screen), said[1])

        thread = threading.Thread(target=serve)
        thread.start()
        yield host
        device.sendto(b"", (host, 55555))
        thread.join()


async def test_a_device_that_tells_nothing_is_refused(dumb: str) -> None:
    with pytest.raises(DeviceError, match="does not tell its axes and position: restart it"):
        await find(SensapexConfig(address=dumb), time.monotonic)


async def test_a_touch_screen_is_no_manipulator(dumb: str) -> None:
    found = await discover([dumb], 55555, time.monotonic, timeout_s=0.05)
    assert [(one.device_id, one.axes, one.position_um, one.version) for one in found] == [
        (1, 0, (), "unknown")
    ]


class TestSettings:
    def test_the_defaults_are_a_ump_4_of_group_a(self) -> None:
        config = SensapexConfig()
        assert (config.port, config.timeout_s, config.wire_id, config.axes) == (55555, 0.02, 1, 4)

    @pytest.mark.parametrize(
        ("setting", "value"),
        [
            ("address", "ump.lab.example"),
            ("address", "169.254.1"),
            ("address", "fe80::1"),
            ("group", 11),
            ("group", -1),
            ("device_id", 0),
            ("device_id", 255),
            ("device_id", 11_399_999),
            ("device_id", 11_499_999),
            ("device_id", 12_200_000),
            ("axes", 2),
            ("timeout_ms", 4),
            ("timeout_ms", 51),
            ("poll_hz", 29.0),
            ("poll_hz", float("nan")),
        ],
    )
    def test_what_cannot_be_is_refused_by_name(self, setting: str, value: object) -> None:
        settings: dict[str, Any] = {setting: value}
        with pytest.raises(ValueError, match=setting):
            SensapexConfig(**settings)

    def test_the_lab_s_network_is_asked_before_this_computer_unless_an_address_is_known(self) -> None:
        assert SensapexConfig().addresses == ("169.254.255.255", "127.0.0.1")
        assert SensapexConfig(address="169.254.1.7").addresses == ("169.254.1.7",)

    @pytest.mark.parametrize(
        ("address", "emulated"), [("127.0.0.1", True), ("127.0.0.9", True), ("169.254.1.7", False)]
    )
    def test_a_controller_on_this_computer_is_an_emulated_one(self, address: str, emulated: bool) -> None:
        assert is_emulated(address) is emulated

    def test_a_serial_number_has_an_id_of_its_own(self) -> None:
        assert wire_id(11_400_123) == 0x107B
        assert SensapexConfig(device_id=11_400_123).wire_id == 0x107B

    @given(number=st.integers(1, 0xFFFF).filter(is_device))
    def test_ids_and_numbers_belong_together(self, number: int) -> None:
        assert wire_id(device_id_of(number)) == number
        assert SensapexConfig(device_id=device_id_of(number)).wire_id == number
