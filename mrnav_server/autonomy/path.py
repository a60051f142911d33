"""Plans a path for the robot's centre: the policy's roll-out in the grid, or the clearance-aware geodesic."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mrnav_server.autonomy.band import clearance_field_px, smooth_path, tangents
from mrnav_server.autonomy.grid_graph import DistanceField, GridGraph
from mrnav_server.autonomy.policy import Policy, Sampler, shield
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.navigation import ACTIONS, ARRIVAL_PX, is_free, observation
from mrnav_server.core.vessel import VesselMap

_NUDGE_PX, _NUDGES = 0.5, 30


@dataclass(frozen=True, slots=True)
class PathConfig:
    """How raw routes become paths.

    Attributes:
        wanted_clearance_um: Walls push the path up to this gap between rim and wall, in µm (0–1000).
        smoothing_um: Standard deviation of the final Gaussian along the path, in µm (50–600).
        end_clearance_um: The end point is nudged to this gap if that is near, in µm (0–300).
        end_nudge_um: How far the end point may be nudged, in µm; stays below the follower's arrival radius.
        coast_um: The path ends this much early: a stopping robot coasts on, in µm (0–150).
        geodesic_clearance_weight: How dear the wall is to the geodesic, relative to length (0–20).
        geodesic_clearance_um: Gap beyond which the geodesic does not care, in µm (50–1000).
        roll_out_steps: A policy's roll-out that has not arrived after this many actions has failed.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    wanted_clearance_um: float = 250.0
    smoothing_um: float = 300.0
    end_clearance_um: float = 150.0
    end_nudge_um: float = 65.0
    coast_um: float = 60.0
    geodesic_clearance_weight: float = 6.0
    geodesic_clearance_um: float = 300.0
    roll_out_steps: int = 2000


@dataclass(frozen=True, slots=True)
class PlannedPath:
    """A smooth path for the robot's centre.

    Attributes:
        points_px: Evenly spaced by about 1 px, shape (n, 2), n >= 2, in the vessel's grid.
        tangents: Unit vectors, shape (n, 2).
        target: Where the robot shall stop; the path ends a coasting distance before it.
        source: What proposed the route.
        fallback: Why the geodesic stands in for the policy; "" where it does not.
        back_off: Whether this path only makes room for a new approach to a target that was missed.
        to_go: How far the target is from everywhere, for a law that does not follow the points.
    """

    points_px: FloatArray
    tangents: FloatArray
    target: VesselPoint
    source: Literal["policy", "geodesic"]
    fallback: str = ""
    back_off: bool = False
    to_go: DistanceField | None = None

    @property
    def spacing_px(self) -> float:
        """Mean distance between neighbouring points, in grid pixels."""
        return self.length_px / (len(self.points_px) - 1)

    @property
    def length_px(self) -> float:
        """Length of the polyline, in grid pixels."""
        return float(np.hypot(*np.diff(self.points_px, axis=0).T).sum())


