"""Makes a vessel model from a picture, trains a policy for it, and has the rig use it."""

import asyncio
import json
import math
import re
import shutil
import threading
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from mrnav_server.app.model_shelf import ModelShelf
from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.training_job import Job
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.modes import ARMED
from mrnav_server.core.records import Frame
from mrnav_server.vision.model_store import find_model, model_names
from mrnav_server.vision.vessel_model import load_vessel_model

PRESETS = ("best", "paper+", "paper")
_POLICY_FILES = ("policy.pt", "manifest.json", "card.md")
_MODEL_FILES = ("mask.png", "model.json", "preview.png", "report.json")
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_CLONED = {"plan": (0.0, 0.25), "clone": (0.25, 0.74), "reinforce": (0.74, 0.97), "evaluate": (0.97, 1.0)}
_REINFORCED = {"plan": (0.0, 0.0), "reinforce": (0.0, 0.97), "evaluate": (0.97, 1.0)}
"""From which to which share of the whole training each stage goes, with the planner cloned first or not."""
_TELLING_SHARE = 0.02
"""Before that much is done, the time left would be a guess."""


@dataclass(frozen=True, slots=True)
class Work:
    """What a job is for.

    Attributes:
        kind: ``"import"`` or ``"training"``.
        model: The vessel model.
        out: Where its results go.
        preset: Of a training.
        seed: Of a training.
        began_s: When it began.
    """

    kind: str
    model: str
    out: Path
    preset: str
    seed: int
    began_s: float


