"""Does the magnet appear where the calibration puts it? Told from several looks: one look errs by chance."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration, ImagePoint, StagePoint
from mrnav_server.vision.tip import TipFinder, TipLook, TipSighting

_APART_UM = 300.0
"""Looks at one place err alike: a look counts anew once the tip has moved on this far."""


@dataclass(frozen=True, slots=True)
class TipWatchConfig:
    """When to look for the tip in the picture, and when to tell that it is elsewhere.

    Attributes:
        look_s: Time between two looks, in s, 0.2..10.
        warn_um: A disagreement beyond this is told, in µm at the tip's height, 20..2000.
        looks: Looks with the tip at different places, of which the median counts, 3..50.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    look_s: float = 0.5
    warn_um: float = 80.0
    looks: int = 5

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"tip_watch.{name} is {value:g}; choose it within {low:g}..{high:g}")


_RANGES = {"look_s": (0.2, 10), "warn_um": (20, 2000), "looks": (3, 50)}


@dataclass(frozen=True, slots=True)
class TipSeen:
    """What the looks so far say.

    Attributes:
        image: Where the magnet was seen last, in image pixels.
        off_um: How far that is from where the calibration puts it, at the tip's height.
        warning: What to tell the operator, or "".
    """

    image: ImagePoint | None = None
    off_um: float | None = None
    warning: str = ""


class TipAgreement:
    """Compares where the tip is seen with where it should be. Not for several threads at once.

    Args:
        config: Bounds.
        look: How the tip looks.
        calibration: Where it should appear.
    """

    def __init__(self, config: TipWatchConfig, look: TipLook, calibration: Calibration) -> None:
        self._config = config
        self._finder = TipFinder(look, calibration)
        self._looks: deque[tuple[StagePoint, float, float]] = deque(maxlen=config.looks)
        self._warning = ""
        self.seen = TipSeen()

    def look(
        self,
        image: ByteArray,
        tip: StagePoint,
        robot: ImagePoint | None,
        robot_radius_px: float,
        *,
        resting: bool,
    ) -> TipSeen:
        """Take a look.

        Args:
            image: Shape (height, width, 3), BGR, uint8.
            tip: Where the manipulator says that the tip is.
            robot: Where the robot is; None if it is nowhere.
            robot_radius_px: Its radius.
            resting: Whether the tip was there when the picture was taken; else the picture is learned alone.
        """
        self._finder.learn(image, tip)
        found = self._finder.find(image, tip, robot, robot_radius_px) if resting else None
        if found is not None:
            self._note(found, tip)
        self.seen = TipSeen(
            found.image if found is not None else None,
            found.off_um if found is not None else None,
            self._warning,
        )
        return self.seen

    def _note(self, found: TipSighting, tip: StagePoint) -> None:
        off = (
            found.um_per_px * (found.image.x_px - found.expected.x_px),
            found.um_per_px * (found.image.y_px - found.expected.y_px),
        )
        if self._looks and _apart_um(self._looks[-1][0], tip) < _APART_UM:
            self._looks.pop()
        self._looks.append((tip, *off))
        if len(self._looks) < self._config.looks:
            return
        x_um, y_um = np.median([(x, y) for _, x, y in self._looks], axis=0)
        off_um = math.hypot(float(x_um), float(y_um))
        self._warning = (
            f"the tip appears {off_um:.0f} µm from where the calibration puts it: the needle was bumped or"
            " the camera moved: check the calibration"
            if off_um > self._config.warn_um
            else ""
        )


def _apart_um(a: StagePoint, b: StagePoint) -> float:
    return math.dist(a.array(), b.array())
