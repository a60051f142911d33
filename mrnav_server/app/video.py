"""The microscope's picture: over WebSocket, as MJPEG and as stills. The newest frame wins."""

import asyncio
import logging
import struct
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, TypeVarTuple

import cv2
from fastapi import WebSocket, WebSocketDisconnect
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from mrnav_server.app import connections
from mrnav_server.app.h264_stream import H264Stream
from mrnav_server.app.openh264 import OpenH264
from mrnav_server.app.problems import ApiError
from mrnav_server.core.records import Frame
from mrnav_server.loops.latest import Latest

HEADER = struct.Struct("<IId")
"""Frame number, format, capture time in seconds."""
JPEG, H264_KEY, H264_DELTA = 0, 1, 2
"""Formats: a JPEG; H.264 that stands by itself; H.264 that builds on what was sent before."""
_MAX_CLIENTS = 32
_MAX_H264 = 4
"""Each takes an encoder of its own; further viewers get JPEG, which is encoded once for all."""
_BOUNDARY = "frame"
_T = TypeVar("_T")
_Ts = TypeVarTuple("_Ts")
_log = logging.getLogger(__name__)


class VideoEncoder:
    """Encodes frames in a thread of its own, JPEG once per size and quality for everybody.

    Args:
        frames: The camera's newest frame.
    """

    def __init__(self, frames: Latest[Frame]) -> None:
        self._frames = frames
        self._thread = ThreadPoolExecutor(1, "jpeg")
        self._jobs: dict[tuple[int, int], tuple[int, asyncio.Future[bytes]]] = {}

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    async def h264_newer_than(self, version: int, stream: H264Stream) -> tuple[Frame, bytes, bool, int]:
        """Wait for a frame newer than ``version`` and encode it into one viewer's stream.

        Returns:
            The frame, its bytes, whether they stand by themselves, and the frame's version.
        """
        frame, version = await self._frames.newer_than(version)
        data, is_key = await self._in_thread(stream.encode, frame)
        return frame, data, is_key, version

    async def close_stream(self, stream: H264Stream) -> None:
        """Close a stream, after whatever is encoded into it."""
        await self._in_thread(stream.close)

    async def newer_than(self, version: int, width_px: int, quality: int) -> tuple[Frame, bytes, int]:
        """Wait for a frame newer than ``version``.

        Args:
            version: Version of the last frame, 0 for none.
            width_px: Width of the picture; a frame is never enlarged.
            quality: JPEG quality, 1..100.

        Returns:
            The frame, its JPEG, and its version.
        """
        frame, version = await self._frames.newer_than(version)
        known = self._jobs.get((width_px, quality))
        if known is None or known[0] != version:
            job = self._in_thread(encode_jpeg, frame, width_px, quality)
            self._jobs = {key: value for key, value in self._jobs.items() if value[0] == version}
            self._jobs[width_px, quality] = known = version, job
        # Others may wait for the same job: a client that leaves must not cancel it.
        return frame, await asyncio.shield(known[1]), version

    def _in_thread(self, work: Callable[[*_Ts], _T], *arguments: *_Ts) -> asyncio.Future[_T]:
        return asyncio.get_running_loop().run_in_executor(self._thread, work, *arguments)


