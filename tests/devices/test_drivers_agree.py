"""Both drivers do the same on the same emulated controller: motion, STOP, and every fault."""

import asyncio
import math
import time
from collections.abc import Iterator

import numpy as np
import pytest

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.config import SensapexConfig
from tests.devices.emulator_process import EmulatorProcess, own_host
from tests.devices.sensapex_rig import (
    DRIVERS,
    NOISE_UM,
    Driver,
    config_of,
    fault,
    held_port,
    kinds,
    lock,
    move_by,
    opened,
    sound,
    until,
)

pytestmark = pytest.mark.parametrize("driver", DRIVERS)


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[int, EmulatorProcess]]:
    three, four = tmp_path_factory.mktemp("three"), tmp_path_factory.mktemp("four")
    with (
        EmulatorProcess(three, "--axes", "3", "--id", "4") as with_three,
        EmulatorProcess(four, "--id", "1", "--id", "11400123") as with_four,
    ):
        yield {3: with_three, 4: with_four}


@pytest.fixture
def emulator(processes: dict[int, EmulatorProcess]) -> EmulatorProcess:
    return sound(processes[4])


@pytest.fixture
def three(processes: dict[int, EmulatorProcess]) -> EmulatorProcess:
    return processes[3]


def near(point: StagePoint, other: StagePoint, within_um: float = NOISE_UM) -> bool:
    return math.dist((point.x_um, point.y_um, point.z_um), (other.x_um, other.y_um, other.z_um)) < within_um


