import pytest
from fake_rig import SETTINGS, FakeRig
from fastapi import FastAPI

from mrnav_server.app.server import create_app


@pytest.fixture
def rig() -> FakeRig:
    return FakeRig()


@pytest.fixture
def app(rig: FakeRig) -> FastAPI:
    return create_app(rig, SETTINGS)
