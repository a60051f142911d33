"""A server that drives an emulated controller, each a process of its own."""

import math
import socket
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mrnav_server.cli.emulate import start_of_the_rig
from mrnav_server.devices.sensapex.emulator_faults import Faults
from mrnav_server.devices.sensapex.smcp1 import MOVE, UNDEFINED, Block, Kind, Message, encode
from mrnav_server.settings import Settings
from tests.devices.emulator_process import EmulatorProcess
from tests.rig_process import MRNAV, RigProcess, wait_for

SMALL = {
    "MRNAV_CAMERA__WIDTH_PX": "800",
    "MRNAV_CAMERA__HEIGHT_PX": "600",
    "MRNAV_SIM__IMAGE_UM_PER_PX": "30",
    "MRNAV_AUTOPILOT__SOURCE": "geodesic",
}
"""Starts sooner, and leaves the machine to what is tested."""

PATIENT = {
    "MRNAV_SUPERVISOR__HANG_S": "0.2",
    "MRNAV_SENSAPEX__SILENT_MS": "400",
    "MRNAV_GUARDS__TIP_AGE_S": "0.4",
}
"""A busy machine must not look like a server that hangs or a controller that is silent."""


class EmulatedRig:
    """Emulator and server; use it in a ``with`` block.

    Args:
        folder: For files.
        env: Further settings of the server.
        driver: ``sensapex-udp`` or ``sensapex-sdk``.
        command: What stands in for ``mrnav``.
    """

    def __init__(
        self,
        folder: Path,
        env: Mapping[str, str] | None = None,
        driver: str = "sensapex-udp",
        command: Sequence[str] = MRNAV,
    ) -> None:
        self._folder = folder
        self._command = command
        self.settings = SMALL | {"MRNAV_MANIPULATOR__DRIVER": driver} | dict(env or {})
        # Said here, so that the emulator imports nothing heavy.
        at = ",".join(map(str, start_of_the_rig(Settings())))
        self.emulator = EmulatorProcess(folder, "--control-port", "0", "--at", at)

    def __enter__(self) -> "EmulatedRig":
        self.emulator.__enter__()
        try:
            where = {"MRNAV_SENSAPEX__ADDRESS": self.emulator.host}
            self.rig = RigProcess(self._folder, command=self._command, **where, **self.settings)
        except BaseException:
            self.emulator.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.rig.end()
        self.emulator.__exit__()

    def prepare(self) -> None:
        """Take the lease and mark the suggested areas; once, before the first ``go``."""
        self.rig.post("/api/v1/lease", {"client": "faults"})
        self.rig.until(lambda s: s["track"]["state"] == "tracking", "finding the robot")
        for site in self.rig.snapshot["vessel"]["suggested_areas"]:
            center = {"frame": "vessel", "x": site["x_px"], "y": site["y_px"]}
            self.rig.post("/api/v1/critical-areas", {"center": center, "epsilon_um": 500.0})

    def go(self) -> None:
        """Bring the rig into AUTO, in motion, towards the area that is farthest away."""
        self.wheel_over_the_robot()
        areas = self.rig.http.get("/api/v1/critical-areas").json()
        robot = self.rig.state["robot_vessel_px"]

        def away_px(area: dict[str, dict[str, float]]) -> float:
            return math.dist((area["center"]["x_px"], area["center"]["y_px"]), robot)

        wait_for(self._armed, 10.0, "arming")
        self.rig.until(lambda s: s["auto_ready"], "the guards of AUTO")
        self.rig.ask("auto", area=max(areas, key=away_px)["id"])
        start_um = self.rig.state["tip_um"]
        self.rig.until(lambda s: math.dist(s["tip_um"], start_um) > 500.0, "motion")

    def recover(self) -> None:
        """Turn all knobs back, and disarm."""
        self.emulator.turn(**Faults().as_json())
        wait_for(lambda: not self.truth()["rebooting"], 10.0, "the reboot")
        self.rig.until(lambda s: s["tip_um"] is not None, "the tip")
        leave = "reset" if self.rig.state["mode"] in ("FAULT", "STOP") else "disarm"
        wait_for(lambda: self.granted(leave), 10.0, leave)
        self.rig.until(lambda s: s["mode"] == "DISARMED", "DISARMED")

    def _armed(self) -> bool:
        # On a busy machine a controller may seem to be silent for a moment.
        if self.rig.state["mode"] == "FAULT":
            self.granted("reset")
        return self.granted("arm")

    def granted(self, ask: str) -> bool:
        """Ask for a mode that is refused until the tip rests; tell whether it was granted."""
        return self.rig.http.post("/api/v1/mode", json={"ask": ask}).is_success

    def wheel_over_the_robot(self) -> None:
        """Turn the controller's own wheels until the magnet holds the robot where it is."""
        robot_um, offset_um = self.rig.state["robot_um"], self.rig.snapshot["calibration"]["magnet_offset_um"]
        z_um = self.truth()["true_um"][2]
        to_um = (robot_um[0] + offset_um[0], robot_um[1] + offset_um[1], z_um)
        target = Block((*(round(1000 * axis_um) for axis_um in to_um), UNDEFINED, 2000, 1))

        def there() -> bool:
            # Again and again: the server stops a tip that moves by itself until it was seen to rest.
            move = Message(1, 0x210, time.monotonic_ns() & 0xFFFF, MOVE, Kind.GOTO, (target,))
            wheels.sendto(encode(move), (self.emulator.host, self.emulator.port))
            time.sleep(0.1)
            return math.dist(self.truth()["true_um"][:3], to_um) < 1.0

        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wheels:
            wait_for(there, 10.0, "the wheels")

    def stops(self, since_s: float = 0.0) -> list[float]:
        """Return when STOP datagrams reached the controller, monotonic, in seconds."""
        return [
            line["t"]
            for line in self.emulator.trace()
            if line["dir"] == "rx" and line["kind"] == Kind.STOP.name and line["t"] >= since_s
        ]

    def truth(self) -> dict[str, Any]:
        """Return where the emulated manipulator really is."""
        return self.emulator.turn()
