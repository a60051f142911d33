"""The tracker on photographs of real round things, against independent locators; prints one JSON object.

Run: ``python -m benchmarks.real_particles``. Nothing in these pictures is simulated, and nobody knows the
true places: what is measured is how far two methods that share no code are apart. Pictures are fetched into
``~/.cache/mrnav/real-particles`` (or ``MRNAV_REAL_PARTICLES``) and are no part of this project:

- ``microspheres``: 50 bright-field frames of five 2.12 µm colloidal spheres that diffuse on a substrate, from
  the examples of trackpy (BSD 3-clause or CC BY 3.0, trackpy-examples contributors), fetched with git.
- ``coins``: a photograph of 24 ancient coins, part of scikit-image (Brooklyn Museum, no known copyright
  restrictions). Coins are worn and not quite round: the difference is theirs too.
"""

import importlib
import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Affine2, Calibration, ImagePoint
from mrnav_server.core.records import Frame
from mrnav_server.vision.measure import RobotLook, measure_robot
from mrnav_server.vision.rim import RimFit
from mrnav_server.vision.sphere import SphereDetector
from mrnav_server.vision.tracker import Tracker, TrackerConfig

# scikit-image is typed in part only.
data, filters, measure, morphology, segmentation = (
    cast(Any, importlib.import_module(f"skimage.{name}"))
    for name in ("data", "filters", "measure", "morphology", "segmentation")
)
SPHERES_URL = "https://github.com/soft-matter/trackpy-examples"
SPHERES_COMMIT = "09fb3074a173585d48b5001b5b4b7e6479999598"
SPHERES_FOLDER = "sample_data/brightfield"
TRACKPY = ("trackpy==0.7", "looseversion==1.3.0")
FIRST_PX = ((254.3, 24.0), (295.7, 127.6), (398.9, 113.1), (78.7, 289.4), (279.8, 363.1))
"""Where the five spheres are in the first frame, to a pixel; the rest follows."""
EMPTY_PX = ((130.0, 90.0), (430.0, 260.0), (150.0, 430.0), (420.0, 430.0))
"""Where none ever is."""
HALF_PX = 45
UM_PER_PX = 15.0
"""The tracker's scale: only pixels matter here."""
MATCH_RADII = 0.3
"""Two places further apart than this are a gross difference."""
Point = tuple[float, float]
Locator = Callable[[ByteArray, Point, float], Point | None]


# -- arithmetic --------------------------------------------------------------------------------------------


def circle_fit(x_px: FloatArray, y_px: FloatArray) -> tuple[float, float, float]:
    """Return centre and radius of the circle with the least squared distance from points (Gauss-Newton)."""
    x0, y0 = float(x_px.mean()), float(y_px.mean())
    radius = float(np.hypot(x_px - x0, y_px - y0).mean())
    for _ in range(20):
        away = np.hypot(x_px - x0, y_px - y0)
        design = np.column_stack([(x_px - x0) / away, (y_px - y0) / away, np.ones_like(away)])
        step = np.linalg.lstsq(design, away - radius, rcond=None)[0]
        x0, y0, radius = x0 + float(step[0]), y0 + float(step[1]), radius + float(step[2])
        if np.abs(step).max() < 1e-6:
            break
    return x0, y0, radius


def summary(off_px: FloatArray, group: list[int], radius_px: float) -> dict[str, float]:
    """Return how far two methods are apart.

    Args:
        off_px: Shape (n, 2), differences of their places.
        group: Which thing each row is of.
        radius_px: Radius of the things.

    Returns:
        Root mean square and median; ``scatter`` is the root mean square about each thing's mean difference,
        so what the two see differently in the same way all the time is left out.
    """
    if not len(off_px):
        return {"n": 0}
    away = np.hypot(off_px[:, 0], off_px[:, 1])
    groups = np.asarray(group)
    rest = off_px.copy()
    for index in set(group):
        rest[groups == index] -= off_px[groups == index].mean(axis=0)
    figures = {
        "n": len(off_px),
        "rms_px": float(np.sqrt(np.mean(away**2))),
        "median_px": float(np.median(away)),
        "max_px": float(away.max()),
        "rms_radii": float(np.sqrt(np.mean(away**2))) / radius_px,
    }
    if len(off_px) > len(set(group)):
        figures["scatter_px"] = float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
    return {name: round(value, 4) for name, value in figures.items()}