class PathPlanner:
    """Plans paths on one vessel. Building takes about 0.2 s; planning tens of milliseconds, in any thread.

    Args:
        vessel: The vessel model.
        config: How raw routes become paths.
    """

    def __init__(self, vessel: VesselMap, config: PathConfig | None = None) -> None:
        self._vessel = vessel
        self._config = config = config or PathConfig()
        self._clearance_px = clearance_field_px(vessel)
        self._graph = GridGraph(
            vessel,
            clearance_weight=config.geodesic_clearance_weight,
            clearance_px=config.geodesic_clearance_um / vessel.um_per_px,
        )
        # The matrix is built once, here, so that planner threads only read it.
        _ = self._graph.matrix

    def plan(
        self,
        start: VesselPoint,
        target: VesselPoint,
        policy: Policy | None = None,
        *,
        greedy: bool = True,
        seed: int = 0,
        epsilon_um: float = math.inf,
    ) -> PlannedPath:
        """Plan a path from the robot to a target.

        Args:
            start: Where the robot is.
            target: Where it shall stop.
            policy: Who proposes the route; None asks the clearance-aware geodesic.
            greedy: Best actions with direction memory, or one draw from the policy's distribution.
            seed: Of the draw.
            epsilon_um: The robot must rest so near to the target, which bounds how far the end is nudged.

        Returns:
            The path; `PlannedPath.fallback` says why if the policy did not reach the target.

        Raises:
            RefusedError: ``no_path`` if start and target are not connected.
        """
        end = self._end_point(target, min(self._config.end_nudge_um, 0.5 * epsilon_um))
        if policy is None:
            return self._smooth(self._graph.path(start, end), target, "geodesic")
        route_px, failure = self._roll_out(start, end, policy, Sampler(greedy=greedy, seed=seed))
        if failure:
            return self._smooth(self._graph.path(start, end), target, "geodesic", fallback=failure)
        return self._smooth(route_px, target, "policy")

    def plan_back_off(self, start: VesselPoint, target: VesselPoint) -> PlannedPath | None:
        """Plan a short way off a missed target, to approach it again with room.

        The waypoint lies 1.1, 1.5 or 1.9 mm from the target, in plain sight of it and of the robot, where
        the lines to both have the most clearance.

        Returns:
            The path, or None where no such point has room.
        """
        um_per_px = self._vessel.um_per_px
        angles = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        offsets_px = np.concatenate([ring * radius_um / um_per_px for radius_um in (1100.0, 1500.0, 1900.0)])
        waypoints_px = np.array([target.x_px, target.y_px]) + offsets_px
        room_px = np.minimum(self._room_px(target, waypoints_px), self._room_px(start, waypoints_px))
        best = int(np.argmax(room_px))
        if room_px[best] * um_per_px < 60.0:
            return None
        waypoint = VesselPoint(float(waypoints_px[best, 0]), float(waypoints_px[best, 1]))
        return self._smooth(self._graph.path(start, waypoint), waypoint, "geodesic", back_off=True)

    def _roll_out(
        self, start: VesselPoint, end: VesselPoint, policy: Policy, sampler: Sampler
    ) -> tuple[FloatArray, str]:
        """Return the policy's route in the grid that it was trained in, and why it failed, or ""."""
        begin_px = np.rint([start.x_px, start.y_px])
        end_px = np.array([end.x_px, end.y_px])
        at_px = begin_px
        route = [np.array([start.x_px, start.y_px])]
        for _ in range(self._config.roll_out_steps):
            if float(np.hypot(*(at_px - end_px))) < ARRIVAL_PX:
                return np.array([*route, end_px]), ""
            logits = policy.logits(observation(at_px, begin_px, end_px)[None])
            if np.isnan(logits).any():
                return np.array(route), f"policy {policy.name} answers with what is not a number"
            action = int(sampler.choose(shield(self._vessel, at_px[None], logits))[0])
            at_px = at_px + ACTIONS[action]
            if not is_free(self._vessel.free, at_px):
                return np.array(route), f"policy {policy.name} runs into the wall"
            route.append(at_px)
        return np.array(
            route
        ), f"policy {policy.name} does not arrive in {self._config.roll_out_steps} actions"

    def _smooth(
        self,
        route_px: FloatArray,
        target: VesselPoint,
        source: Literal["policy", "geodesic"],
        *,
        fallback: str = "",
        back_off: bool = False,
    ) -> PlannedPath:
        um_per_px = self._vessel.um_per_px
        config = self._config
        points_px = smooth_path(
            route_px,
            self._clearance_px,
            config.wanted_clearance_um / um_per_px,
            config.smoothing_um / um_per_px,
        )
        coast = round(config.coast_um / um_per_px)
        points_px = points_px[: max(len(points_px) - coast, min(len(points_px), 4))]
        return PlannedPath(points_px, tangents(points_px), target, source, fallback, back_off)

    def _end_point(self, target: VesselPoint, nudge_um: float) -> VesselPoint:
        """Return the target, nudged away from a near wall by no more than about ``nudge_um``."""
        wanted_px = self._vessel.robot_radius_px + self._config.end_clearance_um / self._vessel.um_per_px
        nudge_px = nudge_um / self._vessel.um_per_px
        end = target
        for _ in range(_NUDGES):
            roomy = self._vessel.wall_distance_px(end.x_px, end.y_px) >= wanted_px
            if roomy or end.distance_px(target) >= nudge_px:
                break
            gx, gy = self._vessel.wall_gradient(end.x_px, end.y_px)
            end = VesselPoint(end.x_px + _NUDGE_PX * gx, end.y_px + _NUDGE_PX * gy)
        return end

    def _room_px(self, origin: VesselPoint, ends_px: FloatArray) -> FloatArray:
        """Return the least clearance on straight lines from a point, without their first 30 %, shape (m,).

        A line that leaves the free space, or the grid, has no room: -1.
        """
        share = np.linspace(0.0, 1.0, 40)[:, None, None]
        here_px = np.array([origin.x_px, origin.y_px])
        lines = np.rint(here_px + share * (ends_px - here_px)).astype(np.int64)
        top = self._vessel.size_px - 1
        inside = ((lines >= 0) & (lines <= top)).all(axis=(0, 2))
        np.clip(lines, 0, top, out=lines)
        gap_px = self._clearance_px[lines[..., 1], lines[..., 0]]
        room_px: FloatArray = gap_px[12:].min(axis=0).astype(np.float64)
        return np.where(inside & (gap_px.min(axis=0) >= 0.0), room_px, -1.0)
