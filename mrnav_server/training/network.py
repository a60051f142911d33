"""The policy and critic networks. The policy takes raw grid pixels, so that it exports as one module."""

import math
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from mrnav_server.autonomy.policy import FORBIDDEN_LOGIT
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import ACTIONS
from mrnav_server.core.vessel import VesselMap

Encoding = Literal["raw", "fourier"]
_REACH_PX = int(np.abs(ACTIONS).max())


class Features(nn.Module):
    """Turns the 6 raw numbers into network inputs.

    ``raw``: the 6 numbers scaled to -1..1. ``fourier`` (61 numbers): position and target, their sines and
    cosines at 6 octaves, the way to the target at three scales, its direction and its length; the start is
    dropped, since the task does not depend on it.

    Args:
        encoding: Which of the two.
        size_px: Side of the vessel's grid in pixels.
    """

    weight: Tensor
    bias: Tensor
    limit: Tensor

    def __init__(self, encoding: Encoding, size_px: int, octaves: int = 6) -> None:
        super().__init__()
        self.raw: bool = encoding == "raw"
        half_px = size_px / 2
        self.half_px: float = half_px
        self.width: int = 6 if self.raw else 13 + 8 * octaves
        # Everything but direction and length is linear in the observation, or the sine of what is: a few
        # large operations cost far less than many small ones when one observation is scored.
        here, there = torch.eye(6)[0:2], torch.eye(6)[4:6]
        points, way = torch.cat([here, there]), there - here
        angles = (points[:, None] * (2.0 ** torch.arange(octaves) * math.pi / size_px)[:, None]).flatten(0, 1)
        rows = [points / half_px, way / half_px, way / 200.0, way / 30.0, angles, angles]
        offset = [
            torch.full((4,), -1.0),
            torch.zeros(6 + len(angles)),
            torch.full((len(angles),), math.pi / 2),
        ]
        self.register_buffer("weight", torch.cat(rows))
        self.register_buffer("bias", torch.cat(offset))
        self.register_buffer("limit", torch.tensor([math.inf] * 6 + [1.0] * 4))

    def forward(self, observations: Tensor) -> Tensor:
        """Map shape (n, 6) in grid pixels to shape (n, width)."""
        if self.raw:
            return observations / self.half_px - 1.0
        linear = functional.linear(observations, self.weight, self.bias)
        scaled, angles = torch.split(linear, [10, self.width - 13], 1)
        way = torch.narrow(scaled, 1, 4, 2)
        length = torch.linalg.vector_norm(way, dim=1, keepdim=True) + 1e-6
        scaled = torch.clamp(scaled, -self.limit, self.limit)
        return torch.cat([scaled, torch.sin(angles), way / length, length], 1)


class PolicyNetwork(nn.Module):
    """Observation in raw pixels to 40 logits, with the vessel's wall inside.

    The wall is a map of three levels (0 blocked, 1 free, 2 free with a margin), one byte a pixel. Only the
    actions of the best level within reach are allowed; the margin makes the policy forgiving of noise, delay
    and step size.

    Args:
        vessel: The vessel model.
        encoding: See `Features`.
        hidden: Width of the two hidden layers.
        masked: Whether the wall is inside; without, the policy must learn it.
        margin_px: Gap to the wall that the upper level asks for; keep it under 10.

    Raises:
        ConfigError: If the grid is too large.
    """

    levels: Tensor
    cell: Tensor
    reach: Tensor

    def __init__(
        self,
        vessel: VesselMap,
        encoding: Encoding = "fourier",
        hidden: int = 128,
        masked: bool = True,
        margin_px: float = 5.0,
    ) -> None:
        super().__init__()
        self.features = Features(encoding, vessel.size_px)
        self.head = _perceptron(self.features.width, hidden, len(ACTIONS), 0.01, tanh=encoding == "raw")
        self.masked: bool = masked
        self.top_px: float = float(vessel.size_px - 1)
        self.forbidden: float = float(FORBIDDEN_LOGIT)
        levels = np.pad(wall_levels(vessel, margin_px), _REACH_PX) if masked else np.zeros((4, 4), np.uint8)
        stride = levels.shape[1]
        if levels.size > 2**24:
            raise ConfigError(
                f"{vessel.name}: a policy's grid may have 4000 pixels a side, not {vessel.size_px}"
            )
        self.register_buffer("levels", torch.from_numpy(levels.ravel()))
        # Start and target weigh nothing: cheaper than cutting the position out of the observation.
        cell = torch.tensor([1.0, stride, 0.0, 0.0, 0.0, 0.0])
        self.register_buffer("cell", cell.repeat(len(ACTIONS), 1))
        moved = ACTIONS + _REACH_PX
        self.register_buffer("reach", torch.from_numpy(moved[:, 1] * stride + moved[:, 0]).float())

    def forbids(self, observations: Tensor) -> Tensor:
        """Return the actions below the best level within reach, shape (n, 6) to shape (n, 40), bool.

        Outside the grid, the nearest pixel of the grid counts.
        """
        nearest = torch.clamp(torch.round(observations), 0.0, self.top_px)
        # Whole numbers below 2^24 are exact in float32.
        reached = functional.linear(nearest, self.cell, self.reach).long()
        levels = torch.take(self.levels, reached)
        return levels != levels.amax(1, keepdim=True)

    def allowed(self, observations: Tensor) -> Tensor:
        """Return the other actions, shape (n, 6) to shape (n, 40), bool."""
        return ~self.forbids(observations)

    def forward(self, observations: Tensor) -> Tensor:
        """Map observations, shape (n, 6), to logits, shape (n, 40)."""
        logits: Tensor = self.head(self.features(observations))
        if self.masked:
            logits = logits.masked_fill_(self.forbids(observations), self.forbidden)
        return logits


class Critic(nn.Module):
    """Value of a state from the policy's features."""

    def __init__(self, width: int, hidden: int, tanh: bool) -> None:
        super().__init__()
        self.head = _perceptron(width, hidden, 1, 1.0, tanh=tanh)

    def forward(self, features: Tensor) -> Tensor:
        """Map shape (n, width) to shape (n,)."""
        value: Tensor = self.head(features)
        return value.squeeze(1)


def wall_levels(vessel: VesselMap, margin_px: float) -> ByteArray:
    """Return 0 where blocked, 1 where free, 2 where free with a margin; shape (size, size)."""
    roomy = vessel.distance_px - vessel.robot_radius_px > margin_px
    levels: ByteArray = vessel.free.astype(np.uint8) * (1 + roomy.astype(np.uint8))
    return levels


def _perceptron(inputs: int, hidden: int, outputs: int, gain: float, *, tanh: bool) -> nn.Sequential:
    """Return two hidden layers with orthogonal weights and an output layer of the given gain."""
    layers: list[nn.Module] = []
    for width in (inputs, hidden):
        layers += [_linear(width, hidden, math.sqrt(2)), nn.Tanh() if tanh else nn.ReLU(inplace=True)]
    return nn.Sequential(*layers, _linear(hidden, outputs, gain))


def _linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer
