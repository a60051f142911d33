"""The follower's frame: the vessel's plane in µm (grid pixels times µm per pixel)."""

from mrnav_server.core.frames import Calibration, StagePoint, VesselPoint


class Plane:
    """Maps between the vessel's plane in µm and the tip in the stage frame.

    The hold point, where a frictionless robot rests below the tip, stands for the tip in the plane.

    Args:
        calibration: How vessel and manipulator see each other.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._um_per_px = calibration.um_per_px
        self._from_stage = calibration.stage_from_vessel.inverse()
        self._to_stage = calibration.stage_from_vessel
        self._offset_um = calibration.magnet_offset_um

    def point_um(self, point: VesselPoint) -> tuple[float, float]:
        """Return a vessel point in the plane."""
        return point.x_px * self._um_per_px, point.y_px * self._um_per_px

    def hold_um(self, tip: StagePoint) -> tuple[float, float]:
        """Return the hold point below a tip."""
        x_px, y_px = self._from_stage(tip.x_um - self._offset_um[0], tip.y_um - self._offset_um[1])
        return x_px * self._um_per_px, y_px * self._um_per_px

    def tip_um(self, hold_um: tuple[float, float]) -> tuple[float, float]:
        """Return the tip, stage x and y, that holds a point."""
        x_um, y_um = self._to_stage(hold_um[0] / self._um_per_px, hold_um[1] / self._um_per_px)
        return x_um + self._offset_um[0], y_um + self._offset_um[1]

    def tip_velocity_um_per_s(self, velocity_um_per_s: tuple[float, float]) -> tuple[float, float]:
        """Return the tip's velocity, stage x and y, for a velocity of the hold point."""
        to_stage, um_per_px = self._to_stage, self._um_per_px
        vx, vy = velocity_um_per_s[0] / um_per_px, velocity_um_per_s[1] / um_per_px
        return to_stage.a * vx + to_stage.b * vy, to_stage.c * vx + to_stage.d * vy
