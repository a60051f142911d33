"""``mrnav track``: the server's tracker on any film or folder of images."""

import csv
import itertools
import json
import math
import statistics
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from rich.console import Console

    from mrnav_server.cli.film import Film
    from mrnav_server.core.arrays import ByteArray
    from mrnav_server.core.records import Frame
    from mrnav_server.vision.tracker import Tracker

_ROBOT_UM = 500.0
"""The tracker's settings are in µm and made for a robot of this radius; a film's scale is set to match."""
_MEASURED_FRAMES = 5
"""The radius is measured in so many of the first pictures."""
_LEAST_RADIUS_PX = 4.0
_PATH_BGR = (60, 200, 60)
_ENDS_BGR = ((255, 120, 0), (0, 60, 255))


class Kind(StrEnum):
    """How the robot is seen."""

    SPHERE = "sphere"
    MOVING = "moving"


class Shade(StrEnum):
    """What the robot is beside its surroundings."""

    DARK = "dark"
    BRIGHT = "bright"


@dataclass(frozen=True, slots=True)
class Row:
    """One frame's answer, as it is printed; a position is None where there is none."""

    frame: int
    x_px: float | None
    y_px: float | None
    sigma_px: float
    confidence: float
    status: str


def track(
    source: Annotated[Path, typer.Argument(help="A film, or a folder of images in natural order.")],
    radius_px: Annotated[
        float | None,
        typer.Option(help="Radius of the robot, or of a circle round it; measured if left out."),
    ] = None,
    polarity: Annotated[
        Shade | None, typer.Option(help="The robot beside its surroundings; dark unless measured.")
    ] = None,
    detector: Annotated[
        Kind, typer.Option(help="A disc's rim, or any shape by what it adds to a learned background.")
    ] = Kind.SPHERE,
    learning_frames: Annotated[
        int, typer.Option(help="--detector moving: pictures from which the background is learned.")
    ] = 30,
    fps: Annotated[float, typer.Option(help="Pictures a second, where no film tells.")] = 30.0,
    csv_file: Annotated[Path | None, typer.Option("--csv", help="Write a table of the frames.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the path over the first picture (PNG).")] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object a frame.")] = False,
) -> None:
    """Track the robot through a film, with the tracker that the server runs."""
    from rich.console import Console

    from mrnav_server.cli.film import open_film

    say = Console(stderr=True, highlight=False, soft_wrap=True)
    film = open_film(source, fps)
    radius_px, shade, frames = _known(film, radius_px, polarity, detector, say)
    first = next(frames)
    tracker, um_per_px = _tracker(first.image, radius_px, shade, detector, learning_frames)
    rows = []
    for frame in _shown(itertools.chain([first], frames), film, say):
        track = tracker.update(frame)
        x_px, y_px = (None, None) if track.image is None else (track.image.x_px, track.image.y_px)
        row = Row(
            frame.number,
            None if x_px is None else round(x_px, 4),
            None if y_px is None else round(y_px, 4),
            round(track.sigma_um / um_per_px, 4),
            round(track.confidence, 4),
            track.state.value,
        )
        rows.append(row)
        if json_output:
            typer.echo(json.dumps(asdict(row)))
    if csv_file is not None:
        _write_csv(csv_file, rows)
    if plot is not None:
        _draw(plot, first.image, rows)
    if not json_output:
        _summarise(film, rows, radius_px)


def _known(
    film: "Film", radius_px: float | None, polarity: Shade | None, detector: Kind, say: "Console"
) -> tuple[float, Shade, Iterator["Frame"]]:
    """Return radius and shade, as told or as measured, and the frames."""
    if radius_px is not None:
        if not math.isfinite(radius_px) or radius_px < _LEAST_RADIUS_PX:
            raise ConfigError(f"--radius-px is {radius_px:g}: a robot needs {_LEAST_RADIUS_PX:g} or more")
        return radius_px, polarity or Shade.DARK, film.frames
    if detector is Kind.MOVING:
        raise ConfigError(
            "--radius-px is missing: give the radius of the smallest circle round the robot; only a sphere's"
            " can be measured"
        )
    first = list(itertools.islice(film.frames, _MEASURED_FRAMES))
    radius_px, spread_px, shade = _measured([frame.image for frame in first], polarity)
    say.print(
        f"radius {radius_px:.2f} ± {spread_px:.2f} px, {shade}: measured in the first {len(first)} pictures"
    )
    return radius_px, shade, itertools.chain(first, film.frames)


def _measured(images: list["ByteArray"], polarity: Shade | None) -> tuple[float, float, Shade]:
    """Return the median radius in px of those pictures that can be measured, its spread, and the shade."""
    from mrnav_server.core.errors import RefusedError
    from mrnav_server.vision.measure import measure_robot

    looks, refused = [], ""
    for image in images:
        try:
            # At 1 µm a pixel, so that µm are pixels.
            looks.append(measure_robot(image, 1.0, (6.0, min(image.shape[:2]) / 3.0)))
        except RefusedError as error:
            refused = str(error)
    looks = [look for look in looks if polarity is None or look.polarity == polarity]
    if not looks:
        raise ConfigError(
            f"--radius-px is missing and cannot be measured in the first {len(images)} pictures"
            f" ({refused or f'what is seen is not {polarity}'}): give it"
        )
    radii_px = [look.radius_px for look in looks]
    spread_px = max(statistics.pstdev(radii_px), statistics.median(look.spread_px for look in looks))
    return statistics.median(radii_px), spread_px, Shade(looks[0].polarity)


