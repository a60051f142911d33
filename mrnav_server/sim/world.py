"""The simulated rig's world: manipulator, magnet and robot, advanced only when told."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Affine2, Calibration, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.magnetics import Magnets, critical_height_um, equilibrium_offset_um
from mrnav_server.sim.optics import Optics, OpticsConfig
from mrnav_server.sim.robot import STEP_S, Robot

TRAVEL_UM = 20_000.0
"""Each axis of the manipulator goes from 0 to this."""
SLOWEST_UM_PER_S = 1.0
"""The slowest speed that the manipulator takes."""
ARRIVED_UM = 0.1
"""A manipulator this near to its target says that it rests."""
TOUCHING_UM = 1000.0
"""The magnet's centre comes no nearer to the robot's centre than this."""
FARTHEST_UM = 5000.0
"""The vessel lies no further than this from where the server is told, along each axis."""
ALLOWED = {
    "friction": (0.0, 1.0),
    "static_ratio": (1.0, 3.0),
    "drag_factor": (1.0, 20.0),
    "viscosity_pa_s": (1e-4, 0.1),
    "height_factor": (1.0, 1.5),
    "floor_z_um": (0.0, TRAVEL_UM),
    "offset_error_um": (0.0, 1000.0),
    "manipulator_lag_s": (1e-3, 1.0),
    "manipulator_speed_um_per_s": (SLOWEST_UM_PER_S, 100_000.0),
    "image_um_per_px": (1.0, 100.0),
    "camera_latency_ms": (0.0, 1000.0),
    "vessel_turn_deg": (-30.0, 30.0),
}
"""What the simulation can compute; the ranges in ``SimConfig`` are those of the bench."""


@dataclass(frozen=True, slots=True)
class SimConfig:
    """The simulated rig.

    Attributes:
        friction: Kinetic friction coefficient of the robot, 0.05..0.3.
        static_ratio: Static over kinetic friction, 1..1.5.
        drag_factor: Drag near the floor over Stokes drag, 3..6.
        viscosity_pa_s: Viscosity of the fluid, 0.0007..0.005 Pa·s.
        height_factor: Working height over the critical height, 1.03..1.06.
        floor_z_um: Stage z at which the magnet's centre would touch the robot's centre, in µm.
        offset_error_um: How wrong the calibrated magnetic offset is, in µm, 0..300; its direction is seeded.
        manipulator_lag_s: Time constant of the manipulator's position servo, in s, 0.005..0.1.
        manipulator_speed_um_per_s: Fastest speed of the manipulator, in µm/s, 1..5000.
        start: Where the robot begins; None is near an end of the vessel.
        image_um_per_px: Size of a camera pixel on the channel's floor, in µm.
        camera_latency_ms: From capture to delivery of a frame, in ms, 0..100.
        vessel_shift_um: How far the vessel lies from where the server is told, along x and y in µm,
            -5000..5000 each; the server finds out by registration.
        vessel_turn_deg: How it is turned about its middle, from x towards y, in °, -30..30.
        seed: Seed of everything that is drawn by chance.
        magnets: The magnets and the ambient field.
        optics: Tilt and distortion of the camera, and the water over the channel.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    friction: float = 0.2
    static_ratio: float = 1.2
    drag_factor: float = 4.0
    viscosity_pa_s: float = 1e-3
    height_factor: float = 1.04
    floor_z_um: float = 2000.0
    offset_error_um: float = 100.0
    manipulator_lag_s: float = 0.02
    manipulator_speed_um_per_s: float = 5000.0
    start: VesselPoint | None = None
    image_um_per_px: float = 15.0
    camera_latency_ms: float = 5.0
    vessel_shift_um: tuple[float, float] = (0.0, 0.0)
    vessel_turn_deg: float = 0.0
    seed: int = 0
    magnets: Magnets = field(default_factory=Magnets)
    optics: OpticsConfig = field(default_factory=OpticsConfig)

    def __post_init__(self) -> None:
        for name, (low, high) in ALLOWED.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"sim.{name} is {value:g}; choose it within {low:g}..{high:g}")
        if not all(abs(axis_um) <= FARTHEST_UM for axis_um in self.vessel_shift_um):
            raise ConfigError(
                f"sim.vessel_shift_um is {self.vessel_shift_um}; choose both within ±{FARTHEST_UM:g}"
            )


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The world at one instant; any thread may read it.

    Attributes:
        time_s: The world's time, in seconds.
        robot: Where the robot is.
        tip: Where the manipulator's encoders say that the magnet is.
        magnet: Where the magnet is; differs from the tip once the needle was bumped.
        moving: Whether the manipulator is on its way.
        collisions: Onsets of wall contact so far.
        lifted: Whether the robot jumped to the magnet.
    """

    time_s: float
    robot: VesselPoint
    tip: StagePoint
    magnet: StagePoint
    moving: bool
    collisions: int
    lifted: bool


class SimulatedWorld:
    """Manipulator, magnet and robot.

    One thread advances and commands it; other threads read ``snapshot()``.

    Args:
        config: The rig.
        vessel: The vessel model.
        picture: The camera's pictures; the vessel is centred in them.
        seed: Takes the place of ``config.seed``.

    Attributes:
        true_calibration: What the physics and the renderer follow.
        calibration: What the server is told; its magnetic offset is wrong by ``offset_error_um``, and the
            vessel lies elsewhere if ``vessel_shift_um`` or ``vessel_turn_deg`` say so.
        optics: The camera that the renderer follows; None while ``config.optics`` is plain, when
            ``true_calibration`` says it all. Under water its maps are paraxial, the optics exact.

    Raises:
        ConfigError: If robot, vessel and manipulator do not fit each other.
    """

    def __init__(
        self, config: SimConfig, vessel: VesselMap, picture: PictureFormat, seed: int | None = None
    ) -> None:
        told = true_calibration(config, vessel, picture)
        self.true_calibration = told.registered(_lies(config, vessel))
        self.optics = optics(config, vessel, picture)
        rng = np.random.default_rng(config.seed if seed is None else seed)
        self.calibration = _with_offset_error(told, config.offset_error_um, rng)
        start = config.start or start_near_an_end(vessel)
        _require_free(vessel, start)
        self._config = config
        self._vessel = vessel
        self._vessel_from_stage = self.true_calibration.stage_from_vessel.inverse()
        self._robot = _robot(config, vessel, start)
        self._tip_um = self._target_um = _tip_at_rest_um(config, self.true_calibration, start)
        self._speed_um_per_s = SLOWEST_UM_PER_S
        self._bump_um = (0.0, 0.0)
        self._origin_s = 0.0
        self._steps = 0
        self._remainder_s = 0.0
        self._snapshot = self._seen()

    def set_time(self, now_s: float) -> None:
        """Put the world's time on the caller's clock; nothing moves.

        Call it before the first ``advance``, so that frames and readings carry times of that clock.
        """
        self._origin_s, self._steps, self._remainder_s = now_s, 0, 0.0
        self._snapshot = self._seen()

    def advance(self, dt_s: float) -> None:
        """Let time pass in steps of 1 ms; what is left over is kept for the next call.

        Raises:
            ValueError: If ``dt_s`` is negative or not finite.
        """
        if not (math.isfinite(dt_s) and dt_s >= 0.0):
            raise ValueError(f"time advances by a finite dt_s >= 0, not {dt_s}")
        self._remainder_s += dt_s
        steps = int(self._remainder_s / STEP_S + 1e-6)  # 0.001 added up a thousand times is one second
        for _ in range(steps):
            self._step()
        self._steps += steps
        self._remainder_s -= steps * STEP_S
        self._snapshot = self._seen()

    def set_target(self, target: StagePoint, speed_um_per_s: float) -> tuple[StagePoint, float]:
        """Send the manipulator to a target, in place of the one before.

        Returns:
            Target and speed within the manipulator's travel and speeds.
        """
        self._target_um = (_in_travel(target.x_um), _in_travel(target.y_um), _in_travel(target.z_um))
        fastest = self._config.manipulator_speed_um_per_s
        self._speed_um_per_s = min(max(speed_um_per_s, SLOWEST_UM_PER_S), fastest)
        return StagePoint(*self._target_um), self._speed_um_per_s

    def follow(self, tip: StagePoint) -> None:
        """Let the magnet follow a tip that something outside the world moves."""
        self._target_um = (tip.x_um, tip.y_um, tip.z_um)
        self._speed_um_per_s = math.inf

    def place_tip(self, tip: StagePoint) -> None:
        """Put the tip somewhere at once; the robot stays where it is."""
        self._tip_um = self._target_um = (tip.x_um, tip.y_um, tip.z_um)
        self._snapshot = self._seen()

    def stop(self) -> None:
        """Stop the manipulator where it is; its servo has no mass that would carry it on."""
        self._target_um = self._tip_um

    def drop_robot(self) -> None:
        """Simulate a robot that was lost: the magnet no longer pulls it."""
        self._robot.held = False

    def lay(self, vessel: VesselMap, start: VesselPoint) -> None:
        """Put another vessel in the present one's place, of the same grid; the robot rests in it, released.

        Raises:
            ConfigError: If the robot does not fit there.
        """
        _require_free(vessel, start)
        self._vessel = vessel
        self._robot = _robot(self._config, vessel, start)
        self._robot.held = False
        self._snapshot = self._seen()

    def place_robot(self, point: VesselPoint) -> None:
        """Put the robot down at rest, held by the magnet again; the manipulator stays where it is.

        Raises:
            ConfigError: If the robot does not fit there.
        """
        _require_free(self._vessel, point)
        self._robot.held = True
        self._robot.place(point)
        self._snapshot = self._seen()

    def bump_needle(self, dx_um: float, dy_um: float) -> None:
        """Simulate a bump of the needle: the magnet shifts, the manipulator's encoders do not see it."""
        self._bump_um = (self._bump_um[0] + dx_um, self._bump_um[1] + dy_um)
        self._snapshot = self._seen()

    @property
    def time_s(self) -> float:
        """The world's time: that of its last whole step."""
        return self._origin_s + self._steps * STEP_S

    @property
    def tip(self) -> StagePoint:
        """Where the manipulator's encoders say that the magnet is."""
        return StagePoint(*self._tip_um)

    @property
    def magnet(self) -> StagePoint:
        """Where the magnet is; differs from the tip once the needle was bumped."""
        x_um, y_um, z_um = self._tip_um
        return StagePoint(x_um + self._bump_um[0], y_um + self._bump_um[1], z_um)

    @property
    def moving(self) -> bool:
        """Whether the manipulator is on its way."""
        return math.dist(self._tip_um, self._target_um) > ARRIVED_UM

    @property
    def robot(self) -> VesselPoint:
        """Where the robot is."""
        return self._robot.position

    @property
    def collisions(self) -> int:
        """Onsets of wall contact so far."""
        return self._robot.collisions

    @property
    def lifted(self) -> bool:
        """Whether the robot jumped to the magnet; it stays out of reach until it is placed again."""
        return self._robot.lifted

    def snapshot(self) -> Snapshot:
        """Return the world after the last ``advance``; safe from any thread."""
        return self._snapshot

    def _step(self) -> None:
        """Move the tip as a first-order servo with bounded speed, then the robot under the magnet."""
        x, y, z = self._tip_um
        to_x, to_y, to_z = self._target_um
        ex, ey, ez = to_x - x, to_y - y, to_z - z
        left_um = math.sqrt(ex * ex + ey * ey + ez * ez)
        if left_um > 0.0:
            share = 1.0 - math.exp(-STEP_S / self._config.manipulator_lag_s)
            share = min(share, self._speed_um_per_s * STEP_S / left_um)
            x, y, z = x + share * ex, y + share * ey, z + share * ez
            self._tip_um = (x, y, z)
        x_px, y_px = self._vessel_from_stage(x + self._bump_um[0], y + self._bump_um[1])
        height_um = max(z - self._config.floor_z_um, TOUCHING_UM)
        px_m = self._vessel.um_per_px * 1e-6
        self._robot.step(x_px * px_m, y_px * px_m, height_um * 1e-6)

    def _seen(self) -> Snapshot:
        return Snapshot(
            self.time_s, self.robot, self.tip, self.magnet, self.moving, self.collisions, self.lifted
        )


