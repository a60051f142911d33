"""Policy, planner and autopilot of one vessel; planning happens in a thread of its own."""

import asyncio
import json
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from mrnav_server.autonomy.following import Law
from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.autonomy.path import PathPlanner, PlannedPath
from mrnav_server.autonomy.policy import Policy, PolicyError
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Calibration, VesselPoint
from mrnav_server.core.records import CriticalArea
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_twin import PolicyCard
from mrnav_server.loops.autopilot import Autopilot, PathOrder
from mrnav_server.loops.laws import new_law
from mrnav_server.loops.ticks import ticks
from mrnav_server.settings import Settings
from mrnav_server.vision.model_store import find_model

_LOOK_S = 0.01


class Navigator:
    """Everything that autonomy needs.

    Args:
        settings: Sections ``rig``, ``path``, ``follower``, ``autopilot`` and ``handover``.
        vessel: The vessel model.
        calibration: How camera, vessel model and manipulator see each other.
    """

    def __init__(self, settings: Settings, vessel: VesselMap, calibration: Calibration) -> None:
        self._config = settings.autopilot
        self._handover = settings.handover
        self._follower_config = settings.follower
        self._path_config = settings.path
        self._folder = find_model(settings.rig.vessel)
        self._vessel = vessel
        self._calibration = calibration
        self._planner: PathPlanner | None = None
        self._lengths: GridGraph | None = None
        self._policy: Policy | None = None
        self._thread = ThreadPoolExecutor(1, "planner")
        self.policy_sha256 = ""
        self._verdict = "not loaded yet"
        self.autopilot = Autopilot(
            settings.autopilot,
            self._law(),
            settings.limits.autonomy_speed_um_per_s,
            vessel.um_per_px,
            "autonomy is still loading",
        )

    def recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration; what was learnt of magnet and robot under the old one is forgotten."""
        self._calibration = calibration
        self.autopilot.use(self._law())

    async def load(self) -> None:
        """Verify and warm up the policy and build the planner; a bad policy leaves MANUAL working."""
        await asyncio.get_running_loop().run_in_executor(self._thread, self._load)
        wanted = self._config.source == "policy"
        self.autopilot.refusal = self._verdict if wanted else ""
        if self._config.law == "direct":
            self.autopilot.use(self._law())

    async def use(self, folder: Path) -> None:
        """Go by the policy in a folder from here on.

        Raises:
            RefusedError: If it cannot be used; the policy in use stays.
        """
        try:
            await asyncio.get_running_loop().run_in_executor(self._thread, self._load_policy, folder)
        except PolicyError as error:
            raise RefusedError("bad_policy", f"the policy cannot be used: {error}") from None
        if self._config.source == "policy":
            self.autopilot.refusal = ""
        if self._config.law == "direct":
            self.autopilot.use(self._law())

    async def plan(
        self, start: VesselPoint, target: VesselPoint, epsilon_um: float = math.inf
    ) -> PlannedPath:
        """Plan the way to a target, so near to which the robot must rest.

        Raises:
            RefusedError: If there is none.
        """
        return await asyncio.get_running_loop().run_in_executor(
            self._thread, self._plan, start, target, epsilon_um
        )

    def prepare(self, path: PlannedPath, area: CriticalArea) -> None:
        """Have the autopilot take a path to an area; nothing moves before AUTO begins."""
        slow_um = area.epsilon_um if self._handover.in_motion(area.epsilon_um) else 0.0
        self.autopilot.prepare(path, area.center, slow_um, area.epsilon_um)

    async def run(self, clock: Callable[[], float]) -> None:
        """Plan the paths that the autopilot orders while it drives, until cancelled."""
        async for _ in ticks(_LOOK_S, clock):
            order = self.autopilot.order
            if order is None:
                continue
            try:
                path = await self.plan_order(order)
            except RefusedError as refused:
                self.autopilot.decline(order, str(refused))
            else:
                self.autopilot.deliver(order, path)

    async def plan_order(self, order: PathOrder) -> PlannedPath | None:
        """Plan what was ordered; None if there is no way off the target."""
        loop = asyncio.get_running_loop()
        if order.back_off:
            return await loop.run_in_executor(self._thread, self._plan_back_off, order)
        return await self.plan(order.start, order.target, order.epsilon_um)

    def policy_cards(self) -> list[PolicyCard]:
        """Return the policy of this vessel model and the baseline."""
        return [
            PolicyCard(self._folder.name, "torchscript", not self._verdict, self._verdict),
            PolicyCard("geodesic", "geodesic", verified=True, reason=""),
        ]

    def close(self) -> None:
        """End the planner's thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _load(self) -> None:
        self._planner = PathPlanner(self._vessel, self._path_config)
        if self._config.law == "direct":
            self._lengths = GridGraph(self._vessel)
            # Built once, here: later asks only read it.
            _ = self._lengths.matrix
        try:
            self._load_policy(self._folder)
        except PolicyError as error:
            self._verdict = f"the policy cannot be used: {error}"

    def _load_policy(self, folder: Path) -> None:
        from mrnav_server.autonomy.torchscript import load_policy

        self._policy = load_policy(folder, self._vessel)
        manifest = json.loads((folder / "manifest.json").read_text())
        self.policy_sha256 = manifest["policy_sha256"]
        self._folder, self._verdict = folder, ""

    def _plan(self, start: VesselPoint, target: VesselPoint, epsilon_um: float) -> PlannedPath:
        policy = self._policy if self._config.source == "policy" else None
        path = self._ready_planner().plan(
            start,
            target,
            policy,
            greedy=self._config.greedy,
            seed=self._config.seed,
            epsilon_um=epsilon_um,
        )
        return (
            path if self._lengths is None else replace(path, to_go=self._lengths.field(target), fallback="")
        )

    def _plan_back_off(self, order: PathOrder) -> PlannedPath | None:
        return self._ready_planner().plan_back_off(order.start, order.target)

    def _law(self) -> Law:
        """Return a law that has learnt nothing yet; the follower, too, where the policy cannot be used."""
        return new_law(self._config, self._follower_config, self._policy, self._vessel, self._calibration)

    def _ready_planner(self) -> PathPlanner:
        if self._planner is None:
            raise RuntimeError("the navigator was not loaded")
        return self._planner
