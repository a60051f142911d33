"""Is the camera well? Frozen, black, late, slow and missing pictures, each named in a sentence.

Everything is judged by capture time, on the clock that the caller tells.
"""

from collections import deque

import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.records import Frame

_SHARE = 0.02
"""Hot pixels, and the glint of a lamp through a cover, are fewer than this share of a picture."""
_WHITE = 253
_SLOW = 1.5
"""A camera is slow when its period is longer than the nominal one by this factor."""
_OVERDUE = 1.2
"""After a frame that was overdue or lost the next one is overdue when so many nominal periods have passed."""
_TWICE = 2
"""Long periods in a row that make a camera slow, or empty ones its clock wrong; a single one is a mishap."""
_STEADY = 5
"""Frames in a row that must agree before a camera is late, and before it is no longer late or slow."""
_WINDOW = 30
_FEW_MISSING = 3
"""So many frames missing within the window are named."""


class PictureWatch:
    """Tells pictures that cannot be true from those that may be.

    Args:
        darkest_gray: A picture with hardly a pixel this bright is black, 0..255; 0 allows black pictures.
        may_repeat: Whether two true pictures may be the same, as in a film: compression repeats what rests.
    """

    def __init__(self, darkest_gray: float, *, may_repeat: bool = False) -> None:
        self._darkest_gray = darkest_gray
        self._may_repeat = may_repeat
        self._before: bytes | None = None

    def fault(self, image: ByteArray) -> str:
        """Return why a picture must not be believed, or ""; to be shown every picture once, in order.

        Args:
            image: Shape (height, width, 3), BGR, uint8. A sparse sample of it is looked at.
        """
        sample = image[7::101, 3::7, 1].copy()
        content = sample.tobytes()
        before, self._before = self._before, content
        if int(np.count_nonzero(sample >= self._darkest_gray)) < _SHARE * sample.size:
            return "the picture is black: switch the lamp on or uncover the lens"
        if int(np.count_nonzero(sample < _WHITE)) < _SHARE * sample.size:
            return "the picture is white: lower the light or the exposure"
        if content == before and not self._may_repeat:
            # Noise alone makes two true pictures differ.
            return "the picture is frozen: it repeats the one before, restart the camera"
        return ""


class FrameWatch:
    """Watches a camera's frames.

    A fault of the content is named at once, since no position can come of it. A fault of the timing is named
    when it repeats, and until it has been gone for a while; single lost frames are the tracker's to bridge.

    Args:
        fps: Frames a second that the camera promises.
        darkest_gray: As in ``PictureWatch``.
        stale_s: Oldest age of a frame on arrival, by its capture time.
        may_repeat: As in ``PictureWatch``.
    """

    def __init__(
        self, fps: float, darkest_gray: float = 12.0, stale_s: float = 0.1, *, may_repeat: bool = False
    ) -> None:
        self.missing = 0
        """Frames that never arrived, by their numbers."""
        self._period_s = 1.0 / fps
        self._stale_s = stale_s
        self._picture = PictureWatch(darkest_gray, may_repeat=may_repeat)
        self._last: tuple[int, float] | None = None
        self._slow, self._late = _Steady(_TWICE, _STEADY), _Steady(_STEADY, _STEADY)
        self._stands_still = _Steady(_TWICE, 1)
        self._arrived: tuple[float, bool] | None = None
        self._gaps: deque[int] = deque(maxlen=_WINDOW)
        self._has_gaps = False
        self._kind, self._sentence = "", ""

    def look(self, frame: Frame, now_s: float) -> str:
        """Return what is wrong with the camera, or "".

        The sentence stays word for word the same while the same fault lasts.

        Args:
            frame: The newest frame; frames come in the order of arrival.
            now_s: When it arrived, on the clock of its capture time.
        """
        kind, sentence = self._fault(frame, now_s)
        if kind != self._kind:
            self._kind, self._sentence = kind, sentence
        return self._sentence

    def overdue(self, now_s: float) -> str:
        """Return that the camera is slow before its next frame could say so, or "".

        May be asked from another thread than the one that looks.

        Args:
            now_s: Now, on the clock of the arrivals.
        """
        if self._arrived is None:
            return ""
        arrived_s, was_overdue = self._arrived
        if not was_overdue or now_s - arrived_s <= _OVERDUE * self._period_s:
            return ""
        return "the camera is slow: two of its frames in a row are overdue"

    def _fault(self, frame: Frame, now_s: float) -> tuple[str, str]:
        content = self._picture.fault(frame.image)
        age_s = now_s - frame.taken_s
        late = self._late(age_s > self._stale_s)
        period_s = self._note(frame)
        long = period_s > _SLOW * self._period_s
        slow = self._slow(long)
        stands_still = self._stands_still(period_s <= 0.0)
        lost_now = bool(self._gaps) and self._gaps[-1] > 0
        self._arrived = (now_s, long or lost_now)
        lost = sum(self._gaps)
        self._has_gaps = lost >= _FEW_MISSING or (self._has_gaps and lost > 0)
        if content:
            return content, content
        if stands_still:
            return "clock", "the camera's capture times do not rise: check its clock"
        if late:
            return "late", f"the camera is late: its frames arrive {1e3 * age_s:.0f} ms after they were taken"
        if slow:
            return (
                "slow",
                f"the camera is slow: a frame every {1e3 * period_s:.0f} ms instead of"
                f" {1e3 * self._period_s:.0f} ms",
            )
        if self._has_gaps:
            return "missing", f"frames are missing: {lost} of the last {lost + len(self._gaps)}"
        return "", ""

    def _note(self, frame: Frame) -> float:
        """Count missing frames; return the time between the last two captures, missing ones included."""
        last, self._last = self._last, (frame.number, frame.taken_s)
        if last is None or frame.number <= last[0]:
            # A camera that was opened anew counts from 0.
            self._gaps.clear()
            return self._period_s
        gap = frame.number - last[0] - 1
        self.missing += gap
        self._gaps.append(gap)
        return frame.taken_s - last[1]


class _Steady:
    """A condition that sets in, and ends, only when it has lasted for some frames."""

    def __init__(self, begins: int, ends: int) -> None:
        self._needed = {False: begins, True: ends}
        self._holds = False
        self._against = 0

    def __call__(self, now: bool) -> bool:
        self._against = 0 if now is self._holds else self._against + 1
        if self._against >= self._needed[self._holds]:
            self._holds, self._against = now, 0
        return self._holds