class TrainingDesk:
    """Runs one job at a time, whoever asks; a page that is loaded again finds it where it is.

    Args:
        shelf: The models that there are; its folder gets one folder per model made here.
        live: The microscope's newest picture, and how many µm one of its pixels is.
        objection: Why nothing may be begun or changed now, or "".
        use: Has the rig go by the policy in a folder.
        fits: Whether a model's folder holds the vessel in use.
        clock: Monotonic time in seconds.
    """

    def __init__(
        self,
        shelf: ModelShelf,
        live: Callable[[], tuple[Frame | None, float]],
        objection: Callable[[], str],
        use: Callable[[Path], Awaitable[None]],
        fits: Callable[[Path], bool],
        clock: Callable[[], float],
    ) -> None:
        self._shelf = shelf
        self._live = live
        self._objection = objection
        self._use = use
        self._fits = fits
        self._clock = clock
        self._work: Work | None = None
        self._job: Job | None = None
        self._used = ""
        self._turn = threading.Lock()

    def state(self) -> dict[str, Any]:
        """Describe what there is, what runs, and how it went. Reads the disk."""
        phase = self._phase()
        found: dict[str, Any] = {
            "phase": phase,
            "models": self._shelf.describe(),
            "presets": PRESETS,
            "objection": self._objection(),
            "refusal": "",
            "used": self._used,
        }
        work, job = self._work, self._job
        if work is None or job is None:
            return found
        found |= {"kind": work.kind, "model": work.model, "refusal": "" if job.cancelled else job.failure}
        if work.kind == "training":
            found |= {"preset": work.preset, "seed": work.seed, "progress": self._progress(work, job)}
        if phase == "imported":
            found["report"] = json.loads((work.out / "report.json").read_text())
        if phase == "trained":
            found["evaluation"] = job.told
        return found

    def import_picture(self, name: str, picture: bytes, suffix: str, um_per_px: float, polarity: str) -> None:
        """Make a model from a picture file.

        Raises:
            RefusedError: If it must not be begun now, or the name cannot be used.
        """
        with self._turn:
            folder = self._fresh_folder(name)
            photograph = folder / f"photograph{suffix}"
            photograph.write_bytes(picture)
            arguments = ["map", "import", str(photograph), f"--um-per-px={um_per_px!r}", f"--name={name}"]
            arguments += [f"--polarity={polarity}", f"--out={folder}"]
            self._begin(Work("import", name, folder, "", 0, self._clock()), arguments)

    def import_live(self, name: str, polarity: str) -> None:
        """Make a model from the microscope's newest picture.

        Raises:
            RefusedError: Without a picture; else as `import_picture`.
        """
        frame, um_per_px = self._live()
        if frame is None:
            raise RefusedError("no_frame", "the camera has given no picture yet")
        _, png = cv2.imencode(".png", frame.image)
        self.import_picture(name, png.tobytes(), ".png", um_per_px, polarity)

    def train(self, model: str, preset: str, seed: int, pairs: int, settings: Sequence[str]) -> None:
        """Train a policy for a model, and evaluate it.

        Args:
            model: One of the models that there are.
            preset: A recipe.
            seed: Of everything random.
            pairs: Random pairs of start and target of the evaluation.
            settings: Changed hyper-parameters, each ``name=value``.

        Raises:
            RefusedError: If it must not be begun now, or there is no such model.
        """
        with self._turn:
            self._require_quiet()
            folder = self._own_copy(model)
            out = folder / f"{preset.replace('+', '-plus')}-{seed}"
            arguments = ["train", str(folder), f"--preset={preset}", f"--seed={seed}", f"--out={out}"]
            arguments += [f"--pairs={pairs}", "--progress", "--json", *(f"--set={each}" for each in settings)]
            self._begin(Work("training", model, out, preset, seed, self._clock()), arguments)

    @property
    def running(self) -> bool:
        """Whether an import or a training runs."""
        return self._job is not None and self._job.running

    def cancel(self) -> None:
        """End what runs; what it made so far is not used. Waits until it has ended."""
        if self._job is not None and self._job.running:
            self._job.end()

    async def use(self) -> None:
        """Make the policy that was trained last the model's own; go by it if its vessel is the one in use.

        Raises:
            RefusedError: Without one, while the rig is armed, or if it cannot be used.
        """
        self._require_quiet()
        work = self._work
        if work is None or self._phase() != "trained":
            raise RefusedError("no_policy", "no policy was trained yet")
        folder = work.out.parent
        fits = await asyncio.to_thread(self._fits, folder)
        if fits:
            await self._use(work.out)
        for name in _POLICY_FILES:
            await asyncio.to_thread(shutil.copyfile, work.out / name, folder / name)
        now = "It drives from now on" if fits else "Choose this vessel under Registration to drive with it"
        self._used = f'{now}. To start the server with it, set rig.vessel = "{folder}".'

    def preview(self, model: str) -> Path:
        """Return the picture of what was found in a model's photograph.

        Raises:
            RefusedError: If there is none.
        """
        path = self._shelf.root / model / "preview.png"
        if not _NAME.fullmatch(model) or not path.is_file():
            raise RefusedError("no_such_model", f"there is no preview of a vessel model {model!r}")
        return path

    def _phase(self) -> str:
        if self._job is None or self._work is None or self._job.cancelled:
            return "idle"
        running, done = {"import": ("importing", "imported"), "training": ("training", "trained")}[
            self._work.kind
        ]
        return running if self._job.running else ("failed" if self._job.failure else done)

    def _progress(self, work: Work, job: Job) -> dict[str, Any]:
        """Return the stage, the share of the whole, the success rate and the time left."""
        stage, told = job.told.get("stage", "plan"), job.told
        begin, end = (_CLONED if work.preset == "best" else _REINFORCED)[stage]
        share = begin + (end - begin) * float(told.get("done", 0.0))
        spent_s = self._clock() - work.began_s
        left_s = round(spent_s * (1.0 - share) / share) if share > _TELLING_SHARE else None
        return {"stage": stage, "share": round(share, 3), "success": told.get("success"), "left_s": left_s}

    def _fresh_folder(self, name: str) -> Path:
        self._require_quiet()
        if not _NAME.fullmatch(name):
            raise RefusedError(
                "bad_name", "a name has small letters, digits, - and _, 64 at most, a letter or digit first"
            )
        folder = self._shelf.root / name
        if name in model_names() or any(folder.glob("**/policy.pt")):
            raise RefusedError(
                "name_taken", f"there is a vessel model {name} with a policy: name it otherwise"
            )
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _own_copy(self, model: str) -> Path:
        """Return the folder of a model below the root; a model from elsewhere is copied there."""
        if model not in self._shelf.names():
            raise RefusedError("no_such_model", f"there is no vessel model {model!r}")
        folder = self._shelf.root / model
        if not (folder / "model.json").is_file():
            source = find_model(model)
            folder.mkdir(parents=True, exist_ok=True)
            for name in _MODEL_FILES:
                if (source / name).is_file():
                    shutil.copyfile(source / name, folder / name)
        return folder

    def _require_quiet(self) -> None:
        if self.running:
            raise RefusedError("busy", "another import or training runs: wait for it, or cancel it")
        if why := self._objection():
            raise RefusedError("not_now", why)

    def _begin(self, work: Work, arguments: Sequence[str]) -> None:
        self._used = ""
        self._work, self._job = work, Job(arguments)


def training_desk(rig: RigPort, shelf: ModelShelf) -> TrainingDesk:
    """Return the desk of a rig. Touches no file and starts nothing."""

    def objection() -> str:
        state = rig.states.value
        if state is not None and state.trial is not None:
            return "A trial runs: end it first, so that nothing computes beside it."
        if state is not None and state.mode in ARMED:
            return "The rig is armed: disarm it first, so that nothing computes beside it."
        return ""

    def fits(folder: Path) -> bool:
        try:
            return load_vessel_model(folder).digest == rig.vessel.digest
        except ConfigError:
            return False

    def live() -> tuple[Frame | None, float]:
        to_image = rig.calibration.image_from_vessel
        px_per_px = math.sqrt(abs(to_image.a * to_image.d - to_image.b * to_image.c))
        return rig.frames.value, rig.calibration.um_per_px / px_per_px

    return TrainingDesk(shelf, live, objection, rig.use_policy, fits, time.monotonic)
