"""The picture's way from capture to pixels: in Chromium, decoded and drawn, and at a client in Python.

Run from a checkout: ``python -m benchmarks.video``. Prints one JSON object. The server is a whole one on the
simulated rig, whose camera takes no time of its own here. A frame's age is taken when its pixels can be read:
in Chromium once the picture is decoded and drawn on a canvas of 800×600, in Python after OpenCV decoded the
JPEG. ``h264`` is Chromium's again, with H.264 in place of JPEG; null where this machine has no OpenH264.
Chromium's clock is set against the system's monotonic one by asking for it several times; half of the
shortest round trip may be off.
The server's CPU time is that beyond what the same server takes without a viewer.
"""

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
from playwright.sync_api import Page, sync_playwright
from websockets.sync.client import connect

from mrnav_server.app.openh264 import OpenH264
from mrnav_server.app.video import HEADER
from mrnav_server.core.errors import ConfigError
from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS
from tests.rig_process import RigProcess

_QUERY = "/ws/video?width=800&quality=75"
_SETTLE_S = 1.0
_LISTEN = """([query, seconds]) => Promise.all(
  ["jpeg", "h264"].map((name) => import(`${location.origin}/static/js/${name}.js`))
).then(([{ decodeJpeg }, { H264Decoder }]) => new Promise((done, fail) => {
  const canvas = Object.assign(document.createElement("canvas"), { width: 800, height: 600 });
  const context = canvas.getContext("2d", { alpha: false });
  const socket = new WebSocket(location.origin.replace("http", "ws") + query);
  socket.binaryType = "arraybuffer";
  const frames = [], sent_s = [];
  let bytes = 0, newest = null, decoding = false;
  const draw = (picture, taken_s) => {
    context.drawImage(picture.image, 0, 0);
    picture.close();
    context.getImageData(400, 300, 1, 1);
    frames.push([taken_s, performance.now()]);
  };
  const h264 = new H264Decoder({ onPicture: (picture) => draw(picture, sent_s.shift()), onFailure: fail });
  const decode = async () => {
    if (decoding) return;
    decoding = true;
    while (newest) {
      const data = newest;
      newest = null;
      draw(await decodeJpeg(new Uint8Array(data, 16)), new DataView(data).getFloat64(8, true));
    }
    decoding = false;
  };
  socket.onmessage = (message) => {
    bytes += message.data.byteLength;
    const header = new DataView(message.data), taken_s = header.getFloat64(8, true);
    if (header.getUint32(4, true) === 0) {
      newest = message.data;
      decode().catch(fail);
    } else {
      sent_s.push(taken_s);
      h264.push(new Uint8Array(message.data, 16), header.getUint32(4, true) === 1, taken_s);
    }
  };
  socket.onerror = () => fail(new Error("the video cannot be opened"));
  setTimeout(() => { socket.close(); done({ frames, bytes }); }, 1000 * seconds);
}))"""


def video(seconds: float) -> dict[str, Any]:
    """Return ages in ms, the stream in Mbit/s and CPU in percent of a core, each viewer by itself.

    Args:
        seconds: Length of each measurement.
    """
    with tempfile.TemporaryDirectory() as folder:
        has_h264 = _has_h264()
        settings = {"MRNAV_SIM__CAMERA_LATENCY_MS": "0", "MRNAV_SERVER__H264": str(has_h264).lower()}
        rig = RigProcess(Path(folder), **settings)
        try:
            rig.until(lambda s: s["track"]["state"] == "tracking", "finding the robot")
            time.sleep(_SETTLE_S)
            before, began_s = _cpu_s(rig), time.monotonic()
            time.sleep(seconds)
            idle_percent = _percent(rig, before, began_s)
            python = _in_python(rig, seconds)
            browser = _in_chromium(rig, _QUERY, seconds, idle_percent)
            h264 = _in_chromium(rig, f"{_QUERY}&codec=h264", seconds, idle_percent) if has_h264 else None
        finally:
            rig.end()
    return {
        "simulated": True,
        "seconds": seconds,
        "width_px": 800,
        "height_px": 600,
        **browser,
        "python": python,
        "h264": h264,
    }


def _has_h264() -> bool:
    try:
        OpenH264()
    except ConfigError:
        return False
    return True


def _in_python(rig: RigProcess, seconds: float) -> dict[str, float]:
    ages_ms: list[float] = []
    headers = {"Authorization": f"Bearer {rig.ready['viewer_token']}"}
    url = rig.url.replace("http", "ws") + _QUERY
    with connect(
        url, additional_headers=headers, proxy=None, compression=None, max_size=None, max_queue=1
    ) as link:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            data = link.recv()
            assert isinstance(data, bytes)
            cv2.imdecode(np.frombuffer(data, np.uint8, offset=HEADER.size), cv2.IMREAD_COLOR)
            ages_ms.append(1000.0 * (time.monotonic() - HEADER.unpack_from(data)[2]))
    return _summary(ages_ms, seconds)


def _in_chromium(rig: RigProcess, query: str, seconds: float, idle_percent: float) -> dict[str, float]:
    os.environ["no_proxy"] = "127.0.0.1"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page()
        # A page without work of its own, so that what is measured is the stream.
        page.goto(f"{rig.url}/?token={rig.ready['viewer_token']}")
        page.goto(f"{rig.url}/healthz")
        offset_s, unsure_ms = _clock_offset(page)
        before, began_s = _cpu_s(rig), time.monotonic()
        seen = page.evaluate(_LISTEN, [query, seconds])
        cpu_percent = _percent(rig, before, began_s)
        browser.close()
    ages_ms = [1000.0 * (at_ms / 1000.0 + offset_s - taken_s) for taken_s, at_ms in seen["frames"]]
    return _summary(ages_ms, seconds) | {
        "mbit_s": round(8e-6 * seen["bytes"] / seconds, 2),
        "cpu_percent": round(cpu_percent - idle_percent, 1),
        "clock_unsure_ms": round(unsure_ms, 2),
    }


def _clock_offset(page: Page) -> tuple[float, float]:
    """Return the monotonic clock minus the page's in s, and how far that may be off in ms."""
    best = (0.0, float("inf"))
    for _ in range(50):
        before_s = time.monotonic()
        page_s = page.evaluate("performance.now()") / 1000.0
        after_s = time.monotonic()
        half_s = (after_s - before_s) / 2.0
        if 1000.0 * half_s < best[1]:
            best = before_s + half_s - page_s, 1000.0 * half_s
    return best


def _summary(ages_ms: list[float], seconds: float) -> dict[str, float]:
    p50_ms, p99_ms = np.percentile(ages_ms, (50, 99))
    return {
        "p50_ms": round(float(p50_ms), 2),
        "p99_ms": round(float(p99_ms), 2),
        "fps": round(len(ages_ms) / seconds, 1),
    }


def _cpu_s(rig: RigProcess) -> float:
    times = psutil.Process(rig.process.pid).cpu_times()
    return float(times.user + times.system)


def _percent(rig: RigProcess, before_s: float, began_s: float) -> float:
    return 100.0 * (_cpu_s(rig) - before_s) / (time.monotonic() - began_s)


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    print(json.dumps(video(parser.parse_args().seconds)))


if __name__ == "__main__":
    main()