def against_sigma(off_px: FloatArray, sigma_px: list[float]) -> dict[str, float]:
    """Return how differences compare with the standard deviation that the tracker states."""
    if not len(off_px):
        return {}
    ratio = np.hypot(off_px[:, 0], off_px[:, 1]) / np.asarray(sigma_px)
    return {
        "median_sigma_px": round(float(np.median(sigma_px)), 4),
        "median_in_sigma": round(float(np.median(ratio)), 2),
        "p95_in_sigma": round(float(np.percentile(ratio, 95)), 2),
        "within_4_sigma": round(float(np.mean(ratio <= 4.0)), 3),
    }


# -- independent locators ----------------------------------------------------------------------------------


def outline(gray: ByteArray, near: Point, radius_px: float) -> Point | None:
    """Circle through the outer contour halfway between the floor and the dark ring (scikit-image)."""
    y, x = np.mgrid[: gray.shape[0], : gray.shape[1]]
    away = np.hypot(x - near[0], y - near[1])
    floor = float(np.median(gray[(away > 1.5 * radius_px) & (away < 3.0 * radius_px)]))
    ring = float(np.percentile(gray[away < 1.2 * radius_px], 5))
    best: tuple[float, float, float] | None = None
    for contour in measure.find_contours(gray.astype(np.float64), 0.5 * (floor + ring)):
        if len(contour) < 3.0 * radius_px or not np.array_equal(contour[0], contour[-1]):
            continue
        found = circle_fit(contour[:, 1], contour[:, 0])
        close = math.hypot(found[0] - near[0], found[1] - near[1]) < 0.5 * radius_px
        if close and 0.8 * radius_px < found[2] < 1.25 * radius_px and (best is None or found[2] > best[2]):
            best = found
    return None if best is None else best[:2]


def bright_core(gray: ByteArray, near: Point, radius_px: float) -> Point | None:
    """Centroid of the light that the sphere focuses into its middle; it never sees the rim."""
    y, x = np.mgrid[: gray.shape[0], : gray.shape[1]]
    away = np.hypot(x - near[0], y - near[1])
    floor = float(np.median(gray[(away > 1.5 * radius_px) & (away < 3.0 * radius_px)]))
    weight = np.clip(gray - floor - 15.0, 0.0, None) * (away < 0.75 * radius_px)
    total = float(weight.sum())
    return None if total == 0.0 else (float((weight * x).sum()) / total, float((weight * y).sum()) / total)


def hough(gray: ByteArray, near: Point, radius_px: float) -> Point | None:
    """Return the circle with the most votes (OpenCV) near a place."""
    low, high = int(0.8 * radius_px), math.ceil(1.2 * radius_px)
    found = cv2.HoughCircles(
        cv2.GaussianBlur(gray, (0, 0), 1.0), cv2.HOUGH_GRADIENT, 1.0, 8.0, None, 80, 8, low, high
    )
    if found is None:
        return None
    x, y = min(
        ((float(c[0]), float(c[1])) for c in np.asarray(found).reshape(-1, found.shape[-1])),
        key=lambda c: math.hypot(c[0] - near[0], c[1] - near[1]),
    )
    return (x, y) if math.hypot(x - near[0], y - near[1]) < 0.5 * radius_px else None


def trackpy_ring(cache: Path) -> Locator | None:
    """Return trackpy's bright-field ring locator, installed beside the pictures; None if it cannot be had."""
    folder = cache / "trackpy"
    if not folder.exists():
        command = [
            sys.executable,
            "-m",
            "pip",
            "install",
            "-q",
            "--no-deps",
            "--target",
            str(folder),
            *TRACKPY,
        ]
        if subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode != 0:
            return None
    sys.path.append(str(folder))
    try:
        trackpy = importlib.import_module("trackpy")
    except ImportError as error:
        sys.stderr.write(f"trackpy is left out: {error}\n")
        return None
    trackpy.quiet()

    def locate(gray: ByteArray, near: Point, radius_px: float) -> Point | None:
        diameter = 2 * round(radius_px) + 1
        found = trackpy.locate_brightfield_ring(gray, diameter, processes=1)
        places = [(float(x), float(y)) for x, y in zip(found["x"], found["y"], strict=True)]
        places = [p for p in places if math.hypot(p[0] - near[0], p[1] - near[1]) < 0.5 * radius_px]
        return places[0] if places else None

    return locate


# -- pictures ----------------------------------------------------------------------------------------------


def cache_folder() -> Path:
    """Return where fetched pictures are kept."""
    return Path(os.environ.get("MRNAV_REAL_PARTICLES", Path.home() / ".cache" / "mrnav" / "real-particles"))


