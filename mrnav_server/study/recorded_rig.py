"""Stands in for everything around the deciders while a trial is replayed: answers as the log says."""

from collections.abc import Callable

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.lease import Lease
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.loops.surroundings import Outlook, Surroundings
from mrnav_server.loops.trial_log import LogLine

DEVICE = "manipulator: "
"""The control loop puts this before what a manipulator's driver says."""


class RecordedManipulator:
    """Reports the recorded readings and answers commands as the recorded device did.

    Args:
        next_reading: Returns the line of the step, or of the ask, that reads the tip now.
        next_answer: Returns the line that says what became of the command that is sent now.
    """

    def __init__(self, next_reading: Callable[[], LogLine], next_answer: Callable[[], LogLine]) -> None:
        self._next_reading = next_reading
        self._next_answer = next_answer

    async def open(self) -> None:
        """Nothing is acquired."""

    async def close(self) -> None:
        """Nothing is given back."""

    def stop(self) -> None:
        """Nothing moves."""

    def warnings(self) -> list[str]:
        """Return nothing: what the driver said is in the recorded outlook."""
        return []

    def tip(self) -> TipReading:
        """Return the recorded reading.

        Raises:
            DeviceError: If the device had failed, with its words.
        """
        data = self._next_reading().data
        if "tip_um" not in data:
            raise DeviceError(data["tip_fault"].removeprefix(DEVICE))
        return TipReading(data["tip_taken_s"], StagePoint(*data["tip_um"]), data["tip_moving"])

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        """Return what the device was really sent; what was asked for is compared by whoever logs it.

        Raises:
            DeviceError: If the device refused then.
        """
        line = self._next_answer()
        if line.topic == "command_failed":
            raise DeviceError(line.data["reason"].removeprefix(DEVICE))
        data = line.data
        return MotionCommand(data["sent_s"], StagePoint(*data["target_um"]), data["speed_um_per_s"])


class RecordedSurroundings(Surroundings):
    """Says what everybody said at the recorded step."""

    outlook = Outlook()

    def look(self, lease: Lease, console_s: float, now_s: float) -> Outlook:
        """Return the recorded outlook."""
        return self.outlook
