"""What the operator does not mean to do: tremor, sway, and the errors of the headset that tracks it."""

import math

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.sim.operator_model import OperatorModel

_TREMOR_HZ = (8.0, 12.0)
_TONES = 5


class Body:
    """Adds involuntary motion and tracking errors to the deliberate hand.

    Args:
        model: Sizes and times.
        rng: Draws all of it.
    """

    def __init__(self, model: OperatorModel, rng: np.random.Generator) -> None:
        self._model = model
        self._rng = rng
        low_hz, high_hz = _TREMOR_HZ
        # One frequency in each fifth of the band, so that no two of them beat slowly.
        shares = (np.arange(_TONES) + rng.uniform(0.25, 0.75, (3, _TONES))) / _TONES
        self._tremor_w = 2 * math.pi * (low_hz + shares * (high_hz - low_hz))
        self._tremor_phase = rng.uniform(0.0, 2 * math.pi, (3, _TONES))
        self._posture_m = model.posture_m * rng.normal(size=3)
        self._drift_m = model.drift_m * rng.normal(size=3)
        self._jitter_m = model.jitter_m * rng.normal(size=3)

    def displacement_m(self, now_s: float, dt_s: float) -> FloatArray:
        """Return what a new pose of the headset adds to the deliberate hand, shape (3,).

        Args:
            now_s: Now.
            dt_s: Since the pose before.
        """
        model = self._model
        self._posture_m = self._wander(self._posture_m, model.posture_m, model.posture_s, dt_s)
        self._drift_m = self._wander(self._drift_m, model.drift_m, model.drift_s, dt_s)
        self._jitter_m = 0.5 * self._jitter_m + math.sqrt(0.75) * model.jitter_m * self._rng.normal(size=3)
        swings = np.sin(self._tremor_w * now_s + self._tremor_phase).sum(axis=1)
        tremor_m = model.tremor_m * math.sqrt(2.0 / _TONES) * swings
        added_m: FloatArray = tremor_m + self._posture_m + self._drift_m + self._jitter_m
        return added_m

    def idle_m(self, hand_m: FloatArray, dt_s: float) -> FloatArray:
        """Return where an idle hand wanders to, shape (2,)."""
        return self._wander(hand_m, self._model.idle_m, self._model.idle_s, dt_s)

    def _wander(self, value: FloatArray, rms: float, time_s: float, dt_s: float) -> FloatArray:
        """Advance an Ornstein–Uhlenbeck process, exactly."""
        kept = math.exp(-dt_s / time_s)
        return kept * value + math.sqrt(1.0 - kept**2) * rms * self._rng.normal(size=value.shape)
