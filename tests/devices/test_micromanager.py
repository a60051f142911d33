"""Stages behind Micro-Manager on a core that does what it is told: order, stops, faults, limits."""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.errors import ConfigError, DeviceError, DeviceTimeoutError
from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.micromanager.capture_time import CaptureTime
from mrnav_server.devices.micromanager.config import MicroManagerConfig
from mrnav_server.devices.micromanager.manipulator import MicroManagerManipulator
from mrnav_server.devices.micromanager.shared_core import Core, SharedCore
from mrnav_server.devices.micromanager.stages import Stages
from tests.devices.fake_core import WAIT_S, FakeCore, OffsetClock, leaked

PATIENT = MicroManagerConfig(timeout_ms=2000.0)
"""A busy machine must not look like a silent stage."""
SILENCE_S = 2.1


def at(x_um: float, y_um: float = 0.0, z_um: float = 0.0) -> StagePoint:
    return StagePoint(x_um, y_um, z_um)


async def until(check: Callable[[], object]) -> None:
    """Let the threads work until something is so."""
    async with asyncio.timeout(WAIT_S):
        while not check():  # noqa: ASYNC110 - other threads bring it about
            await asyncio.sleep(0.001)


class Bench:
    """A manipulator on a fake core."""

    def __init__(self, config: MicroManagerConfig = PATIENT) -> None:
        self.core = FakeCore()
        self.clock = OffsetClock()
        shared = SharedCore(config, lambda _: cast(Core, self.core))
        self.device = MicroManagerManipulator(config, shared, self.clock)

    def go(self, target: StagePoint) -> StagePoint:
        return self.device.move_to(target, 1000.0, self.clock()).target

    def fault(self) -> str:
        try:
            self.device.tip()
        except DeviceError as error:
            return str(error)
        return ""


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    bench = Bench()
    await bench.device.open()
    yield bench
    await bench.device.close()
    assert not leaked()


async def test_opening_shows_that_both_stages_stop_and_moves_nothing() -> None:
    bench = Bench()
    await bench.device.open()
    assert [call for call in bench.core.calls if call[0] != "deviceBusy"][:4] == [
        ("stop", "XY"),
        ("stop", "Z"),
        ("getXYPosition", "XY"),
        ("getPosition", "Z"),
    ]
    assert bench.device.tip().position == at(100.0, 200.0, 300.0)
    assert not bench.core.sent()
    await bench.device.close()


async def test_a_stage_that_cannot_be_stopped_is_refused() -> None:
    bench = Bench()
    bench.core.fails["stop"] = "Unsupported command"
    with pytest.raises(DeviceError, match=r"XY cannot be stopped.*Unsupported command.*take a stage"):
        await bench.device.open()
    with pytest.raises(DeviceError, match="not open"):
        bench.device.tip()
    await bench.device.close()
    assert bench.core.unloaded == 1


async def test_every_stage_is_told_its_own_part_and_only_when_it_changes(bench: Bench) -> None:
    for target in (at(1, 2, 3), at(4, 5, 3), at(4, 5, 6)):
        bench.go(target)
        await until(lambda target=target: bench.device.tip().position == target)  # type: ignore[misc]
    assert bench.core.sent() == [
        ("setXYPosition", "XY", 1, 2),
        ("setPosition", "Z", 3),
        ("setXYPosition", "XY", 4, 5),
        ("setPosition", "Z", 6),
    ]


async def test_the_newest_target_replaces_those_that_wait(bench: Bench) -> None:
    held = bench.core.hold("setXYPosition")
    bench.go(at(1))
    await until(bench.core.sent)
    for x_um in (2, 3, 4):
        bench.go(at(x_um))
    held.set()
    await until(lambda: bench.device.tip().position == at(4))
    assert [call[2] for call in bench.core.sent() if call[0] == "setXYPosition"] == [1, 4]


async def test_a_stop_waits_for_no_call_and_has_the_last_word(bench: Bench) -> None:
    held = bench.core.hold("setXYPosition")
    bench.go(at(1))
    await until(bench.core.sent)
    bench.go(at(2))
    bench.device.stop()
    await until(lambda: {("stop", "XY"), ("stop", "Z")} <= set(bench.core.sent()))
    held.set()
    await until(lambda: bench.core.sent().count(("stop", "XY")) >= 2)
    await until(lambda: bench.device.tip().position.x_um == 1)
    assert bench.core.sent()[0] == ("setXYPosition", "XY", 1, 0)
    assert {call[0] for call in bench.core.sent()[1:]} == {"stop"}


