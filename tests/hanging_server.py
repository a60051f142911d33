"""``mrnav`` with a fault to order: SIGUSR1 holds the interpreter's lock for 1.5 s, whatever goes on."""

import ctypes
import signal
import sys
from types import FrameType

from mrnav_server.cli.main import main

HANG_S = 1.5
COMMAND = (sys.executable, "-m", "tests.hanging_server")


def hang(_: int, __: FrameType | None) -> None:
    # Unlike CDLL, PyDLL keeps the interpreter's lock during the call: no thread of this process runs.
    ctypes.PyDLL(None).usleep(int(HANG_S * 1e6))


if __name__ == "__main__":
    signal.signal(signal.SIGUSR1, hang)
    main()
