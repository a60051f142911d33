"""Films trials: hands the recorder the pictures that viewers get."""

import asyncio
from pathlib import Path

from mrnav_server.app.video import VideoEncoder
from mrnav_server.loops.video_recorder import VIDEO_NAME, VideoConfig, VideoRecorder, VideoSummary


class TrialVideo:
    """Records one film per trial while ``run`` runs.

    At a width and quality that a viewer asks for too, no picture is encoded for the film alone.

    Args:
        config: Whether and how trials are filmed.
        encoder: Turns the newest frame into JPEG.
    """

    def __init__(self, config: VideoConfig, encoder: VideoEncoder) -> None:
        self._config = config
        self._encoder = encoder
        self._recorder: VideoRecorder | None = None
        self._filming = asyncio.Event()

    @property
    def fault(self) -> str:
        """Why the running trial is not filmed any more, in plain words; "" while all is well."""
        return self._recorder.fault if self._recorder else ""

    def begin(self, folder: Path) -> None:
        """Film from the newest frame on, into a trial's folder, if trials are filmed at all."""
        if self._config.enabled:
            self._recorder = VideoRecorder(folder / VIDEO_NAME, self._config.min_free_mb)
            self._filming.set()

    async def end(self) -> VideoSummary | None:
        """Close the film; tell what is in it, None without one."""
        self._filming.clear()
        recorder, self._recorder = self._recorder, None
        return await asyncio.to_thread(recorder.finish) if recorder else None

    async def run(self) -> None:
        """Hand over pictures until cancelled."""
        version = 0
        while True:
            await self._filming.wait()
            frame, jpeg, version = await self._encoder.newer_than(
                version, self._config.width_px, self._config.quality
            )
            if self._recorder is not None:
                self._recorder.add(frame.taken_s, jpeg)
