"""Registers the vessel for clients: by itself from the live picture, or by hand."""

import asyncio
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mrnav_server.app.registration_record import (
    RegistrationRecord,
    digest_of,
    load_registration,
    save_registration,
)
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.frames import Calibration
from mrnav_server.core.records import Frame
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_twin import calibration_fields
from mrnav_server.loops.latest import Latest
from mrnav_server.vision.calibration_parts import VesselPose
from mrnav_server.vision.registration import (
    RegistrationConfig,
    judge,
    outline_px,
    register,
    registered,
    still,
)

_FRAMES = 10
_FRAME_S = 2.0
"""Without a picture for this long there is none."""


class RegistrationDesk:
    """Finds where the vessel lies, and makes the rig go by it.

    Args:
        config: Reach and thresholds.
        root: Folder that keeps the registration.
        vessel: The vessel model.
        base: The calibration without a registration.
        belongs_to: What else a registration depends on: the rig.
        frames: The live picture.
        check: Raises RefusedError while a session must not register.
        use: Makes the rig go by a calibration.
        announce: Tells everybody what happened, and records it.
    """

    def __init__(
        self,
        config: RegistrationConfig,
        root: Path,
        vessel: VesselMap,
        base: Calibration,
        belongs_to: object,
        frames: Latest[Frame],
        check: Callable[[str], None],
        use: Callable[[Calibration], None],
        announce: Callable[[str, Mapping[str, object]], None],
    ) -> None:
        self._config = config
        self._root = root
        self._vessel = vessel
        self._base = base
        self._belongs_to = belongs_to
        self._made_for = digest_of(base, vessel.digest, belongs_to)
        self._frames = frames
        self._check = check
        self._use = use
        self._announce = announce
        self._busy = False
        self._calibration = base
        self._record: RegistrationRecord | None = None

    def rebase(self, base: Calibration) -> None:
        """Take another calibration as the one without a registration; the present registration is void."""
        self._base = self._calibration = base
        self._made_for = digest_of(base, self._vessel.digest, self._belongs_to)
        self._record = None

    def restore(self) -> str:
        """Go by the registration that was kept; return why there is none although one was kept, or ""."""
        try:
            record = load_registration(self._root, self._made_for)
        except ConfigError as error:
            return str(error)
        if record is not None:
            self._go_by(record)
        return ""

    def state(self) -> dict[str, Any]:
        """Describe the registration that the rig goes by, and where the model's walls appear."""
        record = self._record
        pose = record.pose if record else VesselPose()
        return {
            "registered": record is not None,
            "by": record.by if record else None,
            "pose": _pose_fields(pose),
            "overlap": record.overlap if record else None,
            "overlap_by": record.overlap_by if record else None,
            "residual_um": record.residual_um if record else None,
            "outline_px": [line.round(1).tolist() for line in outline_px(self._calibration, self._vessel)],
        }

    async def find(self, session: str) -> dict[str, Any]:
        """Register the vessel from the live picture; a pose that is refused changes nothing.

        Raises:
            RefusedError: While the session must not, or without pictures.
        """
        with self._alone(session):
            picture = await self._picture(_FRAMES)
            found = await asyncio.to_thread(register, picture, self._base, self._vessel, self._config)
        self._check(session)
        if found.accepted:
            self._accept(
                RegistrationRecord(
                    made_for=self._made_for,
                    pose=found.pose,
                    by="auto",
                    overlap=round(found.overlap, 4),
                    overlap_by=found.overlap_by,
                    residual_um=round(found.residual_um, 2),
                )
            )
        return self.state() | {
            "accepted": found.accepted,
            "reason": found.reason,
            "found": _pose_fields(found.pose),
            "overlap": round(found.overlap, 4),
            "overlap_by": found.overlap_by,
            "residual_um": round(found.residual_um, 2),
            "sigma_um": round(found.sigma_um, 2) if math.isfinite(found.sigma_um) else None,
            "wall_share": round(found.wall_share, 4),
        }

    async def adjust(self, session: str, dx_um: float, dy_um: float, turn_deg: float) -> dict[str, Any]:
        """Move the model on the picture by hand, along the base calibration's x and y, and turn it.

        Raises:
            RefusedError: While the session must not, without pictures, or out of reach.
        """
        self._check(session)
        before = self._record.pose if self._record else VesselPose()
        pose = VesselPose(
            x_um=before.x_um + dx_um, y_um=before.y_um + dy_um, angle_deg=before.angle_deg + turn_deg
        )
        reach_um, most_deg = self._config.reach_um, self._config.turn_deg
        if max(abs(pose.x_um), abs(pose.y_um)) > reach_um or abs(pose.angle_deg) > most_deg:
            raise RefusedError(
                "out_of_reach",
                f"the vessel may lie within {reach_um:g} µm and {most_deg:g}° of where the calibration has"
                " it: move the vessel",
            )
        with self._alone(session):
            picture = await self._picture(1)
            overlap, overlap_by = await asyncio.to_thread(judge, picture, self._base, self._vessel, pose)
        self._check(session)
        self._accept(
            RegistrationRecord(
                made_for=self._made_for,
                pose=pose,
                by="hand",
                overlap=round(overlap, 4),
                overlap_by=overlap_by,
                residual_um=None,
            )
        )
        return self.state() | {"accepted": True, "reason": ""}

    @contextmanager
    def _alone(self, session: str) -> Iterator[None]:
        """Let one session register at a time."""
        self._check(session)
        if self._busy:
            raise RefusedError("busy", "the vessel is being registered: wait for the answer")
        self._busy = True
        try:
            yield
        finally:
            self._busy = False

    async def _picture(self, count: int) -> ByteArray:
        """Return the median of the next pictures, gray."""
        version = self._frames.version
        pictures: list[ByteArray] = []
        while len(pictures) < count:
            try:
                async with asyncio.timeout(_FRAME_S):
                    frame, version = await self._frames.newer_than(version)
            except TimeoutError:
                raise RefusedError("no_frame", "the camera gives no pictures: see to it first") from None
            pictures.append(cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY).astype(np.uint8))
        return pictures[0] if count == 1 else await asyncio.to_thread(still, pictures)

    def _accept(self, record: RegistrationRecord) -> None:
        try:
            save_registration(self._root, record)
        except ConfigError as error:
            raise RefusedError("not_kept", str(error)) from None
        self._go_by(record)
        self._announce(
            "registration",
            {
                "pose": _pose_fields(record.pose),
                "by": record.by,
                "overlap": record.overlap,
                "overlap_by": record.overlap_by,
                "residual_um": record.residual_um,
                "calibration": calibration_fields(self._calibration),
            },
        )

    def _go_by(self, record: RegistrationRecord) -> None:
        self._calibration = registered(self._base, self._vessel, record.pose)
        self._record = record
        self._use(self._calibration)


def _pose_fields(pose: VesselPose) -> dict[str, float]:
    return {
        "dx_um": round(pose.x_um, 2),
        "dy_um": round(pose.y_um, 2),
        "turn_deg": round(pose.angle_deg, 4),
    }
