"""The policy that ships navigates the model that ships."""

import numpy as np
import pytest

from mrnav_server.autonomy.policy import Sampler, shield
from mrnav_server.autonomy.torchscript import TorchPolicy, load_policy, verify
from mrnav_server.core.navigation import observation, step
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.evaluate import Mode, evaluate
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

FOLDER = find_model("bifurcation")


@pytest.fixture(scope="module")
def vessel() -> VesselMap:
    return load_vessel_model(FOLDER)


@pytest.fixture(scope="module")
def policy(vessel: VesselMap) -> TorchPolicy:
    return load_policy(FOLDER, vessel)


def test_it_is_small_and_verified(vessel: VesselMap) -> None:
    assert verify(FOLDER, vessel).ok
    assert (FOLDER / "policy.pt").stat().st_size < 200_000


@pytest.mark.parametrize("mode", ["greedy", "sample"])
def test_it_arrives_always_and_directly(policy: TorchPolicy, vessel: VesselMap, mode: Mode) -> None:
    result = evaluate(policy, vessel, pairs=60, mode=mode, seed=7)
    assert result.success == 1.0
    assert result.spl > 0.95
    assert result.wall_hits < 0.05


def test_it_reaches_every_suggested_area_from_every_other(policy: TorchPolicy, vessel: VesselMap) -> None:
    areas = np.array([(a.x_px, a.y_px) for a in vessel.suggested_areas])
    start = np.repeat(areas, len(areas), axis=0)
    target = np.tile(areas, (len(areas), 1))
    apart = (start != target).any(axis=1)
    start, target = start[apart], target[apart]
    position, arrived = start.copy(), np.zeros(len(start), bool)
    sampler = Sampler(greedy=True, agents=len(start))
    for _ in range(600):
        logits = shield(vessel, position, policy.logits(observation(position, start, target)))
        moved = step(vessel.free, position, target, sampler.choose(logits))
        position, arrived = moved.position_px, arrived | moved.arrived
    assert arrived.all()
