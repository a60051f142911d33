"""What hand control does to tremor, and how late it is: ``python -m benchmarks.hand``.

Deterministic and computed alone, without devices: hand samples through HandControl and the shaper. The hand
sends 60 messages a second with 30 different poses, as a headset does; ``shaper`` figures are those of the
setpoint, stepped every 10 ms and at every message. Delays are counted from the messages; ``poses`` says
what the 30 poses a second themselves cost on top (half a pose's interval).
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mrnav_server.core.frames import HandPoint, StagePoint
from mrnav_server.core.hand import HandConfig, HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.limits import Limits
from mrnav_server.core.shaping import Shaper

Floats = npt.NDArray[np.float64]
_SETTLED_S = 2.0
_MIDDLE = StagePoint(10_000.0, 10_000.0, 12_000.0)


@dataclass(frozen=True, slots=True)
class Ride:
    """One run after it has settled; all arrays alike, offsets along stage x in µm at the tip's scale.

    Attributes:
        t_s: Time.
        hand_um: The hand as it really moved.
        message_um: The hand as the newest message had it.
        reference_um: What hand control asked for.
        setpoint_um: What the shaper made of it.
    """

    t_s: Floats
    hand_um: Floats
    message_um: Floats
    reference_um: Floats
    setpoint_um: Floats


def ride(hand_m: Callable[[float], float], config: HandConfig, duration_s: float) -> Ride:
    """Drive hand control and shaper with a hand that moves to the right by ``hand_m(t)``."""
    hand, shaper = HandControl(config, Limits().speed_um_per_s), Shaper(Limits())
    shaper.reset(_MIDDLE)
    rows: list[tuple[float, float, float, float, float]] = []
    pose_m, before_s, message = 0.0, 0.0, 0
    for k in range(int(duration_s * 600)):
        t_s = k / 600
        # Messages at 60 Hz, every other one with a new pose; ticks at 100 Hz.
        if k % 10 == 0:
            new = message % 2 == 0
            pose_m = hand_m(t_s) if new else pose_m
            point = HandPoint(pose_m, 0.0, 0.0)
            hand.on_sample(
                HandSample("b", message, t_s, t_s, point, clutch=message > 1, valid=True, new_pose=new)
            )
            if message == 2:
                hand.engage(_MIDDLE, t_s)
                zero_m = pose_m
            message += 1
        if message <= 2 or (k % 10 and k % 6):
            continue
        reference = hand.reference(t_s)
        if reference is None:
            raise RuntimeError("hand control let go")
        # The setpoint of this moment: the reference of the step before, carried on.
        setpoint = shaper.step(t_s - before_s if before_s else 0.0, reference)
        before_s = t_s
        if t_s >= _SETTLED_S and k % 6 == 0:
            to_um = 1e6 * config.gain
            rows.append(
                (
                    t_s,
                    to_um * (hand_m(t_s) - zero_m),
                    to_um * (pose_m - zero_m),
                    reference.position.x_um - _MIDDLE.x_um,
                    setpoint.x_um - _MIDDLE.x_um,
                )
            )
    return Ride(*np.array(rows).T)


def gain_db(of: Floats, t_s: Floats, frequency_hz: float, amplitude_um: float) -> float:
    """Return how strong a frequency is in a signal, in dB of an amplitude."""
    angle = 2.0 * math.pi * frequency_hz * t_s
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(t_s), t_s], axis=1)
    sine, cosine = np.linalg.lstsq(basis, of, rcond=None)[0][:2]
    return 20.0 * math.log10(max(math.hypot(sine, cosine), 1e-9) / amplitude_um)


def tremor_db(frequency_hz: float, amplitude_m: float, config: HandConfig) -> tuple[float, float]:
    """Return what is left of a tremor on top of a slow motion: in the reference, and in the setpoint."""
    # An odd fraction keeps the sine from meeting the 30 poses a second always at the same angles.
    hz = frequency_hz + 0.013

    def moving(t_s: float) -> float:
        return 0.02 * t_s + amplitude_m * math.sin(2.0 * math.pi * hz * t_s)

    run = ride(moving, config, 8.0)
    amplitude_um = 1e6 * config.gain * amplitude_m
    return (
        gain_db(run.reference_um, run.t_s, hz, amplitude_um),
        gain_db(run.setpoint_um, run.t_s, hz, amplitude_um),
    )


def delays_ms(hand_um_per_s: float, config: HandConfig) -> tuple[float, float, float]:
    """Return how late a slow ramp is, ms: filter, filter and shaper, and what the poses cost on top."""
    run = ride(lambda t_s: 1e-6 * hand_um_per_s * t_s, config, 6.0)
    tip_um_per_s = config.gain * hand_um_per_s

    def late_ms(signal: Floats, behind: Floats) -> float:
        return 1e3 * float(np.mean(behind - signal)) / tip_um_per_s

    return (
        late_ms(run.reference_um, run.message_um),
        late_ms(run.setpoint_um, run.message_um),
        late_ms(run.message_um, run.hand_um),
    )


def swing_delay_ms(frequency_hz: float, config: HandConfig) -> float:
    """Return how late the setpoint is behind the message in a slow swing of 1 cm, ms."""
    run = ride(lambda t_s: 0.01 * math.sin(2.0 * math.pi * frequency_hz * t_s), config, 10.0)

    def phase(signal: Floats) -> float:
        angle = 2.0 * math.pi * frequency_hz * run.t_s
        basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
        sine, cosine = np.linalg.lstsq(basis, signal, rcond=None)[0][:2]
        return math.atan2(cosine, sine)

    return 1e3 * (phase(run.message_um) - phase(run.setpoint_um)) / (2.0 * math.pi * frequency_hz)


def main() -> None:
    """Print the figures for people, then as one line of JSON."""
    config = HandConfig()
    result: dict[str, float] = {}
    print("at 20 mm/s | 0.1 mm: reference dB | setpoint dB | 0.5 mm: reference dB | setpoint dB")
    for hz in (8, 9, 10, 11, 12):
        small, large = tremor_db(hz, 1e-4, config), tremor_db(hz, 5e-4, config)
        print(f"{hz} Hz | {small[0]:.1f} | {small[1]:.1f} | {large[0]:.1f} | {large[1]:.1f}")
        for name, pair in (("0.1mm", small), ("0.5mm", large)):
            result[f"reference_{hz}hz_{name}_db"] = round(pair[0], 1)
            result[f"setpoint_{hz}hz_{name}_db"] = round(pair[1], 1)
    for mm_per_s in (5, 20, 60):
        filtered, total, poses = delays_ms(1000.0 * mm_per_s, config)
        print(f"{mm_per_s} mm/s: filter {filtered:.1f} ms, with shaper {total:.1f} ms, poses {poses:.1f} ms")
        result |= {
            f"filter_{mm_per_s}mm_per_s_ms": round(filtered, 1),
            f"filter_and_shaper_{mm_per_s}mm_per_s_ms": round(total, 1),
            "poses_ms": round(poses, 1),
        }
    for hz_ in (0.3, 0.5, 1.0):
        result[f"swing_{hz_:g}hz_filter_and_shaper_ms"] = round(swing_delay_ms(hz_, config), 1)
        print(f"swing of 1 cm at {hz_:g} Hz: {result[f'swing_{hz_:g}hz_filter_and_shaper_ms']} ms")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
