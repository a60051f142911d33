"""A finished trial's report, made by a process of its own: its imports and plots never stall the rig."""

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from mrnav_server.core.errors import MrnavError
from mrnav_server.loops.priority import make_ordinary

_PATIENCE_S = 120.0


Report = Callable[[Path], Awaitable[dict[str, Any]]]
"""Writes a finished trial's report into its folder and returns the result; raises ReportError."""


class ReportError(MrnavError):
    """A report could not be made. Reaction: the trial's log stays, and the reason is told."""


async def trial_report(folder: Path) -> dict[str, Any]:
    """Run ``mrnav report`` on a trial and return its result.

    Args:
        folder: The trial's folder; ``result.json`` and ``trajectory.png`` are written there.

    Raises:
        ReportError: If it fails or takes too long, with its last line.
    """
    command = (sys.executable, "-m", "mrnav_server.cli.main", "report", str(folder), "--json")
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    make_ordinary(process.pid)
    try:
        async with asyncio.timeout(_PATIENCE_S):
            out, complaint = await process.communicate()
    except TimeoutError:
        raise ReportError(f"the report took longer than {_PATIENCE_S:.0f} s") from None
    finally:
        if process.returncode is None:
            process.kill()
    if process.returncode != 0:
        lines = complaint.decode(errors="replace").strip().splitlines()
        raise ReportError(lines[-1] if lines else f"mrnav report ended with {process.returncode}")
    result: dict[str, Any] = json.loads(out.decode().strip().splitlines()[-1])
    return result
