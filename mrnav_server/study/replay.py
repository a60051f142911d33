"""Replays a trial: the recorded inputs through the same deciders, compared exactly (docs/recording.md)."""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import orjson

from mrnav_server.autonomy.grid_graph import DistanceField, GridGraph
from mrnav_server.autonomy.plane import Plane
from mrnav_server.autonomy.policy import Policy
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration, VesselPoint
from mrnav_server.core.hand import HandControl
from mrnav_server.core.lease import Lease
from mrnav_server.core.modes import Mode
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import Autopilot
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.laws import new_law
from mrnav_server.loops.software import software_version
from mrnav_server.loops.state_image import restored
from mrnav_server.loops.trial_log import CLOSED_TOPIC, TrialHeader
from mrnav_server.loops.trial_marks import TrialMarks
from mrnav_server.settings import Settings
from mrnav_server.study.difference import Difference, first_difference
from mrnav_server.study.recorded_rig import RecordedManipulator, RecordedSurroundings
from mrnav_server.study.recording import Recording, read_recording
from mrnav_server.study.replayer import Replayer
from mrnav_server.study.trial_record import read_trial_record
from mrnav_server.study.trial_report import RESULT_NAME, measured, result_fields, route_graph
from mrnav_server.vision.calibration_file import calibration_of, read_calibration
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

_DECIDING = ("handover", "guards", "limits", "hand", "autopilot", "follower", "trial")
"""Sections of the settings that the deciders are built from."""


@dataclass(frozen=True, slots=True)
class Replay:
    """What came of a replay.

    Attributes:
        id: The trial's id.
        exact: Whether modes, setpoints, marks and metrics are exactly the recorded ones.
        counts: Steps, changes of mode, commands and marks that were found equal.
        difference: The first that was not; None if all are.
        changed: What is not as it was when the trial was recorded, in plain words: why they may differ.
        simulated: Whether the rig or the operator was simulated.
    """

    id: str
    exact: bool
    counts: Mapping[str, int]
    difference: Difference | None
    changed: tuple[str, ...]
    simulated: bool

    def fields(self) -> dict[str, Any]:
        """Return it for JSON."""
        return dataclasses.asdict(self)


def replay_trial(
    folder: Path, settings: Settings | None = None, calibration: Calibration | Path | None = None
) -> Replay:
    """Replay a trial.

    Args:
        folder: The trial's folder.
        settings: Replay by these instead of the recorded ones, to see what they would have changed.
        calibration: The same for the calibration, or for the file of one.

    Raises:
        ConfigError: If it is no trial, or one that was recorded without what a replay needs.
        RefusedError: ``no_tracks`` if the robot was never looked for.
    """
    recording = read_recording(folder)
    header, then = recording.header, recording.calibration
    settings = settings or recording.settings
    vessel = _vessel(recording.settings.rig.vessel)
    if isinstance(calibration, Path):
        calibration = calibration_of(read_calibration(calibration), vessel)
    changed = [
        *_changed_settings(recording.settings, settings),
        *_changed_files(recording, vessel),
        *([] if calibration in (None, then) else ["calibration"]),
    ]
    replayer = _seated(settings, calibration or then, vessel, recording)
    difference = replayer.run() or _changed_result(folder, vessel)
    simulated = header.simulated_rig or header.operator_kind == "simulated"
    return Replay(folder.name, difference is None, replayer.counts, difference, tuple(changed), simulated)


@lru_cache(4)
def _vessel(name: str) -> VesselMap:
    """Return a vessel model; a study's trials share a few."""
    return load_vessel_model(find_model(name))


def _changed_settings(then: Settings, now: Settings) -> Iterator[str]:
    for name in _DECIDING:
        old, new = then.public()[name], now.public()[name]
        for field, value in old.items():
            differs = first_difference(value, new.get(field), f"{name}.{field}")
            if differs is not None:
                yield f"setting {differs[0]}: {differs[1]} → {differs[2]}"


