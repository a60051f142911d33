"""The running trial's metrics, from the real rig with its loops running."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from mrnav_server.app.rig import Rig
from mrnav_server.core.errors import RefusedError
from mrnav_server.settings import RecordingConfig, ServerConfig, Settings


async def no_report(folder: Path) -> dict[str, Any]:
    return {}


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    # Built before the event loop runs: painting the microscope's floor takes a while.
    server = ServerConfig(port=0, hand_port=0, operator_token="operator-token-for-tests")
    settings = Settings(server=server, recording=RecordingConfig(root=str(tmp_path))).with_tokens()
    return Rig(settings, report=no_report)


async def test_a_running_trial_has_metrics_and_its_condition_holds(rig: Rig) -> None:
    started = asyncio.Event()
    async with asyncio.timeout(60), asyncio.TaskGroup() as group:
        task = group.create_task(rig.run(started))
        await started.wait()
        trial = rig.trials.start("SIM01", "without_autonomy", "simulated", "")["id"]
        version = 0
        # Two tracks with the robot seen, at least.
        while (live := await rig.trials.live_metrics(trial)) is None or not (
            live["metrics"]["seen_share"] * live["elapsed_s"]
        ):
            _, version = await rig.frames.newer_than(version)
        assert (live["id"], live["reached"]) == (trial, False)
        assert live["metrics"]["min_clearance_um"] > 0.0
        assert await rig.trials.live_metrics("another") is None
        rig.console.take_lease("page", "a page")
        with pytest.raises(RefusedError, match="runs without autonomy: steer by hand"):
            await rig.console.ask("auto", "page", None)
        state, _ = await rig.states.newer_than(0)
        assert "without autonomy" in state.auto_refusal
        await rig.trials.end(trial)
        assert rig.trials.auto_refusal == ""
        assert await rig.trials.live_metrics(trial) is None
        task.cancel()
