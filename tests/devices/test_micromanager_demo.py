"""Stages and camera on Micro-Manager itself, with its demo devices."""

import asyncio
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame, Track, TrackState
from mrnav_server.devices.micromanager.camera import MicroManagerCamera, to_bgr
from mrnav_server.devices.micromanager.config import MicroManagerConfig
from mrnav_server.devices.micromanager.manipulator import MicroManagerManipulator
from mrnav_server.devices.micromanager.shared_core import Core, SharedCore, load_core
from mrnav_server.loops import tracking
from mrnav_server.loops.tracking import TrackingLoop
from tests.devices.fake_core import WAIT_S, leaked

needed = "needs Micro-Manager's demo devices: pip install 'mrnav-server[micromanager]' mm-test-adapters"
mm_test_adapters = pytest.importorskip("mm_test_adapters", reason=needed)
pymmcore = pytest.importorskip("pymmcore", reason=needed)

PICTURE = PictureFormat(width_px=512, height_px=512, fps=30.0)
CONFIG = MicroManagerConfig(
    offset_um=(10_000.0, 10_000.0, 12_000.0), xy_speed_properties=("Velocity",), timeout_ms=2000.0
)


def stage(config: MicroManagerConfig = CONFIG) -> MicroManagerManipulator:
    return MicroManagerManipulator(config, SharedCore(config), time.monotonic)


@pytest.fixture(autouse=True)
def _no_thread_is_left() -> Iterator[None]:
    yield
    assert not leaked()


@pytest.fixture
def configured(tmp_path: Path) -> Callable[..., MicroManagerConfig]:
    """Write the demo configuration with further lines."""

    def write(*lines: str) -> MicroManagerConfig:
        demo = Path(mm_test_adapters.device_adapter_path()) / "MMConfig_demo.cfg"
        file = tmp_path / "lab.cfg"
        file.write_text("\n".join([demo.read_text(), *lines, ""]))
        return replace(CONFIG, config_file=str(file))

    return write


async def until(check: Callable[[], object]) -> None:
    """Let the threads work until something is so."""
    async with asyncio.timeout(WAIT_S):
        while not check():  # noqa: ASYNC110 - other threads bring it about
            await asyncio.sleep(0.001)


async def test_the_stages_go_to_a_target_and_say_where_they_are() -> None:
    device = stage()
    await device.open()
    assert device.tip().position == StagePoint(10_000.0, 10_000.0, 12_000.0)
    target = StagePoint(10_300.0, 9_900.0, 12_200.0)
    assert device.move_to(target, 1000.0, 0.0).target == target
    await until(lambda: device.tip().moving)
    await until(lambda: not device.tip().moving)
    assert device.tip().position.array() == pytest.approx(target.array(), abs=0.05)
    assert 0.0 <= time.monotonic() - device.tip().taken_s < WAIT_S
    await device.close()


async def test_a_target_on_the_way_replaces_the_one_before() -> None:
    device = stage(replace(CONFIG, speed_um_per_s=1000.0))
    await device.open()
    device.move_to(StagePoint(20_000.0, 10_000.0, 12_000.0), 1000.0, 0.0)
    await until(lambda: device.tip().position.x_um > 10_010.0)
    device.move_to(StagePoint(9_950.0, 10_000.0, 12_000.0), 1000.0, 0.0)
    await until(lambda: device.tip().position.x_um == pytest.approx(9_950.0, abs=0.05))
    await device.close()


async def test_a_stop_ends_a_move_on_the_way() -> None:
    device = stage(replace(CONFIG, speed_um_per_s=1000.0))
    await device.open()
    device.move_to(StagePoint(20_000.0, 10_000.0, 12_000.0), 1000.0, 0.0)
    await until(lambda: device.tip().position.x_um > 10_010.0)
    device.stop()
    await until(lambda: not device.tip().moving)
    rest = device.tip()
    await until(lambda: device.tip().taken_s > rest.taken_s + 0.1)
    assert device.tip().position == rest.position
    assert rest.position.x_um < 19_000.0
    await device.close()


