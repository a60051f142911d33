"""Whether recorded trials replay exactly: of every kind, with and without faults, in virtual and real time.

Run from a checkout: ``mrnav bench replay --json -- --count 50``. They are replayed in another process. Some
are then replayed by other settings, another calibration and another policy: where that comes out differently,
it must be named as the reason. Prints one JSON object. All simulated.
"""

import argparse
import json
import multiprocessing
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path

import torch

import mrnav_server.vision.model_store as model_store
from benchmarks._scripted_trial import FAULTS, PLAIN, ScriptedTrial
from mrnav_server.autonomy.torchscript import INPUTS, OUTPUTS, export_policy
from mrnav_server.core.errors import MrnavError
from mrnav_server.loops.priority import compute_in_calling_threads
from mrnav_server.sim.operator import Condition
from mrnav_server.study.recording import read_recording
from mrnav_server.study.replay import Replay, replay_trial
from mrnav_server.study.trial_report import RESULT_NAME
from mrnav_server.vision.model_store import model_names, models_root
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.camera_rig import CameraRig
from tests.emulated_rig import EmulatedRig
from tests.rig_process import MRNAV, wait_for

VARIANTS: dict[str, dict[str, str]] = {
    "policy": {},
    "geodesic": {"MRNAV_AUTOPILOT__SOURCE": "geodesic"},
    "direct": {"MRNAV_AUTOPILOT__LAW": "direct"},
    "sampled": {"MRNAV_AUTOPILOT__GREEDY": "false"},
    "direct, sampled": {"MRNAV_AUTOPILOT__LAW": "direct", "MRNAV_AUTOPILOT__GREEDY": "false"},
    "shared": {"MRNAV_HANDOVER__SHARING__ENABLED": "true"},
    "stop first": {"MRNAV_HANDOVER__STYLE": "stop"},
    "as in the paper": {"MRNAV_HANDOVER__STYLE": "paper"},
}
"""Settings by name; they follow one another from trial to trial."""
OTHERWISE: dict[str, tuple[str, str, float]] = {
    "setting guards.track_age_s": ("guards", "track_age_s", 0.7),
    "setting handover.announce_s": ("handover", "announce_s", 0.5),
    "setting limits.autonomy_speed_um_per_s": ("limits", "autonomy_speed_um_per_s", 0.5),
    "setting hand.gain": ("hand", "gain", 0.8),
}
"""Settings that are changed: section, field, factor."""


