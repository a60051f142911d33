"""Feeds a log's inputs through the deciders and compares what they decide, line by line."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NoReturn

import numpy as np
import orjson

from mrnav_server.autonomy.grid_graph import DistanceField
from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.hand import HandControl
from mrnav_server.core.modes import Ask, Transition
from mrnav_server.core.records import CriticalArea
from mrnav_server.loops.autopilot import Autopilot
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.surroundings import Outlook
from mrnav_server.loops.trial_fields import hand_sample, track_of
from mrnav_server.loops.trial_log import CLOSED_TOPIC, LogLine
from mrnav_server.loops.trial_marks import TrialMarks
from mrnav_server.study.difference import Difference, DivergedError, first_difference
from mrnav_server.study.recorded_rig import RecordedSurroundings

_READINGS = ("step", "ask")
_DECISIONS = ("mode", "command", "command_failed")
_INPUTS = ("around", "hand", "hand_left", "area", "path", "fail", "track", *_READINGS)
_MARKS = ("go", "reached")


class EndOfLogError(Exception):
    """The log ends here, maybe in the middle of a step."""


class Replayer:
    """Replays one log.

    Args:
        lines: The log's lines after the state.
        field: How far a target is from everywhere, for a law that asks for it.
    """

    def __init__(
        self, lines: Sequence[LogLine], field: Callable[[VesselPoint], DistanceField | None]
    ) -> None:
        self._lines = [line for line in lines if _counts(line)]
        self._at = 0
        self._read: LogLine | None = None
        self._field = field
        self.counts = {"steps": 0, "modes": 0, "commands": 0, "marks": 0}
        """What was replayed and found equal."""

    def seat(
        self,
        control: ControlLoop,
        hand: HandControl,
        autopilot: Autopilot,
        marks: TrialMarks,
        surroundings: RecordedSurroundings,
    ) -> None:
        """Take the deciders, in the state in which the log begins."""
        self._control, self._hand, self._autopilot, self._marks = control, hand, autopilot, marks
        self._surroundings = surroundings

    def run(self) -> Difference | None:
        """Replay to the end of the log, or to the first difference, which is returned."""
        try:
            while True:
                self._feed(self._next())
        except EndOfLogError:
            return None
        except DivergedError as diverged:
            return diverged.difference

    # -- what the deciders ask and tell ------------------------------------------------------------------

    def next_reading(self) -> LogLine:
        """Return the line of the step or the ask that begins now, once everybody was looked at."""
        while (line := self._next()).topic == "around":
            self._at += 1
            self._surroundings.outlook = Outlook(**line.data)
        if line.topic not in _READINGS:
            self._diverge(line, "a step")
        self._at += 1
        self._read = line
        return line

    def next_answer(self) -> LogLine:
        """Return the line that says what became of the command that is sent now."""
        line = self._next()
        if line.topic not in ("command", "command_failed"):
            self._diverge(line, "a command")
        return line

    def log(self, topic: str, data: Mapping[str, object]) -> None:
        """Compare what the control loop logs."""
        if topic in _READINGS:
            if self._read is not None:
                self._compare(self._read, topic, data)
            self.counts["steps"] += topic == "step"
        elif topic in _DECISIONS:
            self._expect(topic, data)
            self.counts["commands"] += 1
            if topic == "command":
                self._marks.on_motion(float(str(data["sent_s"])))

    def on_change(self, change: Transition) -> None:
        """Compare a change of mode; a goal that was chosen because of it is chosen again."""
        fields = {"before": change.before.value, "mode": change.after.value, "reason": change.reason}
        self._expect("mode", {"event": "mode", **fields})
        self.counts["modes"] += 1
        while self._at < len(self._lines):
            line = self._lines[self._at]
            if line.topic != "area" or not line.data["within_step"]:
                break
            self._at += 1
            self._control.choose_area(_area(line.data))

    def announce(self, name: str, fields: Mapping[str, object]) -> None:
        """Compare a mark or a contact."""
        self._expect(name if name == "trial" else "event", {"event": name, **fields})
        self.counts["marks"] += 1

    # -- the log -----------------------------------------------------------------------------------------

    def _next(self) -> LogLine:
        if self._at == len(self._lines) or self._lines[self._at].topic == CLOSED_TOPIC:
            raise EndOfLogError
        return self._lines[self._at]

    def _expect(self, topic: str, data: Mapping[str, object]) -> None:
        line = self._next()
        if line.topic != topic:
            self._diverge(line, _told(topic, data))
        self._at += 1
        self._compare(line, topic, data)

    def _compare(self, line: LogLine, topic: str, data: Mapping[str, object]) -> None:
        # As the log has it: a tuple is a list there, and what is not finite is null.
        replayed = orjson.loads(orjson.dumps(data, option=orjson.OPT_SERIALIZE_NUMPY))
        differs = first_difference(line.data, replayed)
        if line.topic != topic:
            self._diverge(line, _told(topic, data))
        if differs is not None:
            field, theirs, ours = differs
            raise DivergedError(Difference(line.seq, line.t_s, topic, field, theirs, ours))

    def _diverge(self, line: LogLine, replayed: str) -> NoReturn:
        recorded = _told(line.topic, line.data)
        raise DivergedError(Difference(line.seq, line.t_s, line.topic, "", recorded, replayed))

    # -- inputs ------------------------------------------------------------------------------------------

    def _feed(self, line: LogLine) -> None:
        if line.topic in ("around", *_READINGS):
            self._begin_reading()
            return
        if line.topic not in (*_INPUTS, "event"):
            self._diverge(line, "nothing")
        self._at += 1
        data = line.data
        match line.topic:
            case "hand":
                self._hand.on_sample(hand_sample(data))
            case "hand_left":
                self._hand.lose()
            case "track":
                track = track_of(data)
                self._control.scene.see(track)
                self._marks.on_track(track, self._control.machine.mode, self._control.scene.distance_um)
            case "fail":
                self._control.fail(data["reason"])
            case "path":
                self._take_path(line)
            case "area":
                self._choose_area(line)
            case _:
                if data["event"] != "hand":
                    self._at -= 1
                    self._diverge(line, "nothing")
                self._hand.choose_scale(data["scale"])

    def _begin_reading(self) -> None:
        """Step, or ask, as the next reading of the tip says."""
        line = next((line for line in self._lines[self._at :] if line.topic in _READINGS), None)
        if line is None:
            raise EndOfLogError
        data = line.data
        if line.topic == "step" and data["by"] != "ask":
            self._step(data)
        elif line.topic == "step":
            self._diverge(line, "a refusal")
        else:
            ask = self._control.submit if data["submitted"] else self._control.check
            # Whether it was refused then, too, is compared when it is logged.
            with suppress(RefusedError):
                ask(Ask(data["ask"]), data["now_s"])

    def _step(self, data: Mapping[str, Any]) -> None:
        if data["by"] == "hand":
            self._control.on_hand(data["now_s"], data["now_s"])
        else:
            self._control.step(data["now_s"])

    def _take_path(self, line: LogLine) -> None:
        data, order = line.data, self._autopilot.order
        if data["call"] == "prepare":
            path = self._path(data)
            if path is None:
                self._diverge(line, "nothing")
            handover_um, epsilon_um = data["handover_um"], data["epsilon_um"]
            most_um = math.inf if epsilon_um is None else epsilon_um
            self._autopilot.prepare(path, VesselPoint(*data["goal_px"]), handover_um, most_um)
        elif order is None:
            self._diverge(line, "no path was asked for")
        elif data["call"] == "deliver":
            self._autopilot.deliver(order, self._path(data))
        else:
            self._autopilot.decline(order, data["reason"])

    def _path(self, data: Mapping[str, Any]) -> PlannedPath | None:
        if data["points_px"] is None:
            return None
        target = VesselPoint(*data["target_px"])
        return PlannedPath(
            np.array(data["points_px"], np.float64),
            np.array(data["tangents"], np.float64),
            target,
            data["source"],
            data["fallback"],
            data["back_off"],
            self._field(target),
        )

    def _choose_area(self, line: LogLine) -> None:
        if line.data["within_step"]:
            self._diverge(line, "no change of mode")
        try:
            self._control.choose_area(_area(line.data))
        except RefusedError as refused:
            self._diverge(line, str(refused))


def _counts(line: LogLine) -> bool:
    """Tell whether a line feeds the deciders, or is decided by them."""
    match line.topic:
        case "trial":
            return line.data["mark"] in _MARKS
        case "event":
            return line.data["event"] in ("contact", "hand")
        case topic:
            return topic in (*_INPUTS, *_DECISIONS, CLOSED_TOPIC)


def _area(data: Mapping[str, Any]) -> CriticalArea | None:
    if data["id"] is None:
        return None
    return CriticalArea(data["id"], VesselPoint(*data["center_px"]), data["epsilon_um"], data["label"])


def _told(topic: str, data: Mapping[str, Any]) -> str:
    """Name a line for people."""
    match topic:
        case "mode":
            return f"{data['before']} → {data['mode']} ({data['reason']})"
        case "trial":
            return f"mark {data['mark']}"
        case "event":
            return f"event {data['event']}"
        case _:
            return topic