def sphere_frames(cache: Path) -> list[ByteArray] | str:
    """Return the frames, or why there are none."""
    folder = cache / "trackpy-examples"
    if not (folder / SPHERES_FOLDER).exists():
        shutil.rmtree(folder, ignore_errors=True)
        steps = (
            ["git", "clone", "-q", "--filter=blob:none", "--no-checkout", SPHERES_URL, str(folder)],
            ["git", "-C", str(folder), "sparse-checkout", "set", "--no-cone", f"/{SPHERES_FOLDER}/"],
            ["git", "-C", str(folder), "checkout", "-q", SPHERES_COMMIT],
        )
        try:
            for step in steps:
                subprocess.run(step, check=True, timeout=300.0)
        except (OSError, subprocess.SubprocessError) as error:
            return f"skipped, the pictures cannot be fetched (offline?): {error}"
    paths = sorted((folder / SPHERES_FOLDER).glob("*.png"))
    pictures = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
    return [picture.astype(np.uint8) for picture in pictures if picture is not None] or "skipped, no pictures"


def window(gray: ByteArray, center: Point, scale: int) -> tuple[ByteArray, Point]:
    """Return the surroundings of a place, enlarged, and the corner they begin at."""
    left, top = max(0, round(center[0]) - HALF_PX), max(0, round(center[1]) - HALF_PX)
    part = gray[top : top + 2 * HALF_PX, left : left + 2 * HALF_PX]
    if scale > 1:
        part = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC).astype(np.uint8)
    return part, (left, top)


def colour(gray: ByteArray) -> ByteArray:
    """Return a picture as a camera gives it."""
    return cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR).astype(np.uint8)


# -- data sets ---------------------------------------------------------------------------------------------


def microspheres(frames: list[ByteArray], locators: dict[str, Locator], scale: int) -> dict[str, Any]:
    """Follow each sphere through the film; ``scale`` enlarges the pictures for the tracker alone."""
    looks = [measured(window(frames[0], first, 1)[0]) for first in FIRST_PX]
    radius_px = scale * float(np.median([look.radius_px for look in looks if look is not None]))
    config = TrackerConfig(robot_radius_um=radius_px * UM_PER_PX)
    rim = RimFit(radius_px, config.edge_strength, config.systematic_um / UM_PER_PX)
    detector = SphereDetector(rim, config.radius_tolerance)
    ours: list[tuple[int, int, Point, float]] = []
    tracked: list[tuple[int, int, Point]] = []
    follow_ms: list[float] = []
    found = false = 0
    for index, first in enumerate(FIRST_PX):
        tracker = Tracker(config, flat_calibration())
        for number, frame in enumerate(frames):
            part, (left, top) = window(frame, first, scale)
            image = colour(part)

            def native(x_px: float, y_px: float, left: float = left, top: float = top) -> Point:
                return (x_px + 0.5) / scale - 0.5 + left, (y_px + 0.5) / scale - 0.5 + top

            track = tracker.update(Frame(number, number / 7.0, image))
            if track.image is not None:
                tracked.append((index, number, native(track.image.x_px, track.image.y_px)))
            seen = detector.find(image)
            if seen is None or seen.confidence < config.confidence_min:
                continue
            found += 1
            started = time.thread_time()
            seen = detector.follow(image, ImagePoint(seen.x_px + 1.0, seen.y_px - 1.0))
            follow_ms.append(1e3 * (time.thread_time() - started))
            if seen is not None:
                ours.append((index, number, native(seen.x_px, seen.y_px), seen.sigma_px / scale))
    for frame in frames:
        for empty in EMPTY_PX:
            seen = detector.find(colour(window(frame, empty, scale)[0]))
            false += seen is not None and seen.confidence >= config.confidence_min
    native_radius_px = radius_px / scale
    total = len(FIRST_PX) * len(frames)
    result: dict[str, Any] = {
        "n": total,
        "radius_px": round(radius_px, 2),
        "measured_radii_px": [
            None if look is None else [look.polarity, round(look.radius_px / scale, 2)]
            for look in (measured(window(frames[0], first, scale)[0]) for first in FIRST_PX)
        ],
        "found": round(found / total, 3),
        "tracked": round(len(tracked) / total, 3),
        "false": false,
        "empty": len(frames) * len(EMPTY_PX),
        "follow_ms_p50": round(float(np.median(follow_ms)), 3) if follow_ms else None,
        "against": {},
    }
    places: dict[str, dict[tuple[int, int], Point]] = {"rim": {(i, n): place for i, n, place, _ in ours}}
    for name, locate in locators.items():
        off, group, sigma, rough = [], [], [], 0
        taken_s = 0.0
        for index, number, place, sigma_px in ours:
            part, (left, top) = window(frames[number], FIRST_PX[index], 1)
            # Told a whole pixel only, so that no part of our answer is handed over.
            near = float(round(place[0]) - left), float(round(place[1]) - top)
            started = time.thread_time()
            other = locate(part, near, native_radius_px)
            taken_s += time.thread_time() - started
            if other is None:
                rough += 1
                continue
            places.setdefault(name, {})[index, number] = (other[0] + left, other[1] + top)
            off.append((place[0] - other[0] - left, place[1] - other[1] - top))
            group.append(index)
            sigma.append(sigma_px)
        off_px = np.array(off, dtype=np.float64).reshape(-1, 2)
        result["against"][name] = {
            **summary(off_px, group, native_radius_px),
            **against_sigma(off_px, sigma),
            "not_found_by_it": rough,
            "gross": int(np.sum(np.hypot(off_px[:, 0], off_px[:, 1]) > MATCH_RADII * native_radius_px)),
            "ms": round(1e3 * taken_s / max(len(ours), 1), 2),
        }
    result["apart"] = pairs(places, native_radius_px)
    return result


