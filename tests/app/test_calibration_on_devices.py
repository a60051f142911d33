"""Calibrating devices that are not simulated: a film for a camera, an emulated controller in a process."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from mrnav_server.app.bench import build_bench
from mrnav_server.app.calibration_run import calibrate_real
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.settings import CameraConfig, ManipulatorConfig, RigConfig, Settings
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.vision.calibration_plan import CalibrationConfig, Prepare
from mrnav_server.vision.calibration_procedure import Procedure
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.devices.emulator_process import EmulatorProcess


@pytest.fixture(scope="module")
def bifurcation() -> VesselMap:
    return load_vessel_model(find_model("bifurcation"))


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """A film of a plate with dust: nothing on it that could be calibrated with."""
    rng, path = np.random.default_rng(1), tmp_path / "plate.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    for _ in range(40):
        writer.write(rng.normal(160.0, 4.0, (480, 640, 3)).clip(0, 255).astype(np.uint8))
    writer.release()
    return path


def real(film: Path, address: str | None = None) -> Settings:
    return Settings(
        rig=RigConfig(camera="file"),
        camera=CameraConfig(file=str(film), loop=True, width_px=640, height_px=480),
        manipulator=ManipulatorConfig(driver="sensapex-udp"),
        sensapex=SensapexConfig(address=address),
    )


async def test_a_bench_without_a_calibration_can_be_calibrated(film: Path, tmp_path: Path) -> None:
    asked: list[str] = []

    async def ask(step: Prepare) -> None:
        asked.append(step.text)

    with EmulatorProcess(tmp_path) as emulator:
        settings = real(film, emulator.host)
        procedure = Procedure(CalibrationConfig(sheet_pictures=2), settings.camera, settings.tracker)
        with pytest.raises(RefusedError, match="sheet"):
            await calibrate_real(settings, procedure, ask, lambda step: None, tmp_path / "draft.json")
    assert asked[0].startswith("Lay the sheet")


def test_the_server_needs_one(film: Path, bifurcation: VesselMap) -> None:
    with pytest.raises(ConfigError, match="mrnav calibrate run"):
        build_bench(real(film), bifurcation, lambda: 0.0)


def test_where_nothing_is_simulated_no_world_is_made(
    film: Path, bifurcation: VesselMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    def made(*_: object) -> SimulatedWorld:
        raise AssertionError("a world was made for devices that are real")

    monkeypatch.setattr("mrnav_server.app.bench.SimulatedWorld", made)
    with pytest.raises(ConfigError, match=r"rig\.calibration"):
        build_bench(real(film), bifurcation, lambda: 0.0)