def true_calibration(config: SimConfig, vessel: VesselMap, picture: PictureFormat) -> Calibration:
    """Return the calibration that the simulated rig is built to, with the vessel where it belongs.

    The vessel is centred in the image; the tip that holds a robot in the vessel's centre is centred in the
    manipulator's travel. Vessel, image and stage have parallel x and y axes.

    Raises:
        ConfigError: If the magnets hold no robot, or the vessel is made for another one.
    """
    plain = _plain_calibration(config, vessel, picture)
    if config.optics.is_plain:
        return plain
    true = Optics(config.optics, plain, picture)
    um = vessel.um_per_px
    floor = true.floor_map().after(np.array(Affine2.scale(um).rows()))
    return replace(
        plain,
        image_from_vessel=Affine2.of_rows(floor.best_affine(vessel.size_px)),
        floor=floor,
        tip=true.tip_map().then(np.array(Affine2.scale(1.0 / um).rows())),
    )


def optics(config: SimConfig, vessel: VesselMap, picture: PictureFormat) -> Optics | None:
    """Return the camera's exact optics, or None if they are plain."""
    if config.optics.is_plain:
        return None
    plain = _plain_calibration(config, vessel, picture)
    return Optics(config.optics, plain, picture, _lies(config, vessel))


def _lies(config: SimConfig, vessel: VesselMap) -> Affine2:
    """Return where the vessel's grid pixels lie in the grid that the server is told."""
    turn, half = math.radians(config.vessel_turn_deg), vessel.size_px / 2.0
    a, c = math.cos(turn), math.sin(turn)
    x_px, y_px = (axis_um / vessel.um_per_px for axis_um in config.vessel_shift_um)
    return Affine2(a, -c, c, a, half - half * (a - c) + x_px, half - half * (a + c) + y_px)


