"""What the rig does when its camera fails while the policy drives: named, held, and well again by itself.

Orders and reasons only, under a generous ceiling; `mrnav bench faults` measures the milliseconds.
"""

import re
from collections.abc import Iterator

import pytest

from tests.camera_rig import CameraRig

CEILING_S = 2.0
REASONS = {
    "freeze": "frozen|last seen",
    "black": "black|last seen",
    "end": "ended|last seen",
    "half": "slow|missing|last seen",
    "unplug": "unplugged|last seen",
}


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CameraRig]:
    with CameraRig(tmp_path_factory.mktemp("camera")) as rig:
        rig.prepare()
        yield rig


@pytest.mark.parametrize("fault", REASONS)
def test_auto_holds_for_a_reason_and_may_go_on_without_a_restart(filmed: CameraRig, fault: str) -> None:
    rig = filmed.rig
    filmed.go()
    spoilt_s = filmed.spoil(fault)
    rig.until(lambda s: s["mode"] == "HOLD", "HOLD", CEILING_S)
    held = next(e for e in reversed(rig.events) if e["event"] == "mode" and e["mode"] == "HOLD")
    assert held["before"] == "AUTO"
    assert re.search(REASONS[fault], held["reason"]), held["reason"]
    assert 0.0 < held["t"] - spoilt_s < CEILING_S
    rig.until(lambda s: not s["auto_ready"], "AUTO to be refused", CEILING_S)
    assert rig.http.post("/api/v1/mode", json={"ask": "auto"}).status_code == 409
    assert rig.http.get("/healthz").is_success
    filmed.spoil("recover")
    filmed.go()
    rig.ask("hold")
    rig.until(lambda s: s["mode"] == "HOLD", "HOLD", CEILING_S)
