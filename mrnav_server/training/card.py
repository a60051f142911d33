"""Model cards: what a policy is, how it was made, how well it does, and what it cannot do."""

import json
from typing import Any

import numpy as np
import torch

from mrnav_server.autonomy.torchscript import Identity
from mrnav_server.training.environment import ENVIRONMENT_ID
from mrnav_server.training.evaluate import Evaluation

CARD_FILE = "card.md"


def model_card(
    identity: Identity,
    what: str,
    command: str,
    recipe: dict[str, Any],
    facts: dict[str, Any],
    evaluations: tuple[Evaluation, Evaluation],
) -> str:
    """Return the model card, Markdown with YAML front matter.

    Args:
        identity: What the policy is.
        what: The same in a sentence without a full stop.
        command: What made it, in a sentence without a full stop.
        recipe: All settings.
        facts: More entries of the front matter.
        evaluations: Greedy and sampled.
    """
    greedy, sampled = evaluations
    front = {
        "name": identity.name,
        "model": identity.map_name,
        "map_sha256": identity.map_sha256,
        "kind": "torchscript",
        "preset": identity.preset,
        "seed": identity.seed,
        "simulated": True,
        "environment": ENVIRONMENT_ID,
        **facts,
        "torch": str(torch.__version__),
        "numpy": np.__version__,
        "success_greedy": round(greedy.success, 4),
        "success_sampled": round(sampled.success, 4),
        "spl_greedy": round(greedy.spl, 4),
        "spl_sampled": round(sampled.spl, 4),
        "evaluation_pairs": greedy.pairs,
        "evaluation_seed": greedy.seed,
        "licence": "Apache-2.0",
    }
    yaml = "\n".join(f"{key}: {json.dumps(value)}" for key, value in front.items())
    rows = "\n".join(
        f"| {e.mode} | {e.success:.1%} ({e.success_low:.1%} to {e.success_high:.1%}) | {e.spl:.3f} |"
        f" {e.wall_hits:.2f} | {e.steps:.0f} |"
        for e in evaluations
    )
    return f"""---
{yaml}
---
# {identity.name}

A navigation policy for the vessel model `{identity.map_name}`: {what}.
It maps position, start and target (6 numbers in grid pixels) to scores of 40 moves, and runs as TorchScript.

## Results (simulated)

{greedy.pairs} random pairs of start and target in the grid world that it was trained in, with 95 % Wilson
intervals. SPL is success weighted by shortest over travelled length. Greedy takes the best move with a memory
of direction; sample draws from the distribution, as in the published system.

| mode | success | SPL | wall hits a pair | steps |
|---|---|---|---|---|
{rows}

## How it was trained

{command}. The whole recipe:

```json
{json.dumps(recipe, indent=2)}
```

## Limits

- It knows this one map: the server refuses it on any other (`map_sha256`).
- It was trained in a grid world, without magnet, friction or tracking noise; on the rig it plans the path,
  and the follower makes the robot keep to it.
- It was tested in simulation alone. It is a research tool, not a medical device.
"""
