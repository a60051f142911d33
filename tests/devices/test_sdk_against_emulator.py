"""The vendor's own library against the emulated controller: to it, the emulator must be a uMp."""

import ctypes
import importlib.util
import math
import platform
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

from mrnav_server.devices.sensapex.emulator_faults import Faults
from tests.devices.emulator_process import EmulatorProcess

_PACKAGE = importlib.util.find_spec("sensapex")
if sys.platform != "linux" or platform.machine() != "x86_64":
    pytest.skip("the vendor's library is there for Linux x86_64 only", allow_module_level=True)
if _PACKAGE is None or _PACKAGE.origin is None:
    pytest.skip(
        "the package sensapex is missing: pip install 'mrnav-server[sensapex]'", allow_module_level=True
    )

TIMEOUT, INVALID_ARGUMENT, PEER_ERROR = -3, -4, -7
COMPLETED, BUSY, FAILED = 0, 1, -1
NOWHERE = math.nan
NOISE_UM = 0.5
HOME_UM = (10_000.0, 10_000.0, 10_000.0, 19_900.0)


class Sdk:
    """One handle of the library."""

    def __init__(self, host: str, group: int = 0, timeout_ms: int = 50) -> None:
        assert _PACKAGE is not None
        assert _PACKAGE.origin is not None
        lib = ctypes.CDLL(str(Path(_PACKAGE.origin).with_name("libum.so")))
        f, i, p = ctypes.c_float, ctypes.c_int, ctypes.c_void_p
        lib.um_open.restype = p
        lib.um_open.argtypes = [ctypes.c_char_p, ctypes.c_uint, i]
        lib.um_get_version.restype = ctypes.c_char_p
        lib.um_goto_position.argtypes = [p, i, f, f, f, f, f, i, i]
        lib.um_goto_position_ext.argtypes = [p, i, *[f] * 8, i, i]
        lib.um_take_step.argtypes = [p, i, *[f] * 4, *[i] * 6]
        self._lib = lib
        self._handle = lib.um_open(host.encode(), timeout_ms, group)
        assert self._handle, "the library opens no socket"

    def call(self, name: str, *arguments: object) -> int:
        """Call a function of the library that takes the handle first."""
        handle = ctypes.c_void_p(self._handle)
        code: int = getattr(self._lib, name)(handle, *arguments)
        return code

    def close(self) -> None:
        self.call("um_close")

    def devices(self) -> list[int]:
        found = (ctypes.c_int * 50)()
        return sorted(found[: self.call("um_get_device_list", found, 50)])

    def positions(self, device: int = 1, oldest_ms: int = -1) -> list[float]:
        axes = [ctypes.c_float(NOWHERE) for _ in range(4)]
        code = self.call(
            "um_get_positions", device, oldest_ms, *map(ctypes.byref, axes), ctypes.byref(ctypes.c_int())
        )
        assert code > 0, code
        return [axis.value for axis in axes[:code]]

    def parameter(self, number: int) -> int:
        """Return the parameter's value, or the code of the error."""
        value = ctypes.c_int()
        code = self.call("um_get_param", 1, number, ctypes.byref(value))
        return code if code < 0 else value.value

    def wait(self, device: int = 1, longest_s: float = 5.0) -> int:
        """Wait until the library says that the drive has ended; return how."""
        deadline_s = time.monotonic() + longest_s
        while (status := self.call("um_get_drive_status", device)) == BUSY:
            assert time.monotonic() < deadline_s, "the library never reports an end"
            self.call("um_receive", 5)
        return status


