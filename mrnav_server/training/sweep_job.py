"""One job of a sweep: a function of its spec that leaves a folder. It runs in a process of its own.

The result is written last and at once, so that a folder with a result is complete and any other is redone.
"""

import json
import platform
import shutil
import traceback
from pathlib import Path
from typing import Any

from mrnav_server.core.errors import ConfigError
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import read_model_json

SPEC_FILE = "spec.json"
RESULT_FILE = "result.json"
ERROR_FILE = "error.txt"


def run_job(spec: dict[str, Any], folder: Path) -> None:
    """Train and evaluate as a spec says, and leave the result, or the error, in a folder.

    Does nothing if the result is there. What a killed run left is removed first.

    Args:
        spec: See `training.sweep.Job.spec`.
        folder: Named by the spec's hash.
    """
    if read_result(folder) is not None:
        return
    clear(folder)
    folder.mkdir(parents=True)
    (folder / SPEC_FILE).write_text(json.dumps(spec, indent=2) + "\n")
    try:
        figures = _train(spec, folder)
    except Exception:  # noqa: BLE001 - whatever ends a job is told, and the other jobs go on
        _write(folder / ERROR_FILE, traceback.format_exc())
        return
    _write(
        folder / RESULT_FILE, json.dumps({"spec": spec, **figures, "host": platform.node()}, indent=2) + "\n"
    )


def read_result(folder: Path) -> dict[str, Any] | None:
    """Return a job's result, or None if the job is not done."""
    try:
        result: dict[str, Any] = json.loads((folder / RESULT_FILE).read_text())
    except FileNotFoundError:
        return None
    return result


def read_error(folder: Path) -> str | None:
    """Return the last line of a failed job's error, or None if the job did not fail."""
    try:
        return (folder / ERROR_FILE).read_text().strip().splitlines()[-1]
    except FileNotFoundError:
        return None


def clear(folder: Path) -> None:
    """Remove a job's folder, if it is there."""
    shutil.rmtree(folder, ignore_errors=True)


def assignments(settings: dict[str, Any]) -> list[str]:
    """Return hyper-parameters as ``mrnav train --set`` takes them, each ``name=value``."""
    return [
        f"{name}={str(value).lower() if isinstance(value, bool) else value}"
        for name, value in settings.items()
    ]


def _train(spec: dict[str, Any], folder: Path) -> dict[str, Any]:
    from mrnav_server.training.train import train

    model = find_model(spec["model"])
    if read_model_json(model)["mask_sha256"] != spec["map_sha256"]:
        raise ConfigError(f"vessel model {spec['model']}: {model} on {platform.node()} holds another mask")
    changed = assignments(spec["set"])
    result = train(
        model,
        spec["preset"],
        spec["seed"],
        folder,
        pairs=spec["pairs"],
        algorithm=spec["algo"],
        settings=changed,
    )
    record = result.record()
    del record["folder"]  # The same wherever the job ran.
    return record


def _write(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    draft = path.with_suffix(".draft")
    draft.write_text(text)
    draft.replace(path)
