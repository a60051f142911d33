"""Policies trained with Stable-Baselines3, turned into policies of this project."""

import json
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from mrnav_server.autonomy.torchscript import INPUTS, OUTPUTS, Identity, export_policy, load_policy
from mrnav_server.core.arrays import Float32Array
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import observation
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import draw_pairs, free_points
from mrnav_server.training.card import CARD_FILE, model_card
from mrnav_server.training.evaluate import Evaluation, evaluate
from mrnav_server.vision.vessel_model import load_vessel_model

if TYPE_CHECKING:
    from stable_baselines3.common.policies import ActorCriticPolicy

TOLERANCE = 1e-4
"""Largest difference of a log-probability between the original and the imported policy."""


class ImportedPolicy(nn.Module):
    """The acting half of an actor-critic perceptron.

    Args:
        body: Hidden layers.
        head: Output layer.
    """

    def __init__(self, body: nn.Module, head: nn.Module) -> None:
        super().__init__()
        self.body, self.head = body, head

    def forward(self, observations: Tensor) -> Tensor:
        """Map observations, shape (n, 6), to logits, shape (n, 40)."""
        logits: Tensor = self.head(self.body(observations))
        return logits


def import_sb3(
    file: Path, model_folder: Path, out: Path, pairs: int = 500
) -> tuple[Identity, Evaluation, Evaluation]:
    """Turn a saved PPO or A2C model into ``policy.pt``, ``manifest.json`` and ``card.md``.

    The file holds pickled objects, which run code when they are loaded: import only what you trust.
    A ``VecNormalize`` that wrapped the environment is not in the file and is therefore not imported.

    Args:
        file: What ``model.save`` wrote.
        model_folder: The vessel model that it was trained on.
        out: Where the policy goes.
        pairs: Random pairs of each of the two evaluations.

    Returns:
        What the policy is, and its greedy and sampled evaluations.

    Raises:
        ConfigError: If Stable-Baselines3 is not installed, or the file holds no such policy.
    """
    vessel = load_vessel_model(model_folder)
    algorithm, original, seed = _load(file)
    module = _convert(file, original)
    identity = export_policy(module, out, vessel, f"sb3-{algorithm}", seed)
    policy = load_policy(out, vessel)
    probes = _probes(vessel)
    _compare(file, original, probes, policy.logits(probes))
    greedy, sampled = (
        evaluate(policy, vessel, pairs, "greedy", 1),
        evaluate(policy, vessel, pairs, "sample", 1),
    )
    what = f"a policy trained by {algorithm.upper()} of Stable-Baselines3 and imported from `{file.name}`"
    command = f"Outside this project, then `mrnav policy import --sb3 {file.name} --model {vessel.name}`"
    recipe = {"algorithm": algorithm, "layers": str(module).splitlines()}
    card = model_card(identity, what, command, recipe, {"algorithm": algorithm}, (greedy, sampled))
    (out / CARD_FILE).write_text(card)
    return identity, greedy, sampled


def _load(file: Path) -> tuple[str, "ActorCriticPolicy", int]:
    try:
        from stable_baselines3 import A2C, PPO
    except ModuleNotFoundError:
        raise ConfigError("importing needs Stable-Baselines3: pip install 'mrnav-server[sb3]'") from None
    try:
        with zipfile.ZipFile(file) as archive:
            saved = json.loads(archive.read("data"))
        if "gae_lambda" not in saved:
            raise ConfigError(f"{file} is neither PPO nor A2C: only those two can be imported")
        algorithm = "ppo" if "clip_range" in saved else "a2c"
        model = (PPO if algorithm == "ppo" else A2C).load(file, device="cpu")
    except FileNotFoundError:
        raise ConfigError(f"there is no file {file}") from None
    except (zipfile.BadZipFile, KeyError, ValueError) as error:
        raise ConfigError(f"{file} was not saved by Stable-Baselines3 ({error})") from None
    return algorithm, model.policy, int(saved.get("seed") or 0)


def _convert(file: Path, policy: "ActorCriticPolicy") -> ImportedPolicy:
    """Take the acting half out of the policy."""
    from gymnasium.spaces import Box, Discrete
    from stable_baselines3.common.torch_layers import FlattenExtractor

    seen, acts = policy.observation_space, policy.action_space
    if not isinstance(seen, Box) or seen.shape != (INPUTS,):
        raise ConfigError(f"{file}: the observation must be {INPUTS} numbers, not {seen}")
    if not isinstance(acts, Discrete) or acts.n != OUTPUTS:
        raise ConfigError(f"{file}: there must be {OUTPUTS} discrete actions, not {acts}")
    if not isinstance(policy.features_extractor, FlattenExtractor):
        raise ConfigError(f"{file}: only MlpPolicy can be imported, not {type(policy.features_extractor)}")
    return ImportedPolicy(policy.mlp_extractor.policy_net, policy.action_net)


def _probes(vessel: VesselMap, count: int = 256) -> Float32Array:
    points, random = free_points(vessel), np.random.default_rng(0)
    start, target = draw_pairs(points, count, random)
    return observation(points[random.integers(len(points), size=count)], start, target)


def _compare(file: Path, original: "ActorCriticPolicy", probes: Float32Array, logits: Float32Array) -> None:
    """Refuse the import unless both policies give the same distribution."""
    with torch.no_grad():
        said: Any = original.get_distribution(torch.from_numpy(probes)).distribution
    off = float((torch.from_numpy(logits).log_softmax(1) - said.logits).abs().max())
    if not off <= TOLERANCE:
        raise ConfigError(f"{file}: the imported policy answers differently from the original (by {off:.3g})")
