"""Cost and accuracy of rendering and tracking on the simulated microscope; prints one JSON object.

Run: ``python -m benchmarks.tracking``. One thread, 1600x1200, the robot swings through a simulated
bifurcation at up to 3 mm/s while the simulated needle sweeps past it. Times are those of the thread, so that
other load on the machine counts less; ``wall`` times are beside them. All figures are simulated.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, ParamSpec, TypeVar

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import Affine2, Calibration, ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame, Track
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.sim.optics import Optics, OpticsConfig
from mrnav_server.vision.detector import Detector
from mrnav_server.vision.rim import RimFit
from mrnav_server.vision.sphere import SphereDetector
from mrnav_server.vision.tracker import Tracker, TrackerConfig
from mrnav_server.vision.vessel_model import vessel_map

P = ParamSpec("P")
T = TypeVar("T")
FRAMES = 600
RIVAL_FRAMES = 150
SCENE_FRAMES = 240
ABSENT_FRAMES = 1000
FAR_PX = 10.0
"""A rival that is further off than this has lost the robot."""
FALSE_PX = 1.0
"""A tracked position that is further off than this is false."""
PICTURE = PictureFormat()
CALIBRATION = Calibration(
    image_from_vessel=Affine2.scale(10.0 / 15.0, 200.0, 0.0),
    stage_from_vessel=Affine2.scale(10.0, 1000.0, 1000.0),
    um_per_px=10.0,
    floor_z_um=0.0,
    magnet_offset_um=(0.0, 0.0),
    critical_height_um=11_270.0,
)
RADIUS_PX = 500.0 / 15.0
OPTICS = OpticsConfig(radial=-0.03, tilt_deg=4.0, water_depth_um=3000.0)
Point = tuple[float, float]
Retouch = Callable[[ByteArray, ImagePoint, int], ByteArray]


def mask() -> ByteArray:
    """Return a Y-shaped channel, shape (1800, 1800)."""
    picture = np.zeros((1800, 1800), np.uint8)
    trunk = [(900, 1650), (900, 850)]
    for branch in (trunk, [(900, 850), (500, 200)], [(900, 850), (1300, 200)]):
        cv2.polylines(picture, [np.array(branch, np.int32)], False, 255, 280)
    return picture


def scene(number: int) -> tuple[VesselPoint, StagePoint]:
    """Return where robot and tip are on a frame."""
    t_s = number / PICTURE.fps
    robot = VesselPoint(900.0 + 60.0 * np.sin(2.3 * t_s), 1220.0 + 280.0 * np.sin(1.07 * t_s))
    x_um, y_um = CALIBRATION.stage_xy_um(robot)
    sweep_x_um, sweep_y_um = 1500.0 * np.sin(1.9 * t_s) - 900.0, 1900.0 * np.cos(0.9 * t_s)
    return robot, StagePoint(x_um + sweep_x_um, y_um + sweep_y_um, 1.04 * CALIBRATION.critical_height_um)


class Stopwatch:
    """Times calls, by the wall clock and by the thread's own processor time."""

    def __init__(self) -> None:
        self._wall_ms: list[float] = []
        self._cpu_ms: list[float] = []

    def __call__(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Return what a call returns, and note how long it took."""
        wall_s, cpu_s = time.perf_counter(), time.thread_time()
        result = function(*args, **kwargs)
        self._cpu_ms.append(1e3 * (time.thread_time() - cpu_s))
        self._wall_ms.append(1e3 * (time.perf_counter() - wall_s))
        return result

    def forget_last(self) -> None:
        """Drop the newest call from the figures."""
        del self._wall_ms[-1], self._cpu_ms[-1]

    def figures(self) -> dict[str, float]:
        """Return percentiles in ms; the processor's are those of an idle machine."""
        kinds = {"": self._cpu_ms, "wall_": self._wall_ms}
        return {
            f"{kind}p{percent}": round(float(np.percentile(times_ms, percent)), 3)
            for kind, times_ms in kinds.items()
            for percent in (50, 99)
        }


def film(vessel: VesselMap) -> list[tuple[ByteArray, ImagePoint]]:
    """Return frames for the rivals: the first ones of the film that ``cost`` is measured on."""
    microscope = Microscope(MicroscopeConfig(), PICTURE, Magnets(), vessel, CALIBRATION, seed=0)
    return [
        (microscope.render(*scene(number)), CALIBRATION.image_point(scene(number)[0]))
        for number in range(RIVAL_FRAMES)
    ]


def cost(vessel: VesselMap) -> dict[str, Any]:
    """Time rendering, tracking and re-detection on one film."""
    optics = Optics(OPTICS, CALIBRATION, PICTURE)
    microscope = Microscope(MicroscopeConfig(), PICTURE, Magnets(), vessel, CALIBRATION, seed=0)
    tilted = Microscope(MicroscopeConfig(), PICTURE, Magnets(), vessel, CALIBRATION, seed=0, optics=optics)
    tracker = Tracker(TrackerConfig(), CALIBRATION)
    detector = sphere()
    rendering, tilting, tracking, redetecting, seeking = (Stopwatch() for _ in range(5))
    errors_px = []
    for number in range(FRAMES):
        robot, tip = scene(number)
        image = rendering(microscope.render, robot, tip)
        track = tracking(tracker.update, Frame(number, number / PICTURE.fps, image))
        if number % 10 == 0:
            redetecting(detector.find, image)
            seeking(detector.find, microscope.render(None, tip))
        true = CALIBRATION.image_point(robot)
        if track.image is None:
            tracking.forget_last()
        else:
            errors_px.append(off_px((track.image.x_px, track.image.y_px), true))
    # Apart from the others: two floors at once are not what a rig holds in its cache.
    for number in range(FRAMES // 2):
        tilting(tilted.render, *scene(number))
    return {
        "tracked_ms": tracking.figures(),
        "redetect_ms": redetecting.figures(),
        "redetect_absent_ms": seeking.figures(),
        "render_ms": rendering.figures(),
        "render_with_optics_ms": tilting.figures(),
        "rms_px": rms(errors_px),
        "max_px": round(max(errors_px), 3),
        "lost": round(1.0 - len(errors_px) / FRAMES, 3),
    }


def sphere() -> Detector:
    """Return the detector of the default settings."""
    config = TrackerConfig()
    rim = RimFit(RADIUS_PX, config.edge_strength, config.systematic_um / 15.0)
    return SphereDetector(rim, config.radius_tolerance)


# -- scenes ------------------------------------------------------------------------------------------------


def as_it_is(image: ByteArray, robot: ImagePoint, number: int) -> ByteArray:
    """Leave a picture alone."""
    return image


def flickering(image: ByteArray, robot: ImagePoint, number: int) -> ByteArray:
    """Change the light by 30 % up and down."""
    return cv2.convertScaleAbs(image, alpha=1.0 + 0.3 * np.sin(0.21 * number)).astype(np.uint8)


def faint(image: ByteArray, robot: ImagePoint, number: int) -> ByteArray:
    """Leave a third of the contrast."""
    return cv2.convertScaleAbs(image, alpha=0.35, beta=95.0).astype(np.uint8)


def bubbling(image: ByteArray, robot: ImagePoint, number: int) -> ByteArray:
    """Let bubbles rise past the robot: dark rings with a bright middle, smaller and larger than it."""
    rng = np.random.default_rng(11)
    veil = image.copy()
    for index in range(24):
        radius = int(rng.choice([12, 18, 25, 44, 56]))
        x = 800 + rng.uniform(-160.0, 160.0) + 8.0 * np.sin(0.1 * number + index)
        y = (rng.uniform(0.0, 1200.0) - (1.0 + 0.1 * index) * number) % 1200.0
        center = (int(x * 16), int(y * 16))
        cv2.circle(veil, center, radius * 16, (70, 72, 74), 4, cv2.LINE_AA, shift=4)
        cv2.circle(veil, center, (radius - 5) * 16, (225, 226, 224), 2, cv2.LINE_AA, shift=4)
    return cv2.addWeighted(veil, 0.7, image, 0.3, 0.0).astype(np.uint8)


def covered(image: ByteArray, robot: ImagePoint, number: int) -> ByteArray:
    """Hide the robot behind a blurred dark edge, up to 85 % of its width."""
    share = 0.85 * 0.5 * (1.0 - np.cos(0.07 * number))
    x = np.arange(image.shape[1], dtype=np.float32)
    edge_px = robot.x_px - RADIUS_PX + 2.0 * RADIUS_PX * share
    # Fully dark where the robot is counted as hidden; blurred beyond.
    dark = np.clip((edge_px + 12.0 - x) / 12.0, 0.0, 1.0) * (x > robot.x_px - 220.0)
    band = slice(max(0, int(robot.y_px) - 150), int(robot.y_px) + 150)
    hidden = image.copy()
    weight = dark[None, :, None]
    hidden[band] = np.rint(image[band] * (1.0 - weight) + 60.0 * weight).astype(np.uint8)
    return hidden


def scenes(vessel: VesselMap) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield how the tracker does in each scene."""
    standard = Microscope(MicroscopeConfig(), PICTURE, Magnets(), vessel, CALIBRATION, seed=1)
    noisy = Microscope(MicroscopeConfig(noise=10.0), PICTURE, Magnets(), vessel, CALIBRATION, seed=2)
    upright = Microscope(
        MicroscopeConfig(), PICTURE, replace(Magnets(), tilt_deg=0.0), vessel, CALIBRATION, seed=3
    )
    away = StagePoint(60_000.0, -60_000.0, 1.04 * CALIBRATION.critical_height_um)
    yield "open", play(standard, as_it_is, away)
    yield "needle_45_deg", play(standard, as_it_is)
    yield "light_30_percent", play(standard, flickering)
    yield "noise_10", play(noisy, as_it_is)
    yield "magnet_vertical", play(upright, as_it_is)
    yield "low_contrast", play(standard, faint)
    yield "bubbles", play(standard, bubbling, away)
    yield "hidden_to_85_percent", play(standard, covered, away)
    yield "absent", play_absent(standard)


def play(microscope: Microscope, retouch: Retouch, tip: StagePoint | None = None) -> dict[str, Any]:
    """Track one film of a scene; ``lost`` is the share of frames without a position."""
    tracker = Tracker(TrackerConfig(), CALIBRATION)
    errors_px: list[float] = []
    normalised: list[float] = []
    false = 0
    for number in range(SCENE_FRAMES):
        robot, swept = scene(number)
        true = CALIBRATION.image_point(robot)
        image = retouch(microscope.render(robot, tip or swept), true, number)
        track = tracker.update(Frame(number, number / PICTURE.fps, image))
        if track.image is None:
            continue
        error_px = off_px((track.image.x_px, track.image.y_px), true)
        false += error_px > FALSE_PX
        errors_px.append(error_px)
        normalised.append(error_px * 15.0 / track.sigma_um)
    return {
        "rms_px": rms(errors_px),
        "max_px": round(max(errors_px, default=0.0), 3),
        "lost": round(1.0 - len(errors_px) / SCENE_FRAMES, 3),
        "false": false,
        "largest_error_in_sigma": round(max(normalised, default=0.0), 2),
    }


def play_absent(microscope: Microscope) -> dict[str, Any]:
    """Show no robot while the needle sweeps; every position is false."""
    tracker = Tracker(TrackerConfig(), CALIBRATION)
    false = 0
    for number in range(ABSENT_FRAMES):
        image = microscope.render(None, scene(number)[1])
        track: Track = tracker.update(Frame(number, number / PICTURE.fps, image))
        false += track.image is not None
    lost = round(1.0 - false / ABSENT_FRAMES, 3)
    return {"rms_px": 0.0, "max_px": 0.0, "lost": lost, "false": false, "frames": ABSENT_FRAMES}


# -- rivals ------------------------------------------------------------------------------------------------


def threshold_components(image: ByteArray, near: ImagePoint) -> Point | None:
    """Dark pixels of the whole picture; of their components the one whose area is nearest to the disc's."""
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    _, dark = cv2.threshold(gray, 105, 255, cv2.THRESH_BINARY_INV)
    count, _, stats, centers = cv2.connectedComponentsWithStats(dark)
    if count < 2:
        return None
    misfit = np.abs(stats[1:, cv2.CC_STAT_AREA] / (np.pi * RADIUS_PX**2) - 1.0)
    best = int(np.argmin(misfit))
    return (float(centers[1 + best][0]), float(centers[1 + best][1])) if misfit[best] < 0.5 else None


def hough(gray: ByteArray) -> Point | None:
    """Return the circle with the most votes."""
    found = cv2.HoughCircles(
        cv2.GaussianBlur(gray, (0, 0), 1.5),
        cv2.HOUGH_GRADIENT,
        dp=1.0,
        minDist=40.0,
        param1=80,
        param2=20,
        minRadius=int(0.9 * RADIUS_PX),
        maxRadius=int(1.1 * RADIUS_PX) + 1,
    )
    return None if found is None else (float(found[0, 0, 0]), float(found[0, 0, 1]))


def hough_full(image: ByteArray, near: ImagePoint) -> Point | None:
    """HoughCircles on the whole picture."""
    return hough(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.uint8))


def hough_region(image: ByteArray, near: ImagePoint) -> Point | None:
    """HoughCircles around the place of the frame before."""
    gray, left, top = crop(image, near)
    found = hough(gray)
    return None if found is None else (found[0] + left, found[1] + top)


def template_full(image: ByteArray, near: ImagePoint) -> Point | None:
    """Template matching of a disc on the quarter-scale picture."""
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    small = cv2.resize(gray, (gray.shape[1] // 4, gray.shape[0] // 4), interpolation=cv2.INTER_AREA)
    x, y = match(small.astype(np.uint8), RADIUS_PX / 4.0)
    return 4.0 * x + 1.5, 4.0 * y + 1.5


def template_region(image: ByteArray, near: ImagePoint) -> Point | None:
    """Template matching of a disc around the place of the frame before."""
    gray, left, top = crop(image, near)
    x, y = match(gray, RADIUS_PX)
    return x + left, y + top


def match(gray: ByteArray, radius_px: float) -> Point:
    """Return where a dark disc matches best, refined by parabolas."""
    half = int(1.3 * radius_px) + 1
    grid = np.arange(-half, half + 1)
    disc = np.where(np.hypot(grid[None, :], grid[:, None]) < radius_px, 45, 200).astype(np.uint8)
    score = cv2.matchTemplate(gray, disc, cv2.TM_CCOEFF_NORMED)
    _, _, _, (column, row) = cv2.minMaxLoc(score)
    across, down = score[row, :], score[:, column]
    return column + half + peak(across, column), row + half + peak(down, row)


def peak(values: np.ndarray, at: int) -> float:
    """Return by how much a parabola's top lies beside a sample."""
    if not 0 < at < len(values) - 1:
        return 0.0
    left, middle, right = (float(values[at + k]) for k in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    return 0.5 * (left - right) / bend if bend < 0.0 else 0.0


def crop(image: ByteArray, near: ImagePoint) -> tuple[ByteArray, int, int]:
    """Return the gray surroundings of a point, 168 px wide, and where they begin."""
    left, top = max(0, int(near.x_px) - 84), max(0, int(near.y_px) - 84)
    region = image[top : top + 168, left : left + 168]
    return cv2.cvtColor(region, cv2.COLOR_BGR2GRAY).astype(np.uint8), left, top


def rim_alone(image: ByteArray, near: ImagePoint) -> Point | None:
    """The tracker's own detector, without its filter."""
    found = OWN.follow(image, near)
    if found is None or found.confidence < TrackerConfig().confidence_min:
        return None
    return found.x_px, found.y_px


OWN = sphere()
RIVALS: dict[str, Callable[[ByteArray, ImagePoint], Point | None]] = {
    "rim_fit_region": rim_alone,
    "threshold_components_full": threshold_components,
    "hough_full": hough_full,
    "hough_region": hough_region,
    "template_quarter_full": template_full,
    "template_region": template_region,
}


def rivals(frames: list[tuple[ByteArray, ImagePoint]]) -> dict[str, dict[str, float]]:
    """Let other methods find the robot; those that look at a region are told where it was a frame before."""
    results = {}
    for name, locate in RIVALS.items():
        stopwatch = Stopwatch()
        errors_px = []
        near = frames[0][1]
        for image, true in frames:
            found = stopwatch(locate, image, near)
            if found is not None and off_px(found, true) <= FAR_PX:
                errors_px.append(off_px(found, true))
            near = true
        times = stopwatch.figures()
        results[name] = {
            "p50_ms": times["p50"],
            "p99_ms": times["p99"],
            "rms_px": rms(errors_px),
            "lost": round(1.0 - len(errors_px) / len(frames), 3),
        }
    return results


def off_px(found: Point, true: ImagePoint) -> float:
    """Return the distance from the truth."""
    return float(np.hypot(found[0] - true.x_px, found[1] - true.y_px))


def rms(errors_px: list[float]) -> float:
    """Return the root mean square; NaN would be no JSON, so 0 of nothing."""
    return round(float(np.sqrt(np.mean(np.square(errors_px)))), 4) if errors_px else 0.0


def main() -> None:
    """Run everything and print the figures."""
    cv2.setNumThreads(1)
    vessel = vessel_map("y", mask())
    result = {
        "simulated": True,
        **cost(vessel),
        "rivals": rivals(film(vessel)),
        "scenes": dict(scenes(vessel)),
    }
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