async def test_a_stage_s_own_limit_is_a_fault_that_names_it() -> None:
    device = stage()
    await device.open()
    device.move_to(StagePoint(10_000.0, 10_000.0, 13_000.0), 1000.0, 0.0)

    def told() -> str:
        try:
            device.tip()
        except DeviceError as error:
            return str(error)
        return ""

    await until(told)
    assert 'Error in device "Z": Position out of range' in told()
    device.stop()
    await until(lambda: not told())
    await device.close()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"xy_stage": "ASI"}, "no XY stage named ASI: set micromanager.xy_stage to XY"),
        ({"z_stage": "XY"}, "no Z stage named XY: set micromanager.z_stage to Z"),
        ({"config_file": "/nowhere/lab.cfg"}, "/nowhere/lab.cfg does not exist: save one"),
        ({"adapters": "/nowhere"}, "adapters /nowhere is not a folder: give the one"),
        (
            {"xy_speed_properties": ("Speed",)},
            "XY has no property Speed: choose micromanager.xy_speed_properties from .*Velocity",
        ),
    ],
)
async def test_settings_that_fit_no_device(wrong: dict[str, Any], said: str) -> None:
    device = stage(replace(CONFIG, **wrong))
    with pytest.raises(DeviceError, match=said):
        await device.open()
    await device.close()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Device,XY,NoSuchAdapter,Stage\n", 'Failed to load device adapter "NoSuchAdapter".*powered'),
        ("nothing that Micro-Manager knows\n", "has no default XY stage: the configuration has no XY stage"),
    ],
)
async def test_a_configuration_without_devices(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "lab.cfg").write_text(text)
    device = stage(replace(CONFIG, config_file=str(tmp_path / "lab.cfg")))
    with pytest.raises(DeviceError, match=said):
        await device.open()
    await device.close()


@pytest.mark.parametrize(
    ("missing", "remedy"),
    [
        ("pymmcore", r"pip install 'mrnav-server\[micromanager\]'"),
        ("mm_test_adapters", "install mm-test-adap"),
    ],
)
async def test_without_the_packages(monkeypatch: pytest.MonkeyPatch, missing: str, remedy: str) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    device = stage()
    with pytest.raises(DeviceError, match=remedy):
        await device.open()
    await device.close()


@pytest.fixture
def older_adapters(tmp_path: Path) -> Path:
    """Copy the demo adapters; the copies say that they have the device interface before this one."""
    version = pymmcore.CMMCore().getMMDeviceDeviceInterfaceVersion()
    built, older = (bytes([0xB8, number, 0, 0, 0, 0xC3]) for number in (version, version - 1))
    for adapter in Path(mm_test_adapters.device_adapter_path()).glob("*mmgr_dal_*"):
        content = adapter.read_bytes()
        if content.count(built) != 1:
            pytest.skip("the number of the device interface stands elsewhere in this build")
        (tmp_path / adapter.name).write_bytes(content.replace(built, older))
    return tmp_path


async def test_adapters_of_another_device_interface(older_adapters: Path) -> None:
    device = stage(replace(CONFIG, adapters=str(older_adapters)))
    with pytest.raises(DeviceError, match="do not fit: install the pymmcore whose version has"):
        await device.open()
    await device.close()


@pytest.fixture
def camera() -> Iterator[Callable[..., MicroManagerCamera]]:
    """Make cameras; they are closed at the end."""
    made: list[MicroManagerCamera] = []

    def make(config: MicroManagerConfig = CONFIG, picture: PictureFormat = PICTURE) -> MicroManagerCamera:
        made.append(MicroManagerCamera(config, picture, SharedCore(config), time.monotonic))
        return made[-1]

    yield make
    for one in made:
        one.close()


Make = Callable[..., MicroManagerCamera]


@pytest.mark.parametrize("kind", ["8bit", "16bit", "32bitRGB"])
def test_pictures_come_as_bgr(camera: Make, configured: Callable[..., MicroManagerConfig], kind: str) -> None:
    lines = [f"Property,Camera,PixelType,{kind}"]
    if kind == "32bitRGB":
        lines.append("Property,Camera,Mode,Color Test Pattern")
    device = camera(configured(*lines))
    device.open()
    first, second = device.read(WAIT_S), device.read(WAIT_S)
    for frame in (first, second):
        assert frame.image.shape == (512, 512, 3)
        assert frame.image.dtype == np.uint8
        assert frame.image.flags.c_contiguous
        assert np.ptp(frame.image) > 10
    gray = (first.image[..., 0] == first.image[..., 2]).all()
    assert gray == (kind != "32bitRGB")
    assert second.number > first.number
    assert first.taken_s < second.taken_s < time.monotonic()


def test_frames_are_counted_and_spaced_as_they_were_taken(camera: Make) -> None:
    device = camera(replace(CONFIG, exposure_ms=20.0))
    device.open()
    frames = [device.read(WAIT_S) for _ in range(8)]
    assert len({frame.number for frame in frames}) == 8
    spacing_s = (frames[-1].taken_s - frames[0].taken_s) / (frames[-1].number - frames[0].number)
    # The demo camera takes its exposure and a little.
    assert 0.018 < spacing_s < 0.040