async def test_a_target_after_the_stop_waits_for_rest_and_is_sent_even_if_it_is_the_same(
    bench: Bench,
) -> None:
    bench.go(at(1))
    await until(lambda: bench.device.tip().position == at(1))
    bench.core.busy["XY"] = 4
    before = len(bench.core.sent())
    bench.device.stop()
    bench.go(at(1))
    await until(lambda: ("setXYPosition", "XY", 1, 0) in bench.core.sent()[before:])
    sent = bench.core.sent()[before:]
    assert sent[: sent.index(("setXYPosition", "XY", 1, 0))].count(("stop", "XY")) == 4


async def test_a_stage_that_moves_on_after_its_stop_is_a_fault(bench: Bench) -> None:
    bench.core.busy["Z"] = 10**9
    bench.device.stop()
    await until(lambda: ("stop", "Z") in bench.core.sent())
    bench.clock.ahead_s = 1.1
    await until(lambda: "Z moves on after it was stopped: switch" in bench.fault())
    with pytest.raises(DeviceError, match="moves on"):
        bench.go(at(1))
    bench.core.busy["Z"] = 1
    await until(lambda: not bench.fault())


async def test_a_stop_that_is_refused_is_a_fault_and_is_tried_again(bench: Bench) -> None:
    bench.core.fails["stop"] = "serial line closed"
    bench.device.stop()
    await until(lambda: "XY was not stopped (serial line closed)" in bench.fault())
    bench.core.fails.clear()
    await until(lambda: not bench.fault())


async def test_a_stop_that_hangs_is_a_fault(bench: Bench) -> None:
    held = bench.core.hold("stop")
    bench.device.stop()
    await until(lambda: ("stop", "XY") in bench.core.sent())
    bench.clock.ahead_s = SILENCE_S
    await until(lambda: "does not come back from stopping" in bench.fault())
    held.set()


@pytest.mark.parametrize("call", ["getXYPosition", "getPosition", "deviceBusy"])
async def test_a_failure_stands_until_the_stages_were_stopped_and_answer(bench: Bench, call: str) -> None:
    bench.core.fails[call] = 'Error in device "XY":\n no answer'
    await until(bench.fault)
    assert bench.fault().startswith('Micro-Manager: Error in device "XY": no answer: check')
    with pytest.raises(DeviceError, match="no answer"):
        bench.go(at(1))
    bench.core.fails.clear()
    reads = bench.core.calls.count(("getPosition", "Z"))
    await until(lambda: bench.core.calls.count(("getPosition", "Z")) > reads + 2)
    assert "no answer" in bench.fault()
    bench.device.stop()
    await until(lambda: not bench.fault())


async def test_a_target_that_the_stage_refuses_is_a_fault_and_is_not_repeated(bench: Bench) -> None:
    bench.core.fails["setPosition"] = "Position out of range (103)"
    bench.go(at(1))
    await until(lambda: "out of range" in bench.fault())
    bench.core.fails.clear()
    bench.device.stop()
    await until(lambda: not bench.fault())
    assert bench.core.sent().count(("setPosition", "Z", 0)) == 1


@pytest.mark.parametrize(("call", "label"), [("setXYPosition", "XY"), ("setPosition", "Z")])
async def test_a_stage_that_takes_no_target_while_it_moves_gets_the_newest_once_it_rests(
    bench: Bench, call: str, label: str
) -> None:
    def told() -> int:
        return [name for name, *_ in bench.core.sent()].count(call)

    bench.core.fails[call] = "Device busy."
    bench.core.busy[label] = 1
    bench.go(at(1, 0, 1))
    await until(lambda: told() >= 2)
    bench.go(at(2, 0, 2))
    await until(lambda: told() >= 4)
    assert not bench.fault()
    bench.core.fails.clear()
    await until(lambda: bench.device.tip().position == at(2, 0, 2))
    bench.core.fails[call] = "Device busy."
    bench.core.busy[label] = 0
    bench.go(at(3, 0, 3))
    await until(lambda: "Device busy." in bench.fault())


