"""Looks now and then whether the tip is where the calibration puts it, away from the event loop."""

import asyncio
import math
from collections.abc import Callable, Mapping

from mrnav_server.core.frames import Calibration
from mrnav_server.core.records import Frame, TipReading
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.latest import Latest
from mrnav_server.loops.scene import Scene
from mrnav_server.loops.ticks import ticks
from mrnav_server.vision.tip import TipLook
from mrnav_server.vision.tip_agreement import TipAgreement, TipSeen, TipWatchConfig

_RESTS_UM = 3.0


class TipPatrol:
    """Compares the tip in the picture with the manipulator's.

    Args:
        config: How often, and how far is too far.
        look: How the tip looks.
        vessel: The vessel model.
        calibration: Where the tip should appear.
        frames: The live picture.
        scene: Tip and robot.
        blind: Why the picture must not be relied on, or "".
        announce: Tells everybody what was noticed.
    """

    def __init__(
        self,
        config: TipWatchConfig,
        look: TipLook,
        vessel: VesselMap,
        calibration: Calibration,
        frames: Latest[Frame],
        scene: Scene,
        blind: Callable[[], str],
        announce: Callable[[str, Mapping[str, object]], None],
    ) -> None:
        self._config = config
        self._look = look
        self._radius_px = vessel.robot_radius_px
        self._calibration = calibration
        self._frames = frames
        self._scene = scene
        self._blind = blind
        self._announce = announce
        self._watch = TipAgreement(config, look, calibration)

    @property
    def seen(self) -> TipSeen:
        """What the looks so far say."""
        return self._watch.seen

    def warning(self) -> str:
        """Return that the tip is elsewhere, or ""."""
        return self.seen.warning

    def recalibrate(self, calibration: Calibration) -> None:
        """Expect the tip elsewhere from here on."""
        self._calibration = calibration
        self._watch = TipAgreement(self._config, self._look, calibration)

    async def run(self, clock: Callable[[], float]) -> None:
        """Look until cancelled."""
        version = 0
        before: TipReading | None = None
        async for _ in ticks(self._config.look_s, clock):
            frame, tip = self._frames.value, self._scene.tip
            last, before = before, tip
            if self._blind() or self._frames.version == version or frame is None or tip is None:
                continue
            version, watch, track = self._frames.version, self._watch, self._scene.track
            # Where the tip was half a second ago it also was when the picture was taken.
            resting = last is not None and (
                math.dist(last.position.array(), tip.position.array()) <= _RESTS_UM
            )
            warned = watch.seen.warning
            seen = await asyncio.to_thread(
                watch.look,
                frame.image,
                tip.position,
                track.image if track is not None else None,
                self._radius_px * self._calibration.image_from_vessel.linear_scale,
                resting=resting and not tip.moving,
            )
            if watch is self._watch and bool(seen.warning) != bool(warned):
                if seen.warning:
                    self._announce("fault", {"reason": seen.warning})
                else:
                    self._announce("recovered", {"reason": "the tip is where the calibration puts it"})
