"""What the tracker asks of a way to see a robot; each way is one class."""

from dataclasses import dataclass
from typing import Protocol

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import ImagePoint


@dataclass(frozen=True, slots=True)
class Sighting:
    """Where a detector saw the robot in a picture.

    Attributes:
        x_px, y_px: Its centre, in image pixels.
        confidence: How much of the evidence agrees, 0..1.
        sigma_px: Standard deviation of the centre along its worst direction.
    """

    x_px: float
    y_px: float
    confidence: float
    sigma_px: float


class Detector(Protocol):
    """A way to see the robot.

    A detector answers for what it can know from one picture: that this has the robot's size, shape and
    shade. The tracker answers for time: the gate, the least confidence, the state. It shows each good picture
    to one of the two methods, once and in order, so that a detector may learn from the pictures. Pictures
    are of shape (height, width, 3), BGR, uint8, and must not be written to.
    """

    radius_px: float
    """The robot's radius in the image, or that of the smallest circle round it."""

    def find(self, image: ByteArray) -> Sighting | None:
        """Return the robot from anywhere in a picture, or None."""

    def follow(self, image: ByteArray, near: ImagePoint) -> Sighting | None:
        """Return the robot from near where it is expected, or None."""
