"""A server and an operator as processes of their own, to be killed, frozen and asked to end."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
from websockets.sync.client import ClientConnection, connect

from mrnav_server.loops.trial_log import LogLine, read_log

MRNAV = (sys.executable, "-m", "mrnav_server.cli.main")


class RigProcess:
    """``mrnav serve`` on the simulated rig, with a console that keeps the lease alive."""

    def __init__(
        self, folder: Path, *, command: Sequence[str] = MRNAV, arguments: Sequence[str] = (), **env: str
    ) -> None:
        ready = folder / "ready.json"
        self.trials = folder / "trials"
        settings = {
            "MRNAV_SERVER__PORT": "0",
            "MRNAV_SERVER__HAND_PORT": "0",
            "MRNAV_RECORDING__ROOT": str(self.trials),
        }
        self._stack = ExitStack()
        self.operator: subprocess.Popen[bytes] | None = None
        self.process = subprocess.Popen(
            [*command, "serve", "--ready-file", str(ready), *arguments],
            env=os.environ | settings | env,
            stdout=subprocess.DEVNULL,
            stderr=self._stack.enter_context((folder / "stderr.txt").open("w")),
        )
        self._stack.callback(self._kill)
        try:
            self._connect(ready)
        except BaseException:
            self.end()
            raise

    def _connect(self, ready: Path) -> None:
        def is_ready() -> bool:
            assert self.process.poll() is None, (
                f"the server ended: {ready.with_name('stderr.txt').read_text()}"
            )
            return ready.exists() and ready.read_text().endswith("\n")

        wait_for(is_ready, 60.0, "the ready file")
        self.ready: dict[str, Any] = json.loads(ready.read_text())
        self.url = f"http://127.0.0.1:{self.ready['port']}"
        headers = {"Authorization": f"Bearer {self.ready['operator_token']}"}
        twin = self._stack.enter_context(
            connect(self.url.replace("http", "ws") + "/ws/twin", additional_headers=headers, proxy=None)
        )
        self.send: Callable[[str], None] = twin.send
        """Sends a message over the twin's WebSocket."""
        self.snapshot = json.loads(twin.recv())
        self.state: dict[str, Any] = self.snapshot["state"] or {}
        self.events: list[dict[str, Any]] = []
        self.http = httpx.Client(
            base_url=self.url,
            headers=headers | {"X-MRNAV-Session": self.snapshot["session"]},
            trust_env=False,
        )
        self._reader = threading.Thread(target=self._read, args=(twin,), daemon=True)
        self._reader.start()
        self._stack.callback(self.http.close)

    def start_operator(self, *arguments: str) -> None:
        self.operator = subprocess.Popen(
            [*MRNAV, "operator", "--port", str(self.ready["hand_port"]), "--url", self.url, *arguments],
            env=os.environ | {"MRNAV_SERVER__OPERATOR_TOKEN": self.ready["operator_token"]},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.until(lambda s: s["lease"]["hand"], "the operator's hand link")

    def post(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        answer = self.http.post(path, json=body, timeout=60.0)
        assert answer.is_success, answer.text
        result: dict[str, Any] = answer.json()
        return result

    def ask(self, ask: str, **fields: str) -> None:
        self.post("/api/v1/mode", {"ask": ask, **fields})

    def until(self, condition: Callable[[dict[str, Any]], bool], what: str, timeout_s: float = 30.0) -> None:
        try:
            wait_for(lambda: bool(self.state) and condition(self.state), timeout_s, what)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.state.get('mode')}: {self.state.get('reason')}") from None

    def begin_trial(self) -> str:
        """Take the lease, mark an area, start a trial and arm; return the trial's id."""
        self.post("/api/v1/lease", {"client": "faults"})
        self.until(lambda s: s["track"]["state"] == "tracking", "finding the robot")
        site = self.snapshot["vessel"]["suggested_areas"][0]
        center = {"frame": "vessel", "x": site["x_px"], "y": site["y_px"]}
        self.post("/api/v1/critical-areas", {"center": center, "epsilon_um": 500.0})
        trial = {"participant": "SIM0", "condition": "with_autonomy", "operator_kind": "simulated"}
        trial_id: str = self.post("/api/v1/trials", trial)["id"]
        self.ask("arm")
        return trial_id

    def log(self, trial_id: str) -> list[LogLine]:
        return list(read_log(self.trials / trial_id / "log.jsonl"))

    def end(self) -> None:
        """Kill what still runs and close what is open."""
        self._stack.close()

    def _kill(self) -> None:
        for process in (self.operator, self.process):
            if process is not None and process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.kill()
                process.wait(10)

    def _read(self, twin: ClientConnection) -> None:
        beat_s = 0.0
        try:
            while True:
                message = json.loads(twin.recv())
                if message["type"] == "state":
                    self.state = message
                elif message["type"] == "event":
                    self.events.append(message)
                if time.monotonic() - beat_s > 0.2:
                    beat_s = time.monotonic()
                    twin.send('{"type":"heartbeat"}')
        except Exception:  # noqa: BLE001 - the server is killed under this thread in half of the tests
            return


def wait_for(condition: Callable[[], bool], timeout_s: float, what: str) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s, f"{what}: not within {timeout_s} s"
        time.sleep(0.01)
