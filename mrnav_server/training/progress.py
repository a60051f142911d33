"""What training says of itself while it runs."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Report:
    """One line of progress.

    Attributes:
        stage: ``"plan"``, ``"clone"``, ``"reinforce"`` or ``"evaluate"``.
        done: Share of the stage that is done, 0..1.
        steps: Environment steps so far.
        success: Share of the newest episodes that arrived; None before any ended.
        reward: Mean reward per step lately; None outside reinforcement learning.
        loss: Newest loss.
    """

    stage: str
    done: float
    steps: int = 0
    success: float | None = None
    reward: float | None = None
    loss: float | None = None


Progress = Callable[[Report], None]