def _tracker(
    image: "ByteArray", radius_px: float, shade: Shade, detector: Kind, learning_frames: int
) -> tuple["Tracker", float]:
    """Return the server's tracker for pictures of this size, and how many µm it takes a pixel for."""
    from mrnav_server.core.frames import Affine2, Calibration
    from mrnav_server.vision.tracker import Tracker, TrackerConfig

    height_px, width_px = image.shape[:2]
    if radius_px > min(height_px, width_px) / 2.0:
        raise ConfigError(
            f"--radius-px is {radius_px:g}: pictures of {width_px}x{height_px} px hold no such robot"
        )
    um_per_px = _ROBOT_UM / radius_px
    kinds: dict[Kind, Literal["sphere", "moving-shape"]] = {
        Kind.SPHERE: "sphere",
        Kind.MOVING: "moving-shape",
    }
    config = TrackerConfig(
        detector=kinds[detector],
        polarity="dark" if shade is Shade.DARK else "bright",
        robot_radius_um=_ROBOT_UM,
        learning_frames=learning_frames,
    )
    # The floor's grid is the picture itself.
    calibration = Calibration(
        image_from_vessel=Affine2.scale(1.0),
        stage_from_vessel=Affine2.scale(um_per_px),
        um_per_px=um_per_px,
        floor_z_um=0.0,
        magnet_offset_um=(0.0, 0.0),
        critical_height_um=0.0,
    )
    return Tracker(config, calibration, live=False), um_per_px


def _shown(frames: Iterator["Frame"], film: "Film", say: "Console") -> Iterator["Frame"]:
    """Yield frames with a bar on the error stream."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=say, transient=True) as progress:
        bar = progress.add_task("tracking", total=film.count)
        for frame in frames:
            yield frame
            progress.advance(bar)


def _write_csv(path: Path, rows: list[Row]) -> None:
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(Row.__dataclass_fields__))
            writer.writeheader()
            writer.writerows(asdict(row) for row in rows)
    except OSError as error:
        raise ConfigError(f"--csv {path} cannot be written ({error.strerror}): name another file") from None


def _draw(path: Path, first: "ByteArray", rows: list[Row]) -> None:
    """Draw the path over the first picture, with its beginning and its end; it breaks where it was lost."""
    import cv2

    drawn = first.copy()
    width = max(1, round(min(first.shape[:2]) / 400))
    before: tuple[int, int] | None = None
    ends: list[tuple[int, int]] = []
    for row in rows:
        if row.x_px is None or row.y_px is None:
            before = None
            continue
        # OpenCV takes sixteenths of a pixel.
        here = round(16.0 * row.x_px), round(16.0 * row.y_px)
        cv2.line(drawn, before or here, here, _PATH_BGR, width, cv2.LINE_AA, shift=4)
        before = here
        ends = [ends[0] if ends else here, here]
    for end, color in zip(ends, _ENDS_BGR, strict=False):
        cv2.circle(drawn, end, 16 * 3 * width, color, -1, cv2.LINE_AA, shift=4)
    try:
        written = bool(cv2.imwrite(str(path), drawn))
    except cv2.error:
        written = False
    if not written:
        raise ConfigError(f"--plot {path} cannot be written: name a .png in a folder that exists")


def _summarise(film: "Film", rows: list[Row], radius_px: float) -> None:
    from rich.console import Console
    from rich.table import Table

    found = [row for row in rows if row.x_px is not None]
    counts = {status: sum(row.status == status for row in rows) for status in ("tracking", "acquiring")}
    figures = {
        "frames": f"{len(rows)}",
        "with a position": f"{len(found)} ({100.0 * len(found) / len(rows):.1f} %)",
        "tracking, acquiring": f"{counts['tracking']}, {counts['acquiring']}",
        "radius": f"{radius_px:.2f} px",
    }
    if found:
        last = found[-1]
        path_px = sum(
            math.hypot((b.x_px or 0.0) - (a.x_px or 0.0), (b.y_px or 0.0) - (a.y_px or 0.0))
            for a, b in itertools.pairwise(found)
        )
        figures |= {
            "standard deviation, median": f"{statistics.median(row.sigma_px for row in found):.3f} px",
            "confidence, median": f"{statistics.median(row.confidence for row in found):.2f}",
            "length of the path": f"{path_px:.1f} px",
            "last position": f"{last.x_px:.2f}, {last.y_px:.2f} px in frame {last.frame}",
        }
    table = Table(title=f"Tracked: {film.name}", title_justify="left", show_header=False)
    for name, value in figures.items():
        table.add_row(name, value)
    Console().print(table)
    if not found:
        Console(soft_wrap=True).print(
            "The robot was never seen: check --radius-px and --polarity, or try --detector moving."
        )
