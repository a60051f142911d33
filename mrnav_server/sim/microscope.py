"""The simulated microscope: what the camera sees of the vessel, the robot and the end-effector."""

from dataclasses import dataclass, fields

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.backdrop import backdrop
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.occluder import NeedleShape, Occluder
from mrnav_server.sim.optics import Optics, View
from mrnav_server.sim.sprites import Region, SphereSprite

_POOL_MARGIN_PX = 64
"""The noise pool is larger than what is cut from it by this much, so that random crops look fresh."""
_BAND_PX = 300
"""Height of the bands that each get a crop of their own: a pool for the whole height leaves the cache."""


@dataclass(frozen=True)
class MicroscopeConfig:
    """The simulated microscope and what it looks past.

    Attributes:
        noise: Standard deviation of the camera's noise in gray levels, 0..20. At 0 a still scene gives
            identical frames, which the tracker takes for a frozen camera.
        rim_blur_px: Softness of the robot's rim in pixels, 0.3..5.
        pupil_um: Diameter of the camera's entrance pupil in µm, 100..20000; it sets the needle's blur.
        needle_diameter_um: The needle that carries the magnet in µm, 50..5000.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    noise: float = 3.0
    rim_blur_px: float = 1.4
    pupil_um: float = 3000.0
    needle_diameter_um: float = 450.0

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = _RANGES[field.name]
            value = getattr(self, field.name)
            if not low <= value <= high:
                raise ConfigError(f"microscope {field.name} is {value}: set it to {low:g}..{high:g}")


_RANGES = {
    "noise": (0, 20),
    "rim_blur_px": (0.3, 5),
    "pupil_um": (100, 20_000),
    "needle_diameter_um": (50, 5000),
}


class Microscope:
    """Renders camera pictures of a rig.

    The floor is painted once. A frame paints the robot and the occluder on it, adds noise to the whole in
    saturated additions (noise by region would draw a box that a tracker could see), and then restores
    only what was painted over.

    Args:
        config: The microscope.
        picture: Size of its pictures.
        magnets: Size and pose of the magnet, with which the needle is coaxial.
        vessel: What lies under it.
        calibration: Where things appear.
        seed: Seeds the texture and the noise.
        optics: The camera's exact optics, where ``calibration`` is only near to them.

    Raises:
        ConfigError: If the optics fold the vessel over.
    """

    def __init__(
        self,
        config: MicroscopeConfig,
        picture: PictureFormat,
        magnets: Magnets,
        vessel: VesselMap,
        calibration: Calibration,
        seed: int,
        optics: Optics | None = None,
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self._view: View = optics or calibration
        if optics is not None:
            optics.refuse_fold(vessel.size_px)
        width, height = picture.width_px, picture.height_px
        # Unsigned noise around this level; everything painted is lowered by it first.
        offset = round(4 * config.noise)
        seen_px = None if optics is None else optics.grid_seen_px(_pixels(width, height))
        floor = backdrop(vessel, calibration.image_from_vessel, width, height, self._rng, seen_px)
        self._offset = offset
        self.lay(floor)
        self._pool = self._noise_pool(picture, config.noise, offset)
        self._crops = np.zeros(-(-height // _BAND_PX), np.int64)
        self._sphere = SphereSprite(config.rim_blur_px, offset)
        self._radius_px = vessel.robot_radius_px
        shape = NeedleShape(
            magnet_diameter_um=magnets.needle_diameter_um,
            magnet_length_um=magnets.needle_length_um,
            needle_diameter_um=config.needle_diameter_um,
            tilt_deg=magnets.tilt_deg,
            # The image's axes are parallel to the stage's on the simulated rig, so this angle is the same.
            azimuth_deg=magnets.azimuth_deg,
            pupil_um=config.pupil_um,
        )
        self._occluder = Occluder(shape, calibration, self._view, width, height, offset)

    def lay(self, floor: ByteArray) -> None:
        """Lay another floor under the microscope, shape (height, width, 3), BGR, uint8."""
        self._floor = cv2.subtract(floor, np.full_like(floor, self._offset)).astype(np.uint8)
        self._scene = self._floor.copy()

    def render(self, robot: VesselPoint | None, tip: StagePoint) -> ByteArray:
        """Return the picture of a robot and a tip.

        Args:
            robot: The robot's centre; None when there is none on the floor.
            tip: The magnet's centre.

        Returns:
            Shape (height, width, 3), BGR, uint8; a new array each time, so other threads may keep it.
        """
        painted: list[Region] = []
        if robot is not None:
            radius_px = self._radius_px * self._view.image_scale(robot)
            touched = self._sphere.paint(self._scene, self._view.image_point(robot), radius_px)
            if touched is not None:
                painted.append(touched)
        painted += self._occluder.paint(self._scene, tip)
        picture = np.empty_like(self._scene)
        height, width = picture.shape[:2]
        # Never the crops of the picture before: a still scene would look like a frozen camera.
        self._crops += self._rng.integers(1, _POOL_MARGIN_PX**2, len(self._crops))
        self._crops %= _POOL_MARGIN_PX**2
        for top, crop in zip(range(0, height, _BAND_PX), self._crops.tolist(), strict=True):
            row, column = divmod(crop, _POOL_MARGIN_PX)
            band = self._scene[top : top + _BAND_PX]
            noise = self._pool[row : row + len(band), column : column + width]
            cv2.add(band, noise, picture[top : top + _BAND_PX])
        for region in painted:
            self._scene[region] = self._floor[region]
        return picture

    def _noise_pool(self, picture: PictureFormat, noise: float, offset: int) -> ByteArray:
        """Return noise around ``offset``: three quarters common to the channels, as demosaicing leaves it."""
        shape = (_BAND_PX + _POOL_MARGIN_PX, picture.width_px + _POOL_MARGIN_PX)
        pool = self._rng.standard_normal((*shape, 3), np.float32) * np.float32(0.66 * noise)
        pool += self._rng.standard_normal((*shape, 1), np.float32) * np.float32(0.75 * noise)
        pool += np.float32(offset)
        return np.clip(np.rint(pool, out=pool), 0.0, 255.0, out=pool).astype(np.uint8)


def floor_seen_um(optics: Optics, width_px: int, height_px: int) -> FloatArray:
    """Return the floor point that each pixel shows, in µm, shape (height, width, 2)."""
    return optics.floor_um(_pixels(width_px, height_px))


def _pixels(width_px: int, height_px: int) -> FloatArray:
    columns, rows = np.meshgrid(np.arange(width_px, dtype=np.float64), np.arange(height_px, dtype=np.float64))
    return np.stack([columns, rows], axis=-1)
