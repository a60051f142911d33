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

    The states are in random order as drawn; every pass cuts them into batches at another offset and takes
    the batches in random order. That reads memory in a row, which single random states do not.

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
    random.shuffle(states)
    observations = torch.from_numpy(states)
    wanted = torch.from_numpy(label(GeodesicPolicy(vessel), states))
    progress(Report("plan", 1.0))
    batch = min(settings.batch, len(states))
    with torch.no_grad():
        features = policy.features(observations)
        allowed = torch.cat([policy.allowed(part) for part in torch.split(observations, 16_384)])
        for part, open_ways in zip(torch.split(wanted, 16_384), torch.split(allowed, 16_384), strict=True):
            part.copy_(torch.where(open_ways, part, policy.forbidden).softmax(1))
    optimizer = torch.optim.Adam(policy.head.parameters(), lr=settings.learning_rate, fused=True)
    starts: list[int] = []
    for update in range(1, settings.updates + 1):
        if not starts:
            offset = int(random.integers(len(states) % batch + 1))
            starts = list(random.permutation(np.arange(offset, len(states) - batch + 1, batch)))
        at = int(starts.pop())
        rows = slice(at, at + batch)
        guess = torch.where(allowed[rows], policy.head(features[rows]), policy.forbidden)
        loss = functional.cross_entropy(guess, wanted[rows])
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        for group in optimizer.param_groups:
            group["lr"] = settings.learning_rate * (1 - 0.99 * (update - 1) / settings.updates)
        optimizer.step()
        if update % REPORT_EVERY == 0 or update == settings.updates:
            progress(Report("clone", update / settings.updates, loss=loss.item()))