class TestMotion:
    async def test_opening_moves_nothing_and_reads_the_tip(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        before_um = emulator.turn()["true_um"]
        moves = len(kinds(emulator, "GOTO", "STEP", "GOTO_MEMORY", "ZERO_DRIVE"))
        async with opened(driver, emulator) as manipulator:
            assert near(manipulator.tip().position, StagePoint(*before_um[:3]))
            assert not manipulator.tip().moving
            assert manipulator.stop_path is not None
            assert manipulator.stop_path.target == (emulator.host, emulator.port)
        assert emulator.turn()["true_um"] == before_um
        assert len(kinds(emulator, "GOTO", "STEP", "GOTO_MEMORY", "ZERO_DRIVE")) == moves

    async def test_a_move_arrives_and_the_fourth_axis_stays(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        w_um = emulator.turn()["true_um"][3]
        async with opened(driver, emulator) as manipulator:
            at = manipulator.tip().position
            wished = StagePoint(at.x_um + 120.0, at.y_um - 80.0, at.z_um + 30.0)
            sent = manipulator.move_to(wished, 2000.0, time.monotonic())
            assert near(sent.target, wished, 0.003)
            assert sent.speed_um_per_s == 2000.0
            await until(lambda: manipulator.tip().moving, "the tip moves")
            await until(lambda: near(manipulator.tip().position, sent.target), "the tip arrives")
            await until(lambda: not manipulator.tip().moving, "the tip rests")
            assert manipulator.warnings() == []
        true_um = emulator.turn()["true_um"]
        assert near(StagePoint(*true_um[:3]), sent.target)
        assert true_um[3] == w_um

    async def test_a_stream_ends_at_its_newest_target(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        async with opened(driver, emulator) as manipulator:
            at = manipulator.tip().position
            read: set[float] = set()
            for tick in range(1, 51):
                target = StagePoint(at.x_um + 4.0 * tick, at.y_um, at.z_um)
                sent = manipulator.move_to(target, 1000.0, time.monotonic())
                await asyncio.sleep(0.01)
                read.add(manipulator.tip().taken_s)
            assert len(read) > 10
            await until(lambda: near(manipulator.tip().position, sent.target), "the tip arrives")
        assert near(StagePoint(*emulator.turn()["true_um"][:3]), sent.target)

    async def test_a_reading_is_never_older_than_its_time_says(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        """Of a tip that moves up x, a reading shows no less than where it was at the reading's time."""
        emulator.turn(latency_ms=8.0, jitter_ms=8.0)
        truth, readings = [], []
        async with opened(driver, emulator) as manipulator:
            move_by(manipulator, 800.0, 1000.0)
            for _ in range(60):
                state = emulator.turn()
                truth.append((state["t"], state["true_um"][0]))
                readings.append(manipulator.tip())
                await asyncio.sleep(0.01)
        taken_s = np.array([reading.taken_s for reading in readings])
        true_um = np.interp(taken_s, *np.array(truth).T)
        assert np.ptp(true_um) > 200.0
        # Between two looks the truth is interpolated, which on a busy machine errs while it accelerates.
        assert all(
            reading.position.x_um > at_um - 5.0 for reading, at_um in zip(readings, true_um, strict=True)
        )

    async def test_a_device_with_three_axes(self, driver: type[Driver], three: EmulatorProcess) -> None:
        sound(three, device=4)
        async with opened(driver, three, axes=3, device_id=4) as manipulator:
            target = move_by(manipulator, 50.0)
            await until(lambda: near(manipulator.tip().position, target), "the tip arrives")

    async def test_a_device_known_by_its_serial_number(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        async with opened(driver, emulator, device_id=11400123) as manipulator:
            target = move_by(manipulator, 50.0)
            await until(lambda: near(manipulator.tip().position, target), "the tip arrives")
        assert near(StagePoint(*emulator.turn(device=11400123)["true_um"][:3]), target)


class TestStop:
    async def test_a_stop_ends_the_motion_and_nothing_follows(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        async with opened(driver, emulator) as manipulator:
            move_by(manipulator, -1500.0, 1000.0)
            await until(lambda: manipulator.tip().moving, "the tip moves")
            manipulator.stop()
            await until(lambda: not emulator.turn()["moving"], "the tip stops")
            rest_um = emulator.turn()["true_um"]
            await until(lambda: not manipulator.tip().moving, "the reading rests")
            assert emulator.turn()["true_um"] == rest_um
            rows = kinds(emulator, "GOTO", "STOP")
            assert rows[-1]["kind"] == "STOP"

    async def test_a_move_after_a_stop_goes_on(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        async with opened(driver, emulator) as manipulator:
            move_by(manipulator, 500.0, 1000.0)
            manipulator.stop()
            target = move_by(manipulator, 40.0)
            await until(lambda: near(manipulator.tip().position, target), "the tip arrives")

    async def test_a_mute_controller_gets_its_stop(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        async with opened(driver, emulator) as manipulator:
            move_by(manipulator, 1500.0, 1000.0)
            await until(lambda: emulator.turn()["moving"], "the tip moves")
            emulator.turn(mute=True)
            await asyncio.sleep(0.03)
            manipulator.stop()
            await until(lambda: not emulator.turn()["moving"], "the tip stops")

    async def test_closing_stops(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        async with opened(driver, emulator) as manipulator:
            move_by(manipulator, -1500.0, 1000.0)
            await until(lambda: emulator.turn()["moving"], "the tip moves")
            await manipulator.close()
            await until(lambda: not emulator.turn()["moving"], "the tip stops")
            assert "not open" in fault(manipulator)
            await manipulator.open()
            assert not manipulator.tip().moving


class TestRefusals:
    @pytest.mark.parametrize(
        ("x_um", "speed"),
        [(math.nan, 100.0), (-1.0, 100.0), (20_001.0, 100.0), (1.0, math.inf), (1.0, 0.5)],
    )
    async def test_a_bad_target_sends_nothing(
        self, driver: type[Driver], emulator: EmulatorProcess, x_um: float, speed: float
    ) -> None:
        before = len(kinds(emulator, "GOTO"))
        async with opened(driver, emulator) as manipulator:
            with pytest.raises(DeviceError, match="refuses"):
                manipulator.move_to(StagePoint(x_um, 1.0, 1.0), speed, time.monotonic())
            await asyncio.sleep(0.03)
            assert fault(manipulator) == ""
        assert len(kinds(emulator, "GOTO")) == before

    async def test_before_opening_nothing_works_and_stop_is_safe(self, driver: type[Driver]) -> None:
        manipulator = driver(config_of_nobody(), time.monotonic)
        manipulator.stop()
        assert manipulator.warnings() == []
        with pytest.raises(DeviceError, match="not open"):
            manipulator.tip()
        with pytest.raises(DeviceError, match="not open"):
            manipulator.move_to(StagePoint(1.0, 1.0, 1.0), 100.0, 0.0)
        await manipulator.close()

    async def test_nobody_there(self, driver: type[Driver]) -> None:
        manipulator = driver(config_of_nobody(), time.monotonic)
        with pytest.raises(DeviceError, match=r"no manipulator answers.*cable.*group.*169\.254.*firewall"):
            await manipulator.open()
        assert manipulator.stop_path is None

    async def test_another_number(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        with pytest.raises(DeviceError, match=r"id 9 .*there is 1, 11400123: set sensapex\.device_id"):
            await driver(config_of(emulator, device_id=9), time.monotonic).open()

    async def test_a_four_axis_manipulator_seen_with_three(
        self, driver: type[Driver], three: EmulatorProcess
    ) -> None:
        with pytest.raises(DeviceError, match=r"reports 3 axes, not 4: a uMp-4 .*sensapex\.axes = 3"):
            await driver(config_of(three, device_id=4), time.monotonic).open()

    async def test_a_three_axis_manipulator_seen_with_four(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        with pytest.raises(DeviceError, match=r"reports 4 axes, not 3: set sensapex\.axes = 4"):
            await driver(config_of(emulator, axes=3), time.monotonic).open()

    async def test_a_lost_calibration(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        emulator.turn(calibration_lost=True)
        manipulator = driver(config_of(emulator), time.monotonic)
        with held_port(), pytest.raises(DeviceError, match="zero calibration is lost; calibrate it"):
            await manipulator.open()
        assert manipulator.stop_path is None


class TestFaults:
    async def test_mute_fails_and_heals(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        async with opened(driver, emulator) as manipulator:
            emulator.turn(mute=True)
            await until(lambda: "has not answered" in fault(manipulator), "silence is noticed")
            with pytest.raises(DeviceError, match="has not answered"):
                manipulator.move_to(StagePoint(1.0, 1.0, 1.0), 100.0, time.monotonic())
            emulator.turn(mute=False)
            await until(lambda: fault(manipulator) == "", "the driver recovers")

    async def test_a_slow_network_fails(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        async with opened(driver, emulator) as manipulator:
            emulator.turn(latency_ms=600.0)
            await until(lambda: "has not answered" in fault(manipulator), "silence is noticed")

    @pytest.mark.parametrize("knob", ["drop_acks", "drop_requests"])
    async def test_single_losses_are_made_up_for(
        self, driver: type[Driver], emulator: EmulatorProcess, knob: str
    ) -> None:
        async with opened(driver, emulator) as manipulator:
            emulator.turn(**{knob: 2})
            target = move_by(manipulator, 60.0)
            await until(lambda: near(manipulator.tip().position, target), "the tip arrives")

    async def test_many_losses_are_told(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        async with opened(driver, emulator) as manipulator:
            for _ in range(8):
                emulator.turn(drop_acks=1)
                await until(lambda: emulator.turn()["knobs"]["drop_acks"] == 0, "an answer is lost")
            await until(
                lambda: any("without an answer" in text for text in manipulator.warnings()), "it is told"
            )

    async def test_moves_that_are_not_acknowledged_fail_until_a_stop(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        async with opened(driver, emulator) as manipulator:
            lock(emulator, locked=True)
            move_by(manipulator, 60.0)
            await until(lambda: "has not acknowledged a move" in fault(manipulator), "it is noticed")
            manipulator.stop()
            assert fault(manipulator) == ""
            lock(emulator, locked=False)
            target = move_by(manipulator, 20.0)
            await until(lambda: near(manipulator.tip().position, target), "the tip arrives")

    async def test_a_lost_calibration_fails(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        async with opened(driver, emulator) as manipulator:
            emulator.turn(calibration_lost=True)
            await until(lambda: "zero calibration is lost" in fault(manipulator), "it is noticed")

    async def test_a_lost_completion_is_told(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        emulator.turn(lose_completion=True)
        async with opened(driver, emulator) as manipulator:
            move_by(manipulator, 60.0)
            await until(lambda: any("has ended" in text for text in manipulator.warnings()), "it is told")
            assert fault(manipulator) == ""

    async def test_a_missing_status_is_told(self, driver: type[Driver], emulator: EmulatorProcess) -> None:
        emulator.turn(no_status=True)
        async with opened(driver, emulator) as manipulator:
            move_by(manipulator, -400.0, 500.0)
            await until(lambda: any("when it moves" in text for text in manipulator.warnings()), "it is told")
            assert manipulator.tip().moving

    async def test_a_stuck_axis_shows_in_the_reading(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        emulator.turn(stall="x")
        async with opened(driver, emulator) as manipulator:
            start = manipulator.tip().position
            moves = len(kinds(emulator, "GOTO"))
            target = move_by(manipulator, 100.0)
            await until(lambda: len(kinds(emulator, "GOTO")) > moves, "the move is sent")
            await asyncio.sleep(0.2)
            assert near(manipulator.tip().position, start)
            assert not near(manipulator.tip().position, target)

    async def test_a_restart_of_the_controller_fails(
        self, driver: type[Driver], emulator: EmulatorProcess
    ) -> None:
        async with opened(driver, emulator) as manipulator:
            emulator.turn(silence_s=0.8, reboot=True)
            await until(lambda: "has not answered" in fault(manipulator), "silence is noticed")


def config_of_nobody() -> SensapexConfig:
    return SensapexConfig(address=own_host())
