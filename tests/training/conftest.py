"""Small vessels to train on."""

from pathlib import Path

import pytest

from mrnav_server.core.vessel import VesselMap
from tests import vessels


@pytest.fixture(scope="session")
def corner() -> VesselMap:
    return vessels.corner()


@pytest.fixture(scope="session")
def chamber() -> VesselMap:
    return vessels.chamber()


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return vessels.saved_chamber(tmp_path)
