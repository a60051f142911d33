"""From a vessel model and a preset to a policy on disk with its manifest and model card."""

import sys
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic, process_time
from typing import Any

import torch

from mrnav_server.autonomy.torchscript import Identity, export_policy, load_policy
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.card import CARD_FILE, model_card
from mrnav_server.training.checkpoint import load_checkpoint, save_checkpoint
from mrnav_server.training.cloning import clone
from mrnav_server.training.environment import ENVIRONMENT_ID
from mrnav_server.training.evaluate import Evaluation, evaluate
from mrnav_server.training.experience import Episodes
from mrnav_server.training.learner import Learner
from mrnav_server.training.monitor import Board, MonitorFile
from mrnav_server.training.network import PolicyNetwork
from mrnav_server.training.presets import Algorithm, Preset, adjust, find_preset, preset_from
from mrnav_server.training.progress import Progress, Report
from mrnav_server.vision.vessel_model import load_vessel_model

CHECKPOINT_EVERY_S = 5.0


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """What a training run made.

    Attributes:
        folder: Holds the policy, its manifest and its card, ``monitor.csv`` and ``checkpoint.pt``.
        identity: What the policy is.
        algorithm: ``"ppo"`` or ``"a2c"``.
        environment_steps: Steps of reinforcement learning.
        cpu_s: Processor time of the whole training, without the evaluation.
        wall_s: Its duration.
        peak_memory_mb: Most memory that the process ever held; None where the system does not tell.
        curve: Environment steps and share of recent episodes that arrived, one pair per iteration.
        greedy: Evaluation with the best action and direction memory.
        sampled: Evaluation with drawn actions, as published.
    """

    folder: Path
    identity: Identity
    algorithm: Algorithm
    environment_steps: int
    cpu_s: float
    wall_s: float
    peak_memory_mb: float | None
    curve: tuple[tuple[int, float], ...]
    greedy: Evaluation
    sampled: Evaluation

    def record(self) -> dict[str, Any]:
        """Return the figures for JSON: those of the greedy policy, and of drawn actions under ``sampled``."""
        return self.greedy.record() | {
            "cpu_s": round(self.cpu_s, 2),
            "wall_s": round(self.wall_s, 2),
            "steps": self.environment_steps,
            "preset": self.identity.preset,
            "algo": self.algorithm,
            "seed": self.identity.seed,
            "peak_memory_mb": self.peak_memory_mb,
            "folder": str(self.folder),
            "sampled": self.sampled.record(),
        }


def train(
    model_folder: Path,
    preset: str | Preset = "best",
    seed: int = 0,
    out: Path | None = None,
    progress: Progress = lambda report: None,
    pairs: int = 500,
    *,
    algorithm: Algorithm = "ppo",
    settings: Sequence[str] = (),
    tensorboard: bool = False,
) -> TrainingResult:
    """Train a policy and write ``policy.pt``, ``manifest.json`` and ``card.md``.

    One thread; the same seed gives the same policy on the same machine and versions.

    Args:
        model_folder: The vessel model's folder.
        preset: A preset, or its name.
        seed: Of everything random.
        out: Where the files go; the model's folder by default.
        progress: Called now and then.
        pairs: Random pairs of each of the two evaluations.
        algorithm: Of the reinforcement learning.
        settings: Changed hyper-parameters, each ``name=value``; see `presets.adjust`.
        tensorboard: Whether to write TensorBoard's event files as well.

    Raises:
        ConfigError: If the model, the preset or a setting does not exist.
    """
    recipe = adjust(find_preset(preset) if isinstance(preset, str) else preset, algorithm, settings)
    run = _Run(load_vessel_model(model_folder), recipe, algorithm, seed, out or model_folder)
    return run.finish(progress, pairs, tensorboard)


def resume(
    model_folder: Path,
    folder: Path,
    progress: Progress = lambda report: None,
    pairs: int = 500,
    *,
    tensorboard: bool = False,
) -> TrainingResult:
    """Go on with an interrupted training; the policy is the one that it would have made.

    Args:
        model_folder: The vessel model's folder.
        folder: The training's output folder, with its ``checkpoint.pt``.
        progress: Called now and then.
        pairs: Random pairs of each of the two evaluations.
        tensorboard: Whether to write TensorBoard's event files as well.

    Raises:
        ConfigError: If there is no checkpoint, or it belongs to another vessel model.
    """
    vessel, state = load_vessel_model(model_folder), load_checkpoint(folder)
    if state["map_sha256"] != vessel.digest:
        raise ConfigError(f"{folder}: the checkpoint belongs to another vessel model than {vessel.name}")
    run = _Run(vessel, preset_from(state["preset"]), state["algorithm"], state["seed"], folder)
    run.restore(state)
    return run.finish(progress, pairs, tensorboard)


