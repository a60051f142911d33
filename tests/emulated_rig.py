"""A server that drives an emulated controller, each a process of its own."""

import math
import socket
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mrnav_server.devices.sensapex.smcp1 import MOVE, UNDEFINED, Block, Kind, Message, encode
from tests.devices.emulator_process import EmulatorProcess
from tests.rig_process import MRNAV, RigProcess, wait_for

SMALL = {
    "MRNAV_CAMERA__WIDTH_PX": "800",
    "MRNAV_CAMERA__HEIGHT_PX": "600",
    "MRNAV_SIM__IMAGE_UM_PER_PX": "30",
    "MRNAV_AUTOPILOT__SOURCE": "geodesic",
}
"""Starts sooner, and leaves the machine to what is tested."""


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
        # Where the settings' simulated rig begins; said here so that the emulator imports nothing heavy.
        self.emulator = EmulatorProcess(folder, "--control-port", "0", "--at", start_of_the_rig())

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

    def drive(self) -> str:
        """Bring the rig into AUTO, in full motion; return the trial's id."""
        trial = self.rig.begin_trial()
        self.rig.ask("auto")
        self.rig.until(lambda s: s["mode"] == "AUTO", "AUTO")
        start_um = self.rig.state["tip_um"]
        self.rig.until(
            lambda s: max(abs(a - b) for a, b in zip(s["tip_um"], start_um, strict=True)) > 800.0, "motion"
        )
        return trial

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


def start_of_the_rig() -> str:
    """Return where the tip of the default simulated rig begins, as the emulator takes it."""
    from mrnav_server.core.picture import PictureFormat
    from mrnav_server.sim.world import SimConfig, SimulatedWorld
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    vessel = load_vessel_model(find_model("bifurcation"))
    tip = SimulatedWorld(SimConfig(), vessel, PictureFormat()).tip
    return f"{tip.x_um},{tip.y_um},{tip.z_um},10000"
