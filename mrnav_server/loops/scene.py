"""What is known of tip, robot and goal at this moment."""

from mrnav_server.core.frames import Calibration, VesselPoint
from mrnav_server.core.records import CriticalArea, TipReading, Track, TrackState
from mrnav_server.core.vessel import VesselMap


class Scene:
    """The newest tip reading and track, the active area, and the distances between them.

    Args:
        calibration: Frames and heights.
        vessel: The vessel model.
    """

    def __init__(self, calibration: Calibration, vessel: VesselMap) -> None:
        self.tip: TipReading | None = None
        """The newest tip reading."""
        self.area: CriticalArea | None = None
        """The active critical area."""
        self._calibration = calibration
        self._vessel = vessel
        self._track: Track | None = None
        self._seen: Track | None = None

    @property
    def track(self) -> Track | None:
        """The newest track, with or without a position."""
        return self._track

    @property
    def seen(self) -> Track | None:
        """The newest track with a position."""
        return self._seen

    @property
    def robot(self) -> VesselPoint | None:
        """Where the robot was last seen; None while it is lost."""
        if self._track is None or self._seen is None or self._track.state is TrackState.SEARCHING:
            return None
        return self._seen.vessel

    @property
    def lead_um(self) -> float | None:
        """How far the magnet's hold point is from the robot."""
        robot, tip = self.robot, self.tip
        if robot is None or tip is None:
            return None
        return self._calibration.held_point(tip.position).distance_px(robot) * self._vessel.um_per_px

    @property
    def distance_um(self) -> float | None:
        """How far the robot is from the centre of the active area."""
        robot = self.robot
        if robot is None or self.area is None:
            return None
        return robot.distance_px(self.area.center) * self._vessel.um_per_px

    @property
    def tip_distance_um(self) -> float | None:
        """How far the magnet's hold point is from the centre of the active area."""
        if self.tip is None or self.area is None:
            return None
        held = self._calibration.held_point(self.tip.position)
        return held.distance_px(self.area.center) * self._vessel.um_per_px

    def see(self, track: Track) -> None:
        """Take the newest track."""
        self._track = track
        if track.vessel is not None:
            self._seen = track

    def recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration; where the robot was seen under the old one is forgotten."""
        self._calibration = calibration
        self._track = self._seen = None
