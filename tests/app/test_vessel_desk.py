"""Going over to another vessel model: what is refused, and what the successor is like."""

from pathlib import Path

import pytest

from mrnav_server.app.model_shelf import ModelShelf
from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.vessel_desk import VesselDesk
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.settings import Settings
from tests.app.fake_rig import FakeRig


class Bench:
    """A desk, the rig that runs, and what was built."""

    def __init__(self, root: Path) -> None:
        self.rig = FakeRig()
        self.rig.hand_port = 4242
        self.built: list[Settings] = []
        self.objection = ""
        self.shelf = ModelShelf(root, "bifurcation")
        self.desk = VesselDesk(self.rig, self.shelf, self._build, lambda: self.objection, lambda: 0.0)

    def _build(self, settings: Settings) -> RigPort:
        if settings.rig.vessel == "broken":
            raise ConfigError("no vessel model 'broken'")
        self.built.append(settings)
        return FakeRig(settings)

    @property
    def is_changing(self) -> bool:
        return self.desk.changed.is_set() or self.desk.successor is not None


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


async def test_the_successor_has_the_vessel_and_all_else_stays(bench: Bench) -> None:
    with bench.rig.events.subscribe() as events:
        await bench.desk.change("me", "network")
        told = await events.get()
    settings = bench.built[0]
    assert settings.rig.vessel == "network"
    assert settings.server.hand_port == 4242
    assert settings.server.operator_token == bench.rig.settings.server.operator_token
    assert settings.limits == bench.rig.settings.limits
    assert bench.desk.successor is not None
    assert bench.desk.successor.settings is settings
    assert bench.desk.changed.is_set()
    assert told["event"] == "vessel_changing"
    with pytest.raises(RefusedError, match="being changed already"):
        await bench.desk.change("me", "serpentine")


async def test_a_rig_that_is_not_idle_keeps_its_vessel(bench: Bench) -> None:
    bench.rig.refusal = RefusedError("armed", "the rig is armed")
    with pytest.raises(RefusedError, match="armed"):
        await bench.desk.change("me", "network")
    assert not bench.built
    assert not bench.is_changing


async def test_a_rig_that_was_armed_meanwhile_keeps_its_vessel(bench: Bench) -> None:
    asked = 0

    def armed_later(session: str) -> None:
        nonlocal asked
        asked += 1
        if asked == 2:
            raise RefusedError("armed", f"{session} armed the rig")

    bench.rig.require_idle = armed_later  # type: ignore[method-assign]
    with pytest.raises(RefusedError, match="me armed"):
        await bench.desk.change("me", "network")
    assert bench.built
    assert not bench.is_changing


async def test_what_would_break_is_told(bench: Bench) -> None:
    bench.objection = "a calibration is under way"
    with pytest.raises(RefusedError, match="calibration is under way"):
        await bench.desk.change("me", "network")
    assert not bench.built
    assert not bench.is_changing


async def test_a_model_that_cannot_be_used_changes_nothing(bench: Bench) -> None:
    with pytest.raises(RefusedError, match="no vessel model 'broken'"):
        await bench.desk.change("me", "broken")
    assert not bench.is_changing
    await bench.desk.change("me", "network")
    assert bench.is_changing


def test_an_own_model_comes_before_a_shipped_one(tmp_path: Path) -> None:
    for name in ("aorta", "network"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.json").write_text("{}")
    shelf = ModelShelf(tmp_path, "serpentine")
    assert shelf.names() == ["aorta", "network", "bifurcation", "serpentine"]
    assert shelf.setting("network") == str(tmp_path / "network")
    assert shelf.setting("serpentine") == "serpentine"
    assert [each["name"] for each in shelf.describe() if each["in_use"]] == ["serpentine"]
    with pytest.raises(RefusedError, match="name one of aorta"):
        shelf.setting("../network")