def _changed_files(recording: Recording, vessel: VesselMap) -> Iterator[str]:
    header, lines = recording.header, recording.lines
    new = list(_new_settings(recording.told, recording.settings.public()))
    yield from new
    if not new and recording.settings.digest() != header.configuration_sha256:
        yield "the settings in the log are not those that its header names"
    if header.software_version != software_version():
        yield f"software: {header.software_version} → {software_version()}"
    if header.vessel_sha256 != vessel.digest:
        yield f"vessel model {header.vessel}: another mask"
    if header.policy_sha256 not in ("", _policy_sha256(header)):
        yield f"policy of {header.vessel}: {header.policy_sha256[:12]} → {_policy_sha256(header)[:12]}"
    lost = sum(line.data["lost_lines"] or 0 for line in lines if line.topic == CLOSED_TOPIC)
    if lost:
        yield f"{lost} lines were lost when the trial was recorded"


def _new_settings(then: Mapping[str, Any], now: Mapping[str, Any], within: str = "") -> Iterator[str]:
    """Name the settings that this version has and the recording's had not."""
    for name, value in now.items():
        field = f"{within}.{name}" if within else name
        if name not in then:
            yield f"setting {field}: not known then → {value}"
        elif isinstance(value, Mapping) and isinstance(then[name], Mapping):
            yield from _new_settings(then[name], value, field)


def _policy_sha256(header: TrialHeader) -> str:
    manifest = find_model(header.vessel) / "manifest.json"
    return str(orjson.loads(manifest.read_bytes())["policy_sha256"]) if manifest.is_file() else "none"


def _seated(
    settings: Settings,
    calibration: Calibration,
    vessel: VesselMap,
    recording: Recording,
) -> Replayer:
    """Return a replayer with deciders in the state in which the trial began."""
    direct = settings.autopilot.law == "direct"
    graph = GridGraph(vessel) if direct else None

    def field(target: VesselPoint) -> DistanceField | None:
        return graph.field(target) if graph is not None else None

    replayer = Replayer(recording.lines, field)
    policy = _policy(recording.header, vessel) if direct else None
    law = new_law(settings.autopilot, settings.follower, policy, vessel, calibration)
    top_um_per_s = settings.limits.autonomy_speed_um_per_s
    autopilot = Autopilot(settings.autopilot, law, top_um_per_s, vessel.um_per_px, "")
    hand = HandControl(settings.hand, settings.limits.speed_um_per_s)
    manipulator = RecordedManipulator(replayer.next_reading, replayer.next_answer)
    control = ControlLoop(
        settings.handover,
        settings.guards,
        settings.limits,
        manipulator,
        calibration,
        vessel,
        Lease(),
        hand,
        autopilot,
        replayer.log,
        replayer.on_change,
    )
    parts = [*_sections(settings), vessel, calibration, Plane(calibration)]
    surroundings = RecordedSurroundings()
    restored(recording.state, parts, control)
    if direct and control.machine.mode is Mode.AUTO:
        raise ConfigError("the trial began while the direct law drove: it cannot be replayed")
    control.surroundings = surroundings
    surroundings.outlook = control.outlook
    replayer.seat(
        control, hand, autopilot, TrialMarks(settings.trial, vessel, replayer.announce), surroundings
    )
    return replayer


def _policy(header: TrialHeader, vessel: VesselMap) -> Policy | None:
    """Return the trial's policy; None if it had none that could be used."""
    from mrnav_server.autonomy.torchscript import load_policy

    return load_policy(find_model(header.vessel), vessel) if header.policy_sha256 else None


def _sections(value: object) -> Iterator[object]:
    """Yield every section of the settings, at any depth."""
    names = type(value).model_fields if isinstance(value, Settings) else [f.name for f in _inner(value)]
    for each in (getattr(value, name) for name in names):
        if dataclasses.is_dataclass(each):
            yield each
            yield from _sections(each)


def _inner(value: object) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()


def _changed_result(folder: Path, vessel: VesselMap) -> Difference | None:
    """Compare the trial's metrics with those that were written when it ended."""
    file = folder / RESULT_NAME
    if not file.is_file():
        return None
    record = read_trial_record(folder)
    metrics = measured(record, record.clearance_um(vessel), vessel, route_graph(vessel))
    result = result_fields(record, metrics)
    then = orjson.loads(file.read_bytes())["metrics"]
    differs = first_difference(then, result["metrics"], "metrics")
    return Difference(0, record.end_s, "result", *differs) if differs is not None else None
