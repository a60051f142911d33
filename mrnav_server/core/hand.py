"""From the operator's fingertip to a reference for the tip: clutch, re-zero, scale, bounds, smoothing.

The hand arrives as a cumulative pose, so loss, duplication and reordering cannot drift. The server forms
the increments: P_s(t) = P_s(t−1) + τ·(P_m(t) − P_m(t−1)).
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Literal, get_args

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.hand_path import HandPath, PathBounds
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.peer_limits import Strikes
from mrnav_server.core.shaping import GENTLE, Reference
from mrnav_server.core.tremor import TremorFilter

Scale = Literal["coarse", "fine"]

OUT_OF_VIEW = "the headset does not see the hand: bring it into view, then close the clutch anew"
JUMPED = "the hand's position jumped: the jump was left out, and the hand is followed from where it is now"
JUMPS = "the hand's position keeps jumping: check the headset's view of the hand, then close the clutch anew"
_SHORTEST_S = 1e-9
_TOLD_S = 2.0
"""So long the operator reads what went wrong with the hand."""


@dataclass(frozen=True, slots=True)
class HandConfig:
    """How the hand moves the tip.

    Attributes:
        gain: τ, tip motion per hand motion, at the coarse scale, without unit (above 0, at most 1).
        fine_gain: τ at the fine scale (above 0, at most 1).
        vertical_gain: The same for the hand's up and down at the coarse scale; 0 keeps the working height.
        dead_band_um: Play of the hand before it moves anything, 0 to 500 µm of the hand.
        tremor_hz: Centre of the band, from 0.8 to 1.2 of it, that is kept from the tip, 6 to 20 Hz. The delay
            is inversely proportional to it.
        jump_m_per_s: A hand that is faster between two poses has jumped, 0.2 to 10 m/s.
        quiet_s: Silence after which the reference stands still.
        hold_s: Silence after which the hand counts as lost, 0.05 to 0.2 s.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    gain: float = 0.04
    fine_gain: float = 0.01
    vertical_gain: float = 0.0
    dead_band_um: float = 20.0
    tremor_hz: float = 10.0
    jump_m_per_s: float = 2.0
    quiet_s: float = 0.04
    hold_s: float = 0.1

    def __post_init__(self) -> None:
        for name, low, high, unit in (
            ("hold_s", 0.05, 0.2, "s"),
            ("dead_band_um", 0.0, 500.0, "µm"),
            ("tremor_hz", 6.0, 20.0, "Hz"),
            ("jump_m_per_s", 0.2, 10.0, "m/s"),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} must lie between {low:g} and {high:g} {unit}")
        for name in ("gain", "fine_gain"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie above 0 and be at most 1")


class HandControl:
    """The operator's hand as the control loop sees it.

    The clutch must be closed anew for the hand to engage: a clutch that was already closed when a mode
    began, or when the hand came into view, moves nothing.

    Args:
        config: Gains and bounds.
        speed_um_per_s: Largest speed of the reference. The bound is a speed and never a step per message:
            a headset sends 60 messages with about 30 different poses a second.
    """

    def __init__(self, config: HandConfig, speed_um_per_s: float) -> None:
        self._config = config
        self._speed_um_per_s = speed_um_per_s
        self.counters = Counter(hand_jumps=0, hand_out_of_view=0, hand_not_finite=0)
        self._scale: Scale = "coarse"
        self._received_s = -math.inf
        self._clutch = False
        self._closing = self._closing_anew = False
        self._seen_open = False
        self._engaged = False
        self._path = HandPath(PathBounds(config.dead_band_um, config.jump_m_per_s, speed_um_per_s))
        self._jumps = Strikes()
        self._jumping = False
        self._trouble = ""
        self._trouble_s = -math.inf
        self._base = StagePoint(0.0, 0.0, 0.0)
        self._smooth = TremorFilter(config.tremor_hz)
        self._smoothed_s = 0.0

    @property
    def clutch(self) -> bool:
        """Whether the operator's clutch is closed."""
        return self._clutch

    @property
    def engaged(self) -> bool:
        """Whether the hand moves the tip."""
        return self._engaged

    @property
    def scale(self) -> Scale:
        """Which scale is in force."""
        return self._scale

    @property
    def gain(self) -> float:
        """τ of the scale in force."""
        return self._config.gain if self._scale == "coarse" else self._config.fine_gain

    def choose_scale(self, scale: str) -> None:
        """Choose how far the tip goes for the hand's motion.

        Args:
            scale: "coarse" or "fine".

        Raises:
            RefusedError: For another scale, or while the clutch is closed.
        """
        if scale not in get_args(Scale):
            raise RefusedError("no_such_scale", "scale must be coarse or fine")
        if self._clutch:
            raise RefusedError(
                "clutch_closed", "the clutch is closed: open it, then choose the scale, then close it again"
            )
        self._scale = "fine" if scale == "fine" else "coarse"

    def trouble(self, now_s: float) -> str:
        """Return what is or was just wrong with the hand, in plain words, or ""."""
        return self._trouble if now_s - self._trouble_s <= _TOLD_S else ""

    def take_jumping(self) -> bool:
        """Return whether the hand has jumped three times within a second, and forget it."""
        jumping, self._jumping = self._jumping, False
        return jumping

    def fresh(self, now_s: float) -> bool:
        """Tell whether a valid sample arrived within ``hold_s``."""
        return now_s - self._received_s <= self._config.hold_s

    def take_closing(self, *, anew: bool = True) -> bool:
        """Return whether the clutch was closed since the last call, and forget it.

        Args:
            anew: Only a clutch that was seen open before counts; False also takes a hand that comes into view
                with its clutch closed.
        """
        closing = self._closing_anew if anew else self._closing
        self._closing = self._closing_anew = False
        return closing

    def on_sample(self, sample: HandSample) -> None:
        """Take one accepted hand message; one that sees no hand is silence and opens the clutch."""
        point = sample.point
        if not all(map(math.isfinite, (point.x_m, point.y_m, point.z_m, sample.sender_t_s))):
            self.counters["hand_not_finite"] += 1
            return
        if not sample.valid:
            self.counters["hand_out_of_view"] += self._clutch
            self._tell(OUT_OF_VIEW, sample.received_s)
            self._open_clutch()
            return
        # What the hand did until now happened before this message.
        self._advance(sample.received_s)
        self._smoothed_s = max(self._smoothed_s, sample.received_s)
        self._received_s = sample.received_s
        if sample.clutch:
            self._closing |= not self._clutch
            self._closing_anew |= self._seen_open
        else:
            self._open_clutch()
        self._clutch, self._seen_open = sample.clutch, not sample.clutch
        if sample.new_pose:
            self._on_pose(sample)

    def engage(self, base: StagePoint, now_s: float) -> None:
        """Start following from ``base``: the hand's pose of this moment becomes zero."""
        self._engaged = True
        self._base = base
        self._path.zero()
        self._smooth = TremorFilter(self._config.tremor_hz)
        self._smoothed_s = now_s

    def release(self) -> None:
        """Stop following; the clutch must be closed anew."""
        self._engaged = False

    def lose(self) -> None:
        """Forget the hand: its link ended or its lease was lost."""
        self._open_clutch()
        self._seen_open = False
        self._received_s = -math.inf
        self._path.forget()

    def reference(self, now_s: float) -> Reference | None:
        """Return where the hand wants the tip; None while it does not move it."""
        if not self._engaged:
            return None
        self._advance(now_s)
        base, offset = self._base, self._smooth.position_um
        quiet = now_s - self._received_s > self._config.quiet_s
        return Reference(
            StagePoint(base.x_um + offset[0], base.y_um + offset[1], base.z_um + offset[2]),
            (0.0, 0.0, 0.0) if quiet else self._smooth.velocity_um_per_s,
            self._speed_um_per_s,
            GENTLE,
        )

    def _open_clutch(self) -> None:
        self._clutch = self._closing = self._closing_anew = self._engaged = False

    def _on_pose(self, sample: HandSample) -> None:
        pose = (sample.point, sample.sender_t_s, sample.received_s)
        if not self._engaged:
            self._path.note(*pose)
            return
        vertical = self._config.vertical_gain * self.gain / self._config.gain
        if not self._path.follow(*pose, (self.gain, vertical, self.gain)):
            return
        self.counters["hand_jumps"] += 1
        self._jumping = self._jumps.strike(sample.received_s)
        self._tell(JUMPS if self._jumping else JUMPED, sample.received_s)
        if self._jumping:
            self._engaged = False

    def _tell(self, words: str, now_s: float) -> None:
        self._trouble, self._trouble_s = words, now_s

    def _advance(self, now_s: float) -> None:
        """Smooth up to a moment, or up to where a silent hand was last believed to move."""
        until_s = min(now_s, self._received_s + self._config.quiet_s)
        while self._engaged and until_s - self._smoothed_s > _SHORTEST_S:
            # The goal's course has a bend where it arrives at the newest pose.
            step_s = min(until_s - self._smoothed_s, self._path.sliding_s or math.inf)
            self._smooth.advance(self._path.slide(step_s), step_s)
            self._smoothed_s += step_s