def pairs(places: dict[str, dict[tuple[int, int], Point]], radius_px: float) -> dict[str, dict[str, float]]:
    """Return how far the independent locators are apart from one another, to judge ours by."""
    names = [name for name in places if name != "rim"]
    apart = {}
    for number, first in enumerate(names):
        for second in names[number + 1 :]:
            both = sorted(set(places[first]) & set(places[second]))
            off = [np.subtract(places[first][key], places[second][key]) for key in both]
            figures = summary(
                np.array(off, dtype=np.float64).reshape(-1, 2), [key[0] for key in both], radius_px
            )
            apart[f"{first} - {second}"] = figures
    return apart


def coins() -> dict[str, Any]:
    """Fit each coin, started from the outline of its segmentation and with its radius, and compare."""
    photograph = np.asarray(data.coins(), np.uint8)
    edges = filters.sobel(filters.gaussian(photograph, 1.0))
    markers = np.zeros(photograph.shape, np.int32)
    markers[photograph < 30], markers[photograph > 150] = 1, 2
    solid = morphology.opening(segmentation.watershed(edges, markers) == 2, morphology.disk(4))
    regions = [r for r in measure.regionprops(measure.label(solid)) if 600 < r.area < 4000]
    off, sigma, group, radii, confident = [], [], [], [], 0
    for index, region in enumerate(regions):
        x_px, y_px = float(region.centroid[1]), float(region.centroid[0])
        contour = max(measure.find_contours(np.pad(region.image, 2).astype(np.float64), 0.5), key=len)
        left, top = region.bbox[1] - 2.0, region.bbox[0] - 2.0
        circle = circle_fit(contour[:, 1] + left, contour[:, 0] + top)
        fitted = RimFit(circle[2], 25.0, 0.0, "bright").fit(photograph, round(x_px), round(y_px))
        if fitted.confidence < TrackerConfig().confidence_min:
            continue
        confident += 1
        off.append((fitted.x_px - circle[0], fitted.y_px - circle[1]))
        sigma.append(fitted.sigma_px)
        radii.append(circle[2])
        group.append(index)
    off_px = np.array(off, dtype=np.float64).reshape(-1, 2)
    return {
        "n": len(regions),
        "found": round(confident / max(len(regions), 1), 3),
        "radius_px": round(float(np.median(radii)), 2) if radii else None,
        "against": {
            "outline": {**summary(off_px, group, float(np.median(radii))), **against_sigma(off_px, sigma)}
        },
    }


def measured(gray: ByteArray) -> RobotLook | None:
    """Return what the automatic measurement says of a picture, or None if it refuses."""
    try:
        return measure_robot(colour(gray), UM_PER_PX, (6.0 * UM_PER_PX, 60.0 * UM_PER_PX))
    except RefusedError:
        return None


def flat_calibration() -> Calibration:
    """Return a calibration in which a pixel is ``UM_PER_PX`` wide."""
    unit = Affine2.scale(1.0, 0.0, 0.0)
    return Calibration(unit, Affine2.scale(UM_PER_PX, 0.0, 0.0), UM_PER_PX, 0.0, (0.0, 0.0), 11_270.0)


def main() -> None:
    """Run everything and print the figures."""
    cv2.setNumThreads(1)
    cache = cache_folder()
    cache.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {"simulated": False, "coins": coins()}
    frames = sphere_frames(cache)
    if isinstance(frames, str):
        result["microspheres"] = {"skipped": frames}
    else:
        locators: dict[str, Locator] = {"outline": outline, "bright_core": bright_core, "hough": hough}
        ring = trackpy_ring(cache)
        if ring is not None:
            locators["trackpy_ring"] = ring
        for scale in (1, 3):
            name = "microspheres" if scale == 1 else f"microspheres_x{scale}"
            result[name] = microspheres(frames, locators, scale)
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
