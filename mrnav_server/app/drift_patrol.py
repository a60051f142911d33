"""Looks now and then whether the vessel is still where it was, away from the event loop."""

import asyncio
from collections.abc import Callable, Mapping

from mrnav_server.core.frames import Calibration
from mrnav_server.core.records import Frame
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.latest import Latest
from mrnav_server.loops.ticks import ticks
from mrnav_server.vision.drift import Drift, DriftConfig, DriftWatch


class DriftPatrol:
    """Compares the walls in the picture with what they were.

    Args:
        config: How often, and how far is too far.
        vessel: The vessel model.
        calibration: Where its walls appear.
        frames: The live picture.
        blind: Why the picture must not be relied on, or "".
        announce: Tells everybody what was noticed.
    """

    def __init__(
        self,
        config: DriftConfig,
        vessel: VesselMap,
        calibration: Calibration,
        frames: Latest[Frame],
        blind: Callable[[], str],
        announce: Callable[[str, Mapping[str, object]], None],
    ) -> None:
        self._config = config
        self._vessel = vessel
        self._frames = frames
        self._blind = blind
        self._announce = announce
        self._watch = DriftWatch(config, calibration, vessel)

    @property
    def drift(self) -> Drift:
        """What the looks so far say."""
        return self._watch.drift

    def warning(self) -> str:
        """Return that something has moved, or ""."""
        return self.drift.warning

    def fault(self) -> str:
        """Return the same, when it is too far for AUTO."""
        return self.drift.warning if self.drift.holds else ""

    def recalibrate(self, calibration: Calibration) -> None:
        """Expect the walls elsewhere from here on."""
        self._watch = DriftWatch(self._config, calibration, self._vessel)

    async def run(self, clock: Callable[[], float]) -> None:
        """Look until cancelled."""
        version = 0
        async for _ in ticks(self._config.look_s, clock):
            if self._blind() or self._frames.version == version or self._frames.value is None:
                continue
            version = self._frames.version
            before, watch = self.warning(), self._watch
            seen = await asyncio.to_thread(watch.look, self._frames.value.image)
            if watch is self._watch and bool(seen.warning) != bool(before):
                if seen.warning:
                    self._announce("fault", {"reason": seen.warning})
                else:
                    self._announce("recovered", {"reason": "the vessel is where it was"})
