"""A server whose simulated camera fails to order, and an operator's hand that supervises it."""

import contextlib
import math
import socket
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tests.camera_server import COMMAND, SOCKET
from tests.hand_client import HandClient
from tests.rig_process import RigProcess, wait_for


class CameraRig:
    """Use it in a ``with`` block.

    Args:
        folder: For files.
        env: Further settings of the server.
    """

    def __init__(self, folder: Path, **env: str) -> None:
        self._socket = str(folder / "camera")
        settings = {SOCKET: self._socket, "MRNAV_AUTOPILOT__SOURCE": "geodesic"}
        self.rig = RigProcess(folder, command=COMMAND, **settings | env)

    def __enter__(self) -> Self:
        try:
            self._hand = HandClient(self.rig.ready["hand_port"], self.rig.ready["operator_token"])
            self._hand.__enter__()
        except BaseException:
            self.rig.end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._hand.__exit__(kind, error, trace)
        self.rig.end()

    def prepare(self) -> str:
        """Begin a trial, mark all areas and arm; return the trial's id."""
        trial = self.rig.begin_trial()
        for site in self.rig.snapshot["vessel"]["suggested_areas"][1:]:
            center = {"frame": "vessel", "x": site["x_px"], "y": site["y_px"]}
            self.rig.post("/api/v1/critical-areas", {"center": center, "epsilon_um": 500.0})
        return trial

    def go(self) -> None:
        """Bring the rig into AUTO, in motion, towards the area that is farthest away."""
        rig = self.rig
        rig.until(lambda s: s["auto_ready"], "the guards of AUTO")
        robot = rig.state["robot_vessel_px"]

        def away_px(area: dict[str, Any]) -> float:
            return math.dist((area["center"]["x_px"], area["center"]["y_px"]), robot)

        farthest = max(rig.http.get("/api/v1/critical-areas").json(), key=away_px)
        start_um = rig.state["tip_um"]

        def moved() -> bool:
            # On a busy machine the hand is late now and then, and AUTO is held for that.
            if rig.state["mode"] != "AUTO":
                self._granted(farthest["id"])
            return math.dist(rig.state["tip_um"], start_um) > 300.0

        wait_for(moved, 30.0, "motion in AUTO")

    def spoil(self, fault: str) -> float:
        """Let the camera fail, or recover; return when the first picture was spoilt, monotonic."""
        with contextlib.closing(socket.socket(socket.AF_UNIX)) as line:
            line.settimeout(5.0)
            line.connect(self._socket)
            line.sendall(f"{fault}\n".encode())
            return float(line.makefile().readline())

    def _granted(self, area: str) -> bool:
        return self.rig.http.post("/api/v1/mode", json={"ask": "auto", "area": area}).is_success