@contextmanager
def _held_port() -> Iterator[None]:
    """Hold the port that every handle for loopback wants, so that each takes one of its own."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as holder:
        with suppress(OSError):
            holder.bind(("0.0.0.0", 55553))
        yield


@pytest.fixture(scope="module")
def controllers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[int, EmulatorProcess]]:
    """Emulated controllers by their number of axes; the second one has two devices more."""
    three, four = tmp_path_factory.mktemp("three"), tmp_path_factory.mktemp("four")
    with (
        EmulatorProcess(three, "--axes", "3", "--at", "10000,10000,10000") as with_three,
        EmulatorProcess(
            four, "--id", "1", "--id", "7", "--id", "11400123", "--at", "10000,10000,10000,19900"
        ) as with_four,
    ):
        yield {3: with_three, 4: with_four}


@pytest.fixture(params=[3, 4], ids=["3 axes", "4 axes"])
def axes(request: pytest.FixtureRequest) -> int:
    number: int = request.param
    return number


@pytest.fixture
def emulator(controllers: dict[int, EmulatorProcess], axes: int) -> EmulatorProcess:
    return _sound(controllers[axes])


@pytest.fixture
def four(controllers: dict[int, EmulatorProcess]) -> EmulatorProcess:
    return _sound(controllers[4])


def _sound(emulator: EmulatorProcess) -> EmulatorProcess:
    emulator.turn(**Faults().as_json())
    return emulator


@pytest.fixture
def sdk(emulator: EmulatorProcess) -> Iterator[Sdk]:
    with _held_port(), closing(Sdk(emulator.host)) as handle:
        yield handle
        handle.call("um_stop", 1)


@pytest.fixture
def sdk4(four: EmulatorProcess) -> Iterator[Sdk]:
    with _held_port(), closing(Sdk(four.host)) as handle:
        yield handle
        handle.call("um_stop", 1)


def goto(sdk: Sdk, *target_um: float, speed: float = 3000.0, mode: int = 1, highest: int = 0) -> int:
    target_um = (*target_um, *(NOWHERE,) * 4)[:4]
    return sdk.call("um_goto_position", 1, *target_um, speed, mode, highest)


def home(sdk: Sdk, axes: int = 4) -> list[float]:
    """Bring the device to a known place and return it."""
    home_um = list(HOME_UM[:axes])
    assert goto(sdk, *home_um, speed=5000.0) >= 0
    assert sdk.wait() == COMPLETED
    return home_um


def test_the_library_is_the_one_that_was_examined(sdk4: Sdk) -> None:
    version: bytes = sdk4._lib.um_get_version()
    assert version == b"v1.504"


def test_discovery_finds_every_device_of_a_socket(sdk4: Sdk) -> None:
    assert sdk4.devices() == [1, 7, 11400123]


def test_a_device_addressed_by_its_serial_number_moves(four: EmulatorProcess, sdk4: Sdk) -> None:
    assert 11400123 in sdk4.devices()
    sdk4.call("um_stop", 11400123)
    before_um = sdk4.positions(11400123)
    assert sdk4.call("um_take_step", 11400123, 50.0, 0.0, 0.0, 0.0, 1000, 0, 0, 0, 0, 0) >= 0
    moved_um = [before_um[0] + 50.0, *before_um[1:]]
    deadline_s = time.monotonic() + 5.0
    while four.turn(device=11400123)["moving"]:
        assert time.monotonic() < deadline_s
    assert sdk4.positions(11400123) == pytest.approx(moved_um, abs=NOISE_UM)


def test_ping_and_a_device_that_is_not_there(sdk: Sdk) -> None:
    assert sdk.call("um_ping", 1) >= 0
    assert sdk.call("um_ping", 99) == TIMEOUT


def test_version(sdk: Sdk) -> None:
    version = (ctypes.c_int * 5)()
    assert sdk.call("um_read_version", 1, version, 5) == 5
    assert tuple(version) == (1, 504, 0, 0, 0)


def test_axis_count(sdk: Sdk, axes: int) -> None:
    assert sdk.call("um_get_axis_count", 1) == axes


def test_positions(sdk: Sdk, axes: int) -> None:
    home_um = home(sdk, axes)
    assert sdk.positions() == pytest.approx(home_um, abs=NOISE_UM)


def test_a_goto_ends_where_and_when_it_is_completed(sdk: Sdk, axes: int) -> None:
    home(sdk, axes)
    target_um = [10_300.0, 9_800.5, 10_050.25, 19_990.0][:axes]
    assert goto(sdk, *target_um) >= 0
    assert sdk.call("um_get_drive_status", 1) == BUSY
    assert sdk.wait() == COMPLETED
    assert sdk.positions() == pytest.approx(target_um, abs=NOISE_UM)


def test_a_goto_of_longer_than_a_second_is_busy_until_it_ends(sdk4: Sdk) -> None:
    home(sdk4)
    began_s = time.monotonic()
    assert goto(sdk4, 10_700.0, speed=500.0) >= 0
    assert sdk4.wait() == COMPLETED
    assert time.monotonic() - began_s > 1.35
    assert sdk4.positions()[0] == pytest.approx(10_700.0, abs=NOISE_UM)


def test_own_speeds_of_the_axes_and_one_after_another(four: EmulatorProcess, sdk4: Sdk) -> None:
    home(sdk4)
    speeds = (3000.0, 1500.0, 0.0, 0.0)
    assert sdk4.call("um_goto_position_ext", 1, 10_200.0, 10_200.0, NOWHERE, NOWHERE, *speeds, 0, 0) >= 0
    seen = set()
    while (state := four.turn())["moving"]:
        seen.add(tuple(bool(v) for v in state["velocity_um_per_s"][:2]))
    assert seen <= {(True, False), (False, True), (False, False)}
    assert {(True, False), (False, True)} <= seen
    assert sdk4.wait() == COMPLETED
    assert sdk4.positions()[:2] == pytest.approx([10_200.0, 10_200.0], abs=NOISE_UM)


def test_a_speed_below_a_micrometre_per_second_is_kept(four: EmulatorProcess, sdk4: Sdk) -> None:
    home(sdk4)
    assert goto(sdk4, 10_100.0, speed=0.25) >= 0
    time.sleep(0.05)
    assert four.turn()["velocity_um_per_s"][0] == pytest.approx(0.25)


def test_an_axis_without_a_target_stays(sdk: Sdk, axes: int) -> None:
    home_um = home(sdk, axes)
    assert goto(sdk, NOWHERE, 10_100.0) >= 0
    assert sdk.wait() == COMPLETED
    assert sdk.positions() == pytest.approx([home_um[0], 10_100.0, *home_um[2:]], abs=NOISE_UM)


def test_a_goto_to_nowhere_is_completed_at_once(sdk: Sdk) -> None:
    assert goto(sdk, NOWHERE) >= 0
    assert sdk.wait(longest_s=0.9) == COMPLETED


def test_a_target_that_the_library_refuses_is_not_sent(four: EmulatorProcess, sdk4: Sdk) -> None:
    before = len(four.trace())
    assert goto(sdk4, 125_001.0) == INVALID_ARGUMENT
    assert goto(sdk4, -1001.0) == INVALID_ARGUMENT
    assert len(four.trace()) == before


def test_a_target_beyond_the_travel_ends_at_its_end(four: EmulatorProcess, sdk4: Sdk) -> None:
    home(sdk4)
    assert goto(sdk4, NOWHERE, NOWHERE, NOWHERE, 30_000.0) >= 0
    assert sdk4.wait() == COMPLETED
    assert four.turn()["true_um"][3] == 20_000.0


def test_stop_ends_a_goto_as_failed(sdk: Sdk, axes: int) -> None:
    home(sdk, axes)
    assert goto(sdk, 15_000.0) >= 0
    time.sleep(0.05)
    assert sdk.call("um_stop", 1) >= 0
    assert sdk.wait(longest_s=0.9) == FAILED
    rest_um = sdk.positions()
    assert 10_050.0 < rest_um[0] < 12_000.0
    time.sleep(0.05)
    assert sdk.positions() == pytest.approx(rest_um, abs=NOISE_UM)


def test_stop_all_stops_every_device(four: EmulatorProcess, sdk4: Sdk) -> None:
    for device in (1, 7):
        assert sdk4.call("um_goto_position", device, *map(ctypes.c_float, (500.0,) * 4 + (400.0,)), 1, 0) >= 0
    assert four.turn(device=7)["moving"]
    sdk4.call("um_stop_all")
    deadline_s = time.monotonic() + 1.0
    while four.turn(device=1)["moving"] or four.turn(device=7)["moving"]:
        assert time.monotonic() < deadline_s


def test_a_new_goto_replaces_the_one_before(sdk4: Sdk) -> None:
    home(sdk4)
    assert goto(sdk4, 12_000.0) >= 0
    sdk4.call("um_receive", 60)
    assert goto(sdk4, 9_950.0) >= 0
    assert sdk4.wait() == COMPLETED
    assert sdk4.positions()[0] == pytest.approx(9_950.0, abs=NOISE_UM)


def test_step(sdk: Sdk, axes: int) -> None:
    home_um = home(sdk, axes)
    assert sdk.call("um_take_step", 1, 30.0, -20.0, 0.0, 0.0, 1000, 1000, 0, 0, 0, 0) >= 0
    time.sleep(0.15)
    sdk.call("um_receive", 0)
    assert sdk.positions() == pytest.approx(
        [home_um[0] + 30.0, home_um[1] - 20.0, *home_um[2:]], abs=NOISE_UM
    )


def test_positions_while_moving_come_by_themselves(sdk4: Sdk) -> None:
    home(sdk4)
    assert goto(sdk4, 10_600.0, speed=3000.0) >= 0
    cached_um = []
    for _ in range(10):
        sdk4.call("um_receive", 12)
        cached_um.append(sdk4.positions(oldest_ms=0)[0])
    assert cached_um == sorted(cached_um)
    assert len(set(cached_um)) > 5
    assert cached_um[-1] > 10_100.0


def test_parameters(sdk: Sdk, axes: int) -> None:
    assert sdk.parameter(0x105) == axes
    assert 1 <= sdk.parameter(0x101) <= 4
    assert sdk.parameter(0x102) == 11_400_101
    assert sdk.parameter(3) == 1
    assert sdk.parameter(6) == 55555
    assert sdk.parameter(0x103) >= -1
    assert sdk.call("um_set_param", 1, 4, 300) >= 0
    assert sdk.parameter(4) == 300
    assert sdk.call("um_set_param", 1, 2, 1500) >= 0
    assert sdk.parameter(2) == 1500


def test_a_parameter_that_is_not_there_or_cannot_be_set(sdk: Sdk) -> None:
    assert sdk.parameter(0x201) == PEER_ERROR
    serial = sdk.parameter(0x102)
    sdk.call("um_cmd_options", 0x20)
    assert sdk.call("um_set_param", 1, 0x102, 5) == PEER_ERROR
    assert sdk.parameter(0x102) == serial


def test_an_angle_and_the_hand(sdk: Sdk) -> None:
    assert sdk.call("um_set_param", 1, 4, 305) >= 0
    angle = ctypes.c_float()
    assert sdk.call("ump_get_axis_angle", 1, ctypes.byref(angle)) >= 0
    assert angle.value == pytest.approx(30.5)
    assert sdk.call("um_set_param", 1, 0x80, 2) >= 0
    assert sdk.call("ump_get_handedness_configuration", 1) == 1
    assert sdk.call("um_set_param", 1, 0x80, 0) >= 0
    assert sdk.call("ump_get_handedness_configuration", 1) == 0


def test_features(sdk: Sdk) -> None:
    for value in (1, 0):
        assert sdk.call("um_set_feature", 1, 16, value) >= 0
        assert sdk.call("um_get_feature", 1, 16) == value
        assert sdk.call("um_set_slow_speed_mode", 1, value) >= 0
        assert sdk.call("um_get_slow_speed_mode", 1) == value
        assert sdk.call("um_set_soft_start_mode", 1, value) >= 0
        assert sdk.call("um_get_soft_start_mode", 1) == value
    assert sdk.call("um_get_feature", 1, 99) == PEER_ERROR


def test_motion_is_refused_while_it_is_prevented(sdk: Sdk, axes: int) -> None:
    home_um = home(sdk, axes)
    assert sdk.call("um_set_feature", 1, 17, 1) >= 0
    try:
        assert goto(sdk, 10_500.0) == TIMEOUT
        assert sdk.call("um_take_step", 1, 30.0, 0.0, 0.0, 0.0, 1000, 0, 0, 0, 0, 0) == TIMEOUT
    finally:
        assert sdk.call("um_set_feature", 1, 17, 0) >= 0
    assert sdk.positions() == pytest.approx(home_um, abs=NOISE_UM)


def test_lights_zero_and_calibration_are_taken(sdk: Sdk) -> None:
    assert sdk.call("ump_led_control", 1, 1) >= 0
    assert sdk.call("ump_led_control", 1, 0) >= 0
    assert sdk.call("um_save_zero", 1) >= 0
    assert sdk.call("ump_calibrate_load", 1) >= 0


def test_a_lost_acknowledgement_does_not_move_twice(emulator: EmulatorProcess, sdk: Sdk, axes: int) -> None:
    home(sdk, axes)
    before = len(emulator.trace())
    emulator.turn(drop_acks=2)
    # The code is not looked at: a notification that comes while the library waits can end its tries early.
    sdk.call("um_take_step", 1, 40.0, 0.0, 0.0, 0.0, 3000, 0, 0, 0, 0, 0)
    time.sleep(0.2)
    sent = [
        line["hex"] for line in emulator.trace()[before:] if line["kind"] == "STEP" and line["dir"] == "rx"
    ]
    assert len(sent) >= 2
    assert len(set(sent)) == 1
    assert sdk.positions()[0] == pytest.approx(10_040.0, abs=NOISE_UM)


def test_more_lost_answers_than_retries_are_a_timeout(emulator: EmulatorProcess, sdk: Sdk) -> None:
    emulator.turn(drop_acks=3)
    assert sdk.call("um_stop", 1) == TIMEOUT
    assert sdk.call("um_stop", 1) >= 0


def test_a_mute_device_is_a_timeout(emulator: EmulatorProcess, sdk: Sdk) -> None:
    emulator.turn(mute=True)
    assert sdk.call("um_ping", 1) == TIMEOUT


def test_without_status_a_long_goto_is_called_completed_after_a_second(
    four: EmulatorProcess, sdk4: Sdk
) -> None:
    home(sdk4)
    four.turn(no_status=True)
    assert goto(sdk4, 11_000.0, speed=500.0) >= 0
    assert sdk4.wait() == COMPLETED
    assert 10_400.0 < four.turn()["true_um"][0] < 10_900.0


def test_a_lost_completion_is_made_up_for_after_a_second(four: EmulatorProcess, sdk4: Sdk) -> None:
    home(sdk4)
    four.turn(lose_completion=True)
    began_s = time.monotonic()
    assert goto(sdk4, 10_100.0) >= 0
    assert sdk4.wait() == COMPLETED
    assert time.monotonic() - began_s > 0.9


def test_a_lost_zero_is_read_far_outside_the_travel(emulator: EmulatorProcess, sdk: Sdk) -> None:
    emulator.turn(calibration_lost=True)
    assert max(sdk.positions()) < -900_000.0


def test_after_a_reboot_the_library_goes_on(four: EmulatorProcess, sdk4: Sdk) -> None:
    home(sdk4)
    four.turn(reboot=True, silence_s=0.3)
    assert sdk4.call("um_ping", 1) == TIMEOUT
    time.sleep(0.3)
    assert sdk4.call("um_ping", 1) >= 0
    assert goto(sdk4, 10_050.0) >= 0
    assert sdk4.wait() == COMPLETED


def test_groups_are_ports(tmp_path: Path) -> None:
    with (
        EmulatorProcess(tmp_path, "--group", "3") as emulator,
        closing(Sdk(emulator.host, group=3)) as in_group,
    ):
        assert emulator.port == 55558
        assert in_group.call("um_ping", 1) >= 0
        assert in_group.parameter(6) == 55558
