"""What a simulated operator is like: one set of numbers with their sources, and how operators differ.

It exercises the software and predicts directions; it is no evidence about people.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

POSES_HZ = 30
"""Different poses a second that the headset tracks."""
MESSAGES_HZ = 60
"""Hand messages a second that it sends."""
_PERSONAL = 2026


@dataclass(frozen=True, slots=True)
class OperatorModel:
    """The average simulated operator; ``personal`` gives one of many.

    "Assumed" and "tuned" say that no measurement stands behind a number.

    Attributes:
        gain: τ that the operator reckons with, tip motion per hand motion.
        visual_delay_s: From the picture to the percept (Saunders & Knill 2005).
        system_delay_s: Delay of display and robot that the operator has got used to (assumed).
        vision_um: Standard deviation of a perceived place per axis (assumed).
        prediction: κ, the share of the hand's motion of the last delay that the operator adds to the
            percept (a partial forward model; assumed).
        steering_s: b of the local steering law v = 2·clearance/b (form: Accot & Zhai 1997; tuned).
        practice_exponent: b falls with ((5 + trials)/5) to minus this (power law of practice; assumed).
        preview_um: The narrowest place within this length ahead sets the speed (assumed).
        careful_share: Share of that speed within ``careful_um`` of the target (tuned).
        careful_um: Length of the last, careful part of the way.
        cautious_share: Share of that speed while further off the middle than 0.6 of the clearance (tuned).
        homing_s: Near the target the speed is at most distance / this, plus 100 µm/s (tuned).
        slowest_um_per_s: Nobody means to go slower than this while on the way (assumed).
        fastest_hand_m_per_s: Fastest deliberate motion of the hand (assumed).
        crossover_per_s: ω_c of the sideways correction (McRuer & Krendel 1974).
        dead_zone: Share of the clearance within which nothing is corrected sideways (assumed).
        interval_s: Mean time between two intended movements (van de Kamp et al. 2013).
        interval_spread: Their standard deviation, as a share.
        blend_s: Minimum-jerk blend from one movement into the next (Miall et al. 1993).
        speed_noise: Standard deviation of a movement's speed, as a share (form: Harris & Wolpert 1998; size
            assumed).
        direction_noise_rad: The same of its direction.
        tremor_m: RMS of the finger's physiological tremor per axis, 8 to 12 Hz (Growdon et al. 2000).
        posture_m: RMS of the arm's slow sway per axis (assumed).
        posture_s: Its correlation time.
        jitter_m: RMS of the headset's error from pose to pose per axis (tuned within published errors).
        drift_m: RMS of the headset's slow error per axis (tuned within published errors).
        drift_s: Its correlation time.
        idle_m: RMS of the hand's wandering per axis while the clutch is open (assumed).
        idle_s: Its correlation time.
        reach_m: Hand's distance from where it gripped at which the operator grips anew (assumed).
        regrip_s: Duration of the way back.
        reaction_s: From the perceived cue to reaching out (optimistic: distracted drivers take over after a
            median of 4.56 s; Eriksson & Stanton 2017).
        grip_s: Closing or opening the clutch.
        patience_s: Ready before the announced hand-over, the operator closes the clutch so long after the
            countdown ran out (assumed).
        start_s: From the perceived go to closing the clutch, without a hand-over (assumed).
        content_um: Robot's distance to the target that the operator is content with.
        content_s: How long it must hold.
    """

    gain: float = 0.04
    visual_delay_s: float = 0.18
    system_delay_s: float = 0.19
    vision_um: float = 30.0
    prediction: float = 0.8
    steering_s: float = 0.225
    practice_exponent: float = 0.10
    preview_um: float = 1200.0
    careful_share: float = 0.6
    careful_um: float = 2500.0
    cautious_share: float = 0.6
    homing_s: float = 0.8
    slowest_um_per_s: float = 300.0
    fastest_hand_m_per_s: float = 0.25
    crossover_per_s: float = 2.0
    dead_zone: float = 0.15
    interval_s: float = 0.35
    interval_spread: float = 0.2
    blend_s: float = 0.30
    speed_noise: float = 0.15
    direction_noise_rad: float = 0.055
    tremor_m: float = 1.0e-4
    posture_m: float = 5.0e-4
    posture_s: float = 0.7
    jitter_m: float = 5.0e-4
    drift_m: float = 1.8e-3
    drift_s: float = 2.0
    idle_m: float = 0.025
    idle_s: float = 2.0
    reach_m: float = 0.15
    regrip_s: float = 0.8
    reaction_s: float = 0.6
    grip_s: float = 0.2
    patience_s: float = 0.15
    start_s: float = 0.35
    content_um: float = 120.0
    content_s: float = 0.3


def personal(model: OperatorModel, seed: int) -> OperatorModel:
    """Return one operator: the model with the random effects of a person (sizes assumed).

    Times, gains and noises are lognormal about the model's, with these coefficients of variation: steering
    20 %, crossover 12 %, interval 12 %, carefulness 12 %, noises 20 to 40 %, reaction 25 %. The visual delay
    is 0.18 ± 0.02 s, the forward model's share 0.8 ± 0.12, both kept within what is human.
    """
    rng = np.random.default_rng([_PERSONAL, seed])

    def about(value: float, variation: float) -> float:
        return value * math.exp(rng.normal(0.0, variation) - variation**2 / 2)

    return replace(
        model,
        steering_s=about(model.steering_s, 0.20),
        visual_delay_s=float(np.clip(rng.normal(model.visual_delay_s, 0.02), 0.14, 0.25)),
        crossover_per_s=about(model.crossover_per_s, 0.12),
        prediction=float(np.clip(rng.normal(model.prediction, 0.12), 0.3, 1.0)),
        interval_s=about(model.interval_s, 0.12),
        speed_noise=about(model.speed_noise, 0.20),
        direction_noise_rad=about(model.direction_noise_rad, 0.20),
        jitter_m=about(model.jitter_m, 0.30),
        drift_m=about(model.drift_m, 0.30),
        posture_m=about(model.posture_m, 0.30),
        tremor_m=about(model.tremor_m, 0.40),
        reaction_s=about(model.reaction_s, 0.25),
        careful_share=float(np.clip(about(model.careful_share, 0.12), 0.35, 0.9)),
    )


def practised(model: OperatorModel, trials: int) -> OperatorModel:
    """Return the operator after so many trials: b·((5 + n)/5)^−0.10."""
    return replace(model, steering_s=model.steering_s * ((5 + trials) / 5) ** -model.practice_exponent)


def steady(model: OperatorModel) -> OperatorModel:
    """Return the operator with a hand that does only what it is meant to, and a headset without errors."""
    return replace(
        model,
        vision_um=0.0,
        speed_noise=0.0,
        direction_noise_rad=0.0,
        interval_spread=0.0,
        tremor_m=0.0,
        posture_m=0.0,
        jitter_m=0.0,
        drift_m=0.0,
        idle_m=0.0,
    )
