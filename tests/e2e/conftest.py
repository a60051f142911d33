from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from tests.emulated_rig import PATIENT
from tests.rig_process import RigProcess

CALM = PATIENT | {
    "MRNAV_GUARDS__TRACK_AGE_S": "0.5",
    "MRNAV_GUARDS__CONSOLE_S": "2.0",
    "MRNAV_HAND__HOLD_S": "0.2",
}
"""A busy machine must not look like a hand, a robot or a page that is silent."""
expect.set_options(timeout=20_000)


def came(rig: RigProcess, condition: Callable[[dict[str, Any]], bool], within_s: float = 5.0) -> bool:
    """Wait for a state; tell whether it came."""
    try:
        rig.until(condition, "it", within_s)
    except AssertionError:
        return False
    return True


@pytest.fixture
def rig_process(tmp_path: Path) -> Iterator[RigProcess]:
    rig = RigProcess(tmp_path)
    yield rig
    rig.end()
