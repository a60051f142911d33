"""Speed and memory of learning to navigate; prints one JSON object.

Run: ``python -m benchmarks.learning``. One thread. The batched environment, this project's PPO beside that of
Stable-Baselines3 on the same batched environment, one decision of the shipped policies, and the preset
``best`` from nothing on every shipped vessel model, each training in a process of its own. All figures are
simulated.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from mrnav_server.autonomy.torchscript import load_policy
from mrnav_server.core.arrays import Float32Array, IntArray
from mrnav_server.core.navigation import ACTIONS
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import BatchEnvironment
from mrnav_server.training.learner import Learner
from mrnav_server.training.network import PolicyNetwork
from mrnav_server.training.presets import PpoSettings
from mrnav_server.vision.model_store import find_model, model_names
from mrnav_server.vision.vessel_model import load_vessel_model

ENVIRONMENTS = 1024
ROUNDS = 3
PPO_SETTINGS = PpoSettings(
    steps=655_360,
    environments=512,
    horizon=64,
    minibatch=4096,
    epochs=4,
    learning_rate=3e-4,
    discount=0.99,
    critic_updates=0,
)


class BatchVecEnv(VecEnv):
    """The batched environment behind the interface of Stable-Baselines3, with the least work that it asks."""

    def __init__(self, vessel: VesselMap, count: int) -> None:
        seen = spaces.Box(0.0, float(vessel.size_px), (6,), np.float32)
        super().__init__(count, seen, spaces.Discrete(len(ACTIONS)))
        self._environment = BatchEnvironment(vessel, count, seed=0)
        self._quiet: list[dict[str, Any]] = [{} for _ in range(count)]

    def reset(self) -> Float32Array:
        """Return the first observations, shape (n, 6)."""
        return self._environment.observations().copy()

    def step_async(self, actions: IntArray) -> None:
        """Keep the actions, shape (n,)."""
        self._actions = actions

    def step_wait(self) -> tuple[Float32Array, Any, Any, list[dict[str, Any]]]:
        """Move every agent."""
        outcome = self._environment.step(self._actions)
        done = outcome.terminated | outcome.truncated
        told = self._quiet
        if done.any():
            told = list(self._quiet)
            for i in np.flatnonzero(done):
                cut = bool(outcome.truncated[i])
                told[i] = {"terminal_observation": outcome.final[i].copy(), "TimeLimit.truncated": cut}
        seen = self._environment.observations().copy()
        return seen, outcome.reward.astype(np.float32), done, told

    def close(self) -> None:
        """Hold nothing."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:  # noqa: ANN401
        """Return an attribute of every environment."""
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ANN401
        """Ignore the attribute."""

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:  # noqa: ANN401
        """Return what every environment's method returns."""
        return [None] * self.num_envs

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:  # noqa: ANN401
        """Tell that no environment is wrapped."""
        return [False] * self.num_envs


def environment_steps_per_s(vessel: VesselMap, steps: int = 2000) -> float:
    """Return steps per second of processor time, the best of several rounds."""
    actions = np.random.default_rng(0).integers(len(ACTIONS), size=(steps, ENVIRONMENTS))
    environment = BatchEnvironment(vessel, ENVIRONMENTS, seed=0)

    def run() -> None:
        for row in actions:
            environment.step(row)

    return max(steps * ENVIRONMENTS / _cpu_s(run) for _ in range(ROUNDS))


def own_ppo_steps_per_s(vessel: VesselMap) -> float:
    """Return steps per second of processor time of this project's PPO, 64 x 64 tanh, collecting included."""
    torch.manual_seed(0)
    network = PolicyNetwork(vessel, "raw", 64, masked=False)
    learner = Learner(network, vessel, PPO_SETTINGS, 64, seed=0)
    return PPO_SETTINGS.steps / _cpu_s(lambda: learner.learn(lambda report, episodes: None))


def sb3_ppo_steps_per_s(vessel: VesselMap) -> float:
    """Return the same of Stable-Baselines3, with the same settings."""
    s = PPO_SETTINGS
    model = PPO(
        "MlpPolicy",
        BatchVecEnv(vessel, s.environments),
        n_steps=s.horizon,
        batch_size=s.minibatch,
        n_epochs=s.epochs,
        learning_rate=s.learning_rate,
        gamma=s.discount,
        gae_lambda=s.trace_decay,
        clip_range=s.clip,
        ent_coef=s.entropy,
        device="cpu",
        seed=0,
    )
    return s.steps / _cpu_s(lambda: model.learn(s.steps))


def decision_us(name: str, count: int = 5000) -> dict[str, float]:
    """Return how long a shipped policy takes to score one observation: median and 99th percentile."""
    folder = find_model(name)
    vessel = load_vessel_model(folder)
    policy = load_policy(folder, vessel)
    seen = BatchEnvironment(vessel, count, seed=0).observations()
    took_ns = np.empty(count)
    for i in range(count):
        began_ns = time.perf_counter_ns()
        policy.logits(seen[i : i + 1])
        took_ns[i] = time.perf_counter_ns() - began_ns
    return {"p50": float(np.median(took_ns) / 1e3), "p99": float(np.percentile(took_ns, 99) / 1e3)}


def best(name: str) -> dict[str, Any]:
    """Train the preset ``best`` from nothing in a process of its own; return its figures."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            *(sys.executable, "-m", "mrnav_server.cli.main", "train", name),
            *("--preset", "best", "--seed", "1", "--out", folder, "--json"),
        ]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    record = json.loads(done.stdout.splitlines()[-1])
    figures = {key: record[key] for key in ("success", "spl", "cpu_s", "wall_s", "peak_memory_mb")}
    return figures | {
        "success_sampled": record["sampled"]["success"],
        "spl_sampled": record["sampled"]["spl"],
    }


def main() -> None:
    """Measure everything and print the figures as JSON."""
    torch.set_num_threads(1)
    vessels = {name: load_vessel_model(find_model(name)) for name in model_names()}
    first = next(iter(vessels.values()))
    own, theirs = zip(
        *((own_ppo_steps_per_s(first), sb3_ppo_steps_per_s(first)) for _ in range(ROUNDS)), strict=True
    )
    figures = {
        "simulated": True,
        "environment_steps_per_s": {
            name: round(environment_steps_per_s(vessel)) for name, vessel in vessels.items()
        },
        "own_ppo_steps_per_s": round(float(np.median(own))),
        "sb3_ppo_steps_per_s": round(float(np.median(theirs))),
        "decision_us": {name: decision_us(name) for name in vessels},
        "best": {name: best(name) for name in vessels},
    }
    sys.stdout.write(json.dumps(figures) + "\n")


def _cpu_s(work: Callable[[], object]) -> float:
    began_s = time.process_time()
    work()
    return time.process_time() - began_s


if __name__ == "__main__":
    main()
