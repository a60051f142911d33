"""What consoles ask for: modes, control, and STOP."""

import asyncio
from collections.abc import Callable

from mrnav_server.app.herald import Herald
from mrnav_server.app.navigator import Navigator
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.hand import HandControl
from mrnav_server.core.lease import Lease
from mrnav_server.core.modes import ARMED, Ask
from mrnav_server.devices.base import Manipulator
from mrnav_server.loops.control import ControlLoop

_REST_S = 2.0
_LOOK_S = 0.005


class ConsoleDesk:
    """Answers consoles. Refusals are RefusedErrors with the reason.

    Args:
        control: Grants or refuses modes.
        lease: Who controls the rig.
        hand: Its scale is chosen here.
        areas: Where AUTO may be asked to go.
        navigator: Plans the way there.
        manipulator: Stopped at once when anybody asks for it.
        herald: Told of leases and stops.
        step: Steps the control loop now.
        publish: Shows clients the new state at once.
        trial_refusal: Says why the running trial leaves no AUTO; "" if it does.
        clock: Monotonic time in seconds.
    """

    def __init__(
        self,
        control: ControlLoop,
        lease: Lease,
        hand: HandControl,
        areas: CriticalAreas,
        navigator: Navigator,
        manipulator: Manipulator,
        herald: Herald,
        step: Callable[[], None],
        publish: Callable[[], None],
        trial_refusal: Callable[[], str],
        clock: Callable[[], float],
    ) -> None:
        self._control = control
        self._lease = lease
        self._hand = hand
        self._areas = areas
        self._navigator = navigator
        self._manipulator = manipulator
        self._herald = herald
        self._step = step
        self._publish = publish
        self._trial_refusal = trial_refusal
        self._clock = clock
        lease.on_silent = lambda client: self._announce_lease(f"{client} fell silent: its seat is free")

    async def ask(self, name: str, session: str, area: str | None) -> None:
        """Ask for a mode.

        Raises:
            RefusedError: With the reason.
        """
        ask = Ask(name)
        if ask is Ask.STOP:
            self.stop_now(session)
            return
        self._lease.hear(session, self._clock())
        if ask is not Ask.HOLD:
            self.require_lease(session)
        if ask is Ask.AUTO:
            await self._prepare_auto(session, area)
        self._control.submit(ask, self._clock())
        self._publish()

    def choose_area(self, area_id: str) -> None:
        """Make a critical area the goal: of the next AUTO, and of a trial that is steered by hand.

        Raises:
            RefusedError: While the policy drives to another one, or if there is no such area.
        """
        area = self._areas.get(area_id)
        if area != self._control.scene.area:
            self._control.choose_area(area)
            self._areas.tell()

    def choose_scale(self, session: str, scale: str) -> None:
        """Choose the hand's scale, "coarse" or "fine".

        Raises:
            RefusedError: Without the lease, for another scale, or while the clutch is closed.
        """
        self.require_lease(session)
        self._hand.choose_scale(scale)
        self._herald.announce("hand", {"scale": self._hand.scale, "gain": self._hand.gain})
        self._publish()

    def stop_now(self, session: str) -> None:
        """Stop the manipulator at once; anyone may, and nothing is waited for."""
        self._manipulator.stop()
        self._herald.record("event", {"event": "stop", "session": session})
        self._control.submit(Ask.STOP, self._clock())
        self._publish()

    def take_lease(self, session: str, client: str) -> None:
        """Sit down at the console.

        Raises:
            RefusedError: While another console has it.
        """
        self._lease.take_console(session, client, self._clock())
        self._announce_lease()

    async def take_over(self, session: str, client: str) -> None:
        """Take control from whoever has it: the rig holds, comes to rest, and only then the seats change.

        Raises:
            RefusedError: If the rig does not come to rest, or somebody else takes over already.
        """
        if self._lease.holds(session) and self._lease.state().console == session:
            self.take_lease(session, client)
            return
        before = self._lease.state().client
        self._lease.claim()
        began_s = self._clock()
        try:
            self._announce_lease(f"{client} takes control over: the magnet comes to rest first")
            self._step()
            while not self._control.facts.at_rest:
                if self._clock() - began_s > _REST_S:
                    raise RefusedError(
                        "in_motion", "the magnet does not come to rest: press STOP, then try again"
                    )
                await asyncio.sleep(_LOOK_S)
        except BaseException:
            self._lease.withdraw()
            self._announce_lease(f"{client} did not take control over")
            raise
        self._lease.displace(session, client, self._clock())
        self._step()
        self._announce_lease(
            f"{client} took control over from {before}" if before else f"{client} has control"
        )
        self._publish()

    def give_lease(self, session: str) -> None:
        """Give control back; the rig holds before anybody else may take it."""
        self._lease.give_back(session)
        if self._control.machine.mode in ARMED:
            self._step()
        self._announce_lease()

    def require_lease(self, session: str) -> None:
        """Refuse what only the console that controls the rig may ask for.

        Raises:
            RefusedError: If this session does not have the lease.
        """
        if not self._lease.holds(session):
            holder = self._lease.state().client
            who = f"{holder} has control" if holder else "nobody has control"
            raise RefusedError("no_lease", f"{who}: take the lease first")

    def heartbeat(self, session: str) -> None:
        """Note that a page is alive and watched."""
        self._lease.hear(session, self._clock())

    async def _prepare_auto(self, session: str, area_id: str | None) -> None:
        """Choose the area and plan the way there, before AUTO is entered.

        Raises:
            RefusedError: If a guard of AUTO fails, or somebody acted meanwhile: whoever did wins.
        """
        refusal = self._trial_refusal()
        if refusal:
            raise RefusedError("without_autonomy", refusal)
        active = self._control.scene.area
        if area_id is not None:
            self._control.choose_area(self._areas.get(area_id))
        elif active is not None and active.id in self._areas.visited:
            # Control was handed back after an arrival: on to the next area.
            self._control.choose_area(self._areas.following(active.id) or active)
        if self._control.scene.area != active:
            self._areas.tell()
        self._control.check(Ask.AUTO, self._clock())
        area, robot = self._control.scene.area, self._control.scene.robot
        if area is None or robot is None:
            raise RuntimeError("the guards of AUTO let a task without a start or a goal pass")
        generation = self._control.generation
        path = await self._navigator.plan(robot, area.center, area.epsilon_um)
        if self._control.generation != generation:
            raise RefusedError("overtaken", "the rig was used while the path was planned: ask again")
        self.require_lease(session)
        self._control.check(Ask.AUTO, self._clock())
        self._navigator.prepare(path, area)
        if path.fallback:
            self._herald.announce("fault", {"reason": f"the geodesic stands in: {path.fallback}"})

    def _announce_lease(self, reason: str = "") -> None:
        state = self._lease.state()
        self._herald.announce("lease", {"epoch": state.epoch, "client": state.client, "reason": reason})
