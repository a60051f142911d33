"""Checkpoints: everything that an interrupted training needs to go on to the same policy, bit for bit."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mrnav_server.core.errors import ConfigError

CHECKPOINT_FILE = "checkpoint.pt"


def save_checkpoint(folder: Path, state: dict[str, Any]) -> None:
    """Write a state; a crash meanwhile leaves the former checkpoint whole.

    Args:
        folder: Where ``checkpoint.pt`` goes; it must exist.
        state: Nested dictionaries and lists of numbers, strings, tensors and arrays.
    """
    buffer = io.BytesIO()
    torch.save(_to_torch(state), buffer)
    part = folder / (CHECKPOINT_FILE + ".part")
    part.write_bytes(buffer.getvalue())
    part.replace(folder / CHECKPOINT_FILE)


def load_checkpoint(folder: Path) -> dict[str, Any]:
    """Read what `save_checkpoint` wrote; nothing in the file is run.

    Raises:
        ConfigError: If there is no checkpoint, or it cannot be read.
    """
    path = folder / CHECKPOINT_FILE
    try:
        state = torch.load(path, weights_only=True)
    except FileNotFoundError:
        raise ConfigError(f"{path} is missing: --resume takes the output folder of a training") from None
    except Exception as error:  # noqa: BLE001 (torch names no common class for a file that is not its own)
        raise ConfigError(f"{path} is not a checkpoint ({str(error).splitlines()[0]})") from None
    restored: dict[str, Any] = _from_torch(state)
    return restored


def _to_torch(value: Any) -> Any:  # noqa: ANN401 (a tree of anything)
    """Replace arrays by tensors, and whole numbers beyond 64 bits (of random generators) by text."""
    if isinstance(value, dict):
        return {key: _to_torch(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return {"__array__": torch.from_numpy(value.copy())}
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 2**63:
        return {"__json__": json.dumps(value)}
    return value


def _from_torch(value: Any) -> Any:  # noqa: ANN401 (a tree of anything)
    if not isinstance(value, dict):
        return value
    if "__array__" in value:
        return value["__array__"].numpy()
    if "__json__" in value:
        return json.loads(value["__json__"])
    return {key: _from_torch(entry) for key, entry in value.items()}
