"""What the web side needs of a rig; ``app/rig.py`` gives it, tests give a small one."""

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from mrnav_server.app.page_hand import Seat
from mrnav_server.core.frames import Calibration, VesselPoint
from mrnav_server.core.records import CriticalArea, Frame, RigState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.events import EventBus
from mrnav_server.loops.latest import Latest
from mrnav_server.loops.trial_log import Condition, OperatorKind
from mrnav_server.settings import Settings

if TYPE_CHECKING:
    from mrnav_server.app.video import VideoEncoder  # which needs this module itself


class Areas(Protocol):
    """The critical areas; every change may raise RefusedError with the reason."""

    @property
    def visited(self) -> frozenset[str]:
        """Ids of the areas at which autonomy has arrived."""

    def reorder(self, area_ids: Sequence[str]) -> None:
        """Change the order of the visits."""

    def list(self) -> list[CriticalArea]:
        """Return all areas, in the order of their visits."""

    def get(self, area_id: str) -> CriticalArea:
        """Return one area."""

    def add(self, center: VesselPoint, epsilon_um: float, label: str) -> CriticalArea:
        """Mark an area."""

    def replace(self, area_id: str, center: VesselPoint, epsilon_um: float, label: str) -> CriticalArea:
        """Change an area."""

    def remove(self, area_id: str) -> None:
        """Forget an area."""


class Trials(Protocol):
    """The trials; asks raise RefusedError with the reason."""

    def list(self) -> list[dict[str, Any]]:
        """Describe the trials on disk, oldest first."""

    def start(
        self, participant: str, condition: Condition, operator_kind: OperatorKind, notes: str
    ) -> dict[str, Any]:
        """Begin a trial."""

    async def end(self, trial_id: str) -> dict[str, Any]:
        """End a trial and return its result."""

    async def live_metrics(self, trial_id: str) -> dict[str, Any] | None:
        """Return the running trial's metrics up to now; None if it is not the running one."""


class Console(Protocol):
    """What consoles ask for; refusals are RefusedErrors with the reason."""

    def choose_scale(self, session: str, scale: str) -> None:
        """Choose the hand's scale."""

    def choose_area(self, area_id: str) -> None:
        """Make a critical area the goal."""

    async def ask(self, name: str, session: str, area: str | None) -> None:
        """Ask for a mode."""

    def stop_now(self, session: str) -> None:
        """Stop the manipulator. Waits behind nothing."""

    def take_lease(self, session: str, client: str) -> None:
        """Take control."""

    async def take_over(self, session: str, client: str) -> None:
        """Take control from whoever has it, once the rig rests."""

    def give_lease(self, session: str) -> None:
        """Give control back."""

    def heartbeat(self, session: str) -> None:
        """Note that a page is alive and watched."""


class Registering(Protocol):
    """Where the vessel lies; asks raise RefusedError with the reason."""

    def state(self) -> dict[str, Any]:
        """Describe the registration that the rig goes by."""

    async def find(self, session: str) -> dict[str, Any]:
        """Register the vessel from the live picture."""

    async def adjust(self, session: str, dx_um: float, dy_um: float, turn_deg: float) -> dict[str, Any]:
        """Move the model by hand."""


class Calibrating(Protocol):
    """The guided calibration; asks raise RefusedError with the reason."""

    def state(self) -> dict[str, Any]:
        """Describe where it stands."""

    def begin(
        self, session: str, changes: Mapping[str, float | int], water_depth_um: float
    ) -> dict[str, Any]:
        """Begin afresh."""

    def next(self, session: str) -> dict[str, Any]:
        """Go on: the bench is prepared."""

    def cancel(self) -> dict[str, Any]:
        """Bring the tip to rest and forget."""

    def use(self, session: str) -> dict[str, Any]:
        """Keep what was measured, and go by it."""


class RigPort(Protocol):
    """A rig as the server sees it."""

    @property
    def settings(self) -> Settings:
        """The settings that the rig was built from."""

    @property
    def vessel(self) -> VesselMap:
        """The vessel model."""

    @property
    def calibration(self) -> Calibration:
        """How camera, vessel model and manipulator see each other."""

    @property
    def states(self) -> Latest[RigState]:
        """The newest state, at least 60 a second."""

    @property
    def frames(self) -> Latest[Frame]:
        """The newest camera picture."""

    @property
    def encoder(self) -> "VideoEncoder":
        """Turns the newest camera picture into JPEG."""

    @property
    def events(self) -> EventBus:
        """What happens once."""

    @property
    def areas(self) -> Areas:
        """The critical areas."""

    @property
    def console(self) -> Console:
        """Modes, control and STOP."""

    @property
    def hand_seat(self) -> Seat:
        """Where a page becomes the rig's hand."""

    @property
    def calibrating(self) -> Calibrating:
        """The guided calibration."""

    @property
    def registration(self) -> Registering:
        """Where the vessel lies."""

    @property
    def trials(self) -> Trials:
        """The trials."""

    @property
    def simulated(self) -> bool:
        """Whether any device is simulated or emulated."""

    @property
    def hand_port(self) -> int:
        """The hand link's port, once started."""

    def snapshot(self, session: str, role: str) -> dict[str, Any]:
        """Return the twin's first message."""

    def to_vessel(self, frame: str, x: float, y: float) -> VesselPoint:
        """Map a point of the vessel, image or stage frame into the vessel's grid."""

    async def use_policy(self, folder: Path) -> None:
        """Verify a policy of this vessel and go by it; RefusedError with the reason if it is not one."""

    def policies(self) -> list[dict[str, Any]]:
        """Describe the policies and whether they were verified."""

    def require_idle(self, session: str) -> None:
        """Refuse what must not happen under somebody's hand; RefusedError with the reason."""

    def readiness(self) -> list[str]:
        """Return why the rig is not ready; empty when it is."""

    async def run(self, started: asyncio.Event) -> None:
        """Own the devices until cancelled; sets ``started`` once they are open."""
