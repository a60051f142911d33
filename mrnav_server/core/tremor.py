"""The low-pass that keeps a hand's tremor (8 to 12 Hz) from the tip, for little delay.

One pair of zeros in the tremor's band and two pairs of poles. A plain low-pass that is 10 dB down at 8 Hz
costs more than the 40 ms that an operator may be kept waiting: by Bode's relation the delay of a filter is
(2/π)∫ln(1/|H|)/ω² dω, so attenuation is cheapest where it is needed, and nowhere below.
"""

import cmath
import math

import numpy as np

_CENTRE_HZ = 10.0
_ZERO_HZ, _ZERO_DAMPING = 9.355, 0.12
_POLES = ((7.228, 0.973), (45.0, 0.6805))
"""Frequency in Hz and quality of each pair, found numerically for the least delay."""


class TremorFilter:
    """A fourth-order low-pass on three axes, stepped exactly over any span of time.

    It is kept as the sum of its modes, H(s) = Σ rᵢ/(s - pᵢ), each of which is solved in closed form: messages
    come when they come, and no sampling rate is assumed.

    Args:
        tremor_hz: Centre of the suppressed band, which reaches from 0.8 to 1.2 of it.
    """

    def __init__(self, tremor_hz: float = _CENTRE_HZ) -> None:
        poles, residues = _modes(tremor_hz)
        self._poles, self._residues = poles, residues
        self._states = [[0j] * len(poles) for _ in range(3)]
        self._goal_um = (0.0, 0.0, 0.0)

    @property
    def position_um(self) -> tuple[float, float, float]:
        """The smoothed position."""
        x, y, z = (
            2.0 * sum((r * m).real for r, m in zip(self._residues, axis, strict=True))
            for axis in self._states
        )
        return (x, y, z)

    @property
    def velocity_um_per_s(self) -> tuple[float, float, float]:
        """Its rate of change; a jump of the goal shows in it only with time, since Σ rᵢ = 0."""
        x, y, z = (
            2.0
            * sum(
                (r * (p * m + goal)).real for r, p, m in zip(self._residues, self._poles, axis, strict=True)
            )
            for axis, goal in zip(self._states, self._goal_um, strict=True)
        )
        return (x, y, z)

    def advance(self, goal_um: tuple[float, float, float], dt_s: float) -> None:
        """Let time pass in which the goal moves evenly from where it was to a new place.

        Args:
            goal_um: Where the unsmoothed hand is in the end.
            dt_s: How long, above 0.
        """
        before_um, self._goal_um = self._goal_um, goal_um
        for k, pole in enumerate(self._poles):
            decay = cmath.exp(pole * dt_s)
            held = (decay - 1.0) / pole
            moved = (held / dt_s - 1.0) / pole
            for axis, before, goal in zip(self._states, before_um, goal_um, strict=True):
                axis[k] = decay * axis[k] + held * before + moved * (goal - before)


def response(tremor_hz: float, frequency_hz: float) -> complex:
    """Return the filter's gain at a frequency; its angle is the phase."""
    s = 2j * math.pi * frequency_hz
    poles, residues = _modes(tremor_hz)
    return complex(
        sum(r / (s - p) + r.conjugate() / (s - p.conjugate()) for p, r in zip(poles, residues, strict=True))
    )


def _modes(tremor_hz: float) -> tuple[list[complex], list[complex]]:
    """Return one pole of each pair and its residue; the gain at rest is 1."""
    stretch = 2.0 * math.pi * tremor_hz / _CENTRE_HZ
    zero = stretch * _ZERO_HZ
    numerator = np.array([1.0, 2.0 * _ZERO_DAMPING * zero, zero**2]) / zero**2
    denominator = np.array([1.0])
    poles = []
    for hz, quality in _POLES:
        w = stretch * hz
        poles.append(w * complex(-0.5 / quality, math.sqrt(1.0 - 0.25 / quality**2)))
        numerator = numerator * w**2
        denominator = np.polymul(denominator, [1.0, w / quality, w**2])
    slope = np.polyder(denominator)
    residues = [complex(np.polyval(numerator, p) / np.polyval(slope, p)) for p in poles]
    return poles, residues
