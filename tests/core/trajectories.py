"""Trajectories whose metrics have closed forms, as a 30 fps camera sees them."""

import math
from collections.abc import Callable

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.motion import Motion, filtered, segments

Path = Callable[[FloatArray], FloatArray]


def times(end_s: float, begin_s: float = 0.0) -> FloatArray:
    """Return the frames of a 30 fps camera, both ends included."""
    return np.arange(round(begin_s * 30), round(end_s * 30) + 1) / 30.0


def motions(t_s: FloatArray, path: Path) -> list[Motion]:
    return [motion for each in segments(t_s, path(t_s)) if (motion := filtered(each)).t_s.size > 1]


def circle(radius_um: float, speed_um_per_s: float) -> Path:
    rate = speed_um_per_s / radius_um
    return lambda t: radius_um * np.column_stack([np.cos(rate * t), np.sin(rate * t)])


def line(speed_um_per_s: float) -> Path:
    return lambda t: speed_um_per_s * np.outer(t, [0.6, 0.8])


def minimum_jerk(duration_s: float, distance_um: float = 10_000.0) -> Path:
    """Return the minimum-jerk motion, its polynomial continued outside."""

    def path(t_s: FloatArray) -> FloatArray:
        u = t_s / duration_s
        return np.column_stack([distance_um * (10 * u**3 - 15 * u**4 + 6 * u**5), np.zeros_like(u)])

    return path


def logarithmic_spiral(start_um: float, growth: float, rate: float) -> Path:
    """Return r = start·exp(growth·angle), the angle at a constant rate in rad/s."""

    def path(t_s: FloatArray) -> FloatArray:
        angle = rate * t_s
        radius_um = start_um * np.exp(growth * angle)
        return np.column_stack([radius_um * np.cos(angle), radius_um * np.sin(angle)])

    return path


def archimedean_spiral(start_um: float, pitch_um: float, rate: float) -> Path:
    """Return r = start + pitch·angle, the angle at a constant rate in rad/s."""

    def path(t_s: FloatArray) -> FloatArray:
        angle = rate * t_s
        radius_um = start_um + pitch_um * angle
        return np.column_stack([radius_um * np.cos(angle), radius_um * np.sin(angle)])

    return path


def figure_of_eight(size_um: float, rate: float) -> Path:
    """Return Gerono's lemniscate, (cos φ, sin φ · cos φ), the phase at a constant rate in rad/s."""

    def path(t_s: FloatArray) -> FloatArray:
        phase = rate * t_s
        return size_um * np.column_stack([np.cos(phase), np.sin(phase) * np.cos(phase)])

    return path


def repeated_minimum_jerk(duration_s: float, distance_um: float = 10_000.0) -> Path:
    """Return one minimum-jerk motion after the other along a line, with a rest of no length between them."""

    def path(t_s: FloatArray) -> FloatArray:
        pieces, u = np.divmod(t_s / duration_s, 1.0)
        along_um = distance_um * (pieces + 10 * u**3 - 15 * u**4 + 6 * u**5)
        return np.outer(along_um, [math.cos(0.5), math.sin(0.5)])

    return path