@pytest.mark.parametrize(
    ("picture", "lines", "said"),
    [
        (PictureFormat(1600, 1200), (), "gives pictures of 512×512 px.*set camera.width_px = 512"),
        (PICTURE, ("Property,Camera,PixelType,64bitRGB",), "4 components in uint64: set its pixel type"),
        (PICTURE, ("Property,Camera,PixelType,32bit",), "1 components in uint32: set its pixel type"),
    ],
)
def test_other_pictures_are_refused(
    camera: Make,
    configured: Callable[..., MicroManagerConfig],
    picture: PictureFormat,
    lines: tuple[str, ...],
    said: str,
) -> None:
    with pytest.raises(DeviceError, match=said):
        camera(configured(*lines), picture).open()


def test_a_camera_that_is_not_there_or_not_open(camera: Make) -> None:
    device = camera(replace(CONFIG, camera="Basler"))
    with pytest.raises(DeviceError, match="camera Basler is not open"):
        device.read(0.0)
    with pytest.raises(DeviceError, match=r"no camera named Basler: set micromanager.camera to Camera"):
        device.open()
    device.close()
    with pytest.raises(DeviceError, match="is not open"):
        device.read(0.0)


async def test_a_camera_that_stops_is_told_and_can_be_opened_again_beside_the_stages() -> None:
    shared = SharedCore(CONFIG)
    device = MicroManagerCamera(CONFIG, PICTURE, shared, time.monotonic)
    stages = MicroManagerManipulator(CONFIG, shared, time.monotonic)
    device.open()
    await stages.open()
    core = shared.acquire()
    core.stopSequenceAcquisition("Camera")

    def read_on() -> None:
        while True:
            device.read(WAIT_S)

    with pytest.raises(DeviceError, match="stopped by itself: check its power"):
        read_on()
    device.close()
    device.open()
    assert device.read(WAIT_S).image.any()
    device.close()
    assert not core.isSequenceRunning("Camera")
    stages.move_to(StagePoint(10_100.0, 10_000.0, 12_000.0), 1000.0, 0.0)
    await until(lambda: stages.tip().position.x_um > 10_050.0)
    await stages.close()
    shared.release()


def test_deep_gray_keeps_its_upper_bits() -> None:
    image = np.array([[0, 15, 16, 4095, 65535]], np.uint16)
    assert to_bgr(image, 1, 12, "camera")[0, :, 0].tolist() == [0, 0, 1, 255, 255]
    colour = np.array([[0x00112233]], np.uint32)
    assert to_bgr(colour, 4, 8, "camera")[0, 0].tolist() == [0x33, 0x22, 0x11]


class Blind:
    """A tracker that never finds anything."""

    def update(self, frame: Frame) -> Track:
        return Track(frame.taken_s, frame.number, TrackState.SEARCHING, None, None, 0.0, 0.0, 0)


async def test_the_tracking_loop_runs_on_the_camera(camera: Make) -> None:
    device = camera()
    device.open()
    seen: list[tuple[Frame, Track]] = []
    loop = TrackingLoop(device, Blind(), lambda *both: seen.append(both), lambda fault: pytest.fail(fault))
    running = asyncio.ensure_future(loop.run())
    await until(lambda: len(seen) >= 5)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    numbers = [track.frame_number for _, track in seen]
    assert numbers == sorted(set(numbers))
    assert [track.taken_s for _, track in seen] == [frame.taken_s for frame, _ in seen]


class LooseCable:
    """A core whose camera refuses every call while it is pulled out; the acquisition is then not stopped."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self.out = False

    def __getattr__(self, name: str) -> object:
        if self.out and name in ("getRemainingImageCount", "setCameraDevice", "stopSequenceAcquisition"):
            raise RuntimeError('Error in device "Camera": \n(device not connected)')
        return getattr(self._core, name)


async def test_the_tracking_loop_survives_a_camera_that_throws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracking, "_FIRST_RETRY_S", 0.001)
    monkeypatch.setattr(tracking, "_LAST_RETRY_S", 0.01)
    cable = LooseCable(load_core(CONFIG))
    shared = SharedCore(CONFIG, lambda _: cast(Core, cable))
    stages = shared.acquire()
    device = MicroManagerCamera(CONFIG, PICTURE, shared, time.monotonic)
    device.open()
    seen: list[Frame] = []
    told: list[str] = []
    loop = TrackingLoop(device, Blind(), lambda frame, _: seen.append(frame), told.append)
    running = asyncio.ensure_future(loop.run())
    await until(lambda: seen)
    cable.out = True
    await until(lambda: told)
    assert told == [
        'camera: Micro-Manager camera failed: Error in device "Camera": (device not connected): check its'
        " power and its cable; trying again"
    ]
    seen.clear()
    cable.out = False
    await until(lambda: len(seen) >= 3)
    assert told[1:] == [""]
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert not stages.isSequenceRunning("Camera")
    shared.release()
