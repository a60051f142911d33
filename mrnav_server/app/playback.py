"""A recorded trial as columns over time, for the page that plays it back (docs/recording.md)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import Affine2
from mrnav_server.core.motion import filtered, segments
from mrnav_server.loops.film_index import FilmFrame
from mrnav_server.loops.handover import eased
from mrnav_server.loops.trial_log import LOG_NAME, LogLine, TrialHeader, read_header, read_log

_PATH_POINTS = 200
_MARKED_MODES = {"AUTO": "auto", "STOP": "stop"}
_HANDOVERS = {"arrival": "Arrived: handed over", "takeover": "Taken over by hand"}


def playback(folder: Path, film: Sequence[FilmFrame]) -> dict[str, Any]:
    """Read a trial's log; return what is drawn, with times in seconds since the go cue.

    Args:
        folder: The trial's.
        film: Its film's pictures; none without a film.

    Raises:
        ConfigError: If the log cannot be read.
    """
    tape = _Tape(folder.name, read_header(folder / LOG_NAME))
    for line in read_log(folder / LOG_NAME):
        tape.take(line)
    return tape.fields(film)


class _Tape:
    """Takes a log line by line; every track becomes a row with all that was true at that moment."""

    def __init__(self, trial_id: str, header: TrialHeader) -> None:
        self._id = trial_id
        self._header = header
        self._areas: list[dict[str, Any]] = []
        if header.area_px is not None:
            self._note_area(float("-inf"), header.area_id, header.area_px, header.area_epsilon_um, "")
        self._rows: list[tuple[float, ...]] = []
        self._tip_um: Sequence[float] | None = None
        self._modes: list[dict[str, Any]] = []
        self._paths: list[dict[str, Any]] = []
        self._marks: list[dict[str, Any]] = []
        self._go_s: float | None = None
        self._end_s = 0.0
        self._clutch = False
        self._announced = self._shares = False
        self._blend_s = 0.0
        self._blend_began_s: float | None = None

    def take(self, line: LogLine) -> None:
        data = line.data
        self._end_s = max(self._end_s, line.t_s)
        match line.topic:
            case "settings":
                handover = data.get("handover", {})
                self._blend_s = handover.get("blend_s", 0.0)
                self._shares = handover.get("sharing", {}).get("enabled", False)
            case "step":
                self._tip_um = data["tip_um"]
            case "hand":
                self._clutch = data["clutch"] and data["valid"]
            case "hand_left":
                self._clutch = False
            case "track":
                self._on_track(data, line.t_s)
            case "mode":
                self._on_mode(data, line.t_s)
            case "area":
                self._note_area(line.t_s, data["id"], data["center_px"], data["epsilon_um"], data["label"])
            case "path":
                self._paths.append({"t_s": line.t_s, "end_s": None, "points_px": _thinned(data["points_px"])})
            case "trial" | "event":
                self._on_event(data, line.t_s)

    def fields(self, film: Sequence[FilmFrame]) -> dict[str, Any]:
        """Return everything, ready for JSON; what is not known is null."""
        header = self._header
        rows = np.array(self._rows).reshape(-1, 9)
        begin_s = float(rows[0, 0]) if len(rows) else 0.0
        zero_s = begin_s if self._go_s is None else self._go_s

        def relative(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
            return [
                entry
                | {
                    name: round(max(entry[name], begin_s) - zero_s, 3)
                    for name in ("t_s", "end_s")
                    if entry.get(name) is not None
                }
                for entry in entries
            ]

        t_s, xy_um = rows[:, 0], rows[:, 2:4] * header.um_per_px
        speed, jerk = _speed_and_jerk(t_s, xy_um)
        tip_px = self._tips_px(rows[:, 4:6])
        return {
            "id": self._id,
            "participant": header.participant,
            "condition": header.condition,
            "operator_kind": header.operator_kind,
            "simulated_rig": header.simulated_rig,
            "simulated": header.simulated_rig or header.operator_kind == "simulated",
            "vessel": header.vessel,
            "um_per_px": header.um_per_px,
            "start_px": header.start_px,
            "frames": {
                "t_s": np.round(t_s - zero_s, 3).tolist(),
                "number": rows[:, 1].astype(int).tolist(),
                "x_px": _column(rows[:, 2], 2),
                "y_px": _column(rows[:, 3], 2),
                "tip_x_px": _column(tip_px[:, 0], 2),
                "tip_y_px": _column(tip_px[:, 1], 2),
                "hand": _column(rows[:, 6], 3),
                "clutch": rows[:, 7].astype(bool).tolist(),
                "distance_um": _column(rows[:, 8], 0),
                "speed_um_per_s": _column(speed, 0),
                "jerk_um_per_s3": _column(jerk, 0),
            },
            "modes": relative(self._modes),
            "areas": relative(self._areas),
            "paths": relative(self._paths),
            "marks": relative(sorted(self._marks, key=lambda mark: float(mark["t_s"]))),
            "film_s": [round(frame.taken_s - zero_s, 3) for frame in film],
        }

    def _on_track(self, data: Mapping[str, Any], now_s: float) -> None:
        x_px, y_px = data["vessel"] or (np.nan, np.nan)
        tip_x, tip_y = (np.nan, np.nan) if self._tip_um is None else self._tip_um[:2]
        distance_um = np.nan
        if self._areas:
            goal_x, goal_y = self._areas[-1]["center_px"]
            distance_um = self._header.um_per_px * np.hypot(x_px - goal_x, y_px - goal_y)
        hand = self._authority(now_s)
        self._rows.append(
            (data["taken_s"], data["frame"], x_px, y_px, tip_x, tip_y, hand, self._clutch, distance_um)
        )

    def _on_mode(self, data: Mapping[str, Any], now_s: float) -> None:
        mode, before, reason = data["mode"], data.get("before"), data.get("reason", "")
        if not self._modes and before is not None:
            self._modes.append({"t_s": float("-inf"), "mode": before, "reason": ""})
        self._modes.append({"t_s": now_s, "mode": mode, "reason": reason})
        if before == "AUTO":
            self._end_path(now_s)
            self._blend_began_s = now_s if mode == "MANUAL" and self._announced else None
        if before == "DISARMED":
            self._mark(now_s, "arm", "Armed")
        if mode in _MARKED_MODES:
            self._announced = False
            self._mark(now_s, _MARKED_MODES[mode], reason or mode)

    def _on_event(self, data: Mapping[str, Any], now_s: float) -> None:
        match data.get("mark", data.get("event")):
            case "go":
                self._go_s = data["t_s"]
                self._mark(data["t_s"], "go", "Go: the rig is told to move")
            case "reached":
                self._mark(data["t_s"], "reached", "Target reached")
            case "handover_announced":
                self._announced = True
                self._mark(now_s, "announced", "Hand-over announced")
            case "handover":
                self._mark(now_s, "handover", _HANDOVERS.get(data["by"], "Handed over"))
            case "contact":
                self._mark(now_s, "contact", f"Wall contact {data['count']}")
            case "fault" | "recovered" as kind:
                self._mark(now_s, kind, data["reason"])

    def _authority(self, now_s: float) -> float:
        """Return the hand's share; NaN where hand and policy drove together, which the log does not hold."""
        mode = self._modes[-1]["mode"] if self._modes else ""
        if mode == "AUTO":
            return float("nan") if self._shares and self._clutch else 0.0
        if mode != "MANUAL" or self._blend_began_s is None or self._blend_s <= 0.0:
            return float(mode == "MANUAL")
        return eased(min((now_s - self._blend_began_s) / self._blend_s, 1.0))

    def _end_path(self, now_s: float) -> None:
        for path in self._paths:
            path["end_s"] = path["end_s"] or now_s

    def _mark(self, t_s: float, kind: str, text: str) -> None:
        self._marks.append({"t_s": t_s, "kind": kind, "text": text})

    def _note_area(
        self,
        t_s: float,
        area_id: str | None,
        center_px: Sequence[float],
        epsilon_um: float | None,
        label: str,
    ) -> None:
        area = {"id": area_id, "center_px": list(center_px), "epsilon_um": epsilon_um, "label": label}
        if not self._areas or {**self._areas[-1], "t_s": t_s} != {**area, "t_s": t_s}:
            self._areas.append({"t_s": t_s, **area})

    def _tips_px(self, tips_um: FloatArray) -> FloatArray:
        """Return the vessel points below the tip, shape (n, 2)."""
        rows = self._header.calibration.get("stage_from_vessel")
        if rows is None:
            return np.full_like(tips_um, np.nan)
        below: FloatArray = np.array(Affine2.of_rows(np.array(rows)).inverse().rows())
        return np.asarray(tips_um @ below[:, :2].T + below[:, 2])


def _speed_and_jerk(t_s: FloatArray, xy_um: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the filtered motion (core/motion.py) at every track, each of shape (n,); NaN within gaps."""
    speed, jerk = np.full_like(t_s, np.nan), np.full_like(t_s, np.nan)
    for segment in segments(t_s, xy_um):
        motion = filtered(segment)
        for out, at_s, values in (
            (speed, motion.t_s, motion.speed_um_per_s),
            (jerk, motion.jerk_t_s, np.hypot(motion.jerk_um_per_s3[:, 0], motion.jerk_um_per_s3[:, 1])),
        ):
            if at_s.size:
                within = (t_s >= at_s[0]) & (t_s <= at_s[-1])
                out[within] = np.interp(t_s[within], at_s, values)
    return speed, jerk


def _column(values: FloatArray, digits: int) -> list[float | None]:
    rounded = np.round(values, digits)
    return [None if np.isnan(value) else value for value in rounded.tolist()]


def _thinned(points: Sequence[Sequence[float]]) -> list[list[float]]:
    stride = max(1, len(points) // _PATH_POINTS)
    kept = [*points[:-1:stride], points[-1]] if points else []
    return [[round(x, 1), round(y, 1)] for x, y in kept]
