"""The published navigation task as a Gymnasium environment, ``mrnav/VesselNav-v0``."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from mrnav_server.core.arrays import Float32Array, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import ACTIONS, ARRIVAL_PX, MAX_STEPS, is_free, observation, step
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import draw_pairs, free_points
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

ENVIRONMENT_ID = "mrnav/VesselNav-v0"


class VesselNavigation(gym.Env[Float32Array, np.int64]):
    """Steer a disc through a vessel to a target.

    Observation: Box(0, size, (6,), float32): x, y, x_start, y_start, x_target, y_target, in grid pixels.

    Actions: Discrete(40): the integer points on the outline of a square of side 10 pixels, sorted by angle.

    Reward: +1000 on arrival; otherwise -0.005 times the distance to the target, -0.02 times the length of
    the move, and a further -10 when the move would enter the wall, which leaves the agent where it is.

    Episode: begins at a random start with a random target; terminated within 10 pixels of the target,
    truncated after 20,000 steps. ``info`` holds ``is_success``, ``collision`` and ``distance`` (pixels).

    Args:
        model: A model's name or folder, or a loaded map.
        max_steps: Steps until truncation.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own declaration)

    def __init__(self, model: str | Path | VesselMap = "bifurcation", max_steps: int = MAX_STEPS) -> None:
        self._max_steps = max_steps
        self._use(model)
        size = self._vessel.size_px
        self.observation_space = gym.spaces.Box(0.0, float(size), (6,), np.float32)
        self.action_space = gym.spaces.Discrete(len(ACTIONS))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Of ``np_random``, from which start and target are drawn.
            options: Any of ``start`` and ``target`` (pixels (x, y)) and ``map`` (as ``model``, of the same
                size).

        Raises:
            ConfigError: If an option is unknown, a point is not free, or the two are within arrival.
        """
        super().reset(seed=seed)
        chosen = dict(options or {})
        if "map" in chosen:
            self._use(chosen.pop("map"))
        given: dict[str, FloatArray] = {}
        for name in ("start", "target"):
            if name in chosen:
                given[name] = self._free_point(name, chosen.pop(name))
        if chosen:
            raise ConfigError(f"reset: unknown options {sorted(chosen)}; there are start, target and map")
        self._start, self._target = self._draw(given)
        self._position = self._start
        self._steps = 0
        return self._observation(), self._info(False, self._distance_px())

    def step(self, action: np.int64) -> tuple[Float32Array, float, bool, bool, dict[str, Any]]:
        """Move once; see the class for the rules."""
        moved = step(self._vessel.free, self._position, self._target, np.asarray(action))
        self._position = moved.position_px
        self._steps += 1
        arrived = bool(moved.arrived)
        truncated = not arrived and self._steps >= self._max_steps
        info = self._info(bool(moved.hit), float(moved.distance_px), arrived)
        return self._observation(), float(moved.reward), arrived, truncated, info

    def _use(self, model: str | Path | VesselMap) -> None:
        self._vessel = model if isinstance(model, VesselMap) else load_vessel_model(find_model(model))
        self._points = free_points(self._vessel)

    def _draw(self, given: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
        while True:
            starts, targets = draw_pairs(self._points, 1, self.np_random)
            start, target = given.get("start", starts[0]), given.get("target", targets[0])
            if np.hypot(*(start - target)) >= ARRIVAL_PX:
                return start, target
            if len(given) == 2:
                raise ConfigError(f"reset: start and target must be at least {ARRIVAL_PX:.0f} px apart")

    def _free_point(self, name: str, value: Any) -> FloatArray:  # noqa: ANN401 (an option may be anything)
        point = np.array(value, dtype=np.float64)
        if point.shape != (2,) or not np.isfinite(point).all() or not is_free(self._vessel.free, point):
            raise ConfigError(f"reset: {name} must be a pixel (x, y) where the robot fits, not {value!r}")
        return point

    def _observation(self) -> Float32Array:
        return observation(self._position, self._start, self._target)

    def _distance_px(self) -> float:
        return float(np.hypot(*(self._position - self._target)))

    def _info(self, hit: bool, distance_px: float, arrived: bool = False) -> dict[str, Any]:
        return {"is_success": arrived, "collision": hit, "distance": distance_px}


if ENVIRONMENT_ID not in gym.registry:
    gym.register(ENVIRONMENT_ID, entry_point=f"{__name__}:VesselNavigation")