class VideoHub:
    """Serves video to many clients.

    Args:
        encoder: Encodes frames.
        openh264: For viewers that ask for H.264; None serves JPEG alone.
    """

    def __init__(self, encoder: VideoEncoder, openh264: OpenH264 | None = None) -> None:
        self._encoder = encoder
        self._openh264 = openh264
        self._h264_clients = 0
        self.clients = 0
        self.slow_readers = 0

    async def serve(self, websocket: WebSocket, width_px: int, quality: int, *, takes_h264: bool) -> None:
        """Send frames to one client until it leaves or lags.

        Args:
            websocket: Its connection.
            width_px: Width of the pictures.
            quality: Of JPEG.
            takes_h264: Whether it also takes H.264; every picture says what it is.

        Raises:
            ApiError: 503 if too many clients are connected.
        """
        self._require_room()
        self.clients += 1
        try:
            await websocket.accept()
            async with asyncio.TaskGroup() as group:
                send = self._send_h264 if takes_h264 and self._has_h264 else self._send_jpeg
                group.create_task(send(websocket, width_px, quality), name="video frames")
                group.create_task(_until_closed(websocket), name="video watch")
        except* WebSocketDisconnect:
            pass
        except* TimeoutError:
            self._count_slow_reader()
        finally:
            self.clients -= 1

    def mjpeg(self, width_px: int, quality: int) -> Response:
        """Return an endless multipart answer for plain ``<img>`` use.

        Raises:
            ApiError: 503 if too many clients are connected.
        """
        self._require_room()
        return _MjpegResponse(self, self._parts(width_px, quality))

    @property
    def _has_h264(self) -> bool:
        return self._openh264 is not None and self._h264_clients < _MAX_H264

    async def _send_jpeg(self, websocket: WebSocket, width_px: int, quality: int) -> None:
        version = 0
        while True:
            frame, jpeg, version = await self._encoder.newer_than(version, width_px, quality)
            await _send(websocket, frame, JPEG, jpeg)

    async def _send_h264(self, websocket: WebSocket, width_px: int, _: int) -> None:
        assert self._openh264 is not None
        stream, version = H264Stream(self._openh264, width_px), 0
        self._h264_clients += 1
        try:
            while True:
                frame, data, is_key, version = await self._encoder.h264_newer_than(version, stream)
                if data:
                    await _send(websocket, frame, H264_KEY if is_key else H264_DELTA, data)
        finally:
            self._h264_clients -= 1
            await self._encoder.close_stream(stream)

    async def _parts(self, width_px: int, quality: int) -> AsyncIterator[bytes]:
        version = 0
        while True:
            _, jpeg, version = await self._encoder.newer_than(version, width_px, quality)
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            yield head.encode() + jpeg + b"\r\n"

    def _require_room(self) -> None:
        if self.clients >= _MAX_CLIENTS:
            raise ApiError(503, "too_many_clients", f"{_MAX_CLIENTS} clients take video already")

    def _count_slow_reader(self) -> None:
        self.slow_readers += 1
        _log.warning("a video client that did not read for %g s was dropped", connections.SLOW_READER_S)

    async def stream(self, parts: AsyncIterator[bytes], send: Send) -> None:
        """Send a multipart answer's parts, each within the time limit."""
        self.clients += 1
        try:
            async for part in parts:
                async with asyncio.timeout(connections.SLOW_READER_S):
                    await send({"type": "http.response.body", "body": part, "more_body": True})
        except TimeoutError:
            self._count_slow_reader()
        finally:
            self.clients -= 1


class _MjpegResponse(Response):
    """Ends when the client leaves or does not read; Starlette's own streaming waits for ever."""

    media_type = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"

    def __init__(self, hub: VideoHub, parts: AsyncIterator[bytes]) -> None:
        super().__init__()
        self._hub = hub
        self._parts = parts
        del self.headers["content-length"]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
        async with asyncio.TaskGroup() as group:
            stream = group.create_task(self._hub.stream(self._parts, send), name="mjpeg")
            watch = group.create_task(_until_disconnected(receive), name="mjpeg watch")
            await asyncio.wait((stream, watch), return_when=asyncio.FIRST_COMPLETED)
            stream.cancel()
            watch.cancel()


def encode_jpeg(frame: Frame, width_px: int, quality: int) -> bytes:
    """Return a frame as JPEG, shrunk to a width; the height keeps the aspect."""
    image = frame.image
    height, width = image.shape[:2]
    if width_px < width:
        size = width_px, max(1, round(height * width_px / width))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError(f"OpenCV cannot encode a picture of shape {image.shape}")
    return jpeg.tobytes()


async def _send(websocket: WebSocket, frame: Frame, form: int, data: bytes) -> None:
    async with asyncio.timeout(connections.SLOW_READER_S):
        await websocket.send_bytes(HEADER.pack(frame.number & 0xFFFFFFFF, form, frame.taken_s) + data)


async def _until_closed(websocket: WebSocket) -> None:
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1005))


async def _until_disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
