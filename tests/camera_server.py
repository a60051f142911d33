"""``mrnav`` whose simulated camera fails to order.

Write ``freeze``, ``black``, ``end``, ``half``, ``unplug`` or ``recover`` and a newline to the socket at
``TEST_CAMERA``; the answer is when the first picture was spoilt, on the monotonic clock: the moment at
which it was taken, or should have been.
"""

import os
import socket
import sys
import threading
import time
from collections.abc import Callable

import mrnav_server.app.bench as bench
from mrnav_server.cli.main import main
from mrnav_server.core.errors import DeviceError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.sim.devices import Renderer, SimulatedCamera
from mrnav_server.sim.world import SimConfig, Snapshot

COMMAND = (sys.executable, "-m", "tests.camera_server")
SOCKET = "TEST_CAMERA"
FAULTS = ("freeze", "black", "end", "half", "unplug")


class FailingCamera(SimulatedCamera):
    """A simulated camera that obeys the socket."""

    def __init__(
        self,
        config: SimConfig,
        picture: PictureFormat,
        snapshot: Callable[[], Snapshot],
        render: Renderer,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        super().__init__(config, picture, snapshot, render, clock, sleep)
        self._wanted = self._fault = ""
        self._spoilt_s = 0.0
        self._told = threading.Event()
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(os.environ[SOCKET])
        listener.listen()
        threading.Thread(target=self._obey, args=(listener,), daemon=True).start()

    def open(self) -> None:
        if self._fault == "end":
            raise DeviceError("the stream has ended")
        super().open()

    def read(self, timeout_s: float) -> Frame:
        frame = super().read(timeout_s)
        if self._wanted != self._fault:
            # Between two pictures, so that the first spoilt one is known.
            self._fault, self._spoilt_s = self._wanted, frame.taken_s
            if self._fault == "freeze":
                self.freeze()
                self._spoilt_s += self._period_s
            elif self._fault == "black":
                self.black_out()
                self._spoilt_s += self._period_s
            elif self._fault == "unplug":
                self.unplug()
                self._spoilt_s = time.monotonic()
            self._told.set()
            if self._fault == "half":
                return super().read(timeout_s)
        if self._fault == "end":
            raise DeviceError("the stream has ended")
        if self._fault == "half":
            frame = super().read(timeout_s)
        return frame

    def _obey(self, listener: socket.socket) -> None:
        while True:
            connection, _ = listener.accept()
            with connection, connection.makefile("rw") as lines:
                self._wanted = lines.readline().strip()
                if self._wanted == "recover":
                    self.recover()
                    self._wanted = self._fault = ""
                    self._spoilt_s = time.monotonic()
                else:
                    self._told.clear()
                    self._told.wait()
                lines.write(f"{self._spoilt_s}\n")
                lines.flush()


if __name__ == "__main__":
    vars(bench)["SimulatedCamera"] = FailingCamera
    main()
