"""The server killed with SIGKILL at random moments of a study's trials: what is missing, and what goes on.

Run from a checkout: ``mrnav bench crashes --json -- --count 100 --seed 1``. Every kill has a real server on
the simulated rig, a console and a hand that steers; the next server takes the study up. What is missing is
the time from the log's last line to the signal: all that the server may have done until then counts as lost.
Prints one JSON object. All simulated.
"""

import argparse
import json
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.core.errors import MrnavError, RefusedError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.trial_log import CLOSED_TOPIC, LOG_NAME, read_log
from mrnav_server.study.replay import replay_trial
from mrnav_server.study.trial_record import read_trial_record
from mrnav_server.study.trial_report import measured, route_graph
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.led_study import Kill, LedStudy, Moment

PROMISED_S = 0.25
_LATEST_S: dict[Moment, float] = {"begin": 0.4, "drive": 4.0, "end": 0.12}
_SHARES: dict[Moment, float] = {"begin": 0.25, "drive": 0.5, "end": 0.25}


@dataclass(frozen=True, slots=True)
class Left:
    """What a crash left on disk, before anybody mended it.

    Attributes:
        kill: The crash.
        problem: Why the log does not open, in words; "" if it does.
        closed: Whether the log had been closed before the signal.
        lines: Lines of the log.
        missing_s: From its last line to the signal.
        unseen_s: From its last line to the last state that a client had got; below 0 if that is in the log.
        measured: Whether metrics could be computed: not before the first picture.
        exact: Whether a replay is exact to where the log ends.
    """

    kill: Kill
    problem: str
    closed: bool = False
    lines: int = 0
    missing_s: float = 0.0
    unseen_s: float = 0.0
    measured: bool = False
    exact: bool = False


def look(kill: Kill, trial: Path) -> Left:
    """Open what a crash left, by every reader."""
    try:
        lines = list(read_log(trial / LOG_NAME))
        if not lines:
            return Left(kill, "the log has no line")
        replay = replay_trial(trial)
        metrics = _has_metrics(trial)
    except MrnavError as error:
        return Left(kill, str(error))
    last = lines[-1]
    return Left(
        kill,
        "",
        last.topic == CLOSED_TOPIC,
        len(lines),
        kill.at_s - last.t_s,
        kill.seen_s - last.t_s,
        metrics,
        replay.exact and not replay.changed,
    )


def _has_metrics(trial: Path) -> bool:
    try:
        record = read_trial_record(trial)
    except RefusedError:
        return False
    vessel, routes = _vessel(record.header.vessel)
    return bool(measured(record, record.clearance_um(vessel), vessel, routes))


@cache
def _vessel(name: str) -> tuple[VesselMap, GridGraph]:
    vessel = load_vessel_model(find_model(name))
    return vessel, route_graph(vessel)


def draw(random: np.random.Generator) -> tuple[Moment, float]:
    """Return a random moment of a trial."""
    moment: Moment = random.choice(list(_SHARES), p=list(_SHARES.values())).item()
    return moment, float(random.uniform(0.0, _LATEST_S[moment]))


def summary(left: list[Left], study: LedStudy, following: list[str]) -> dict[str, object]:
    """Return the figures.

    Args:
        left: What every crash of a running trial left.
        study: Where it lies.
        following: The step that was due after each.
    """
    missing_ms = [1e3 * each.missing_s for each in left if not each.problem]
    unseen_ms = [1e3 * max(each.unseen_s, 0.0) for each in left if not each.problem]
    marked = [study.status(each.kill.trial) == "interrupted" for each in left if each.kill.trial]
    return {
        "simulated": True,
        "kills": len(left),
        "opened": sum(not each.problem for each in left),
        "problems": [each.problem for each in left if each.problem],
        "lines_fewest": min(each.lines for each in left),
        "missing_ms": _spread(missing_ms),
        "missing_of_what_a_client_saw_ms": _spread(unseen_ms),
        "beyond_promised": sum(each > 1e3 * PROMISED_S for each in missing_ms),
        "measured": sum(each.measured for each in left),
        "replayed_exactly": sum(each.exact for each in left),
        "marked_interrupted": sum(marked),
        "step_repeated": sum(each.kill.step == step for each, step in zip(left, following, strict=True)),
    }


def _spread(values: list[float]) -> dict[str, float]:
    p50, p99 = np.percentile(values, [50, 99])
    return {"p50": round(float(p50), 1), "p99": round(float(p99), 1), "max": round(max(values), 1)}


def main() -> None:
    """Kill as often as told."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="kills of running trials")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    left: list[Left] = []
    following: list[str] = []
    outside: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        study = LedStudy(Path(folder), options.seed)
        while len(left) < options.count:
            moment, delay_s = draw(random)
            kill = study.kill(moment, delay_s)
            if len(following) < len(left):
                following.append(kill.step)
            if kill.trial is None:
                outside["before the trial"] += 1
                continue
            found = look(kill, kill.trial)
            print(f"{len(left) + 1}: {moment} + {delay_s:.2f} s: {found}", file=sys.stderr, flush=True)
            if found.closed:
                outside["after the trial"] += 1
            else:
                left.append(found)
        with study.server() as rig:
            following.append(rig.http.get("/api/v1/study").json()["step"]["id"])
        print(json.dumps(summary(left, study, following) | {"outside": dict(outside)}))


if __name__ == "__main__":
    main()
