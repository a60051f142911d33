"""Control is taken from another operator: only at rest, only by HOLD, and everybody is told."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.modes import Mode
from tests.app.test_rig_asks import HELLO, Desk, desk, planner, refusal_of_auto, vessel

__all__ = ["desk", "planner", "vessel"]


async def take_over(desk: Desk, beat: Callable[[], None] | None = None) -> list[tuple[int, Mode, bool]]:
    """Take over as "chief" while time passes; return epoch, mode and rest at every step."""
    seen: list[tuple[int, Mode, bool]] = []

    async def live() -> None:
        while True:
            (beat or desk.tick)()
            desk.rig.control.step(desk.now_s)
            control = desk.rig.control
            seen.append((desk.rig.lease.epoch, desk.mode, control.facts.at_rest))
            await asyncio.sleep(0)

    async with asyncio.timeout(20.0), asyncio.TaskGroup() as group:
        living = group.create_task(live())
        try:
            await desk.rig.console.take_over("chief-1", "Chief")
        finally:
            living.cancel()
    return seen


async def driving(desk: Desk) -> None:
    await desk.open()
    assert await refusal_of_auto(desk, desk.tick) == ""
    for _ in range(60):
        desk.tick()
        await asyncio.sleep(0)
    assert desk.mode is Mode.AUTO
    assert not desk.rig.control.facts.at_rest


async def test_a_rig_in_motion_comes_to_rest_before_the_seats_change(desk: Desk) -> None:
    await driving(desk)
    epoch = desk.rig.lease.epoch
    seen = await take_over(desk)
    assert any(not rest for _, _, rest in seen)
    assert all(rest for e, _, rest in seen if e != epoch)
    assert {mode for _, mode, _ in seen} == {Mode.HOLD}
    lease = desk.rig.lease.state()
    assert (lease.console, lease.hand, lease.client) == ("chief-1", False, "Chief")
    assert lease.epoch > epoch


async def test_the_one_who_lost_control_moves_nothing_until_a_new_hello(desk: Desk) -> None:
    await driving(desk)
    await take_over(desk)
    for clutch in (False, True, True):
        desk.tick(clutch=clutch)
    assert desk.mode is Mode.HOLD
    assert not desk.rig.lease.state().hand
    with pytest.raises(RefusedError, match="Chief has control"):
        desk.rig.console.require_lease("page")
    desk.rig._hand_link.acquire("hand-2", HELLO, lambda *_: None)
    assert desk.rig.lease.state().hand


async def test_the_clutch_does_not_resume_while_control_changes_hands(desk: Desk) -> None:
    await driving(desk)
    clutch = False

    def grab() -> None:
        nonlocal clutch
        clutch = not clutch
        desk.tick(clutch=clutch)

    seen = await take_over(desk, grab)
    assert Mode.MANUAL not in {mode for _, mode, _ in seen}


async def test_both_sides_are_told_in_words(desk: Desk) -> None:
    await driving(desk)
    told: list[dict[str, Any]] = []
    with desk.rig.events.subscribe() as events:
        await take_over(desk)
        for _ in range(3):
            told.append(await events.get())
    reasons = [event["reason"] for event in told]
    assert "takes control over" in reasons[0]
    assert "take the lease" in reasons[1]
    assert "took control over from test and Dashboard" in reasons[2]


async def test_a_rig_that_does_not_rest_keeps_its_seats(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    await driving(desk)
    monkeypatch.setattr(desk.rig.control, "_at_rest", lambda _: False)

    def watched() -> None:
        desk.now_s += 0.04
        desk.tick()
        desk.rig.console.heartbeat("page")

    before = desk.rig.lease.state()
    with pytest.raises(ExceptionGroup) as refused:
        await take_over(desk, watched)
    assert "does not come to rest" in str(refused.value.exceptions[0])
    assert desk.rig.lease.state() == before
    assert desk.rig.lease.held


async def test_a_seat_that_falls_silent_is_announced(desk: Desk) -> None:
    await desk.open()
    with desk.rig.events.subscribe() as events:
        desk.now_s += 2.5
        desk.rig.control.step(desk.now_s)
        told = [await events.get(), await events.get()]
    assert [(event["event"], event["reason"]) for event in told] == [
        ("lease", "Dashboard fell silent: its seat is free"),
        ("lease", "test fell silent: its seat is free"),
    ]


async def test_the_hand_is_told_over_its_own_connection(desk: Desk) -> None:
    await driving(desk)
    await take_over(desk)
    assert desk.told == [(False, "displaced", "Chief took control over: connect anew")]
    with pytest.raises(RefusedError, match="connect anew"):
        desk.rig._hand_link.acquire("hand", HELLO, lambda *_: None)


async def test_a_hand_that_fell_silent_is_told_and_told_again_when_it_has_the_seat_back(desk: Desk) -> None:
    await desk.open()
    desk.now_s += 2.5
    desk.rig.control.step(desk.now_s)
    assert [(lease, code) for lease, code, _ in desk.told] == [(False, "silent")]
    desk.tick()
    assert desk.told[1:] == [(True, "ok", "")]
    desk.rig._hand_link.on_closed("hand")
    assert len(desk.told) == 2, "a hand that left is told nothing more"
