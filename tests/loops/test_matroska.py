"""Films as bytes: laid out as RFC 9559 says, whole at every cluster, stamps true at any rate."""

import itertools
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.loops.matroska import MAX_CLUSTER_BYTES, MAX_CLUSTER_TICKS, MatroskaMuxer
from tests.films import Element, elements, packets, played, tag

PICTURES = [
    cv2.imencode(".jpg", np.full((48, 64, 3), 20 * level, np.uint8))[1].tobytes() for level in range(12)
]


def film(ticks: list[int], jpegs: list[bytes]) -> list[bytes]:
    """Return a film as it is written: the head, the clusters, and all of it at its end."""
    muxer = MatroskaMuxer(64, 48, {"PLACE": "Zürich"})
    parts = [muxer.head, *(muxer.add(*frame) for frame in zip(ticks, jpegs, strict=True))]
    whole = bytearray(b"".join(parts) + muxer.tail())
    assert muxer.frames == len(ticks)
    for offset, content in muxer.patches():
        whole[offset : offset + len(content)] = content
    return [part for part in parts if part] + [bytes(whole)]


def pictures(count: int) -> list[bytes]:
    return [PICTURES[number % len(PICTURES)] for number in range(count)]


def named(found: list[Element], name: str) -> list[Element]:
    return [element for element in found if element.path.endswith(f"/{name}")]


def number(element: Element) -> int:
    return int.from_bytes(element.content, "big")


def frames(film: bytes) -> list[tuple[int, bytes]]:
    """Return every frame's time in ticks and its JPEG."""
    found: list[tuple[int, bytes]] = []
    cluster = 0
    for element in elements(film):
        if element.path == "/Segment/Cluster/Timestamp":
            cluster = number(element)
        elif element.path == "/Segment/Cluster/SimpleBlock":
            track, relative, flags = struct.unpack(">BhB", element.content[:4])
            assert (track, flags) == (0x81, 0x80)
            found.append((cluster + relative, element.content[4:]))
    return found


RATES = st.lists(st.integers(1, 4000), min_size=1, max_size=40).map(
    lambda gaps: list(itertools.accumulate(gaps, initial=0))
)


@settings(max_examples=60, deadline=None)
@given(ticks=RATES)
def test_frames_come_back_at_their_times_and_the_index_finds_every_cluster(ticks: list[int]) -> None:
    whole = film(ticks, pictures(len(ticks)))[-1]
    assert frames(whole) == list(zip(ticks, pictures(len(ticks)), strict=True))
    found = list(elements(whole))
    (segment,) = named(found, "Segment")
    assert segment.size == len(segment.content)
    start = len(whole) - len(segment.content)
    clusters, (cues,) = named(found, "Cluster"), named(found, "Cues")
    assert [number(place) + start for place in named(found, "CueClusterPosition")] == [
        cluster.offset for cluster in clusters
    ]
    stamps = [number(stamp) for stamp in named(found, "Timestamp")]
    assert [number(time) for time in named(found, "CueTime")] == stamps
    assert number(named(found, "SeekPosition")[0]) + start == cues.offset
    assert named(found, "SeekID")[0].content == bytes.fromhex("1C53BB6B")
    (duration_ticks,) = struct.unpack(">d", named(found, "Duration")[0].content)
    assert duration_ticks == ticks[-1] + ticks[-1] - ticks[-2]


def test_the_head_says_what_the_film_is() -> None:
    found = {element.path: element for element in elements(film([0], pictures(1))[-1])}
    assert found["/EBML/DocType"].content == b"matroska"
    assert number(found["/Segment/Info/TimestampScale"]) == 1_000_000
    track = "/Segment/Tracks/TrackEntry"
    assert found[f"{track}/CodecID"].content == b"V_MJPEG"
    assert (number(found[f"{track}/Video/PixelWidth"]), number(found[f"{track}/Video/PixelHeight"])) == (
        64,
        48,
    )
    assert f"{track}/DefaultDuration" not in found
    assert tag(film([0], pictures(1))[-1], "PLACE") == "Zürich"


@settings(max_examples=30, deadline=None)
@given(ticks=RATES)
def test_what_is_written_is_whole_after_every_cluster(ticks: list[int]) -> None:
    parts = film(ticks, pictures(len(ticks)))[:-1]
    for written in range(1, len(parts) + 1):
        left = frames(b"".join(parts[:written]))
        assert left == list(zip(ticks, pictures(len(ticks)), strict=True))[: len(left)]
        assert left or written == 1
    # What is not written yet is the last cluster, of at most a second.
    assert ticks[-1] - ticks[len(left)] <= MAX_CLUSTER_TICKS


def test_a_cluster_is_bounded_in_time_and_size() -> None:
    large = b"\xff\xd8" + bytes(MAX_CLUSTER_BYTES // 3)
    whole = film(list(range(0, 300, 33)), [large] * 10)[-1]
    assert [
        len(named(list(elements(c.content)), "SimpleBlock")) for c in named(list(elements(whole)), "Cluster")
    ] == [2] * 5
    small = film([0, 500, MAX_CLUSTER_TICKS, MAX_CLUSTER_TICKS + 1], pictures(4))[-1]
    assert [number(stamp) for stamp in named(list(elements(small)), "Timestamp")] == [
        0,
        MAX_CLUSTER_TICKS + 1,
    ]


@settings(max_examples=10, deadline=None)
@given(ticks=RATES)
def test_players_see_every_frame_at_its_time(
    ticks: list[int], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("film") / "film.mkv"
    path.write_bytes(film(ticks, pictures(len(ticks)))[-1])
    shown = played(path)
    assert [frame.stamp_s for frame in shown] == pytest.approx([1e-3 * tick for tick in ticks], abs=1e-3)
    assert packets(path) == pictures(len(ticks))
    for frame, jpeg in zip(shown, pictures(len(ticks)), strict=True):
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        # Two decoders round colour differently.
        assert np.abs(frame.image.astype(int) - image).max() <= 2


def test_players_take_what_a_crash_leaves(tmp_path: Path) -> None:
    path = tmp_path / "left.mkv"
    ticks = list(range(0, 5000, 100))
    parts = film(ticks, pictures(50))[:-1]
    path.write_bytes(b"".join(parts))
    whole = len(frames(path.read_bytes()))
    assert len(played(path)) == whole == 44
    # Killed while a cluster is written: the frames before it, at least, are played.
    path.write_bytes(b"".join(parts)[:-300])
    assert len(played(path)) >= 33
