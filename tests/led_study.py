"""A study that is led through by one server after the other; each is killed in the middle of a trial."""

import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import httpx

from mrnav_server.loops.trial_log import list_trials
from mrnav_server.study.plan import new_plan
from mrnav_server.study.study_folder import StudyFolder
from tests.emulated_rig import SMALL
from tests.hand_client import HandClient
from tests.rig_process import RigProcess, wait_for

Moment = Literal["begin", "drive", "end"]
"""The trial is asked for; it has begun; its end is asked for."""
_SPEED_M_PER_S = 0.02
_DRIVE_S = 1.0
_ASK_S = 0.05


@dataclass(frozen=True, slots=True)
class Kill:
    """A server that was killed in a trial.

    Attributes:
        step: The study's step that was under way.
        again: Whether it had been interrupted before.
        trial: The folder of its trial; None if none had begun.
        at_s: When the signal was sent, monotonic.
        seen_s: The time of the last state that a client had got, monotonic.
    """

    step: str
    again: bool
    trial: Path | None
    at_s: float
    seen_s: float


class LedStudy:
    """A study of one code on one model, whose trials nobody finishes.

    Args:
        folder: For the study and the servers' files.
        seed: Of the plan: which condition comes first.
    """

    def __init__(self, folder: Path, seed: int = 0) -> None:
        self._folder = folder
        self._servers = 0
        plan = new_plan(1, ["bifurcation"], 99, seed, training_s=0.0)
        self.study = StudyFolder.create(folder / "study", plan).folder
        self._steps = {step.id: step for step in plan.steps}

    def status(self, trial: Path) -> str:
        """Return what a trial is said to be."""
        return next(info.status for info in list_trials(trial.parent) if info.id == trial.name)

    def kill(self, moment: Moment, delay_s: float) -> Kill:
        """Start a server, begin the study's next trial, steer by hand, and kill the server.

        Args:
            moment: What the signal is timed from.
            delay_s: How long after it.
        """
        with self.server() as rig:
            self._prepare(rig)
            due = rig.http.get("/api/v1/study").json()
            step = due["step"]["id"]
            before = self._trials()
            reached: dict[Moment, threading.Event] = {
                "begin": threading.Event(),
                "drive": threading.Event(),
                "end": threading.Event(),
            }
            player = threading.Thread(target=self._play, args=(rig, step, moment == "end", reached))
            player.start()
            assert reached[moment].wait(60.0), f"the trial did not come to {moment}"
            time.sleep(delay_s)
            at_s = time.monotonic()
            rig.process.kill()
            rig.process.wait(10.0)
            player.join(60.0)
            seen_s = float(rig.state["t"])
        begun = self._trials() - before
        return Kill(step, due["again"], begun.pop() if begun else None, at_s, seen_s)

    def server(self) -> "_Server":
        """Return the next server of this study, for a ``with`` block."""
        self._servers += 1
        folder = self._folder / f"server-{self._servers}"
        folder.mkdir()
        return _Server(folder, self.study)

    def _trials(self) -> set[Path]:
        root = self.study / "trials"
        return {log.parent for log in root.glob("*/log.jsonl")}

    def _prepare(self, rig: RigProcess) -> None:
        rig.post("/api/v1/lease", {"client": "crashes"})
        rig.until(lambda s: s["track"]["state"] == "tracking", "finding the robot")
        site = rig.snapshot["vessel"]["suggested_areas"][-1]
        center = {"frame": "vessel", "x": site["x_px"], "y": site["y_px"]}
        rig.post("/api/v1/critical-areas", {"center": center, "epsilon_um": 500.0})
        if rig.http.get("/api/v1/study").json()["step"]["kind"] == "training":
            rig.post("/api/v1/study/next", {})
            rig.post("/api/v1/study/finish", {})

    def _play(self, rig: RigProcess, step: str, ends: bool, reached: dict[Moment, threading.Event]) -> None:
        """Do the trial until the server dies."""
        with (
            suppress(AssertionError, OSError, httpx.HTTPError, ValueError),
            HandClient(rig.ready["hand_port"], rig.ready["operator_token"]) as hand,
        ):
            reached["begin"].set()
            rig.post("/api/v1/study/next", {})
            reached["drive"].set()
            began_s = time.monotonic()
            wait_for(lambda: rig.http.post("/api/v1/mode", json={"ask": "arm"}).is_success, 5.0, "arming")
            if self._steps[step].condition == "with_autonomy":
                rig.http.post("/api/v1/mode", json={"ask": "auto"})
            while rig.process.poll() is None:
                towards = 1.0 if (time.monotonic() - began_s) % 2.0 < 1.0 else -1.0
                if rig.state["mode"] != "AUTO":
                    hand.close_clutch((towards * _SPEED_M_PER_S, 0.0, 0.0))
                if ends and time.monotonic() - began_s > _DRIVE_S:
                    reached["end"].set()
                    rig.post("/api/v1/study/finish", {})
                    ends = False
                time.sleep(_ASK_S)


class _Server:
    def __init__(self, folder: Path, study: Path) -> None:
        self._folder = folder
        self._study = study

    def __enter__(self) -> RigProcess:
        self._rig = RigProcess(self._folder, arguments=["--study", str(self._study)], **SMALL)
        return self._rig

    def __exit__(self, *_: object) -> None:
        self._rig.end()
