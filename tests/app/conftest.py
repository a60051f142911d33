import pytest
from fastapi import FastAPI

from mrnav_server.app.server import create_app
from tests.app.fake_rig import SETTINGS, FakeRig


@pytest.fixture
def rig() -> FakeRig:
    return FakeRig()


@pytest.fixture
def app(rig: FakeRig) -> FastAPI:
    return create_app(rig, SETTINGS)
