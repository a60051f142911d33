"""What the running trial's metrics are computed from, kept as the log keeps it (docs/metrics.md)."""

import math
from collections.abc import Callable

import numpy as np

from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.metrics import Trial, trial_metrics
from mrnav_server.core.records import Track

Clearance = Callable[[VesselPoint], float]


class LiveTrial:
    """Collects a trial's tracks, so that its metrics can be had while it runs.

    Args:
        um_per_px: Size of a vessel grid pixel in µm.
        clearance_um: Gap between rim and wall at a place of the vessel.
    """

    def __init__(self, um_per_px: float, clearance_um: Clearance) -> None:
        self._um_per_px = um_per_px
        self._clearance_um = clearance_um
        self._running = False
        self._rows: list[tuple[float, float, float, float, float]] = []

    def prepare(self) -> None:
        """Run the filters once: what they import would stall a control tick later."""
        t_s = np.arange(60) / 30.0
        still_um = np.zeros((60, 2))
        trial_metrics(Trial(t_s, still_um, t_s, go_s=0.0, end_s=2.0, reached=True))

    def begin(self) -> None:
        """A trial begins."""
        self._running = True
        self._rows = []

    def end(self) -> None:
        """The trial is over; its log is the truth from here on."""
        self._running = False
        self._rows = []

    def on_track(self, track: Track) -> None:
        """Keep a track, if a trial runs."""
        if not self._running:
            return
        x_px = y_px = clearance_um = math.nan
        if track.vessel is not None:
            x_px, y_px = track.vessel.x_px, track.vessel.y_px
            clearance_um = self._clearance_um(track.vessel)
        self._rows.append((track.taken_s, x_px, y_px, clearance_um, track.sigma_um))

    def trial(self, go_s: float | None, reached_s: float | None) -> Trial | None:
        """Return the trial as if it ended with the newest track; None before the first one.

        Args:
            go_s: The go cue; None before it.
            reached_s: When the target was reached; None before.
        """
        if not self._rows:
            return None
        t_s, x_px, y_px, clearance_um, sigma_um = np.array(self._rows).T
        known_um = sigma_um[np.isfinite(sigma_um)]
        return Trial(
            t_s=t_s,
            xy_um=np.column_stack([x_px, y_px]) * self._um_per_px,
            clearance_um=clearance_um,
            go_s=float(t_s[0]) if go_s is None else go_s,
            end_s=float(t_s[-1]) if reached_s is None else reached_s,
            reached=reached_s is not None,
            sigma_um=float(np.median(known_um)) if known_um.size else math.nan,
        )
