"""Calibrating devices that are not simulated: a film for a camera, an emulated controller in a process."""

import asyncio
import threading
from collections.abc import Generator, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from mrnav_server.app.bench import build_bench, build_camera, build_manipulator
from mrnav_server.app.calibration_run import calibrate_real, check_real, run_check, run_procedure
from mrnav_server.cli.main import app
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.micromanager.shared_core import SharedCore
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.video_file import VideoFileCamera
from mrnav_server.loops.calibration_host import CalibrationHost
from mrnav_server.settings import CameraConfig, ManipulatorConfig, RigConfig, Settings
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.vision.calibration_parts import HeldOut
from mrnav_server.vision.calibration_plan import Answer, CalibrationConfig, Prepare, Step
from mrnav_server.vision.calibration_procedure import Procedure
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.devices.emulator_process import EmulatorProcess
from tests.vision.test_calibration_file import made


@pytest.fixture(scope="module")
def bifurcation() -> VesselMap:
    return load_vessel_model(find_model("bifurcation"))


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorProcess]:
    with EmulatorProcess(tmp_path_factory.mktemp("calibration")) as running:
        yield running


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """A film of a plate with dust: nothing on it that could be calibrated with."""
    rng, path = np.random.default_rng(1), tmp_path / "plate.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    for _ in range(40):
        writer.write(rng.normal(160.0, 4.0, (480, 640, 3)).clip(0, 255).astype(np.uint8))
    writer.release()
    return path


def real(film: Path, address: str = "") -> Settings:
    return Settings(
        rig=RigConfig(camera="file"),
        camera=CameraConfig(file=str(film), loop=True, width_px=640, height_px=480),
        manipulator=ManipulatorConfig(driver="sensapex-udp"),
        # On a busy machine a short silence is no failure.
        sensapex=SensapexConfig(address=address, silent_ms=400),
    )


def test_the_command_gets_as_far_as_the_picture(
    film: Path, emulator: EmulatorProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = {
        "RIG__CAMERA": "usb",
        "CAMERA__WIDTH_PX": "640",
        "CAMERA__HEIGHT_PX": "480",
        "MANIPULATOR__DRIVER": "sensapex-udp",
        "SENSAPEX__ADDRESS": emulator.host,
        "CALIBRATION__SHEET_PICTURES": "2",
    }
    for name, value in rig.items():
        monkeypatch.setenv(f"MRNAV_{name}", value)
    monkeypatch.setattr(
        "mrnav_server.app.bench.UsbCamera",
        lambda _, asked, clock, controls: VideoFileCamera(film, asked, clock, loop=True),
    )
    done = CliRunner().invoke(app, ["calibrate", "run", "--water-depth-um", "0"], input="\n")
    assert isinstance(done.exception, RefusedError), done.output
    assert "sheet" in str(done.exception)


async def test_a_bench_without_a_calibration_can_be_calibrated(
    film: Path, emulator: EmulatorProcess, tmp_path: Path
) -> None:
    asked: list[str] = []

    async def ask(step: Prepare) -> None:
        asked.append(step.text)

    settings = real(film, emulator.host)
    procedure = Procedure(CalibrationConfig(sheet_pictures=2), settings.camera, settings.tracker)
    with pytest.raises(RefusedError, match="sheet"):
        await calibrate_real(settings, procedure, ask, lambda step: None, tmp_path / "draft.json")
    assert asked[0].startswith("Lay the sheet")


async def test_a_calibration_whose_tip_is_not_seen_does_not_hold(
    film: Path, emulator: EmulatorProcess
) -> None:
    asked: list[str] = []

    async def ask(step: Prepare) -> None:
        asked.append(step.scene)

    plan = CalibrationConfig(
        raster_span_um=2000.0,
        raster_z_um=(10_200.0, 10_000.0),
        travel_z_um=10_200.0,
        speed_um_per_s=3000.0,
        settle_s=0.0,
    )
    with pytest.raises(RefusedError, match="tip"):
        await check_real(real(film, emulator.host), made(), plan, ask)
    assert asked == ["plate"]
    assert any(row["kind"] == "GOTO" for row in emulator.trace())


class Touch:
    """Long sums that end only once the event loop has kept in touch with the devices meanwhile."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()

    def wait(self) -> None:
        kept = threading.Event()
        self._loop.call_soon_threadsafe(kept.set)
        assert kept.wait(0.5), "the event loop was held"


def host_that_asks_a_person(film: Path) -> CalibrationHost:
    settings = real(film)
    core = SharedCore(settings.micromanager)
    manipulator = build_manipulator(settings, lambda: 0.0, core)
    camera = build_camera(settings, lambda: 0.0, core)
    return CalibrationHost(manipulator, camera, settings.limits, lambda _: asyncio.sleep(0.0), lambda: 0.0)


async def test_the_sums_of_a_calibration_do_not_hold_up_the_drivers(film: Path) -> None:
    touch = Touch()

    class LongSums(Procedure):
        def told(self, answer: Answer) -> None:
            touch.wait()
            self.step = None

    settings = real(film)
    procedure = LongSums(CalibrationConfig(), settings.camera, settings.tracker)
    await run_procedure(procedure, host_that_asks_a_person(film), lambda step: None)


async def test_the_sums_of_a_check_do_not_hold_up_the_drivers(
    film: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    touch = Touch()

    def long_check(*_: object) -> Generator[Step, Answer, HeldOut]:
        yield Prepare("check", "Leave the plate", 0.0, "plate")
        touch.wait()
        return HeldOut(points=5, rms_um=3.0, max_um=5.0)

    monkeypatch.setattr("mrnav_server.app.calibration_run.check_tip", long_check)
    held_out = await run_check(made(), CalibrationConfig(), host_that_asks_a_person(film))
    assert held_out.max_um == 5.0


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
