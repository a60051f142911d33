"""From a picture to a model's folder, and random networks."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.map_import import PREVIEW_FILE, REPORT_FILE, import_map
from mrnav_server.training.map_report import map_report
from mrnav_server.training.random_vessels import generate_random
from mrnav_server.training.train import train
from mrnav_server.training.vessels import AREA_CLEARANCE_PX, draw
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.training.photographs import photographed


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """A mask of a straight vessel, 12 x 2 mm, at 20 µm/px."""
    mask = np.zeros((600, 600), np.uint8)
    mask[200:300] = 255
    path = tmp_path / "Straight Vessel 1.png"
    assert cv2.imwrite(str(path), mask)
    return path


def test_a_model_is_a_folder_that_loads(image: Path, tmp_path: Path) -> None:
    done = import_map(image, 20.0, tmp_path / "model")
    files = sorted(path.name for path in done.folder.iterdir())
    assert files == ["mask.png", "model.json", PREVIEW_FILE, REPORT_FILE]
    loaded = load_vessel_model(done.folder)
    assert (loaded.name, loaded.size_px, loaded.um_per_px) == ("straight-vessel-1", 1200, 10.0)
    assert loaded.digest == done.report.vessel.digest
    assert loaded.lumen[400:600].all()
    assert not loaded.lumen[:400].any()
    assert done.report.length_um == pytest.approx(12_000, rel=0.01)
    assert 1 <= len(loaded.suggested_areas) <= 3
    for area in loaded.suggested_areas:
        assert loaded.clearance_um(area) >= AREA_CLEARANCE_PX * loaded.um_per_px


def test_scale_robot_and_crop_are_those_asked_for(image: Path, tmp_path: Path) -> None:
    done = import_map(
        image, 30.0, tmp_path / "model", name="part", crop=(100, 150, 200, 200), robot_radius_um=300.0
    )
    loaded = load_vessel_model(done.folder)
    assert (loaded.name, loaded.size_px, loaded.robot_radius_px) == ("part", 600, 30.0)
    assert loaded.lumen[150:450].all()
    assert not loaded.lumen[451:].any()


def test_the_name_is_checked(image: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"name: '../x' may have small letters"):
        import_map(image, 20.0, tmp_path / "model", name="../x")


def test_anothers_policy_is_not_written_over(image: Path, tmp_path: Path) -> None:
    folder = import_map(image, 20.0, tmp_path / "model").folder
    (folder / "policy.pt").write_bytes(b"trained for hours")
    import_map(image, 20.0, folder)
    with pytest.raises(ConfigError, match="holds the policy of another vessel: name another folder"):
        import_map(image, 22.0, folder)
    assert load_vessel_model(folder).size_px == 1200


@example(seed=2)  # where vessels merge, a sliver would remain
@example(seed=115)  # a vessel along the edge would bend out of the picture
@given(seed=st.integers(0, 10_000))
@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_random_networks_are_wide_and_connected(seed: int, tmp_path: Path) -> None:
    drawn = generate_random(seed, tmp_path)
    loaded = load_vessel_model(tmp_path)
    assert (loaded.digest, loaded.name, loaded.size_px) == (drawn.digest, f"random-{seed}", 1800)
    count, _ = cv2.connectedComponents(loaded.lumen.astype(np.uint8), connectivity=4)
    assert count == 2
    assert not loaded.lumen[[0, -1]].any()
    assert not loaded.lumen[:, [0, -1]].any()
    _, _, stats, _ = cv2.connectedComponentsWithStats((~loaded.lumen).astype(np.uint8), connectivity=4)
    assert stats[1:, cv2.CC_STAT_AREA].min() >= 10_000
    report = map_report(loaded)
    assert report.tight == ()
    assert report.widths_um[0] >= 1300 - 20
    # Nothing that the robot's centre fits in is cut off.
    assert loaded.free.sum() == (loaded.distance_px > loaded.robot_radius_px).sum()
    assert 2 <= len(loaded.suggested_areas) <= 3
    for area in loaded.suggested_areas:
        assert loaded.clearance_um(area) >= AREA_CLEARANCE_PX * loaded.um_per_px


def test_a_seed_is_always_the_same_network(tmp_path: Path) -> None:
    assert generate_random(5, tmp_path).digest == generate_random(5, tmp_path).digest
    assert generate_random(5, tmp_path).digest != generate_random(6, tmp_path).digest


@pytest.mark.slow
def test_from_a_photograph_to_a_policy(tmp_path: Path) -> None:
    photograph = tmp_path / "photograph.jpg"
    photograph.write_bytes(photographed(draw("network"), 15.0, seed=1, dark=True).tobytes())
    folder = import_map(photograph, 15.0, tmp_path / "model").folder
    trained = train(folder, pairs=500)
    assert (trained.greedy.success, trained.sampled.success) == (1.0, 1.0)
    assert trained.greedy.spl >= 0.97
    assert trained.greedy.wall_hits == 0.0


@pytest.mark.slow
def test_from_the_retina_to_a_policy(tmp_path: Path) -> None:
    import skimage

    retina = Path(skimage.__file__).parent / "data" / "retina.jpg"
    folder = import_map(retina, 110.0, tmp_path / "model", crop=(95, 705, 164, 164)).folder
    trained = train(folder, pairs=500)
    assert (trained.greedy.success, trained.sampled.success) == (1.0, 1.0)
    assert trained.greedy.spl >= 0.97
