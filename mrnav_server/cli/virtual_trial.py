"""A simulated operator's trial in virtual time: server, console and operator in this process."""

import asyncio
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from mrnav_server.app.ready import Ready
from mrnav_server.app.reporting import ReportError
from mrnav_server.app.virtual_run import run_in_virtual_time
from mrnav_server.cli.console import TrialFailedError
from mrnav_server.cli.operator import Desk, Seat
from mrnav_server.cli.simulated_trial import SimulatedTrial, lead_trial
from mrnav_server.core.errors import MrnavError
from mrnav_server.loops.trial_log import LOG_NAME, read_header
from mrnav_server.settings import load_settings
from mrnav_server.sim.operator import SimulatedOperator
from mrnav_server.sim.operator_model import OperatorModel, personal, practised
from mrnav_server.sim.virtual_time import AtOnce, VirtualTimeLoop
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

_LOOK_S = 0.02


def run_in_this_process(trial: SimulatedTrial, root: Path) -> dict[str, Any]:
    """Run a trial in virtual time.

    Args:
        trial: What is to be done.
        root: Folder that gets the trial's own; empty.

    Returns:
        As ``lead_trial``, and what the operator did.

    Raises:
        MrnavError: If the trial cannot even begin.
    """
    settings = load_settings(None, {**os.environ, **trial.environment(str(root))})
    operator: dict[str, Any] = {}

    def play(ready: Ready, loop: VirtualTimeLoop) -> dict[str, Any]:
        url = f"http://127.0.0.1:{ready.port}"
        sit_down = partial(_operator, trial, ready, url, loop, operator)
        return lead_trial(trial, url, ready.operator_token, sit_down, loop.waiting)

    led = run_in_virtual_time(settings, report_here, play)
    return {**led, "operator": operator}


async def report_here(folder: Path) -> dict[str, Any]:
    """Write a trial's report in this process.

    Raises:
        ReportError: If it fails.
    """
    from mrnav_server.study.trial_report import write_trial_report

    try:
        vessel = load_vessel_model(find_model(read_header(folder / LOG_NAME).vessel))
        return await asyncio.to_thread(write_trial_report, folder, vessel)
    except MrnavError as error:
        raise ReportError(str(error)) from None


@contextmanager
def _operator(
    trial: SimulatedTrial, ready: Ready, url: str, loop: VirtualTimeLoop, result: dict[str, Any], area: str
) -> Iterator[Callable[[], None]]:
    """Have the operator sit at the hand link for a ``with`` block; note what it did in ``result``."""
    model = practised(personal(OperatorModel(), trial.operator), trial.practice)
    desk = Desk(
        Seat("127.0.0.1", ready.hand_port, url, ready.operator_token, area),
        SimulatedOperator(model, trial.noise, trial.condition),
        AtOnce(),
        loop.waiting,
    )
    work = partial(desk.work, trial.operator, trial.condition, once=False)
    working = loop.run_in_executor(None, work)

    def alive() -> None:
        if working.done():
            raise TrialFailedError(f"the operator ended: {working.exception() or 'by itself'}")

    try:
        yield alive
    finally:
        desk.leave()
        while not working.done():
            loop.waiting.sleep(_LOOK_S)
        working.exception()
        result.update(desk.result(trial.operator, trial.condition))