def _seen_from_vessel(config: SimConfig) -> Magnets:
    """Return the magnets and the ambient field in the axes of a vessel that is turned."""
    magnets, turn = config.magnets, math.radians(config.vessel_turn_deg)
    x_t, y_t, z_t = magnets.ambient_t
    turned_t = Affine2(math.cos(turn), math.sin(turn), -math.sin(turn), math.cos(turn), 0.0, 0.0)(x_t, y_t)
    azimuth_deg = math.remainder(magnets.azimuth_deg - config.vessel_turn_deg, 360.0)
    return replace(magnets, azimuth_deg=azimuth_deg, ambient_t=(*turned_t, z_t))


def _plain_calibration(config: SimConfig, vessel: VesselMap, picture: PictureFormat) -> Calibration:
    """Return the calibration under a camera that looks straight down through a perfect lens."""
    radius_um = vessel.robot_radius_px * vessel.um_per_px
    if abs(radius_um - config.magnets.robot_radius_um) > 1.0:
        raise ConfigError(
            f"magnets.robot_radius_um is {config.magnets.robot_radius_um:.0f} but vessel model {vessel.name}"
            f" is made for {radius_um:.0f} µm; set them equal"
        )
    critical_um = critical_height_um(config.magnets)
    offset_um = equilibrium_offset_um(config.magnets, config.height_factor * critical_um)
    px = vessel.um_per_px / config.image_um_per_px
    center_um = TRAVEL_UM / 2.0
    half_um = vessel.size_px * vessel.um_per_px / 2.0
    return Calibration(
        image_from_vessel=Affine2.scale(
            px,
            (picture.width_px - vessel.size_px * px) / 2.0,
            (picture.height_px - vessel.size_px * px) / 2.0,
        ),
        stage_from_vessel=Affine2.scale(
            vessel.um_per_px, center_um - half_um - offset_um[0], center_um - half_um - offset_um[1]
        ),
        um_per_px=vessel.um_per_px,
        floor_z_um=config.floor_z_um,
        magnet_offset_um=offset_um,
        critical_height_um=critical_um,
        image_center_px=picture.center_px,
    )


