"""Which law drives, and what it has learnt."""

import asyncio
from collections.abc import Iterator
from dataclasses import replace

import pytest

from mrnav_server.app.navigator import Navigator
from mrnav_server.autonomy.direct import DirectLaw
from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.observer import Coupling
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import AutopilotConfig
from mrnav_server.settings import Settings
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model


@pytest.fixture(scope="module")
def vessel() -> VesselMap:
    return load_vessel_model(find_model("bifurcation"))


@pytest.fixture(params=["path", "direct"])
def navigator(request: pytest.FixtureRequest, vessel: VesselMap) -> Iterator[Navigator]:
    base = Settings()
    calibration = SimulatedWorld(base.sim, vessel, PictureFormat()).calibration
    settings = base.model_copy(update={"autopilot": AutopilotConfig(law=request.param)})
    navigator = Navigator(settings, vessel, calibration)
    # A loop that is not watched: the first import of the planner's libraries takes a second.
    asyncio.run(navigator.load())
    yield navigator
    navigator.close()


def test_the_setting_chooses_the_law(navigator: Navigator, vessel: VesselMap) -> None:
    direct = navigator._config.law == "direct"
    assert isinstance(navigator.autopilot._law, DirectLaw if direct else Follower)
    start, target = VesselPoint(893.0, 1500.0), vessel.suggested_areas[0]
    path = asyncio.run(navigator.plan(start, target))
    if not direct:
        assert path.to_go is None
    else:
        assert path.to_go is not None
        assert path.to_go.at_px(start.x_px, start.y_px) == pytest.approx(path.length_px, rel=0.1)


def test_a_new_calibration_forgets_what_was_learnt_under_the_old_one(
    navigator: Navigator, vessel: VesselMap
) -> None:
    law = navigator.autopilot._law
    assert isinstance(law, Follower | DirectLaw)
    law._watch.coupling = Coupling((30.0, -40.0), 310.0, 120)
    learned = {"offset_um": [30.0, -40.0], "friction_lead_um": 310.0, "looks": 120}
    assert navigator.autopilot.learned == learned
    navigator.autopilot.end()
    assert navigator.autopilot.learned == learned
    navigator.recalibrate(SimulatedWorld(Settings().sim, vessel, PictureFormat()).calibration)
    assert navigator.autopilot.learned["looks"] == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"law": "direct", "source": "geodesic"}, "needs source"),
        ({"actions_per_s": 0.0}, "actions_per_s"),
        ({"progress_s": 5.0}, "progress_s"),
        ({"most_reversals": -1}, "most_reversals"),
        ({"most_replans": 1000}, "most_replans"),
    ],
)
def test_nonsense_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(AutopilotConfig(), **change)  # type: ignore[arg-type]