@pytest.mark.parametrize("call", ["getXYPosition", "setXYPosition"])
async def test_a_call_that_hangs_is_silence(bench: Bench, call: str) -> None:
    held = bench.core.hold(call)
    bench.go(at(1))
    await until(lambda: bench.core.calls[-1][0] == call)
    bench.clock.ahead_s = SILENCE_S
    with pytest.raises(DeviceTimeoutError, match=r"silent for .* ms: check"):
        bench.device.tip()
    held.set()
    await until(lambda: not bench.fault())


@pytest.mark.parametrize("z_um", [math.nan, math.inf])
async def test_a_position_that_is_not_finite_is_a_fault(bench: Bench, z_um: float) -> None:
    bench.core.z_um = z_um
    await until(lambda: "restart them" in bench.fault())


@pytest.mark.parametrize(
    ("target", "speed_um_per_s"),
    [
        (at(math.nan), 100.0),
        (at(0, math.inf), 100.0),
        (at(0, 0, -math.inf), 100.0),
        (at(0), math.nan),
        (at(0), math.inf),
        (at(0), 0.0),
    ],
)
async def test_what_is_not_finite_moves_nothing(
    bench: Bench, target: StagePoint, speed_um_per_s: float
) -> None:
    with pytest.raises(DeviceError, match="refuse"):
        bench.device.move_to(target, speed_um_per_s, bench.clock())
    reads = len(bench.core.calls)
    await until(lambda: len(bench.core.calls) > reads + 8)
    assert not bench.core.sent()


async def test_targets_are_kept_within_the_travel(bench: Bench) -> None:
    assert bench.go(at(-5, 30_000, 10)) == at(0, 20_000, 10)
    await until(lambda: bench.device.tip().position == at(0, 20_000, 10))


async def test_a_reading_is_stamped_before_the_stages_were_asked(bench: Bench) -> None:
    asked_s: list[float] = []

    def number(name: str) -> None:
        if name == "getXYPosition":
            bench.core.xy_um = (len(asked_s), 0.0)
            asked_s.append(bench.clock())

    bench.core.z_um = 0.0
    bench.core.on_call = number
    await until(lambda: len(asked_s) > 3 and bench.device.tip().position.z_um == 0.0)
    tip = bench.device.tip()
    assert tip.taken_s <= asked_s[int(tip.position.x_um)]
    assert not tip.moving
    bench.core.busy["Z"] = 1
    await until(lambda: bench.device.tip().moving)


async def test_closing_stops_until_the_stages_rest_unloads_and_may_be_repeated(bench: Bench) -> None:
    bench.core.busy["XY"] = 3
    await bench.device.close()
    await bench.device.close()
    assert bench.core.sent().count(("stop", "XY")) >= 3
    assert ("stop", "Z") in bench.core.sent()
    assert bench.core.unloaded == 1
    with pytest.raises(DeviceError, match="not open"):
        bench.device.tip()
    await bench.device.open()
    assert bench.device.tip().position == at(100.0, 200.0, 300.0)
    assert bench.core.unloaded == 1


async def test_closing_does_not_wait_for_a_call_that_hangs(bench: Bench) -> None:
    held = bench.core.hold("getXYPosition")
    await until(lambda: bench.core.calls[-1] == ("getXYPosition", "XY"))
    await bench.device.close()
    with pytest.raises(DeviceError, match="still held"):
        await bench.device.open()
    held.set()
    await until(lambda: bench.core.unloaded == 1)


async def test_loading_that_takes_too_long_is_given_up() -> None:
    bench = Bench(MicroManagerConfig(open_timeout_s=1.0))
    held = bench.core.hold("stop")
    with pytest.raises(DeviceTimeoutError, match=r"has not loaded demo within 1 s.*open_timeout_s"):
        await bench.device.open()
    held.set()
    await bench.device.close()
    assert bench.core.unloaded == 1


async def test_stages_that_answer_too_slowly_are_refused_and_slow_ones_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    for read_s, refused in ((0.05, False), (0.15, True)):
        bench = Bench()

        def delay(name: str, bench: Bench = bench, read_s: float = read_s) -> None:
            if name == "getPosition":
                bench.clock.ahead_s += read_s

        bench.core.on_call = delay
        if refused:
            with pytest.raises(DeviceError, match="takes 150 ms, too long to steer by"):
                await bench.device.open()
        else:
            await bench.device.open()
            assert "takes 50 ms: fewer than 30 positions" in caplog.text
        bench.core.on_call = lambda name: None
        await bench.device.close()


