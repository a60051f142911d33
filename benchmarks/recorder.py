"""What a message costs the control loop's thread to record, and the writer's thread to encode.

Run from a checkout: ``mrnav bench recorder --json``. The real control loop drives the simulated world in real
time, so that the messages are its own, and come from caches as cold as a server's. Prints one JSON object.
All simulated.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter_ns

import numpy as np

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.modes import Mode
from mrnav_server.loops.trial_log import log_line
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.study.recorded_rig import RecordedRig, drive

_TICK_S = 0.01
_TURN_S = 1.0
_HAND_M_PER_S = 0.03


class TimedRecord:
    """Stands in for a recorder's ``record`` and times it.

    Args:
        rig: Whose recorder it is.
    """

    def __init__(self, rig: RecordedRig) -> None:
        self._record = rig.recorder.record
        self.took_us: dict[str, list[float]] = {}
        self.messages: list[tuple[str, Mapping[str, object]]] = []
        rig.recorder.record = self.record  # type: ignore[method-assign]

    def record(self, topic: str, data: Mapping[str, object]) -> None:
        """Record one message."""
        began_ns = perf_counter_ns()
        self._record(topic, data)
        took_ns = perf_counter_ns() - began_ns
        self.took_us.setdefault(topic, []).append(1e-3 * took_ns)
        self.messages.append((topic, data))


def spread(values_us: list[float]) -> dict[str, float]:
    """Return how values lie."""
    p50, p99 = np.percentile(values_us, [50, 99])
    mean = float(np.mean(values_us))
    return {
        "n": len(values_us),
        "mean": round(mean, 2),
        "p50": round(float(p50), 2),
        "p99": round(float(p99), 2),
    }


def encoding_us(messages: list[tuple[str, Mapping[str, object]]]) -> list[float]:
    """Return what each message takes to encode."""
    took_us = []
    for number, (topic, data) in enumerate(messages):
        began_ns = perf_counter_ns()
        log_line(number, 1.0, 1.0, topic, data)
        took_us.append(1e-3 * (perf_counter_ns() - began_ns))
    return took_us


def main() -> None:
    """Record a trial in AUTO, then by hand."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    vessel = load_vessel_model(find_model("bifurcation"))
    with tempfile.TemporaryDirectory() as folder:
        rig = RecordedRig(Path(folder), vessel, PathPlanner(vessel))
        rig.advance(0.5)
        drive(rig)
        timed = TimedRecord(rig)
        due_s = time.monotonic()
        for tick in range(round(options.seconds / _TICK_S)):
            rig.clutch = rig.is_in(Mode.MANUAL)
            forth = (tick * _TICK_S) % (2 * _TURN_S) < _TURN_S
            rig.hand_x_m += (1.0 if forth else -1.0) * _HAND_M_PER_S * _TICK_S
            rig.tick()
            due_s += _TICK_S
            time.sleep(max(due_s - time.monotonic(), 0.0))
        rig.end()
    every = [each for values in timed.took_us.values() for each in values]
    print(
        json.dumps(
            {
                "simulated": True,
                "messages_per_s": round(len(every) / options.seconds, 1),
                "control_thread_us": spread(every),
                "by_topic_us": {topic: spread(values) for topic, values in timed.took_us.items()},
                "writer_thread_encoding_us": spread(encoding_us(timed.messages)),
            }
        )
    )


if __name__ == "__main__":
    main()
