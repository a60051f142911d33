"""How far off a registered vessel is (simulated): ``python -m benchmarks.registration``."""

import time

import cv2
import numpy as np

from mrnav_server.sim.optics import OpticsConfig
from mrnav_server.vision.registration import RegistrationConfig, register
from tests.vision.registration_scenes import LENS, Scene, shipped

_PLACES = 8


def main() -> None:
    """Print a table: one line a vessel model."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(7)
    print("model | accepted | largest error µm | median | overlap | residual µm | s")
    for name in ("bifurcation", "network", "serpentine"):
        found, errors_um, took_s = [], [], []
        for place in range(_PLACES):
            away_um, way = 2000.0 * np.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * np.pi)
            shift_um = (float(away_um * np.cos(way)), float(away_um * np.sin(way)))
            optics = LENS if place % 2 else OpticsConfig()
            scene = Scene.of(shipped(name), shift_um, float(rng.uniform(-5.0, 5.0)), optics)
            picture, began_s = scene.picture(), time.perf_counter()
            found.append(register(picture, scene.told, scene.vessel, RegistrationConfig()))
            took_s.append(time.perf_counter() - began_s)
            errors_um.append(scene.error_um(found[-1].pose))
        overlaps, residuals = [f.overlap for f in found], [f.residual_um for f in found]
        print(
            f"{name} | {sum(f.accepted for f in found)} of {_PLACES} | {max(errors_um):.1f}"
            f" | {np.median(errors_um):.1f} | {min(overlaps):.3f} to {max(overlaps):.3f}"
            f" | {min(residuals):.1f} to {max(residuals):.1f} | {np.median(took_s):.2f}"
        )


if __name__ == "__main__":
    main()
