"""An emulated controller as a process of its own."""

import itertools
import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

MRNAV = (sys.executable, "-m", "mrnav_server.cli.main")
_hosts = itertools.count(1)


def own_host() -> str:
    """Return a loopback address that no other test uses at the same time."""
    pid = os.getpid()
    return f"127.{1 + pid // 256 % 254}.{pid % 256}.{next(_hosts) % 255}"


class EmulatorProcess:
    """``mrnav emulate ump`` on a loopback address of its own; use it in a ``with`` block."""

    def __init__(self, folder: Path, *options: str, host: str | None = None) -> None:
        self.host = host or own_host()
        self._ready_file = folder / "emulator.json"
        self.trace_file = folder / "trace.jsonl"
        self._log = (folder / "emulator.log").open("w+")
        where = ("--host", self.host, "--ready-file", str(self._ready_file), "--trace", str(self.trace_file))
        if "--at" not in options:
            options += ("--at", "10000,10000,10000,10000")
        self.process = subprocess.Popen(
            [*MRNAV, "emulate", "ump", *where, *options], stdout=self._log, stderr=self._log
        )

    def __enter__(self) -> "EmulatorProcess":
        deadline_s = time.monotonic() + 30.0
        while not self._ready_file.exists():
            if self.process.poll() is not None or time.monotonic() > deadline_s:
                self._log.seek(0)
                said = self._log.read()
                self.__exit__()
                raise RuntimeError(f"the emulator did not start: {said}")
            time.sleep(0.01)
        ready = json.loads(self._ready_file.read_text())
        self.port: int = ready["port"]
        self.control_port: int = ready["control_port"]
        self._control = socket.create_connection((self.host, self.control_port), 5.0)
        self._answers = self._control.makefile("rb")
        return self

    def __exit__(self, *_: object) -> None:
        if hasattr(self, "_control"):
            self._answers.close()
            self._control.close()
        self.process.terminate()
        self.process.wait(10.0)
        self._log.close()

    def turn(self, **ask: object) -> dict[str, Any]:
        """Turn knobs; return all of them and where the device really is."""
        self._control.sendall(json.dumps(ask).encode() + b"\n")
        answer: dict[str, Any] = json.loads(self._answers.readline())
        return answer

    def trace(self) -> list[dict[str, Any]]:
        """Return the datagrams so far."""
        return [json.loads(line) for line in self.trace_file.read_text().splitlines()]
