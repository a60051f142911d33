"""The training runs behind the learning curves, and the rate that they could reach at best."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from mrnav_server.autonomy.torchscript import MANIFEST_FILE
from mrnav_server.core.errors import ConfigError
from mrnav_server.training.batch import draw_pairs, free_points
from mrnav_server.training.presets import Algorithm
from mrnav_server.training.shortest import shortest_ways
from mrnav_server.training.train import train
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

EVALUATION_PAIRS = 100


def train_for_curves(
    model: str, preset: str, algo: Algorithm, seed: int, steps: int | None, runs: Path
) -> Path:
    """Train once and return the run's folder; a run that is complete is not repeated.

    Args:
        model: A vessel model's name or folder.
        preset: The recipe.
        algo: The algorithm.
        seed: Of the training.
        steps: Environment steps; the preset's if None.
        runs: The run goes into a folder of its own in here.
    """
    source = find_model(model)
    length = "" if steps is None else f"-{steps}"
    folder = runs / f"{source.name}-{preset}-{algo}-{seed}{length}"
    if not (folder / MANIFEST_FILE).is_file():
        settings = [] if steps is None else [f"steps={steps}"]
        train(source, preset, seed, folder, pairs=EVALUATION_PAIRS, algorithm=algo, settings=settings)
    return folder


def best_per_1000(models: Iterable[str], pairs: int = 1000) -> dict[str, float]:
    """Return the arrivals per 1000 steps of an agent on the shortest ways, for the models that are known."""
    best: dict[str, float] = {}
    for model in models:
        try:
            vessel = load_vessel_model(find_model(model))
        except ConfigError:
            continue  # a model that lies elsewhere: its curve is drawn without this line
        start_px, target_px = draw_pairs(free_points(vessel), pairs, np.random.default_rng(0))
        best[model] = 1000.0 / float(shortest_ways(vessel, start_px, target_px)[1].mean())
    return best
