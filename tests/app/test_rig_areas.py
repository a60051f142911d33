"""Critical areas one after the other: arrival, hand-back, the next one."""

from dataclasses import replace
from typing import Any

import pytest

from mrnav_server.app.rig import Rig
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.modes import Mode, Transition
from mrnav_server.loops.trial_log import TrialHeader
from mrnav_server.settings import Settings


@pytest.fixture
def rig() -> Rig:
    """A rig with two areas, of which the first is the active one."""
    rig = Rig(Settings().with_tokens())
    for point in rig.vessel.suggested_areas[:2]:
        rig.areas.add(point, 300.0, "")
    return rig


def arrive(rig: Rig) -> None:
    """Let the rig take note of an arrival at the active area."""
    rig.control._facts = replace(rig.control.facts, arrived=True)
    rig._on_change(Transition(Mode.AUTO, Mode.MANUAL, ""))


async def test_after_an_arrival_auto_goes_to_the_next_area(rig: Rig) -> None:
    told: list[dict[str, Any]] = []
    with rig.events.subscribe() as events:
        arrive(rig)
        assert rig.control.scene.area is not None
        assert rig.control.scene.area.id == "area-1", "the operator works where autonomy arrived"
        rig.console.take_lease("page", "Dashboard")
        # The guards refuse AUTO on a rig that does not run; the area was chosen before.
        with pytest.raises(RefusedError):
            await rig.console.ask("auto", "page", None)
        rig.areas.tell()
        while len(told) < 3:
            message = await events.get()
            if message["event"] == "areas":
                told.append(message)
    assert told[0]["next"] == "area-2"
    assert rig.control.scene.area.id == "area-2"
    assert [(area["id"], area["active"], area["visited"]) for area in told[1]["critical_areas"]] == [
        ("area-1", False, True),
        ("area-2", True, False),
    ]


async def test_an_area_that_is_named_is_gone_to_again(rig: Rig) -> None:
    arrive(rig)
    rig.console.take_lease("page", "Dashboard")
    with pytest.raises(RefusedError):
        await rig.console.ask("auto", "page", "area-1")
    assert rig.control.scene.area is not None
    assert rig.control.scene.area.id == "area-1"


async def test_a_takeover_is_no_visit(rig: Rig) -> None:
    rig._on_change(Transition(Mode.AUTO, Mode.MANUAL, ""))
    assert rig.areas.visited == frozenset()


async def test_an_area_that_is_chosen_is_the_goal_of_a_trial_by_hand_too(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    headers: list[TrialHeader] = []

    def note(header: TrialHeader, beginning: object) -> str:
        headers.append(header)
        return "trial-1"

    monkeypatch.setattr(rig._recorder, "start_trial", note)
    with rig.events.subscribe() as events:
        rig.console.choose_area("area-2")
        assert (await events.get())["next"] == "area-2"
    rig.trials.start("P01", "without_autonomy", "human", "")
    assert headers[0].area_id == "area-2"


async def test_autonomy_on_its_way_keeps_its_goal(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig.control.machine, "_mode", Mode.AUTO)
    with pytest.raises(RefusedError, match="the policy is driving"):
        rig.console.choose_area("area-2")
    assert rig.control.scene.area is not None
    assert rig.control.scene.area.id == "area-1"
