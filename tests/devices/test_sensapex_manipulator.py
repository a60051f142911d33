"""What both Sensapex drivers share: a session that is opened, stopped and closed beside a way of STOP."""

from collections.abc import Callable

import pytest

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.discovery import FoundController
from mrnav_server.devices.sensapex.manipulator import Connect, SensapexManipulator
from mrnav_server.devices.sensapex.raw_stop import RawStop

FOUND = FoundController(11_400_123, "127.0.0.1", 55_555, (1, 2), 4, (1.0, 2.0, 3.0, 4.0))


class ScriptedSession:
    """Writes down what happens to it."""

    def __init__(self, told: list[str], fails: bool) -> None:
        self._told = told
        self._fails = fails

    async def start(self) -> None:
        self._told.append("start")
        if self._fails:
            raise DeviceError("no position")

    async def close(self) -> None:
        self._told.append("close")

    def tip(self, now_s: float) -> TipReading:
        return TipReading(now_s, StagePoint(1.0, 2.0, 3.0), moving=False)

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        return MotionCommand(now_s, target, speed_um_per_s)

    def drop_moves(self) -> None:
        self._told.append("drop")

    def warnings(self, now_s: float) -> list[str]:
        return [f"at {now_s:g}"]


class ScriptedManipulator(SensapexManipulator[ScriptedSession]):
    """Opens scripted sessions."""

    def __init__(self, told: list[str], fails: bool = False) -> None:
        super().__init__(SensapexConfig(device_id=11_400_123), lambda: 7.0)
        self._told = told
        self._fails = fails

    def _connect(self) -> Connect[ScriptedSession]:
        self._told.append("ready")
        return lambda found, stop_path: ScriptedSession(self._told, self._fails)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    events: list[str] = []

    async def find(config: SensapexConfig, clock: Callable[[], float]) -> FoundController:
        events.append("find")
        return FOUND

    class NotedStop(RawStop):
        def send(self) -> bool:
            events.append("STOP")
            return True

        def close(self) -> None:
            events.append("no way of STOP")
            super().close()

    monkeypatch.setattr("mrnav_server.devices.sensapex.manipulator.find", find)
    monkeypatch.setattr("mrnav_server.devices.sensapex.manipulator.RawStop", NotedStop)
    return events


async def test_what_this_computer_lacks_is_told_before_the_network_is_searched(told: list[str]) -> None:
    manipulator = ScriptedManipulator(told)
    await manipulator.open()
    assert told == ["ready", "find", "start"]
    await manipulator.close()


async def test_moves_are_void_before_the_stop_goes_out(told: list[str]) -> None:
    manipulator = ScriptedManipulator(told)
    manipulator.stop()
    assert told == []
    await manipulator.open()
    manipulator.stop()
    assert told[3:] == ["drop", "STOP"]
    await manipulator.close()


async def test_closing_stops_first_and_happens_once(told: list[str]) -> None:
    manipulator = ScriptedManipulator(told)
    await manipulator.open()
    await manipulator.close()
    await manipulator.close()
    assert told[3:] == ["drop", "STOP", "close", "no way of STOP"]
    with pytest.raises(DeviceError, match="11400123 is not open"):
        manipulator.tip()


async def test_a_session_that_does_not_start_leaves_nothing_open(told: list[str]) -> None:
    manipulator = ScriptedManipulator(told, fails=True)
    with pytest.raises(DeviceError, match="no position"):
        await manipulator.open()
    assert told[2:] == ["start", "close", "no way of STOP"]
    assert manipulator.stop_path is None
    assert manipulator.warnings() == []


async def test_the_way_of_stop_knows_the_device_by_its_id_in_messages(told: list[str]) -> None:
    manipulator = ScriptedManipulator(told)
    await manipulator.open()
    assert manipulator.stop_path is not None
    assert manipulator.stop_path.target == ("127.0.0.1", 55_555)
    assert manipulator.stop_path.device_id == 0x107B
    assert manipulator.warnings() == ["at 7"]
    await manipulator.close()
