"""Notices when the vessel or the camera moves during a session, by the walls in the live picture.

What a wall looked like is remembered place by place, and sought there again. Most of the walls must agree on
one motion, so that a needle, a robot or a change of light does not pass for one.
"""

import math
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, Float32Array, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.walls import Walls, best_shift, gray_at, image_px

_STEP_UM = 15.0
_PATTERN_UM = 150.0
_SEARCH_UM = 300.0
_MOST_POINTS = 160
_LEAST_MATCH = 0.75
"""A wall that resembles what it was less is hidden, or elsewhere."""
_AGREE_UM = 25.0
"""Walls within this of the common motion agree with it."""
_LEAST_AGREEING = 0.5
"""The share of the remembered walls that must agree on a motion."""
_LEAST_LIKE = 0.6
"""At first a wall is taken for one if it resembles the median of all this much, within ..."""
_BEGIN_UM = 120.0
_FEWEST = 20
_CONFIRM = 3
"""Looks in a row that must say the same."""
_CONFIRM_LOST = 5
"""Looks in a row without recognised walls after which that is told."""
_GONE = (
    "the vessel's walls are not where they were: the vessel or the camera has moved far, or the view is"
    " covered: register the vessel again"
)


@dataclass(frozen=True, slots=True)
class DriftConfig:
    """When a motion of vessel or camera is told, and when autonomy is held for it.

    Attributes:
        look_s: Time between two looks, in s, 0.2..10.
        warn_um: A motion beyond this is told, in µm, 20..1000.
        hold_um: Beyond this AUTO is refused and held until the vessel is registered again, in µm, 20..1000.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    look_s: float = 1.0
    warn_um: float = 50.0
    hold_um: float = 100.0

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"drift.{name} is {value:g}; choose it within {low:g}..{high:g}")
        if self.warn_um > self.hold_um:
            raise ConfigError(
                f"drift.warn_um is {self.warn_um:g}: choose it at most hold_um ({self.hold_um:g})"
            )


_RANGES = {"look_s": (0.2, 10), "warn_um": (20, 1000), "hold_um": (20, 1000)}


@dataclass(frozen=True, slots=True)
class Drift:
    """What the looks so far say.

    Attributes:
        moved_um: How far the walls have moved, the largest over the vessel; None while nothing is known, or
            when they are not recognised any more.
        warning: What to tell the operator, or "".
        holds: Whether autonomy must not go on.
    """

    moved_um: float | None = None
    warning: str = ""
    holds: bool = False


class DriftWatch:
    """Compares pictures with the first ones. Not for several threads at once.

    Args:
        config: Thresholds.
        calibration: Where the vessel lies; what drifts is told relative to it.
        vessel: The model.
    """

    def __init__(self, config: DriftConfig, calibration: Calibration, vessel: VesselMap) -> None:
        self._config = config
        every = Walls.of(vessel, 200.0)
        stride = max(1, math.ceil(len(every.points_px) / _MOST_POINTS))
        walls = Walls(every.points_px[::stride], every.normals[::stride], every.spacing_um * stride)
        reach = round((_PATTERN_UM + _SEARCH_UM) / _STEP_UM)
        offsets_um = np.arange(-reach, reach + 1) * _STEP_UM
        self._at_px = image_px(calibration, walls.across(offsets_um, vessel.um_per_px))
        self._cut = round(_SEARCH_UM / _STEP_UM)
        half_px = vessel.size_px / 2.0
        arm = (walls.points_px - half_px) / half_px
        turning = walls.normals[:, 1] * arm[:, 0] - walls.normals[:, 0] * arm[:, 1]
        self._matrix = np.column_stack([walls.normals, turning])
        self._arm = arm
        count = len(walls.points_px)
        self._known: Float32Array = np.zeros((count, 2 * round(_PATTERN_UM / _STEP_UM) + 1), np.float32)
        self._has: BoolArray = np.zeros(count, bool)
        self._recent: list[float] = []
        self._lost = 0
        self.drift = Drift()

    def look(self, picture: ByteArray) -> Drift:
        """Look at a picture, BGR or gray, uint8; return what all looks so far say."""
        profiles = gray_at(picture, self._at_px)
        inside = np.asarray(np.isfinite(profiles).all(axis=1))
        if not self._has.any():
            self._begin(profiles, inside)
            return self.drift
        shift_um, match = best_shift(profiles, self._known, _STEP_UM)
        found = self._has & (match > _LEAST_MATCH)
        moved_um = self._moved_um(shift_um, found)
        if moved_um is None:
            self._lost += 1
        else:
            self._lost = 0
            self._recent = [*self._recent, moved_um][-_CONFIRM:]
            if moved_um < self._config.warn_um / 2.0:
                # Where a needle or the robot stood before, the wall is seen now.
                self._remember(profiles, inside & ~found)
        self.drift = self._judged()
        return self.drift

    def _begin(self, profiles: Float32Array, inside: BoolArray) -> None:
        """Remember the walls, if what is seen is alike wherever the model has one."""
        if inside.any():
            centred = profiles[inside][:, self._cut : -self._cut]
            usual = np.median(centred - centred.mean(axis=1, keepdims=True), axis=0)
            shift_um, match = best_shift(profiles, usual, _STEP_UM)
            walls = inside & (match > _LEAST_LIKE) & (np.abs(shift_um) < _BEGIN_UM)
            if walls.sum() >= _LEAST_AGREEING * max(inside.sum(), _FEWEST):
                self._remember(profiles, walls)
                self.drift = Drift()
                return
        self._lost += 1
        if self._lost >= _CONFIRM_LOST:
            self.drift = Drift(
                None, "the vessel's walls are not seen where the calibration has them: register the vessel"
            )

    def _remember(self, profiles: Float32Array, which: BoolArray) -> None:
        self._known[which] = profiles[which, self._cut : -self._cut]
        self._has |= which

    def _moved_um(self, shift_um: FloatArray, found: BoolArray) -> float | None:
        """Return how far the walls moved; None if too few are recognised, or agree on a motion."""
        known = int(self._has.sum())
        if found.sum() < _LEAST_AGREEING * known:
            return None
        matrix, shift_um = self._matrix[found], shift_um[found]
        weight = np.ones(len(shift_um))
        for _ in range(6):
            weighted = (matrix * weight[:, None]).T / max(weight.sum(), 1e-9)
            # A direction that no wall holds is taken to be at rest.
            move = np.linalg.solve(weighted @ matrix + 1e-3 * np.eye(3), weighted @ shift_um)
            left = np.abs(shift_um - matrix @ move)
            scale = max(float(np.median(left)), _AGREE_UM / 2.0)
            weight = np.maximum(1.0 - (left / (4.0 * scale)) ** 2, 0.0) ** 2
        if (left < _AGREE_UM).sum() < _LEAST_AGREEING * known:
            return None
        x_um = move[0] - move[2] * self._arm[:, 1]
        y_um = move[1] + move[2] * self._arm[:, 0]
        return float(np.hypot(x_um, y_um).max())

    def _judged(self) -> Drift:
        if self._lost >= _CONFIRM_LOST:
            self._recent = []
            return Drift(None, _GONE, holds=True)
        if len(self._recent) < _CONFIRM:
            return self.drift
        moved_um, least_um = sorted(self._recent)[_CONFIRM // 2], min(self._recent)
        if least_um <= self._config.warn_um:
            return Drift(moved_um)
        told = f"the vessel or the camera has moved by {moved_um:.0f} µm: register the vessel again"
        return Drift(moved_um, told, holds=least_um > self._config.hold_um)
