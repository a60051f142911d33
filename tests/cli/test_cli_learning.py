"""The commands about learning, as a person types them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from mrnav_server.autonomy.policy import PolicyError
from mrnav_server.cli.evaluate import evaluate
from mrnav_server.cli.map import generate
from mrnav_server.cli.policy import policies
from mrnav_server.cli.train import train
from mrnav_server.core.errors import ConfigError
from mrnav_server.training import presets
from mrnav_server.training.environment import VesselNavigation
from mrnav_server.training.presets import CloningSettings, PpoSettings, Preset
from mrnav_server.vision.vessel_model import load_vessel_model, save_vessel_model, vessel_map


@pytest.fixture
def app() -> typer.Typer:
    app = typer.Typer()
    app.command()(train)
    app.command()(evaluate)
    app.command()(generate)
    return app


def run(app: typer.Typer, *arguments: str) -> str:
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_evaluate_the_shipped_policy(app: typer.Typer) -> None:
    answer = json.loads(run(app, "evaluate", "bifurcation", "--pairs", "10", "--json").splitlines()[-1])
    assert (answer["policy"], answer["success"], answer["mode"]) == ("bifurcation-best", 1.0, "greedy")
    assert answer["simulated"] is True


def test_evaluate_the_planner_by_sampling(app: typer.Typer) -> None:
    text = run(app, "evaluate", "bifurcation", "--policy", "geodesic", "--pairs", "10", "--sample")
    assert text.startswith("geodesic on bifurcation, sample, 10 pairs (simulated): success 100.00%")


def test_evaluate_refuses_a_folder_without_a_policy(app: typer.Typer, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="missing"):
        run(app, "evaluate", "bifurcation", "--policy", str(tmp_path))


def test_train_then_evaluate(app: typer.Typer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick = Preset(
        "quick",
        "a test",
        hidden=16,
        cloning=CloningSettings(labels=2000, updates=20),
        ppo=replace(PpoSettings(), steps=256, environments=8, horizon=16, minibatch=64, max_steps=100),
    )
    monkeypatch.setitem(presets.PRESETS, "quick", quick)
    model, out = tmp_path / "chamber", tmp_path / "out"
    chamber = vessel_map("chamber", np.full((60, 60), 255, np.uint8), robot_radius_um=100.0)
    save_vessel_model(model, chamber, "chamber", "test")
    order = ["train", str(model), "--preset", "quick", "--pairs", "2", "--json"]
    text = run(app, *order, "--out", str(out), "--set", "steps=512")
    answer = json.loads(text.splitlines()[-1])
    contract = {"model", "policy", "mode", "n", "success", "success_low", "spl", "wall_hits", "steps_ratio"}
    assert contract | {"cpu_s", "wall_s", "steps"} <= set(answer)
    assert (answer["policy"], answer["mode"], answer["steps"]) == ("chamber-quick", "greedy", 512)
    assert sorted(path.name for path in out.iterdir()) == [
        *("card.md", "checkpoint.pt", "manifest.json", "monitor.csv", "policy.pt")
    ]
    resumed = json.loads(run(app, *order, "--resume", str(out)).splitlines()[-1])
    assert (resumed["steps"], resumed["spl"]) == (512, answer["spl"])
    other = run(app, *order, "--out", str(tmp_path / "a2c"), "--algo", "a2c", "--set", "steps=256")
    assert json.loads(other.splitlines()[-1])["policy"] == "chamber-quick-a2c"
    text = run(app, "evaluate", str(model), "--policy", str(out), "--pairs", "2", "--json")
    assert json.loads(text)["policy"] == "chamber-quick"


def test_resume_takes_no_other_settings(app: typer.Typer, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="leave out --set"):
        run(app, "train", "bifurcation", "--resume", str(tmp_path), "--set", "steps=5")


def test_train_names_the_settings_there_are(app: typer.Typer, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gamma: no such setting of a2c; there are .*rms_decay"):
        run(app, "train", "bifurcation", "--algo", "a2c", "--set", "gamma=1", "--out", str(tmp_path))


def test_import_a_policy(tmp_path: Path) -> None:
    from stable_baselines3 import PPO

    chamber = vessel_map("chamber", np.full((60, 60), 255, np.uint8), robot_radius_um=100.0)
    save_vessel_model(tmp_path / "chamber", chamber, "chamber", "test")
    PPO("MlpPolicy", VesselNavigation(chamber), seed=0, device="cpu").save(tmp_path / "saved.zip")
    text = run(
        policies,
        *("import", "--sb3", str(tmp_path / "saved.zip"), "--model", str(tmp_path / "chamber")),
        *("--out", str(tmp_path / "out"), "--pairs", "1", "--json"),
    )
    assert json.loads(text.splitlines()[-1])["policy"] == "chamber-sb3-ppo"


def test_draw_a_model(app: typer.Typer, tmp_path: Path) -> None:
    assert "1800 x 1800 px" in run(app, "generate", "serpentine", "--out", str(tmp_path / "s"))
    assert load_vessel_model(tmp_path / "s").name == "serpentine"


def test_an_unknown_model_is_a_configuration_error(app: typer.Typer) -> None:
    with pytest.raises(ConfigError, match="bifurcation"):
        run(app, "train", "nowhere")
