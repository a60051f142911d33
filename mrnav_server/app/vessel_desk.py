"""Has the server go by another vessel model, without an end of the process."""

import asyncio
import dataclasses
from collections.abc import Callable

from mrnav_server.app.model_shelf import ModelShelf
from mrnav_server.app.rig_port import RigPort
from mrnav_server.core import wire_twin
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.settings import Settings

BuildRig = Callable[[Settings], RigPort]


class VesselDesk:
    """Builds a rig around another vessel model while the old one runs, and has the process go over to it.

    A model reaches into everything: map, distances, policy, calibration, the simulated world. So nothing is
    exchanged within a rig; it is left and another one entered.

    Args:
        rig: The rig that runs.
        shelf: The models that there are.
        build_rig: Builds a rig, touching no device; None where the vessel stays.
        objection: Why the vessel must stay now, or "", beside what the rig itself says.
        clock: Monotonic time in seconds.
    """

    def __init__(
        self,
        rig: RigPort,
        shelf: ModelShelf,
        build_rig: BuildRig | None,
        objection: Callable[[], str],
        clock: Callable[[], float],
    ) -> None:
        self.shelf = shelf
        self._rig = rig
        self._build_rig = build_rig
        self._objection = objection
        self._clock = clock
        self._turn = asyncio.Lock()
        self.changed = asyncio.Event()
        self.successor: RigPort | None = None

    async def change(self, session: str, vessel: str) -> None:
        """Go over to another model; the links of all clients break, and they come back to it.

        Args:
            session: Who asks.
            vessel: As ``rig.vessel`` has it.

        Raises:
            RefusedError: Without the lease, while the rig is armed or something runs that a change would
                break, or if the model or the rig's calibration cannot be used. Everything stays.
        """
        async with self._turn:
            build_rig = self._build_rig
            if build_rig is None:
                raise RefusedError("not_here", "this server keeps its vessel: start another one")
            self._require_quiet(session)
            settings = self._rig.settings
            # The hand comes back to the port that it knows.
            server = dataclasses.replace(settings.server, hand_port=self._rig.hand_port)
            rig = dataclasses.replace(settings.rig, vessel=vessel)
            changed = settings.model_copy(update={"server": server, "rig": rig})
            try:
                successor = await asyncio.to_thread(build_rig, changed)
            except ConfigError as error:
                raise RefusedError("bad_vessel", str(error)) from None
            # It took a moment.
            self._require_quiet(session)
            self._rig.events.publish(
                wire_twin.event("vessel_changing", self._clock(), {"vessel": successor.vessel.name})
            )
            self.successor = successor
            self.changed.set()

    def _require_quiet(self, session: str) -> None:
        if self.changed.is_set():
            raise RefusedError("busy", "the vessel is being changed already: wait a moment")
        self._rig.require_idle(session)
        if why := self._objection():
            raise RefusedError("not_now", why)
