"""An emulated manipulator controller as a child process, for commands that need one."""

import json
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from mrnav_server.cli.children import mrnav_child
from mrnav_server.cli.console import TrialFailedError
from mrnav_server.devices.sensapex.smcp1 import BASE_PORT

_READY_S = 30.0
_GROUPS = 11


@contextmanager
def emulated_controller(env: Mapping[str, str], scratch: Path) -> Iterator[dict[str, str]]:
    """Run a controller on this computer for the length of a ``with`` block.

    Args:
        env: Variables of the rig that it stands in, on top of this process's own: it begins over its vessel.
        scratch: Folder for its files.

    Yields:
        The variables with which a server finds it.

    Raises:
        TrialFailedError: If it does not start.
    """
    group = _free_group()
    ready_file, trace = scratch / "emulator.json", scratch / "emulator.trace"
    arguments = ["emulate", "ump", "--group", str(group), "--control-port", "0"]
    arguments += ["--ready-file", str(ready_file), "--trace", str(trace)]
    with mrnav_child("the emulated controller", arguments, env, scratch / "emulator.log") as child:
        deadline_s = time.monotonic() + _READY_S
        while not ready_file.exists():
            child.check()
            if time.monotonic() > deadline_s:
                raise TrialFailedError(f"the emulated controller was not ready within {_READY_S:g} s")
            time.sleep(0.02)
        host = json.loads(ready_file.read_text())["host"]
        yield {"MRNAV_SENSAPEX__ADDRESS": host, "MRNAV_SENSAPEX__GROUP": str(group)}


def _free_group() -> int:
    """Return a group whose UDP port nobody on this computer uses.

    Raises:
        TrialFailedError: If all are in use.
    """
    for group in range(_GROUPS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", BASE_PORT + group))
            except OSError:
                continue
            return group
    raise TrialFailedError(f"UDP ports {BASE_PORT} to {BASE_PORT + _GROUPS - 1} are all in use: end a server")
