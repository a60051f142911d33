"""Finding vessel models by name or path."""

from pathlib import Path

import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.vision.model_store import find_model, model_names, models_root


def test_the_shipped_model_is_found_by_name_and_by_path() -> None:
    folder = find_model("bifurcation")
    assert folder == models_root() / "bifurcation"
    assert find_model(folder) == folder
    assert "bifurcation" in model_names()


@pytest.mark.parametrize("name", ["nowhere", "", "/", "."])
def test_an_unknown_model_names_those_there_are(name: str) -> None:
    with pytest.raises(ConfigError, match="bifurcation"):
        find_model(name)


def test_a_folder_without_a_description_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"model\.json"):
        find_model(tmp_path)
