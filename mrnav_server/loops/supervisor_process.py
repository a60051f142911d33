"""The supervisor: a small process that stops the manipulator when the server is killed or hangs.

    python -m mrnav_server.loops.supervisor_process ADDRESS PORT DEVICE_ID HANG_S REPORT_FILE

It reads one byte per control step on its standard input: ``m`` the tip may move, ``i`` it may not, ``q``
the server ends. The end of input without ``q`` means that the server was killed; silence after an ``m``
that it hangs. Everything it says is one JSON object per line (docs/safety.md).

It imports the standard library and the wire protocol, nothing else: it must be there at once, and stay.
"""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from mrnav_server.devices.sensapex.raw_stop import RawStop
from mrnav_server.devices.sensapex.stop_until_rest import Tip, stop_until_rest

MOVES, IDLE, QUIT = b"m", b"i", b"q"

_LATE_S = 0.008
"""After this, a look at whether the server is dying; its next beat is due 10 ms after the last."""
_LOOK_S = 0.003
_ANSWER_S = 0.1
_OVERSLEPT_S = 0.005
_EXITING = 0x4 | 0x200 | 0x400
"""Linux's marks of a process that exits, dumps its core, or was killed by a signal."""


class Beats:
    """What the server's beats say. Told the time; waits for nothing.

    Args:
        hang_s: A server that may move the tip and is silent for longer hangs.
    """

    def __init__(self, hang_s: float) -> None:
        self.newest_s: float | None = None
        self._hang_s = hang_s
        self._moves = False

    def heard(self, kind: bytes, now_s: float) -> None:
        """Take a beat."""
        self.newest_s, self._moves = now_s, kind == MOVES

    def pause_s(self, now_s: float) -> float:
        """Return in how long to look again."""
        if not self._moves or self.newest_s is None:
            return self._hang_s
        silent_s = now_s - self.newest_s
        return max(_LATE_S - silent_s, _LOOK_S if silent_s < self._hang_s else 0.0)

    def late(self, now_s: float) -> bool:
        """Tell whether a beat should have come while the tip may move."""
        return self._moves and self.newest_s is not None and now_s - self.newest_s >= _LATE_S

    def hangs(self, now_s: float) -> bool:
        """Tell whether the server has been silent for too long while the tip may move."""
        return self._moves and self.newest_s is not None and now_s - self.newest_s >= self._hang_s

    def disarm(self) -> None:
        """Ask nothing of the server until its next beat."""
        self._moves = False


class SupervisorProcess:
    """Listens to the server, and stops the manipulator in its place.

    Args:
        stop: Puts a STOP on the wire.
        tip: Where the tip is.
        hang_s: As in ``Beats``.
        report_file: What was done is appended here.
        say: Tells the server, if it still lives.
        dies: Tells whether the server is being killed.
    """

    def __init__(
        self,
        stop: RawStop,
        tip: Tip,
        hang_s: float,
        report_file: Path,
        say: Callable[[bytes], None],
        dies: Callable[[], bool],
    ) -> None:
        self._stop = stop
        self._tip = tip
        self._beats = Beats(hang_s)
        self._report_file = report_file
        self._say = say
        self._dies = dies
        self._ended = threading.Event()
        self._quit = False

    def listen(self, beats: int) -> None:
        """Read beats from a file descriptor until its end."""
        while chunk := os.read(beats, 4096):
            if QUIT in chunk:
                self._quit = True
                break
            self._beats.heard(chunk[-1:], time.monotonic())
        self._ended.set()

    def watch(self) -> None:
        """Watch until the server ends, cleanly or not."""
        answered_s = time.monotonic()
        self._say(b'{"event": "ready"}\n')
        while True:
            asked_s = time.monotonic()
            pause_s = self._beats.pause_s(asked_s)
            ended = self._ended.wait(pause_s)
            now_s = time.monotonic()
            if ended or (self._beats.late(now_s) and self._dies()):
                break
            if now_s - asked_s > pause_s + _OVERSLEPT_S:
                # This process was held up itself, so that beats may lie unread: look again first.
                time.sleep(_OVERSLEPT_S)
            if self._beats.hangs(time.monotonic()):
                self._act("hung")
            elif (self._beats.newest_s or 0.0) > answered_s and now_s - answered_s >= _ANSWER_S:
                answered_s = now_s
                self._say(b'{"event": "alive"}\n')
        if not self._quit:
            self._act("killed")

    def _act(self, reason: str) -> None:
        """Stop the manipulator until it rests, and say so."""
        self._stop.send()
        began_s = time.monotonic()
        beat_s = self._beats.newest_s
        self._beats.disarm()
        silent_ms = None if beat_s is None else round(1000.0 * (began_s - beat_s), 3)
        what = {"reason": reason, "silent_ms": silent_ms}
        self._say(_line({"event": "stopping", **what}))
        stops, position_um, rested = stop_until_rest(self._stop, self._tip)
        report = _line(
            {
                "event": "stopped",
                "at": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                **what,
                "stops": stops,
                "answered": position_um is not None,
                "rested": rested,
                "position_um": position_um,
            }
        )
        with suppress(OSError):
            _append(self._report_file, report)
        self._say(report)


def death_watch(pid: int) -> Callable[[], bool]:
    """Return what tells whether a process is being killed; where the system does not show it, it never does.

    The end of the pipe comes late: a dying process gives back its memory first, 0.1 ms for each MB.
    """
    try:
        stat = os.open(f"/proc/{pid}/stat", os.O_RDONLY)
    except OSError:
        return lambda: False

    def dies() -> bool:
        try:
            flags = int(os.pread(stat, 1024, 0).rpartition(b")")[2].split()[6])
        except ProcessLookupError:
            return True
        except (OSError, ValueError, IndexError):
            return False
        return bool(flags & _EXITING)

    return dies


def _line(fields: dict[str, object]) -> bytes:
    return json.dumps(fields).encode() + b"\n"


def _append(path: Path, line: bytes) -> None:
    """Append a line and have it on the disk when this returns."""
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        os.write(file, line)
        os.fsync(file)
    finally:
        os.close(file)


def _prefer_this_process() -> None:
    """Ask to run before all ordinary programs: this one does next to nothing, and must do it in time."""
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))


def _say(line: bytes) -> None:
    # A server that is gone hears nothing, and one that hangs must not hold this process up.
    with suppress(OSError):
        os.write(1, line)


def main() -> None:
    """Run as the process of its own that it is."""
    address, port, device_id, hang_s, report_file = sys.argv[1:]
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        # What ends the server must not end who watches over it; it ends by itself when the server has.
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    _prefer_this_process()
    if os.name == "posix":
        os.set_blocking(1, False)
    target = (address, int(port))
    process = SupervisorProcess(
        RawStop(*target, int(device_id)),
        Tip(target, int(device_id)),
        float(hang_s),
        Path(report_file),
        _say,
        death_watch(os.getppid()),
    )
    threading.Thread(target=process.listen, args=(0,), daemon=True).start()
    process.watch()


if __name__ == "__main__":
    main()
