"""Cost and accuracy of rendering and tracking on the simulated microscope; prints one JSON object.

Run: ``python -m benchmarks.tracking``. One thread, 1600x1200, the robot swings through a simulated
bifurcation at up to 3 mm/s while the simulated needle sweeps past it. All figures are simulated.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import Affine2, Calibration, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame, TrackState
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.vision.redetect import Redetector
from mrnav_server.vision.rim import RimFit
from mrnav_server.vision.tracker import Tracker, TrackerConfig
from mrnav_server.vision.vessel_model import vessel_map

P = ParamSpec("P")
T = TypeVar("T")
FRAMES = 900
PICTURE = PictureFormat()
CALIBRATION = Calibration(
    image_from_vessel=Affine2.scale(10.0 / 15.0, 200.0, 0.0),
    stage_from_vessel=Affine2.scale(10.0, 1000.0, 1000.0),
    um_per_px=10.0,
    floor_z_um=0.0,
    magnet_offset_um=(0.0, 0.0),
    critical_height_um=11_270.0,
)


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
    """Times calls, by the wall clock and by the thread's own processor time.

    Args:
        name: Prefix of its figures.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._wall_ms: list[float] = []
        self._cpu_ms: list[float] = []

    def __call__(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Return what a call returns, and note how long it took."""
        wall_s, cpu_s = time.perf_counter(), time.thread_time()
        result = function(*args, **kwargs)
        self._wall_ms.append(1e3 * (time.perf_counter() - wall_s))
        self._cpu_ms.append(1e3 * (time.thread_time() - cpu_s))
        return result

    def forget_last(self) -> None:
        """Drop the newest call from the figures."""
        del self._wall_ms[-1], self._cpu_ms[-1]

    def figures(self) -> dict[str, float]:
        """Return percentiles by name; the processor's are those of an idle machine."""
        kinds = {"": self._wall_ms, "_cpu": self._cpu_ms}
        return {
            f"{self._name}{kind}_ms_p{percent}": round(float(np.percentile(times_ms, percent)), 3)
            for kind, times_ms in kinds.items()
            for percent in (50, 99)
        }


def main() -> None:
    """Run the sequence and print the figures."""
    cv2.setNumThreads(1)
    config = TrackerConfig()
    vessel = vessel_map("y", mask())
    microscope = Microscope(MicroscopeConfig(), PICTURE, Magnets(), vessel, CALIBRATION, seed=0)
    tracker = Tracker(config, CALIBRATION)
    redetector = Redetector(RimFit(500.0 / 15.0, config.edge_strength, 0.05), config.radius_tolerance)
    rendering, tracking, redetecting = (Stopwatch(n) for n in ("render", "tracked_frame", "redetection"))
    errors_px: list[float] = []
    for number in range(FRAMES):
        robot, tip = scene(number)
        image = rendering(microscope.render, robot, tip)
        track = tracking(tracker.update, Frame(number, number / PICTURE.fps, image))
        if number % 20 == 0:
            redetecting(redetector.find, image)
        if track.state is TrackState.TRACKING and track.image is not None:
            true = CALIBRATION.image_point(robot)
            errors_px.append(float(np.hypot(track.image.x_px - true.x_px, track.image.y_px - true.y_px)))
        else:
            tracking.forget_last()
    figures = {
        "simulated": True,
        "frames": FRAMES,
        **rendering.figures(),
        **tracking.figures(),
        **redetecting.figures(),
        "rmse_px": round(float(np.sqrt(np.mean(np.square(errors_px)))), 4),
        "largest_error_px": round(max(errors_px), 3),
        "tracked_share": round(len(errors_px) / FRAMES, 3),
    }
    sys.stdout.write(json.dumps(figures) + "\n")


if __name__ == "__main__":
    main()