async def test_the_speed_is_set_once_in_the_stage_s_own_unit() -> None:
    bench = Bench(MicroManagerConfig(xy_speed_properties=("SpeedX", "SpeedY"), speed_um_per_s=4000.0))
    bench.core.properties = ("SpeedX", "SpeedY")
    await bench.device.open()
    assert [call for call in bench.core.calls if call[0] == "setProperty"] == [
        ("setProperty", "XY", "SpeedX", "4"),
        ("setProperty", "XY", "SpeedY", "4"),
    ]
    await bench.device.close()


@pytest.mark.parametrize(
    ("config", "refusal", "said"),
    [
        (
            {"z_speed_properties": ("Pace",)},
            "",
            "Z has no property Pace: choose micromanager.z_speed_properties from Speed",
        ),
        ({"xy_speed_properties": ("Speed",)}, "read only", "refuses Speed = 5 .read only.: check"),
        ({"xy_stage": "Z"}, "", "no XY stage named Z: set micromanager.xy_stage to XY"),
        ({"z_stage": "Zed"}, "", "no Z stage named Zed: set micromanager.z_stage to Piezo or Z"),
    ],
)
async def test_settings_that_do_not_fit_the_stages(config: dict[str, Any], refusal: str, said: str) -> None:
    bench = Bench(MicroManagerConfig(**config))
    if refusal:
        bench.core.fails["setProperty"] = refusal
    with pytest.raises(DeviceError, match=said):
        await bench.device.open()
    await bench.device.close()


COORDINATE = st.floats(0.0, 20_000.0)
SCALE = st.floats(0.01, 100.0).flatmap(lambda size: st.sampled_from([size, -size]))


@given(
    target=st.tuples(COORDINATE, COORDINATE, COORDINATE),
    scale=st.tuples(SCALE, SCALE, SCALE),
    offset=st.tuples(*[st.floats(-50_000.0, 50_000.0)] * 3),
)
def test_what_is_sent_is_what_is_read(
    target: tuple[float, float, float],
    scale: tuple[float, float, float],
    offset: tuple[float, float, float],
) -> None:
    core = FakeCore()
    stages = Stages(cast(Core, core), MicroManagerConfig(scale_xyz=scale, offset_um=offset), OffsetClock())
    stages.send(StagePoint(*target), lambda: True)
    read = stages.read().position
    assert read.array() == pytest.approx(target, abs=1e-6)
    assert core.z_um * scale[2] + offset[2] == pytest.approx(target[2], abs=1e-6)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"scale_xyz": (1.0, 0.0, 1.0)}, "scale_xyz has a 0"),
        ({"offset_um": (math.nan, 0.0, 0.0)}, "offset_um is not finite"),
        ({"travel_min_um": (0.0, 0.0, 20_000.0)}, "not below travel_max_um along z"),
        ({"poll_hz": 10.0}, "poll_hz is 10; choose it within 30..200"),
        ({"timeout_ms": math.nan}, "timeout_ms is nan"),
    ],
)
def test_settings_out_of_range(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        MicroManagerConfig(**wrong)


def test_one_core_is_loaded_for_all_and_unloaded_by_the_last() -> None:
    made: list[FakeCore] = []

    def load(_: MicroManagerConfig) -> Core:
        made.append(FakeCore())
        return cast(Core, made[-1])

    shared = SharedCore(MicroManagerConfig(), load)
    assert shared.acquire() is shared.acquire()
    assert len(made) == 1
    shared.release()
    assert made[0].unloaded == 0
    shared.release()
    assert made[0].unloaded == 1
    shared.acquire()
    assert len(made) == 2
    shared.release()


def test_a_picture_is_placed_between_two_looks_into_the_buffer() -> None:
    times = CaptureTime(exposure_s=0.010)
    assert times.taken_s(empty_s=5.000, filled_s=5.002, elapsed_s=None) == pytest.approx(4.995)
    # The fastest picture says where the camera's clock begins: 5.002 - 0.100.
    assert times.taken_s(5.000, 5.002, 0.100) == pytest.approx(4.997)
    # After a stall of 0.5 s the camera's clock tells when the picture came.
    assert times.taken_s(5.100, 5.600, 0.500) == pytest.approx(5.402 - 0.005)
    # A camera's clock that ran away or jumped cannot leave the bounds.
    assert times.taken_s(5.700, 5.702, 90.0) == pytest.approx(5.702 - 0.005)
    assert times.taken_s(5.800, 5.802, -90.0) == pytest.approx(5.795)
