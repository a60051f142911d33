"""A page as the rig's hand over ``/ws/twin``: the seat, its loss, and what counts as a sample."""

import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection

from tests.app.test_app_streams import Site, closing, message, site

__all__ = ["site"]
TAKE = {"type": "take_hand", "client": "dashboard", "frame": "stage"}


@pytest.fixture
async def page(site: Site) -> AsyncIterator[ClientConnection]:
    async with site.twin() as link:
        yield link


async def say(link: ClientConnection, **fields: Any) -> None:  # noqa: ANN401 - any field of a message
    await link.send(json.dumps(fields))


async def asked(link: ClientConnection) -> None:
    """Wait until everything that was sent before has been read."""
    await say(link, type="ask", ask="hold")
    await message(link, "answer")


def hand(seq: int, x_m: float = 0.0, **more: Any) -> dict[str, Any]:  # noqa: ANN401 - any field of a message
    fields = {"type": "hand", "seq": seq, "t": seq / 60.0, "p": [x_m, 0.02, 0.03], "clutch": True}
    return fields | {"valid": True} | more


async def test_a_page_sits_down_and_its_samples_move_the_hand(site: Site, page: ClientConnection) -> None:
    await say(page, **TAKE)
    answer = await message(page, "lease")
    assert answer["lease"] is True
    assert answer["transform"]["gain"] == 0.04
    for seq, x_m in ((1, 0.001), (2, 0.002), (2, 0.5)):
        await say(page, **hand(seq, x_m, pose=seq))
    await asked(page)
    first, second = site.rig.hand_seat.samples
    assert (second.point.x_m, second.clutch, second.new_pose) == (0.002, True, True)
    # The stage's y lies towards the operator, its z up.
    assert (second.point.y_m, second.point.z_m) == (0.03, 0.02)
    assert first.session.startswith("hand-")
    assert site.rig.hand_seat.counters["hand_out_of_order"] == 1
    assert site.rig.asked[-1][:2] == ("hold", first.session)


async def test_without_the_seat_nothing_moves_and_it_is_counted(site: Site, page: ClientConnection) -> None:
    await say(page, **hand(1))
    await asked(page)
    assert site.rig.hand_seat.samples == []
    assert site.rig.hand_seat.counters["hand_without_seat"] == 1


async def test_one_hand_alone_has_the_seat(site: Site, page: ClientConnection) -> None:
    await say(page, **TAKE)
    await message(page, "lease")
    async with site.twin() as other:
        await say(other, **TAKE)
        refused = await message(other, "lease")
        assert (refused["lease"], refused["code"]) == (False, "lease_held")
        assert "dashboard" in refused["message"]
        await say(page, type="give_hand")
        assert (await message(page, "lease"))["code"] == "given_back"
        await say(other, **TAKE)
        assert (await message(other, "lease"))["lease"] is True
    async with site.twin("viewer") as viewer:
        await say(viewer, **TAKE)
        assert (await message(viewer, "lease"))["code"] == "forbidden"


async def test_the_seat_is_free_once_the_page_is_gone(site: Site) -> None:
    async with site.twin() as link:
        await say(link, **TAKE)
        await message(link, "lease")
    async with site.twin() as link:
        await say(link, **TAKE)
        assert (await message(link, "lease"))["lease"] is True


async def test_the_page_is_told_when_it_loses_the_seat_and_when_it_returns(
    site: Site, page: ClientConnection
) -> None:
    await say(page, **TAKE)
    await message(page, "lease")
    assert site.rig.hand_seat.holder is not None
    session, _, tell = site.rig.hand_seat.holder
    tell(False, "silent", "the hand was silent")
    assert (await message(page, "lease"))["code"] == "silent"
    await asked(page)
    assert site.rig.asked[-1][1] != session, "it asks as a page while it is no hand"
    tell(True, "ok", "")
    assert (await message(page, "lease"))["lease"] is True
    await asked(page)
    assert site.rig.asked[-1][1] == session


async def test_numbers_that_measure_nothing_are_told_and_drop_nobody(
    site: Site, page: ClientConnection
) -> None:
    await say(page, **TAKE)
    await message(page, "lease")
    for seq in (1, 2, 3):
        await say(page, **hand(seq, 1e6))
    await asked(page)
    assert site.rig.hand_seat.samples == []
    assert [what for what, _ in site.rig.hand_seat.told] == ["bad_numbers"]


@pytest.mark.parametrize(
    ("sent", "named"),
    [
        (hand(1) | {"clutch": 1}, "clutch"),
        (hand(1) | {"extra": 1}, "extra"),
        (TAKE | {"frame": "moon"}, "frame"),
        (TAKE | {"client": ""}, "client"),
    ],
)
async def test_a_malformed_message_closes_the_connection(
    site: Site, page: ClientConnection, sent: dict[str, Any], named: str
) -> None:
    await say(page, **TAKE)
    await message(page, "lease")
    await say(page, **sent)
    code, reason = await closing(page)
    assert code == 1008
    assert named in reason


async def test_an_operator_is_told_that_it_is_no_chief(site: Site) -> None:
    async with site.twin("operator") as link:
        assert (await message(link, "snapshot"))["chief"] is False
