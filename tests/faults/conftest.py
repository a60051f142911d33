from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.rig_process import RigProcess


@pytest.fixture
def rig_process(tmp_path: Path) -> Iterator[RigProcess]:
    rig = RigProcess(tmp_path)
    yield rig
    rig.end()
