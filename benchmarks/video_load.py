"""What watching costs the control loop: the tick's p99 with and without video clients, in one run.

Run from a checkout: ``python -m benchmarks.video_load``. Prints one JSON object. A hand drives a running
server by turns without and with viewers; each block is a trial, and its tick is the server's own figure: the
time from one beat of the control loop to the next, 10 ms nominally. The viewers run on the same machine, so
their reading is in the difference too. All simulated.
"""

import argparse
import itertools
import json
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from tests.hand_client import HandClient
from tests.rig_process import RigProcess

_SETTLE_S = 1.0
_STROKE_S = 0.5
_STROKE_M_PER_S = 0.002
_REST_S = 0.2
TRIAL = {"participant": "SIM0", "condition": "without_autonomy", "operator_kind": "simulated"}


class Viewers:
    """Video clients that read and forget.

    Args:
        url: The server's.
        token: A viewer's.
        count: How many.
        width_px: Width of their pictures.
    """

    def __init__(self, url: str, token: str, count: int, width_px: int) -> None:
        self.frames = 0
        self._stack = ExitStack()
        address = url.replace("http", "ws") + f"/ws/video?width={width_px}&quality=75"
        headers = {"Authorization": f"Bearer {token}"}
        for _ in range(count):
            client = connect(address, additional_headers=headers, proxy=None, compression=None)
            self._stack.enter_context(client)
            threading.Thread(target=self._read, args=(client,), daemon=True).start()

    def close(self) -> None:
        """Leave."""
        self._stack.close()

    def _read(self, client: ClientConnection) -> None:
        with suppress(ConnectionClosed):
            for _ in client:
                self.frames += 1


def video_load(pairs: int, block_s: float, clients: int = 4, width_px: int = 800) -> dict[str, Any]:
    """Return the tick's percentiles without and with viewers, and what the viewers add to its p99.

    Args:
        pairs: Blocks of each kind; which of a pair comes first alternates.
        block_s: Length of a block, at most 20 s: the server keeps 2000 ticks.
        clients: Video clients in a block with viewers.
        width_px: Width of their pictures.
    """
    found: dict[int, list[dict[str, float]]] = {0: [], clients: []}
    with _driven() as (rig, hand):
        for pair in range(pairs):
            for viewers in (0, clients) if pair % 2 == 0 else (clients, 0):
                found[viewers].append(_block(rig, hand, block_s, viewers, width_px))
                print(f"{viewers} viewers: {found[viewers][-1]}", file=sys.stderr)
    p99_ms = {viewers: np.array([one["p99"] for one in blocks]) for viewers, blocks in found.items()}
    added_ms = p99_ms[clients] - p99_ms[0]
    return {
        "simulated": True,
        "clients": clients,
        "width_px": width_px,
        "pairs": pairs,
        "block_s": block_s,
        "fps_seen": round(float(np.mean([one["fps"] for one in found[clients]])), 1),
        "tick_p50_ms_without": _median(one["p50"] for one in found[0]),
        "tick_p50_ms_with": _median(one["p50"] for one in found[clients]),
        "tick_p99_ms_without": _median(p99_ms[0]),
        "tick_p99_ms_with": _median(p99_ms[clients]),
        "tick_p99_added_ms": _median(added_ms),
        "tick_p99_added_ms_standard_error": round(_standard_error(added_ms), 3),
    }


@contextmanager
def _driven() -> Iterator[tuple[RigProcess, HandClient]]:
    """Give a server that a hand drives."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        rig = RigProcess(Path(folder))
        stack.callback(rig.end)
        hand = stack.enter_context(HandClient(rig.ready["hand_port"], rig.ready["operator_token"]))
        trial = rig.begin_trial()
        rig.post(f"/api/v1/trials/{trial}/end", {})
        yield rig, hand


def _block(
    rig: RigProcess, hand: HandClient, block_s: float, clients: int, width_px: int
) -> dict[str, float]:
    """Return the tick's percentiles over one block in ms, and frames a second that each viewer got."""
    viewers = Viewers(rig.url, rig.ready["viewer_token"], clients, width_px)
    try:
        time.sleep(_SETTLE_S)
        # On a busy machine the hand may have been late in the block before, which held the rig.
        hand.open_clutch()
        time.sleep(_REST_S)
        hand.close_clutch((0.0, 0.0, 0.0))
        rig.until(lambda s: s["mode"] == "MANUAL", "MANUAL")
        trial = rig.post("/api/v1/trials", TRIAL)["id"]
        frames, began_s = viewers.frames, time.monotonic()
        for direction in itertools.cycle((1.0, -1.0)):
            hand.close_clutch((direction * _STROKE_M_PER_S, 0.0, 0.0))
            time.sleep(_STROKE_S)
            if time.monotonic() - began_s >= block_s:
                break
        frames, took_s = viewers.frames - frames, time.monotonic() - began_s
        tick = rig.post(f"/api/v1/trials/{trial}/end", {})["latency_ms"]["tick"]
    finally:
        viewers.close()
    return {"p50": tick["p50"], "p99": tick["p99"], "fps": round(frames / took_s / max(clients, 1), 1)}


def _median(values: Iterator[float] | np.ndarray[Any, Any]) -> float:
    return round(float(np.median(list(values))), 3)


def _standard_error(values: np.ndarray[Any, Any]) -> float:
    """Return the standard error of a median, as of normally distributed values with these quartiles."""
    low, high = np.percentile(values, (25, 75))
    return float(1.2533 * (high - low) / 1.349 / np.sqrt(len(values)))


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--block-s", type=float, default=10.0)
    parser.add_argument("--clients", type=int, default=4)
    asked = parser.parse_args()
    print(json.dumps(video_load(asked.pairs, asked.block_s, asked.clients)))


if __name__ == "__main__":
    main()
