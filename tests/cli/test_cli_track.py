"""`mrnav track` on films and folders of images."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from mrnav_server.cli.film import open_film
from mrnav_server.cli.main import app
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError

RADIUS_PX = 18.4


def place(number: int) -> tuple[float, float]:
    return 80.0 + 2.5 * number, 120.0 + 15.0 * np.sin(0.2 * number)


def drawn(number: int, *, bright: bool = False, robot: bool = True) -> ByteArray:
    """Draw a disc on a floor with some shade and noise, gray, 240x320."""
    y, x = np.mgrid[0:240, 0:320]
    picture = 170.0 + 6.0 * np.sin(x / 90.0) + np.random.default_rng(number).normal(0.0, 2.0, x.shape)
    if robot:
        x_px, y_px = place(number)
        picture += -120.0 * (0.5 - 0.5 * np.tanh(np.hypot(x - x_px, y - y_px) - RADIUS_PX))
    gray: ByteArray = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return 255 - gray if bright else gray


def folder_of(path: Path, pictures: Iterator[ByteArray] | list[ByteArray]) -> Path:
    path.mkdir()
    for number, picture in enumerate(pictures):
        # Without leading zeros, so that only natural order is theirs.
        cv2.imwrite(str(path / f"shot {number}.png"), picture)
    return path


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder_of(tmp_path_factory.mktemp("stills") / "dark", [drawn(n) for n in range(24)])


def track(*words: object) -> Result:
    return CliRunner().invoke(app, ["track", *map(str, words)])


def rows(result: Result) -> list[dict[str, Any]]:
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_each_picture_of_a_folder_is_a_line_in_natural_order(images: Path) -> None:
    told = rows(track(images, "--radius-px", RADIUS_PX, "--json"))
    assert [set(row) for row in told] == [
        {"frame", "x_px", "y_px", "sigma_px", "confidence", "status"} for _ in range(24)
    ]
    assert [row["frame"] for row in told] == list(range(24))
    for row in told:
        assert (row["x_px"], row["y_px"]) == pytest.approx(place(row["frame"]), abs=0.1)
        assert 0.0 < row["sigma_px"] < 0.5
        assert row["confidence"] > 0.8
    assert [row["status"] for row in told] == ["acquiring"] * 9 + ["tracking"] * 15


def test_a_robot_that_is_gone_is_searched_and_found_again(tmp_path: Path) -> None:
    there = [number not in range(12, 18) for number in range(32)]
    path = folder_of(tmp_path / "gone", (drawn(n, robot=there[n]) for n in range(32)))
    told = rows(track(path, "--radius-px", RADIUS_PX, "--json"))
    assert [row["x_px"] is not None for row in told] == there
    assert told[15]["status"] == "searching"
    assert told[15]["y_px"] is None
    assert (told[18]["status"], told[31]["status"]) == ("acquiring", "tracking")


def test_a_bright_robot_is_seen_by_its_option_alone(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "bright", (drawn(n, bright=True) for n in range(6)))
    unseen = rows(track(path, "--radius-px", RADIUS_PX, "--json"))
    assert all(row["x_px"] is None for row in unseen)
    for row in rows(track(path, "--radius-px", RADIUS_PX, "--polarity", "bright", "--json")):
        assert (row["x_px"], row["y_px"]) == pytest.approx(place(row["frame"]), abs=0.1)


@pytest.mark.parametrize("bright", [False, True])
def test_radius_and_polarity_are_measured_and_said_if_left_out(tmp_path: Path, bright: bool) -> None:
    path = folder_of(tmp_path / "unknown", (drawn(n, bright=bright) for n in range(7)))
    result = track(path, "--json")
    assert f"{'bright' if bright else 'dark'}: measured in the first 5 pictures" in result.stderr
    measured_px = float(result.stderr.split("radius ")[1].split()[0])
    assert measured_px == pytest.approx(RADIUS_PX, abs=0.15)
    told = rows(result)
    assert [row["frame"] for row in told] == list(range(7))
    assert all(row["x_px"] is not None for row in told)


def test_a_radius_that_cannot_be_measured_is_asked_for(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "empty", (drawn(n, robot=False) for n in range(3)))
    error = track(path, "--json").exception
    assert isinstance(error, ConfigError)
    assert "--radius-px is missing" in str(error)
    assert "no disc" in str(error)


def test_a_film_is_tracked_by_its_time_stamps(tmp_path: Path) -> None:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (320, 240))
    for number in range(14):
        writer.write(cv2.cvtColor(drawn(number), cv2.COLOR_GRAY2BGR))
    writer.release()
    film = open_film(path, 30.0)
    assert film.count == 14
    assert [frame.taken_s for frame in film.frames] == pytest.approx([n / 20.0 for n in range(14)], abs=1e-3)
    told = rows(track(path, "--radius-px", RADIUS_PX, "--json"))
    assert len(told) == 14
    assert (told[13]["x_px"], told[13]["y_px"]) == pytest.approx(place(13), abs=0.2)


def test_pictures_that_repeat_are_no_camera_fault_in_a_film(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "still", [drawn(0)] * 12)
    told = rows(track(path, "--radius-px", RADIUS_PX, "--json"))
    assert [row["status"] for row in told][-1] == "tracking"
    assert all(row["x_px"] is not None for row in told)


def test_any_moving_shape_is_tracked(tmp_path: Path) -> None:
    def picture(number: int) -> ByteArray:
        image = drawn(number, robot=False)
        if number >= 10:
            x_px, y_px = (round(value) for value in place(number))
            cv2.rectangle(image, (x_px - 16, y_px - 7), (x_px + 16, y_px + 7), 40, -1, cv2.LINE_AA)
        return image

    path = folder_of(tmp_path / "bar", (picture(n) for n in range(24)))
    options = ("--radius-px", 18, "--detector", "moving", "--learning-frames", 6)
    told = rows(track(path, *options, "--json"))
    assert all(row["x_px"] is None for row in told[:10])
    for row in told[11:]:
        assert (row["x_px"], row["y_px"]) == pytest.approx(place(row["frame"]), abs=1.6)
    error = track(path, "--detector", "moving").exception
    assert "--radius-px is missing" in str(error)


def test_without_json_there_is_a_summary_a_table_and_a_drawing(images: Path, tmp_path: Path) -> None:
    table, plot = tmp_path / "path.csv", tmp_path / "path.png"
    result = track(images, "--radius-px", RADIUS_PX, "--csv", table, "--plot", plot)
    assert "24 (100.0 %)" in result.stdout
    with table.open() as file:
        written = list(csv.DictReader(file))
    assert len(written) == 24
    assert float(written[7]["x_px"]) == pytest.approx(place(7)[0], abs=0.1)
    image, first = cv2.imread(str(plot)), cv2.cvtColor(drawn(0), cv2.COLOR_GRAY2BGR)
    assert image is not None
    x_px, y_px = (round(value) for value in place(12))
    assert image[y_px - 1 : y_px + 2, x_px - 1 : x_px + 2, 1].max() > 180
    assert (image != first).any(axis=2).mean() < 0.05


@pytest.mark.parametrize(
    ("options", "field"),
    [
        (["--radius-px", "2"], "--radius-px is 2"),
        (["--radius-px", "nan"], "--radius-px is nan"),
        (["--radius-px", "150"], "--radius-px is 150"),
        (["--radius-px", "18", "--fps", "0"], "--fps"),
        (["--radius-px", "18", "--csv", "/nowhere/path.csv"], "--csv"),
        (["--radius-px", "18", "--plot", "/nowhere/path.png"], "--plot"),
        (["--radius-px", "18", "--detector", "moving", "--learning-frames", "0"], "learning_frames"),
    ],
)
def test_a_wrong_option_is_named(images: Path, options: list[str], field: str) -> None:
    error = track(images, *options).exception
    assert isinstance(error, ConfigError)
    assert field in str(error)


def test_what_cannot_be_read_is_named_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mp4").write_text("no film")
    broken = folder_of(tmp_path / "broken", [drawn(0)])
    (broken / "shot 1.png").write_bytes(b"no picture")
    mixed = folder_of(tmp_path / "mixed", [drawn(0), drawn(1)[:200]])
    for source, told in (
        (tmp_path / "nothing", "does not exist"),
        (tmp_path / "empty", "holds no images"),
        (tmp_path / "text.mp4", "cannot be read as a film"),
        (broken, "shot 1.png is damaged or no picture"),
        (mixed, "320x200"),
    ):
        error = track(source, "--radius-px", RADIUS_PX, "--json").exception
        assert isinstance(error, ConfigError)
        assert told in str(error)
