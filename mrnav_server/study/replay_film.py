"""Looks at a trial's film again: the tracker on the recorded pictures, beside what it saw in the trial."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.loops.trial_fields import track_of
from mrnav_server.loops.video_recorder import FIRST_TAKEN_KEY, VIDEO_NAME
from mrnav_server.study.recording import read_recording
from mrnav_server.vision.tracker import Tracker

_HEAD_BYTES = 65_536
_SAME_FRAME_S = 0.003
"""The film's stamps are 1 ms fine."""


@dataclass(frozen=True, slots=True)
class FilmReplay:
    """What the tracker sees in the film.

    Attributes:
        frames: Pictures in the film.
        compared: Pictures in which the robot was seen then and is seen now.
        missed: Pictures in which it was seen then, but is not now: the first ones, until it is found, too.
        rms_um: Root mean square of the distance between both, in µm; None without any.
        max_um: Largest distance.
    """

    frames: int
    compared: int
    missed: int
    rms_um: float | None
    max_um: float | None

    def __str__(self) -> str:
        found = f"robot found in {self.compared} of {self.frames} pictures, missed in {self.missed}"
        if self.rms_um is None or self.max_um is None:
            return found
        return f"{found}; off by {self.rms_um:.1f} µm (root mean square), {self.max_um:.1f} µm at most"


def replay_film(folder: Path) -> FilmReplay:
    """Track a trial's film and compare.

    The film is smaller than the camera's pictures, and compressed: it agrees to within micrometres.

    Raises:
        ConfigError: If there is no film, or one that cannot be read.
    """
    recording = read_recording(folder)
    tracks = [track_of(line.data) for line in recording.lines if line.topic == "track"]
    settings, um_per_px = recording.settings, recording.header.um_per_px
    tracker = Tracker(settings.tracker, recording.calibration, live=False)
    then_s = np.array([track.taken_s for track in tracks])
    off_um: list[float] = []
    frames = missed = 0
    for frame in _frames(folder / VIDEO_NAME, settings.camera):
        frames += 1
        now = tracker.update(frame).vessel
        nearest = int(np.abs(then_s - frame.taken_s).argmin()) if then_s.size else 0
        then = tracks[nearest].vessel if then_s.size else None
        if then is None or abs(then_s[nearest] - frame.taken_s) > _SAME_FRAME_S:
            continue
        if now is None:
            missed += 1
        else:
            off_um.append(now.distance_px(then) * um_per_px)
    rms_um = math.sqrt(float(np.square(off_um).mean())) if off_um else None
    return FilmReplay(frames, len(off_um), missed, rms_um, max(off_um, default=None))


def _frames(film: Path, picture: PictureFormat) -> Iterator[Frame]:
    if not film.is_file():
        raise ConfigError(f"trial {film.parent.name} was not filmed: set video.enabled = true before a trial")
    with film.open("rb") as file:
        tag = re.search(
            FIRST_TAKEN_KEY.encode() + rb".{1,12}?(\d+\.\d{6})", file.read(_HEAD_BYTES), re.DOTALL
        )
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    capture = cv2.VideoCapture(str(film), cv2.CAP_FFMPEG)
    if tag is None or not capture.isOpened():
        raise ConfigError(f"{film} is no film of a trial")
    first_s, number = float(tag[1]), 0
    try:
        while capture.grab():
            taken_s = first_s + 1e-3 * float(capture.get(cv2.CAP_PROP_POS_MSEC))
            decoded, image = capture.retrieve()
            if not decoded:
                # A crash cut the last picture off.
                return
            whole = cv2.resize(np.asarray(image), (picture.width_px, picture.height_px))
            yield Frame(number, taken_s, np.asarray(whole, np.uint8))
            number += 1
    finally:
        capture.release()
