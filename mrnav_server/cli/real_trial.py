"""A simulated operator's trial in real time: server and operator as processes, the console in this one."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from mrnav_server.cli.children import Child, mrnav_child
from mrnav_server.cli.simulated_trial import SimulatedTrial, lead_trial
from mrnav_server.cli.trial_steps import wait_ready
from mrnav_server.client.waiting import REAL


def run_as_processes(trial: SimulatedTrial, root: Path) -> dict[str, Any]:
    """Run a trial in real time.

    Args:
        trial: What is to be done.
        root: Folder that gets the trial's own, and what the processes say; empty.

    Returns:
        As ``lead_trial``, and what the operator did.

    Raises:
        MrnavError: If the trial cannot even begin.
    """
    ready_file, said = root / "ready.json", root / "operator"
    arguments = ["serve", "--ready-file", str(ready_file)]
    with mrnav_child("the server", arguments, trial.environment(str(root)), root / "serve") as server:
        ready = wait_ready(ready_file, server)
        url, token = f"http://127.0.0.1:{ready['port']}", ready["operator_token"]
        led = lead_trial(trial, url, token, partial(_operator, trial, ready, url, server, said), REAL)
    return {**led, "operator": _last_json(said)}


@contextmanager
def _operator(
    trial: SimulatedTrial, ready: dict[str, Any], url: str, server: Child, said: Path, area: str
) -> Iterator[Callable[[], None]]:
    sit = ["operator", "--port", str(ready["hand_port"]), "--url", url, "--condition", trial.condition]
    sit += ["--seed", str(trial.operator), "--trial", str(trial.repetition), "--area", area, "--json"]
    token = {"MRNAV_SERVER__OPERATOR_TOKEN": ready["operator_token"]}
    with mrnav_child("the operator", sit, token, said) as operator:

        def alive() -> None:
            server.check()
            operator.check()

        yield alive


def _last_json(file: Path) -> dict[str, Any] | None:
    lines = [line for line in file.read_text(errors="replace").splitlines() if line.startswith("{")]
    last: dict[str, Any] | None = json.loads(lines[-1]) if lines else None
    return last
