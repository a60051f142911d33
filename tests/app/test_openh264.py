"""Pictures as H.264, by the system's own OpenH264 and read back by FFmpeg's decoder."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from mrnav_server.app import openh264
from mrnav_server.app.h264_stream import H264Stream
from mrnav_server.app.openh264 import H264Encoder, OpenH264
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.records import Frame


@pytest.fixture(scope="module")
def library() -> OpenH264:
    try:
        return OpenH264()
    except ConfigError as error:
        pytest.skip(str(error))


def frames(count: int, width_px: int = 640, height_px: int = 480) -> list[Frame]:
    """A dark disk that crosses a grey field with the camera's noise."""
    noise = np.random.default_rng(1)
    found = []
    for number in range(count):
        image = np.full((height_px, width_px, 3), 150, np.uint8)
        cv2.circle(image, (100 + 8 * number, 200), 33, (40, 60, 30), -1)
        image += noise.integers(0, 9, image.shape, np.uint8)
        found.append(Frame(number, number / 30.0, image))
    return found


def decoded(stream: bytes, folder: Path) -> list[ByteArray]:
    file = folder / "stream.h264"
    file.write_bytes(stream)
    film, found = cv2.VideoCapture(str(file), cv2.CAP_FFMPEG), []
    while (read := film.read())[0]:
        found.append(np.asarray(read[1], np.uint8))
    return found


def psnr_db(one: ByteArray, other: ByteArray) -> float:
    return float(10.0 * np.log10(255.0**2 / np.mean((one.astype(float) - other) ** 2)))


def test_a_decoder_sees_what_was_encoded(library: OpenH264, tmp_path: Path) -> None:
    stream = H264Stream(library, 320)
    given = frames(40)
    coded = [stream.encode(frame) for frame in given]
    stream.close()
    assert [is_key for _, is_key in coded] == [True] + [False] * 39
    assert coded[0][0].startswith(b"\0\0\0\1\x67")
    seen = decoded(b"".join(data for data, _ in coded), tmp_path)
    assert len(seen) == 40
    for frame, picture in zip(given, seen, strict=True):
        small = cv2.resize(frame.image, (320, 240), interpolation=cv2.INTER_AREA)
        assert psnr_db(np.asarray(small, np.uint8), picture) > 32.0
    jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1].size
    assert sum(len(data) for data, _ in coded[1:]) / 39 < jpeg / 4


@pytest.mark.parametrize(("width_px", "size"), [(64, (64, 48)), (4096, (636, 478)), (97, (96, 72))])
def test_sides_are_even_and_never_enlarged(
    library: OpenH264, tmp_path: Path, width_px: int, size: tuple[int, int]
) -> None:
    stream = H264Stream(library, width_px)
    data, _ = stream.encode(frames(1, 637, 479)[0])
    stream.close()
    width, height = size
    assert decoded(data, tmp_path)[0].shape == (height, width, 3)


def test_another_size_begins_anew(library: OpenH264) -> None:
    stream = H264Stream(library, 4096)
    assert [stream.encode(frame)[1] for frame in frames(2)] == [True, False]
    assert stream.encode(frames(1, 320, 240)[0])[1]
    stream.close()
    stream.close()


def test_a_picture_of_another_shape_is_refused(library: OpenH264) -> None:
    encoder = H264Encoder(library, 64, 48)
    with pytest.raises(ValueError, match="none of 64×48"):
        encoder.encode(np.zeros((48, 64), np.uint8), 0.0)
    encoder.close()


def test_a_machine_without_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(openh264, "find_library", lambda _: None)
    monkeypatch.setattr(openh264, "_FILES", ("libno-such-thing.so.1",))
    with pytest.raises(ConfigError, match=r"server\.h264 needs OpenH264.*libopenh264"):
        OpenH264()
