"""The robustness table: one policy in worlds that it was not trained in."""

from mrnav_server.autonomy.policy import Policy
from mrnav_server.training.evaluate import Evaluation, Mode, Task
from mrnav_server.training.rollout import Disturbance

WORLDS = (
    Disturbance(),
    Disturbance(noise_px=10.0),
    Disturbance(delay_steps=6),
    Disturbance(scale=0.5),
    Disturbance(scale=1.5),
)
"""The rows of the table."""
MODES: tuple[Mode, ...] = ("greedy", "sample")
ROBUST_SUCCESS = 0.995
"""What every row should reach."""


def robustness(policy: Policy, task: Task) -> list[Evaluation]:
    """Evaluate a policy in every world, greedy and sampled, on the same pairs."""
    return [task.run(policy, mode, world)[0] for mode in MODES for world in WORLDS]


def markdown(rows: list[Evaluation]) -> str:
    """Return the table for people, in Markdown."""
    lines = [
        f"{rows[0].policy} on {rows[0].vessel}, {rows[0].pairs} pairs, seed {rows[0].seed} (simulated)",
        "",
        "| mode | world | success (95 % CI) | SPL | wall hits a pair | steps / fewest |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row.mode} | {row.disturbance} | {row.success:.2%} ({row.success_low:.2%} to"
        f" {row.success_high:.2%}) | {row.spl:.3f} | {row.wall_hits:.2f} | {row.steps_ratio:.2f} |"
        for row in rows
    ]
    return "\n".join(lines)