def planned(number: int) -> ScriptedTrial:
    """Return a trial: model, condition, settings and what happens follow one another."""
    models, ways = model_names(), list(VARIANTS.values())
    script = FAULTS[(number // 2) % len(FAULTS)] if number % 2 else PLAIN
    condition: Condition = "without_autonomy" if number % 5 == 4 else "with_autonomy"
    return ScriptedTrial(models[number % len(models)], condition, script, ways[number % len(ways)])


def demonstrated(folder: Path, seed: int, manipulator: str) -> Path:
    """Run the demonstration in real time; return its trial."""
    command = [
        *MRNAV,
        "demo",
        "--seed",
        str(seed),
        "--manipulator",
        manipulator,
        "--trials",
        str(folder),
        "--json",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return Path(json.loads(done.stdout.strip().splitlines()[-1])["trial_dir"])


def rebooted(folder: Path) -> Path:
    """Have the emulated controller reboot in a trial, in real time; return the trial."""
    with EmulatedRig(folder) as emulated:
        emulated.prepare()
        body = {"participant": "SIM0", "condition": "with_autonomy", "operator_kind": "simulated"}
        begun = emulated.rig.post("/api/v1/trials", body)
        wait_for(lambda: _goes(emulated), 60.0, "motion in AUTO")
        emulated.emulator.turn(reboot=True)
        emulated.rig.until(lambda s: s["mode"] == "FAULT", "FAULT", 10.0)
        time.sleep(0.5)
        emulated.recover()
        emulated.rig.post(f"/api/v1/trials/{begun['id']}/end", {})
    return Path(begun["folder"])


def kept(folder: Path, happens: Callable[[Path], Path]) -> Path:
    """Return the finished trial in a folder; make it if there is none."""
    for result in folder.glob(f"**/{RESULT_NAME}"):
        return result.parent
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return happens(folder)


def make(number: int, root: Path) -> Path:
    """Make a planned trial in a folder of its own; one that is there already is left as it is."""
    compute_in_calling_threads()
    return kept(root / f"{number:03d}", lambda folder: scripted(number, folder))


def scripted(number: int, folder: Path) -> Path:
    """Run a planned trial in virtual time."""
    try:
        return planned(number).run(folder, number)
    except MrnavError as error:
        raise RuntimeError(f"trial {number} ({planned(number).script.name}): {error}") from None


def replayed(trials: dict[str, Path], workers: ProcessPoolExecutor) -> dict[str, Replay]:
    """Replay trials; return what came of each."""
    found: dict[str, Replay] = {}
    for title, replay in zip(trials, workers.map(replay_trial, trials.values()), strict=True):
        print(f"replayed {title}: {told(replay)}", file=sys.stderr, flush=True)
        found[title] = replay
    return found


def _goes(emulated: EmulatedRig) -> bool:
    """Tell whether AUTO was granted: on a busy machine somebody may seem to have acted meanwhile."""
    try:
        emulated.go()
    except AssertionError:
        return False
    return True


def unplugged(folder: Path) -> Path:
    """Have the simulated camera unplugged for a while in a trial, in real time; return the trial."""
    with CameraRig(folder) as filmed:
        trial = filmed.prepare()
        filmed.go()
        filmed.spoil("unplug")
        filmed.rig.until(lambda s: s["mode"] == "HOLD", "HOLD", 10.0)
        filmed.spoil("recover")
        filmed.rig.until(lambda s: s["track"]["state"] == "tracking", "the robot", 10.0)
        filmed.rig.post(f"/api/v1/trials/{trial}/end", {})
    return filmed.rig.trials / trial


def told(replay: Replay) -> str:
    """Return what came of a replay in a few words."""
    return "exact" if replay.exact else f"{replay.difference} {replay.changed}"


# -- what is not as it was ---------------------------------------------------------------------------------


REAL: dict[str, Callable[[Path], Path]] = {
    "demo": partial(demonstrated, seed=1, manipulator="simulated"),
    "demo again": partial(demonstrated, seed=2, manipulator="simulated"),
    "demo on an emulated controller": partial(demonstrated, seed=3, manipulator="sensapex-udp"),
    "emulated controller reboots": rebooted,
    "camera is unplugged": unplugged,
}
"""Trials in real time by what happens."""


def otherwise(trial: Path) -> Iterator[tuple[str, Replay]]:
    """Replay a trial by everything that is not as it was; yield what must be named, and what came of it."""
    recording = read_recording(trial)
    for name, (section, field, factor) in OTHERWISE.items():
        part = getattr(recording.settings, section)
        other = replace(part, **{field: factor * getattr(part, field)})
        yield name, replay_trial(trial, settings=recording.settings.model_copy(update={section: other}))
    then = recording.calibration
    x_um, y_um = then.magnet_offset_um
    yield "calibration", replay_trial(trial, calibration=replace(then, magnet_offset_um=(x_um + 40.0, y_um)))
    with other_policy(recording.header.vessel):
        yield f"policy of {recording.header.vessel}", replay_trial(trial)


@contextmanager
def other_policy(model: str) -> Iterator[None]:
    """Let a model have another policy, one that was never trained, for a ``with`` block."""
    here = models_root()
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        shutil.copytree(here / model, root / model)
        vessel = load_vessel_model(root / model)
        export_policy(torch.nn.Linear(INPUTS, OUTPUTS), root / model, vessel, "untrained", 0)
        vars(model_store)["models_root"] = lambda: root
        try:
            yield
        finally:
            vars(model_store)["models_root"] = models_root


def changes(trials: list[Path]) -> dict[str, dict[str, int]]:
    """Return for every change how often it led to another replay, and how often it was named then."""
    found: dict[str, dict[str, int]] = {}
    for trial in trials:
        for name, replay in otherwise(trial):
            row = found.setdefault(name, {"replays": 0, "named": 0, "different": 0, "difference_named": 0})
            named = any(reason.startswith(name) for reason in replay.changed)
            row["replays"] += 1
            row["named"] += named
            row["different"] += not replay.exact
            row["difference_named"] += not replay.exact and named
            print(f"{trial.name}, other {name}: {told(replay)}", file=sys.stderr, flush=True)
    return found


def main() -> None:
    """Make the trials and replay them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50, help="trials in virtual time")
    parser.add_argument("--workers", type=int, default=2, help="processes that make trials and replay them")
    parser.add_argument("--changed", type=int, default=5, help="trials that are replayed otherwise")
    parser.add_argument("--keep", type=Path, help="folder that keeps the trials, for the next run, too")
    parser.add_argument("--no-real-time", action="store_true")
    options = parser.parse_args()
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name, ProcessPoolExecutor(options.workers, spawn) as workers:
        root = options.keep or Path(name)
        made: dict[str, Path] = {}
        numbers = range(options.count)
        for number, folder in zip(numbers, workers.map(make, numbers, repeat(root)), strict=True):
            trial = planned(number)
            title = f"{number} {trial.model}, {trial.condition}, {trial.script.name}, {trial.variables}"
            made[title] = folder
            print(f"made {title}", file=sys.stderr, flush=True)
        real: dict[str, Path] = {}
        if not options.no_real_time:
            for title, happens in REAL.items():
                print(f"in real time: {title}", file=sys.stderr, flush=True)
                real[title] = kept(root / title.replace(" ", "-"), happens)
        # By processes that have made other trials, in another order: nothing is carried over.
        replays = replayed(made | real, workers)
        exact = {title: each.exact and not each.changed for title, each in replays.items()}
        result = {
            "simulated": True,
            "virtual_time": {"trials": len(made), "exact": sum(exact[title] for title in made)},
            "with_something_that_happened": sum("nothing" not in title for title in made),
            "real_time": {"trials": len(real), "exact": sum(exact[title] for title in real)},
            "steps": sum(each.counts["steps"] for each in replays.values()),
            "different": {title: told(replays[title]) for title, same in exact.items() if not same},
            "changed": changes(list(made.values())[: options.changed]),
        }
        print(json.dumps(result))


if __name__ == "__main__":
    main()
