"""`mrnav evaluate` as a person and as a program call it."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mrnav_server.cli.main import app
from mrnav_server.core.errors import ConfigError

CONTRACT = ["model", "policy", "mode", "n", "success", "success_low", "spl", "wall_hits", "steps_ratio"]


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["evaluate", *arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def test_the_last_line_is_the_contract() -> None:
    answer = json.loads(run("bifurcation", "--pairs", "20", "--sample", "--json").splitlines()[-1])
    assert list(answer)[: len(CONTRACT)] == CONTRACT
    assert (answer["model"], answer["policy"], answer["mode"]) == (
        "bifurcation",
        "bifurcation-best",
        "sample",
    )
    assert (answer["n"], answer["success"], answer["wall_hits"]) == (20, 1.0, 0.0)
    # Wilson: 1 / (1 + 1.96^2 / 20).
    assert answer["success_low"] == pytest.approx(0.83887, abs=1e-5)
    assert 0.95 < answer["spl"] < 1.0
    assert 0.9 < answer["steps_ratio"] < 1.1


def test_the_pairs_are_fixed_by_the_seed() -> None:
    first, again, other = (run("bifurcation", "--pairs", "5", "--seed", seed, "--json") for seed in "112")
    assert first == again != other


def test_a_model_may_be_a_folder() -> None:
    from mrnav_server.vision.model_store import find_model

    assert run(str(find_model("bifurcation").resolve()), "--pairs", "2").startswith("bifurcation-best on")


def test_a_worse_world_is_said_and_told() -> None:
    disturbed = ("--noise-px", "5", "--delay", "2", "--scale", "0.5")
    text = run("bifurcation", "--policy", "geodesic", "--pairs", "5", *disturbed)
    assert "noise 5 px, delay 2 steps, scale 0.5, 5 pairs (simulated)" in text
    answer = json.loads(run("bifurcation", "--pairs", "5", *disturbed, "--json"))
    assert (answer["noise_px"], answer["delay_steps"], answer["scale"]) == (5.0, 2, 0.5)


def test_the_table_in_one_command() -> None:
    text = run("bifurcation", "--pairs", "3", "--robustness")
    assert [line.split(" | ")[1] for line in text.splitlines() if line.startswith("| greedy")] == [
        *("plain", "noise 10 px", "delay 6 steps", "scale 0.5", "scale 1.5")
    ]
    answer = json.loads(run("bifurcation", "--pairs", "3", "--robustness", "--sample", "--json"))
    assert (answer["mode"], answer["noise_px"], len(answer["rows"])) == ("sample", 0.0, 10)


def test_the_table_has_its_own_worlds() -> None:
    with pytest.raises(ConfigError, match="leave out"):
        run("bifurcation", "--robustness", "--delay", "3")


def test_the_failures_are_drawn(tmp_path: Path) -> None:
    picture = tmp_path / "failures.png"
    text = run("bifurcation", "--pairs", "3", "--failures", str(picture))
    assert f"0 failed pairs are drawn in {picture}" in text
    assert picture.read_bytes().startswith(b"\x89PNG")
