"""When the tip is looked at in the running server, and what is told of it; time passes without waiting."""

import asyncio
from collections.abc import Callable, Mapping
from itertools import count
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from mrnav_server.app import tip_patrol
from mrnav_server.app.tip_patrol import TipPatrol
from mrnav_server.core.frames import Affine2, Calibration, StagePoint
from mrnav_server.core.records import Frame, TipReading
from mrnav_server.loops.latest import Latest
from mrnav_server.loops.scene import Scene
from mrnav_server.vision.tip import TipLook
from mrnav_server.vision.tip_agreement import TipSeen, TipWatchConfig
from mrnav_server.vision.vessel_model import vessel_map

CALIBRATION = Calibration(
    image_from_vessel=Affine2.scale(1.0),
    stage_from_vessel=Affine2.scale(10.0),
    um_per_px=10.0,
    floor_z_um=0.0,
    magnet_offset_um=(0.0, 0.0),
    critical_height_um=11_000.0,
)
VESSEL = vessel_map("open", np.full((400, 400), 255, np.uint8))
LOOKED_S = 0.5


class Agreement:
    """Answers as it is told, and keeps what it was shown."""

    answer = ""
    resting: list[bool]
    made: list["Agreement"]

    def __init__(self, *_: object) -> None:
        self.seen = TipSeen()
        self.made.append(self)

    def look(self, *_: object, resting: bool) -> TipSeen:
        self.resting.append(resting)
        self.seen = TipSeen(warning=self.answer)
        return self.seen


class Watch:
    """A patrol, and what it sees."""

    def __init__(self) -> None:
        self.frames: Latest[Frame] = Latest()
        self.scene = SimpleNamespace(tip=None, track=None)
        self.blind = ""
        self.told: list[str] = []
        self.patrol = TipPatrol(
            TipWatchConfig(look_s=LOOKED_S),
            TipLook(),
            VESSEL,
            CALIBRATION,
            self.frames,
            cast(Scene, self.scene),
            lambda: self.blind,
            self.tell,
        )

    def tell(self, event: str, data: Mapping[str, object]) -> None:
        self.told.append(f"{event}: {data['reason']}")

    def show(self, x_um: float, *, moving: bool = False, fresh: bool = True) -> None:
        self.scene.tip = TipReading(0.0, StagePoint(x_um, 0.0, 12_000.0), moving)
        if fresh:
            self.frames.put(Frame(0, 0.0, np.zeros((8, 8, 3), np.uint8)))

    async def go(self, looks: list[Callable[[], Any]]) -> None:
        """Let one look after the other come, each after what happens before it."""
        times, waiting = count(), iter(looks)
        ended = asyncio.Event()

        def clock() -> float:
            # Asked when a look is due, and when it has come.
            number = next(times)
            if number >= 2 and number % 2 == 0:
                happens = next(waiting, ended.set)
                happens()
            return number * LOOKED_S

        async with asyncio.timeout(30), asyncio.TaskGroup() as group:
            task = group.create_task(self.patrol.run(clock))
            await ended.wait()
            task.cancel()


@pytest.fixture
def watch(monkeypatch: pytest.MonkeyPatch) -> Watch:
    monkeypatch.setattr(tip_patrol, "TipAgreement", Agreement)
    Agreement.answer, Agreement.resting, Agreement.made = "", [], []
    return Watch()


def answered(answer: str, watch: Watch) -> None:
    Agreement.answer = answer
    watch.show(0.0)


async def test_only_a_tip_that_has_not_moved_since_the_look_before_rests(watch: Watch) -> None:
    await watch.go(
        [
            lambda: watch.show(0.0),
            lambda: watch.show(1.0),
            lambda: watch.show(500.0),
            lambda: watch.show(500.0),
            lambda: watch.show(500.0, moving=True),
        ]
    )
    assert Agreement.resting == [False, True, False, True, False]


async def test_nothing_is_looked_at_twice_nor_through_a_camera_that_is_not_believed(watch: Watch) -> None:
    def blinded() -> None:
        watch.blind = "the picture is black"
        watch.show(0.0)

    await watch.go(
        [lambda: watch.show(0.0), lambda: watch.show(0.0, fresh=False), blinded, lambda: watch.show(0.0)]
    )
    assert len(Agreement.resting) == 1


async def test_a_warning_is_told_once_and_so_is_its_end(watch: Watch) -> None:
    await watch.go(
        [
            lambda: answered("the tip is elsewhere", watch),
            lambda: watch.show(0.0),
            lambda: answered("", watch),
            lambda: watch.show(0.0),
        ]
    )
    assert watch.told == [
        "fault: the tip is elsewhere",
        "recovered: the tip is where the calibration puts it",
    ]


async def test_another_calibration_begins_anew(watch: Watch) -> None:
    await watch.go([lambda: answered("the tip is elsewhere", watch)])
    assert watch.patrol.warning()
    watch.patrol.recalibrate(CALIBRATION)
    assert not watch.patrol.warning()
    assert len(Agreement.made) == 2
