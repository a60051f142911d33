"""The microscope's picture: JPEG over WebSocket, as MJPEG and as stills. The newest frame wins."""

import asyncio
import logging
import struct
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor

import cv2
from fastapi import WebSocket, WebSocketDisconnect
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from mrnav_server.app import connections
from mrnav_server.app.problems import ApiError
from mrnav_server.core.records import Frame
from mrnav_server.loops.latest import Latest

HEADER = struct.Struct("<IId")
"""Frame number, reserved (0), capture time in seconds."""
_MAX_CLIENTS = 32
_BOUNDARY = "frame"
_log = logging.getLogger(__name__)


class VideoEncoder:
    """Encodes each frame once per size and quality, in a thread of its own.

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
            loop = asyncio.get_running_loop()
            job = loop.run_in_executor(self._thread, encode_jpeg, frame, width_px, quality)
            self._jobs = {key: value for key, value in self._jobs.items() if value[0] == version}
            self._jobs[width_px, quality] = known = version, job
        # Others may wait for the same job: a client that leaves must not cancel it.
        return frame, await asyncio.shield(known[1]), version


class VideoHub:
    """Serves video to many clients.

    Args:
        encoder: Turns frames into JPEG.
    """

    def __init__(self, encoder: VideoEncoder) -> None:
        self._encoder = encoder
        self.clients = 0
        self.slow_readers = 0

    async def serve(self, websocket: WebSocket, width_px: int, quality: int) -> None:
        """Send frames to one client until it leaves or lags.

        Raises:
            ApiError: 503 if too many clients are connected.
        """
        self._require_room()
        self.clients += 1
        try:
            await websocket.accept()
            async with asyncio.TaskGroup() as group:
                group.create_task(self._send(websocket, width_px, quality), name="video frames")
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

    async def _send(self, websocket: WebSocket, width_px: int, quality: int) -> None:
        version = 0
        while True:
            frame, jpeg, version = await self._encoder.newer_than(version, width_px, quality)
            header = HEADER.pack(frame.number & 0xFFFFFFFF, 0, frame.taken_s)
            async with asyncio.timeout(connections.SLOW_READER_S):
                await websocket.send_bytes(header + jpeg)

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


async def _until_closed(websocket: WebSocket) -> None:
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1005))


async def _until_disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
