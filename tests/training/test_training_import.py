"""Policies of Stable-Baselines3 become policies of this project."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import A2C, DQN, PPO

from mrnav_server.autonomy.torchscript import load_policy
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.environment import VesselNavigation
from mrnav_server.training.sb3_import import import_sb3


@pytest.mark.parametrize(
    ("algorithm", "name", "layers"),
    [(PPO, "ppo", {}), (A2C, "a2c", {"net_arch": [32], "activation_fn": torch.nn.ReLU})],
)
def test_an_imported_policy_answers_like_the_original(
    chamber: VesselMap,
    model: Path,
    tmp_path: Path,
    algorithm: type[PPO | A2C],
    name: str,
    layers: dict[str, Any],
) -> None:
    original = algorithm("MlpPolicy", VesselNavigation(chamber), seed=7, device="cpu", policy_kwargs=layers)
    original.save(tmp_path / "saved.zip")
    identity, greedy, sampled = import_sb3(tmp_path / "saved.zip", model, tmp_path / "out", pairs=1)
    assert (identity.name, identity.seed) == (f"chamber-sb3-{name}", 7)
    assert (greedy.mode, sampled.mode) == ("greedy", "sample")
    seen = np.random.default_rng(0).uniform(0, 60, (200, 6)).astype(np.float32)
    given = torch.from_numpy(load_policy(tmp_path / "out", chamber).logits(seen)).log_softmax(1)
    with torch.no_grad():
        wanted: Any = original.policy.get_distribution(torch.from_numpy(seen)).distribution
    assert torch.allclose(given, wanted.logits, atol=1e-5)
    card = (tmp_path / "out" / "card.md").read_text()
    assert "imported from `saved.zip`" in card


class OtherTask(gym.Env[np.ndarray[Any, Any], np.int64]):
    observation_space = gym.spaces.Box(0.0, 1.0, (4,), np.float32)
    action_space = gym.spaces.Discrete(40)


class OtherMoves(OtherTask):
    observation_space = gym.spaces.Box(0.0, 1.0, (6,), np.float32)
    action_space = gym.spaces.Discrete(4)


def test_other_files_are_refused(model: Path, tmp_path: Path) -> None:
    saved = tmp_path / "saved.zip"
    with pytest.raises(ConfigError, match="there is no file"):
        import_sb3(saved, model, tmp_path / "out")
    saved.write_text("no archive")
    with pytest.raises(ConfigError, match="not saved by Stable-Baselines3"):
        import_sb3(saved, model, tmp_path / "out")
    for task, said in ((OtherTask(), "observation must be 6"), (OtherMoves(), "must be 40 discrete actions")):
        PPO("MlpPolicy", task, device="cpu", n_steps=64).save(saved)
        with pytest.raises(ConfigError, match=said):
            import_sb3(saved, model, tmp_path / "out")
    DQN("MlpPolicy", OtherMoves(), device="cpu", buffer_size=10).save(saved)
    with pytest.raises(ConfigError, match="neither PPO nor A2C"):
        import_sb3(saved, model, tmp_path / "out")