def start_near_an_end(vessel: VesselMap) -> VesselPoint:
    """Return a place with a median clearance or more, as far as possible from where treatment is needed.

    That is the suggested critical areas, or the vessel's middle where there are none.
    """
    y, x = np.nonzero(vessel.free)
    clearance = vessel.distance_px[y, x]
    roomy = clearance >= np.median(clearance)
    y, x = y[roomy], x[roomy]
    away = [(area.x_px, area.y_px) for area in vessel.suggested_areas] or [(x.mean(), y.mean())]
    nearest = np.min([np.hypot(x - to_x, y - to_y) for to_x, to_y in away], axis=0)
    farthest = int(np.argmax(nearest))
    return VesselPoint(float(x[farthest]), float(y[farthest]))


def _with_offset_error(true: Calibration, error_um: float, rng: np.random.Generator) -> Calibration:
    angle = rng.uniform(0.0, 2.0 * math.pi)
    x_um, y_um = true.magnet_offset_um
    return replace(
        true, magnet_offset_um=(x_um + error_um * math.cos(angle), y_um + error_um * math.sin(angle))
    )


def _robot(config: SimConfig, vessel: VesselMap, start: VesselPoint) -> Robot:
    return Robot(
        _seen_from_vessel(config),
        vessel,
        start,
        friction=config.friction,
        static_ratio=config.static_ratio,
        drag_factor=config.drag_factor,
        viscosity_pa_s=config.viscosity_pa_s,
    )


def _require_free(vessel: VesselMap, point: VesselPoint) -> None:
    if not vessel.is_free(point.x_px, point.y_px) or vessel.clearance_um(point) < 0.0:
        raise ConfigError(
            f"the robot does not fit at ({point.x_px:g}, {point.y_px:g}) px in vessel model {vessel.name};"
            " name a start in the vessel's free space, or none"
        )


def _tip_at_rest_um(
    config: SimConfig, calibration: Calibration, robot: VesselPoint
) -> tuple[float, float, float]:
    """Return where the tip stands so that the robot rests under it, at the working height."""
    x_um, y_um = calibration.stage_xy_um(robot)
    dx_um, dy_um = calibration.magnet_offset_um
    z_um = config.floor_z_um + config.height_factor * calibration.critical_height_um
    tip_um = (x_um + dx_um, y_um + dy_um, z_um)
    if tip_um != tuple(_in_travel(axis) for axis in tip_um):
        raise ConfigError(
            f"the tip would stand at {tip_um} µm, outside the manipulator's 0..{TRAVEL_UM:.0f} µm;"
            " use a smaller vessel model, or a lower floor_z_um"
        )
    return tip_um


def _in_travel(axis_um: float) -> float:
    return min(max(axis_um, 0.0), TRAVEL_UM)
