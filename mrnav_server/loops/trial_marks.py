"""The running trial: its record and its marks (go cue, target reached), and its result when it ends."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mrnav_server.core.contacts import ContactCounter
from mrnav_server.core.modes import Mode
from mrnav_server.core.records import Track
from mrnav_server.core.vessel import VesselMap

Announce = Callable[[str, Mapping[str, object]], None]


@dataclass(frozen=True, slots=True)
class TrialConfig:
    """When a trial's target counts as reached.

    Attributes:
        target_um: The robot's centre is this near to the area's centre ...
        dwell_s: ... for this long.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    target_um: float = 150.0
    dwell_s: float = 0.5


class TrialMarks:
    """Watches one trial, or the rig between trials, for what must be marked.

    Args:
        config: When the target counts as reached.
        vessel: For the gap to the wall.
        announce: Called with an event's name and its fields.
    """

    def __init__(self, config: TrialConfig, vessel: VesselMap, announce: Announce) -> None:
        self._config = config
        self._vessel = vessel
        self._announce = announce
        self.restart()

    @property
    def collisions(self) -> int:
        """Wall contacts since the last restart."""
        return self._contacts.count

    @property
    def collisions_in_auto(self) -> int:
        """Those of them that began in AUTO."""
        return self._contacts_in_auto

    @property
    def go_s(self) -> float | None:
        """When the rig was first told to move; None before."""
        return self._go_s

    @property
    def reached_s(self) -> float | None:
        """When the robot entered the target and stayed; None before."""
        return self._reached_s

    def restart(self) -> None:
        """Begin anew: a trial starts, or the rig is armed outside of one."""
        self._contacts = ContactCounter()
        self._contacts_in_auto = 0
        self._go_s: float | None = None
        self._entered_s: float | None = None
        self._reached_s: float | None = None

    def on_motion(self, now_s: float) -> None:
        """Mark the go cue: the first moment at which the rig was told to move."""
        if self._go_s is None:
            self._go_s = now_s
            self._announce("trial", {"mark": "go", "t_s": now_s})

    def on_track(self, track: Track, mode: Mode, distance_um: float | None) -> None:
        """Count contacts and watch the target.

        Args:
            track: The newest track.
            mode: The mode in force.
            distance_um: Robot to the active area's centre; None if either is unknown.
        """
        clearance_um = None if track.vessel is None else self._vessel.clearance_um(track.vessel)
        if self._contacts.step(clearance_um, track.taken_s):
            self._contacts_in_auto += mode is Mode.AUTO
            self._announce("contact", {"mode": mode.value, "count": self.collisions})
        if track.vessel is None or distance_um is None:
            return
        if distance_um > self._config.target_um:
            self._entered_s = None
        elif self._entered_s is None:
            self._entered_s = track.taken_s
        elif (
            self._go_s is not None
            and self._reached_s is None
            and track.taken_s - self._entered_s >= self._config.dwell_s
        ):
            self._reached_s = self._entered_s
            self._announce("trial", {"mark": "reached", "t_s": self._entered_s})

    def summary(self) -> dict[str, Any]:
        """Return the marks for the end of a trial's record."""
        return {
            "collisions": self.collisions,
            "collisions_in_auto": self.collisions_in_auto,
            "reached_s": self._reached_s,
        }
