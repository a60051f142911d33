"""The vessel that ships, a small one, and a planner for it."""

import pytest

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests import vessels


@pytest.fixture(scope="session")
def bifurcation() -> VesselMap:
    return load_vessel_model(find_model("bifurcation"))


@pytest.fixture(scope="session")
def corner() -> VesselMap:
    return vessels.corner()


@pytest.fixture(scope="session")
def planner(bifurcation: VesselMap) -> PathPlanner:
    return PathPlanner(bifurcation)
