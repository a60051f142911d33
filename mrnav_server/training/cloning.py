"""Behaviour cloning: distil the shortest-path planner into the policy network."""

import numpy as np
import torch
from torch.nn import functional

from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.expert import draw_states, label
from mrnav_server.training.network import PolicyNetwork
from mrnav_server.training.presets import CloningSettings
from mrnav_server.training.progress import Progress, Report

REPORT_EVERY = 200


def clone(
    policy: PolicyNetwork, vessel: VesselMap, settings: CloningSettings, seed: int, progress: Progress
) -> None:
    """Fit the policy to soft labels of the planner, in place.

    Args:
        policy: The network.
        vessel: The vessel model.
        settings: How long and how.
        seed: Of the states and of their order.
        progress: Called now and then.
    """
    progress(Report("plan", 0.0))
    random = np.random.default_rng(seed)
    states = draw_states(vessel, settings.labels, random)
    wanted = torch.from_numpy(label(GeodesicPolicy(vessel), states))
    progress(Report("plan", 1.0))
    observations = torch.from_numpy(states)
    with torch.no_grad():
        features = policy.features(observations)
        forbidden = torch.cat([~policy.allowed(part) for part in torch.split(observations, 16_384)])
    optimizer = torch.optim.Adam(policy.head.parameters(), lr=settings.learning_rate, fused=True)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.01, total_iters=settings.updates)
    for update in range(1, settings.updates + 1):
        drawn = torch.from_numpy(random.integers(len(states), size=settings.batch))
        blocked = forbidden[drawn]
        target = wanted[drawn].masked_fill(blocked, policy.forbidden).softmax(1)
        guess = policy.head(features[drawn]).masked_fill(blocked, policy.forbidden)
        loss = functional.cross_entropy(guess, target)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
        if update % REPORT_EVERY == 0 or update == settings.updates:
            progress(Report("clone", update / settings.updates, loss=loss.item()))
