"""From a vessel model and a preset to a policy on disk with its manifest and model card."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time

import numpy as np
import torch

from mrnav_server.autonomy.torchscript import Identity, export_policy, load_policy
from mrnav_server.training.cloning import clone
from mrnav_server.training.evaluate import Evaluation, evaluate
from mrnav_server.training.network import PolicyNetwork
from mrnav_server.training.ppo import PpoLearner
from mrnav_server.training.presets import Preset, find_preset
from mrnav_server.training.progress import Progress, Report
from mrnav_server.vision.vessel_model import load_vessel_model

CARD_FILE = "card.md"


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """What a training run made.

    Attributes:
        folder: Holds the policy, its manifest and its card.
        identity: What the policy is.
        environment_steps: Steps of reinforcement learning.
        cpu_s: Processor time of the whole training, without the evaluation.
        curve: Environment steps and share of episodes that arrived, one pair per report.
        greedy: Evaluation with the best action and direction memory.
        sampled: Evaluation with drawn actions, as published.
    """

    folder: Path
    identity: Identity
    environment_steps: int
    cpu_s: float
    curve: tuple[tuple[int, float], ...]
    greedy: Evaluation
    sampled: Evaluation


def train(
    model_folder: Path,
    preset: str | Preset = "best",
    seed: int = 0,
    out: Path | None = None,
    progress: Progress = lambda report: None,
    pairs: int = 500,
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

    Raises:
        ConfigError: If the model or the preset does not exist.
    """
    recipe = find_preset(preset) if isinstance(preset, str) else preset
    vessel = load_vessel_model(model_folder)
    folder = out if out is not None else model_folder
    began_s = process_time()
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    network = PolicyNetwork(vessel, recipe.encoding, recipe.hidden, recipe.masked, recipe.margin_px)
    curve: list[tuple[int, float]] = []

    def watch(report: Report) -> None:
        if report.stage == "reinforce" and report.success is not None:
            curve.append((report.steps, report.success))
        progress(report)

    if recipe.cloning.labels:
        clone(network, vessel, recipe.cloning, seed, watch)
    steps = 0
    if recipe.ppo.steps:
        steps = PpoLearner(network, vessel, recipe.ppo, recipe.hidden, seed).learn(watch)
    cpu_s = process_time() - began_s
    identity = export_policy(network, folder, vessel, recipe.name, seed)
    policy = load_policy(folder, vessel)
    progress(Report("evaluate", 0.0))
    greedy = evaluate(policy, vessel, pairs, "greedy", seed=1)
    progress(Report("evaluate", 0.5))
    sampled = evaluate(policy, vessel, pairs, "sample", seed=1)
    progress(Report("evaluate", 1.0))
    result = TrainingResult(folder, identity, steps, cpu_s, tuple(curve), greedy=greedy, sampled=sampled)
    (folder / CARD_FILE).write_text(model_card(result, recipe))
    return result


def model_card(result: TrainingResult, recipe: Preset) -> str:
    """Return the model card, Markdown with YAML front matter."""
    identity, greedy, sampled = result.identity, result.greedy, result.sampled
    front = {
        "name": identity.name,
        "model": identity.map_name,
        "map_sha256": identity.map_sha256,
        "kind": "torchscript",
        "preset": identity.preset,
        "seed": identity.seed,
        "simulated": True,
        "environment": "mrnav/VesselNav-v0",
        "environment_steps": result.environment_steps,
        "training_cpu_s": round(result.cpu_s),
        "torch": str(torch.__version__),
        "numpy": np.__version__,
        "success_greedy": round(greedy.success, 4),
        "success_sampled": round(sampled.success, 4),
        "spl_greedy": round(greedy.spl, 4),
        "spl_sampled": round(sampled.spl, 4),
        "evaluation_pairs": greedy.pairs,
        "evaluation_seed": greedy.seed,
        "licence": "Apache-2.0",
    }
    yaml = "\n".join(f"{key}: {json.dumps(value)}" for key, value in front.items())
    rows = "\n".join(
        f"| {e.mode} | {e.success:.1%} ({e.success_low:.1%} to {e.success_high:.1%}) | {e.spl:.3f} |"
        f" {e.wall_hits:.2f} | {e.steps:.0f} |"
        for e in (greedy, sampled)
    )
    recipe_json = json.dumps(asdict(recipe), indent=2)
    return f"""---
{yaml}
---
# {identity.name}

A navigation policy for the vessel model `{identity.map_name}`: {recipe.what}.
It maps position, start and target (6 numbers in grid pixels) to scores of 40 moves, and runs as TorchScript.

## Results (simulated)

{greedy.pairs} random pairs of start and target in the grid world that it was trained in, with 95 % Wilson
intervals. SPL is success weighted by shortest over travelled length. Greedy takes the best move with a memory
of direction; sample draws from the distribution, as in the published system.

| mode | success | SPL | wall hits a pair | steps |
|---|---|---|---|---|
{rows}

## How it was trained

`mrnav train {identity.map_name} --preset {identity.preset} --seed {identity.seed}`, one thread,
{result.cpu_s:.0f} s of processor time. The whole recipe:

```json
{recipe_json}
```

## Limits

- It knows this one map: the server refuses it on any other (`map_sha256`).
- It was trained in a grid world, without magnet, friction or tracking noise; on the rig it plans the path,
  and the follower makes the robot keep to it.
- It was tested in simulation alone. It is a research tool, not a medical device.
"""
