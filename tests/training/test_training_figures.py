"""What the figures of the learning results show."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mrnav_server.cli.main import app
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import reward
from mrnav_server.training.curves import LearningRun, curves_figure, read_run
from mrnav_server.training.discount import distances_along, way_pays
from mrnav_server.training.rig_runs import EPSILON_UM, distance_to_path_px, random_tasks
from mrnav_server.training.trajectories import run_trajectories, trajectories_figure
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model, save_vessel_model, vessel_map


def write_run(folder: Path, algo: str, seed: int, ends: list[tuple[int, bool]], steps: int = 10_000) -> Path:
    about = {"t_start": 1.0, "model": "room", "preset": "paper", "algo": algo, "seed": seed, "steps": steps}
    rows = "".join(f"-1.5,7,0.1,{arrived},{end}\n" for end, arrived in ends)
    folder.mkdir()
    (folder / "monitor.csv").write_text(f"#{json.dumps(about)}\nr,l,t,is_success,s\n{rows}")
    return folder


@pytest.fixture
def learned(tmp_path: Path) -> Path:
    ends = [(1000 + 10 * i, True) for i in range(100)] + [(9000, False), (9500, True)]
    return write_run(tmp_path / "run", "ppo", 3, ends)


def test_a_run_counts_its_arrivals_by_true_steps(learned: Path) -> None:
    run = read_run(learned)
    assert (run.model, run.preset, run.algo, run.seed, run.steps) == ("room", "paper", "ppo", 3, 10_000)
    rate = run.arrivals_per_1000(np.array([0.0, 1000.0, 2000.0, 8000.0, 10_000.0, 12_000.0]))
    assert rate[:4].tolist() == [0.0, 100.0, 0.0, 0.5]
    assert np.isnan(rate[4])  # the run was over
    assert run.record()["arrivals_per_1000_at_the_end"] == 1.0


def test_the_curve_is_the_mean_with_the_spread_over_seeds(tmp_path: Path) -> None:
    every = [
        read_run(write_run(tmp_path / str(seed), "ppo", seed, [(s, True) for s in range(0, 10_000, gap)]))
        for seed, gap in enumerate((10, 20))
    ]
    axes = curves_figure(every, {"room": 9.0}).axes[0]
    line = axes.lines[0]
    assert str(line.get_label()) == "PPO, 2 seeds"
    assert np.mean(np.asarray(line.get_ydata())) == pytest.approx(75.0)  # 100 and 50 per 1000
    band = np.asarray(axes.collections[0].get_paths()[0].vertices)[:, 1]
    assert (band.min(), band.max()) == (50.0, 100.0)
    assert np.asarray(axes.lines[1].get_ydata()).tolist() == [9.0, 9.0]


def test_the_curves_of_two_algorithms_by_command(learned: Path, tmp_path: Path) -> None:
    other = write_run(tmp_path / "a2c", "a2c", 0, [(500, True)])
    out = tmp_path / "figures" / "curves.png"
    done = CliRunner().invoke(
        app,
        ["figure", "curves", str(learned), str(other), "--out", str(out), "--json"],
        catch_exceptions=False,
    )
    answer = json.loads(done.stdout.splitlines()[-1])
    assert [row["algo"] for row in answer["runs"]] == ["ppo", "a2c"]
    assert answer["best_per_1000"] == {}
    assert out.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("r,l,t\n1,2,3\n", "unreadable"),
        ('#{"model": "room"}\nr,l,t,is_success,s\n1,2,3,True,4\n', "'preset' is missing"),
    ],
)
def test_a_monitor_file_that_says_too_little_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "monitor.csv").write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_run(tmp_path)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no training run"):
        read_run(tmp_path)
    with pytest.raises(ConfigError, match="no training runs"):
        curves_figure([], {})


def test_the_curves_can_train_by_themselves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trained: list[str] = []

    def fake(model: str, preset: str, algo: str, seed: int, steps: int | None, runs: Path) -> Path:
        trained.append(f"{model} {preset} {algo} {seed} {steps}")
        return write_run(tmp_path / str(len(trained)), algo, seed, [(5, True)])

    monkeypatch.setattr("mrnav_server.training.curve_runs.train_for_curves", fake)
    out = str(tmp_path / "curves.png")
    arguments = ["figure", "curves", "--run", "room", "--seeds", "2", "--steps", "99", "--out", out]
    CliRunner().invoke(app, arguments, catch_exceptions=False)
    presets = ("paper", "paper+")
    assert trained == [f"room {p} {a} {s} 99" for p in presets for a in ("ppo", "a2c") for s in (0, 1)]


def test_a_training_run_for_a_curve_is_not_repeated(tmp_path: Path) -> None:
    from mrnav_server.training.curve_runs import train_for_curves

    chamber = vessel_map("chamber", np.full((50, 50), 255, np.uint8), robot_radius_um=100.0)
    save_vessel_model(tmp_path / "chamber", chamber, "chamber", "test")
    model, runs = str(tmp_path / "chamber"), tmp_path / "runs"
    folder = train_for_curves(model, "paper+", "a2c", 5, 4096, runs)
    run = read_run(folder)
    assert (run.model, run.preset, run.algo, run.seed, run.steps) == ("chamber", "paper+", "a2c", 5, 4096)
    before = (folder / "monitor.csv").stat().st_mtime_ns
    assert train_for_curves(model, "paper+", "a2c", 5, 4096, runs) == folder
    assert (folder / "monitor.csv").stat().st_mtime_ns == before


def test_what_pays_in_closed_form() -> None:
    towards = np.arange(500.0, 5.0, -6.0)
    assert way_pays(towards, 0.99)  # always nearer: nothing to gain by waiting
    # Away from 100 px to 900 px for 1600 steps: 0.99^1600 · 1000 is nothing, and the way costs far more.
    detour = np.concatenate([np.linspace(100, 900, 800), np.linspace(900, 9, 800)])
    assert not way_pays(detour, 0.99)
    assert way_pays(detour, 0.9999)


def test_a_way_is_worth_what_the_reward_says() -> None:
    """Two steps: the first costs, the second arrives; far away, waiting at the start is cheaper."""
    none, yes = np.array(False), np.array(True)
    for distance_px in (100.0, 1e6):
        step = float(reward(np.array(distance_px), np.array(5.5), none, none))
        arrive = float(reward(np.array(5.0), np.array(5.5), none, yes))
        wait = float(reward(np.array(distance_px), np.array(5.0), none, none)) / (1 - 0.5)
        assert way_pays(np.array([distance_px, distance_px, 5.0]), 0.5) == (step + 0.5 * arrive > wait)


def test_the_distances_along_a_straight_way() -> None:
    room = vessel_map("room", np.full((200, 200), 255, np.uint8), robot_radius_um=100.0)
    way = distances_along(room, np.array([[40.0, 50.0]]), np.array([[140.0, 50.0]]))[0]
    assert way[0] < 100
    assert (np.diff(way) < 0).all()
    assert way[-1] < 10 <= way[-2]


def test_the_distance_to_a_path_in_closed_form() -> None:
    path = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    points = np.array([[5.0, 3.0], [13.0, 5.0], [-3.0, -4.0], [10.0, 10.0]])
    assert distance_to_path_px(path, points).tolist() == [3.0, 3.0, 5.0, 0.0]


def test_random_tasks_repeat_by_seed_and_have_room() -> None:
    vessel = load_vessel_model(find_model("bifurcation"))
    tasks = random_tasks(vessel, 20, seed=1)
    assert tasks == random_tasks(vessel, 20, seed=1) != random_tasks(vessel, 20, seed=2)
    for start, target in tasks:
        assert vessel.clearance_um(start) >= 50.0
        assert start.distance_px(target) >= 300.0
        assert vessel.is_free(target.x_px, target.y_px)


def test_a_task_in_the_grid_and_on_the_simulated_rig() -> None:
    driven = run_trajectories(find_model("bifurcation"), sets=1, seed=0)
    run = driven.rig[0]
    assert (run.arrived, run.reason, run.source, run.contacts) == (True, "", "policy", 0)
    left_um = 10.0 * np.hypot(*(run.driven_px[-1] - (run.target.x_px, run.target.y_px)))
    assert left_um <= EPSILON_UM
    assert driven.grid_px[0][0].tolist() == [run.start.x_px, run.start.y_px]
    assert np.hypot(*(driven.grid_px[0][-1] - (run.target.x_px, run.target.y_px))) < 10
    mean_um, largest_um = driven.deviation_um
    assert 0.0 < mean_um < largest_um < 150.0
    assert driven.record()["deviation_max_um_by_set"] == [largest_um]
    off_um = 10.0 * distance_to_path_px(run.planned_px, run.driven_px)
    assert np.allclose(off_um, run.deviation_um)
    figure = trajectories_figure([driven])
    assert "simulated" in figure.axes[1].get_title()
    assert f"{largest_um:.0f} µm at most" in figure.axes[1].get_title()


def test_the_curves_keep_a_run_that_is_shorter_apart() -> None:
    arrived = np.ones(10)
    long, short = (
        LearningRun("room", "paper", "ppo", seed, np.linspace(0, steps, 10), arrived, steps)
        for seed, steps in enumerate((1e4, 5e3))
    )
    line = curves_figure([long, short], {}).axes[0].lines[0]
    assert np.asarray(line.get_xdata())[-1] == pytest.approx(0.0099)