class _Run:
    """One training, from nothing or from a checkpoint."""

    def __init__(self, vessel: VesselMap, recipe: Preset, algorithm: Algorithm, seed: int, out: Path) -> None:
        self._began_cpu_s, self._began_s = process_time(), monotonic()
        torch.set_num_threads(1)
        torch.manual_seed(seed)
        self._vessel, self._recipe, self._algorithm = vessel, recipe, algorithm
        self._seed, self._out = seed, out
        self._network = PolicyNetwork(vessel, recipe.encoding, recipe.hidden, recipe.masked, recipe.margin_px)
        self._learner = Learner(self._network, vessel, recipe.learner(algorithm), recipe.hidden, seed)
        self._curve: list[tuple[int, float]] = []
        self._cloned = not recipe.cloning.labels
        self._monitor_size = 0
        self._saved_s = monotonic()

    def finish(self, progress: Progress, pairs: int, tensorboard: bool) -> TrainingResult:
        self._out.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            before_s = monotonic() - self._began_s
            monitor = MonitorFile(self._out, self._about(), self._monitor_size, before_s)
            stack.enter_context(closing(monitor))
            per_iteration = self._learner.per_iteration
            board = stack.enter_context(closing(Board(self._out))) if tensorboard else None

            def show(report: Report) -> None:
                progress(report)
                if board is not None:
                    board.add(report)

            def tell(report: Report, episodes: Episodes) -> None:
                if report.success is not None:
                    self._curve.append((report.steps, report.success))
                monitor.add(episodes, report.steps - per_iteration)
                if monotonic() - self._saved_s > CHECKPOINT_EVERY_S:
                    self._save(monitor)
                show(report)

            if not self._cloned:
                clone(self._network, self._vessel, self._recipe.cloning, self._seed, show)
                self._cloned = True
            self._save(monitor)
            self._learner.learn(tell)
            self._save(monitor)
        cpu_s, wall_s = process_time() - self._began_cpu_s, monotonic() - self._began_s
        return self._publish(progress, pairs, cpu_s, wall_s)

    def restore(self, state: dict[str, Any]) -> None:
        self._network.load_state_dict(state["network"])
        self._learner.restore(state["learner"])
        self._curve = [(int(steps), float(success)) for steps, success in state["curve"]]
        self._cloned = True
        self._monitor_size = state["monitor_size"]
        self._began_cpu_s -= state["cpu_s"]
        self._began_s -= state["wall_s"]
        torch.set_rng_state(state["torch_random"])

    def _about(self) -> dict[str, Any]:
        return {
            "env_id": ENVIRONMENT_ID,
            "model": self._vessel.name,
            "preset": self._recipe.name,
            "algo": self._algorithm,
            "seed": self._seed,
            "steps": self._learner.iterations * self._learner.per_iteration,
        }

    def _save(self, monitor: MonitorFile) -> None:
        state = {
            "map_sha256": self._vessel.digest,
            "preset": asdict(self._recipe),
            "algorithm": self._algorithm,
            "seed": self._seed,
            "network": self._network.state_dict(),
            "learner": self._learner.state(),
            "curve": self._curve,
            "monitor_size": monitor.size,
            "cpu_s": process_time() - self._began_cpu_s,
            "wall_s": monotonic() - self._began_s,
            "torch_random": torch.get_rng_state(),
        }
        save_checkpoint(self._out, state)
        self._saved_s = monotonic()

    def _publish(self, progress: Progress, pairs: int, cpu_s: float, wall_s: float) -> TrainingResult:
        name = self._recipe.name if self._algorithm == "ppo" else f"{self._recipe.name}-{self._algorithm}"
        identity = export_policy(self._network, self._out, self._vessel, name, self._seed)
        policy = load_policy(self._out, self._vessel)
        progress(Report("evaluate", 0.0))
        greedy = evaluate(policy, self._vessel, pairs, "greedy", seed=1)
        progress(Report("evaluate", 0.5))
        sampled = evaluate(policy, self._vessel, pairs, "sample", seed=1)
        progress(Report("evaluate", 1.0))
        result = TrainingResult(
            self._out,
            identity,
            self._algorithm,
            self._learner.steps,
            cpu_s,
            wall_s,
            _peak_memory_mb(),
            tuple(self._curve),
            greedy=greedy,
            sampled=sampled,
        )
        facts = {
            "algorithm": self._algorithm,
            "environment_steps": self._learner.steps,
            "training_cpu_s": round(cpu_s),
        }
        command = (
            f"`mrnav train {identity.map_name} --preset {self._recipe.name} --algo {self._algorithm}"
            f" --seed {self._seed}`, one thread, {cpu_s:.0f} s of processor time"
        )
        what = self._recipe.what.format(algorithm=self._algorithm.upper())
        recipe = {key: value for key, value in asdict(self._recipe).items() if key not in {"ppo", "a2c"}} | {
            self._algorithm: asdict(self._recipe.learner(self._algorithm))
        }
        card = model_card(identity, what, command, recipe, facts, (greedy, sampled))
        (self._out / CARD_FILE).write_text(card)
        return result


def _peak_memory_mb() -> float | None:
    try:
        import resource
    except ModuleNotFoundError:  # Windows keeps no such count for Python.
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1e6 if sys.platform == "darwin" else 1e3))
