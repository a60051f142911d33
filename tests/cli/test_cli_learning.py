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
from mrnav_server.cli.train import train
from mrnav_server.core.errors import ConfigError
from mrnav_server.training import presets
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
    assert text.startswith("geodesic on bifurcation, sample, 10 pairs (simulated): success 100.0%")


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
    text = run(app, "train", str(model), "--preset", "quick", "--out", str(out), "--pairs", "2", "--json")
    answer = json.loads(text.splitlines()[-1])
    assert answer["identity"]["name"] == "chamber-quick"
    assert answer["folder"] == str(out)
    assert sorted(path.name for path in out.iterdir()) == ["card.md", "manifest.json", "policy.pt"]
    text = run(app, "evaluate", str(model), "--policy", str(out), "--pairs", "2", "--json")
    assert json.loads(text)["policy"] == "chamber-quick"


def test_draw_a_model(app: typer.Typer, tmp_path: Path) -> None:
    assert "1800 x 1800 px" in run(app, "generate", "serpentine", "--out", str(tmp_path / "s"))
    assert load_vessel_model(tmp_path / "s").name == "serpentine"


def test_an_unknown_model_is_a_configuration_error(app: typer.Typer) -> None:
    with pytest.raises(ConfigError, match="bifurcation"):
        run(app, "train", "nowhere")
