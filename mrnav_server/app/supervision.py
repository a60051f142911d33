"""Who stops the manipulator when the rig ends, hangs or is killed."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from mrnav_server.app.bench import Bench
from mrnav_server.app.herald import Herald
from mrnav_server.core.errors import DeviceError
from mrnav_server.core.records import TipReading
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.stopping import Stopping
from mrnav_server.loops.supervisor import REPORT_NAME, StopReport, StopTarget, Supervisor, earlier_reports
from mrnav_server.settings import Settings

_REST_S = 1.0
_LOOK_S = 0.01
_log = logging.getLogger(__name__)


def tell_earlier_stops(root: Path) -> None:
    """Say in the log what a supervisor did after the server had died; each stop once.

    Args:
        root: Folder of all trials; the supervisor's report lies beside them.
    """
    try:
        reports = earlier_reports(root / REPORT_NAME)
    except OSError as error:
        _log.warning("what the supervisor did cannot be read: %s", error)
        return
    for report in reports:
        _log.warning("%s", report.sentence)


@asynccontextmanager
async def supervised(
    settings: Settings,
    bench: Bench,
    control: ControlLoop,
    herald: Herald,
    root: Path,
    clock: Callable[[], float],
) -> AsyncIterator[None]:
    """Have an open manipulator watched by a process of its own; one that dies with this process needs none.

    Args:
        settings: ``supervisor`` says when this process counts as hung.
        bench: Its manipulator is open.
        control: Beats at every step, and fails when the supervisor had to stop the manipulator.
        herald: Told what the supervisor did.
        root: Folder that gets the supervisor's report.
        clock: Monotonic time in seconds.
    """
    path = bench.stop_path
    if path is None or not settings.supervisor.enabled:
        yield
        return

    def on_report(report: StopReport) -> None:
        _log.warning("%s", report.sentence)
        herald.announce("fault", {"reason": report.sentence})

    target = StopTarget(*path.target, path.device_id)
    supervisor = Supervisor(settings.supervisor, target, root / REPORT_NAME, clock, control.fail, on_report)
    async with supervisor:
        around = control.surroundings
        around.beat, around.supervisor_fault = supervisor.beat, lambda: supervisor.refusal
        yield


async def come_to_rest(
    bench: Bench, tip_age_s: float, beat: Callable[[bool], None], clock: Callable[[], float]
) -> None:
    """Stop the manipulator, and again until its tip rests; after a second without rest, go on.

    Args:
        bench: Its manipulator is open.
        tip_age_s: A position older than this is unknown.
        beat: Tells the supervisor that this process still lives.
        clock: Monotonic time in seconds.
    """
    bench.manipulator.stop()
    began_s = clock()
    stopping = Stopping(tip_age_s)
    stopping.begin(began_s)
    while clock() - began_s < _REST_S:
        beat(stopping.pending)
        if bench.world_clock is not None:
            bench.world_clock.catch_up()
        if stopping.due(_tip(bench), clock(), latched=False):
            bench.manipulator.stop()
        if not stopping.pending:
            return
        await asyncio.sleep(_LOOK_S)
    _log.warning("the manipulator was not seen to rest before the server ended: look where the magnet is")


def _tip(bench: Bench) -> TipReading | None:
    try:
        return bench.manipulator.tip()
    except DeviceError:
        return None
