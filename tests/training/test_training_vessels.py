"""The vessel models that are drawn."""

from pathlib import Path

import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.vessels import AREA_CLEARANCE_PX, generate, names
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model


@pytest.mark.parametrize("name", names())
def test_a_drawn_model_loads_with_roomy_areas(name: str, tmp_path: Path) -> None:
    drawn = generate(name, tmp_path / name)
    loaded = load_vessel_model(tmp_path / name)
    assert loaded.digest == drawn.digest
    assert loaded.size_px == 1800
    assert len(loaded.suggested_areas) == 3
    for area in loaded.suggested_areas:
        assert loaded.is_free(area.x_px, area.y_px)
        assert loaded.clearance_um(area) >= AREA_CLEARANCE_PX * loaded.um_per_px


def test_the_drawing_gives_the_model_that_ships(tmp_path: Path) -> None:
    shipped = load_vessel_model(find_model("bifurcation"))
    assert generate("bifurcation", tmp_path).digest == shipped.digest


def test_an_unknown_model_names_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="bifurcation, serpentine, network"):
        generate("trifurcation", tmp_path)
