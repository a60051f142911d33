"""The steps of a trial that every command takes which runs one on a server of its own."""

import json
import time
from http import HTTPStatus
from pathlib import Path
from typing import Any

from mrnav_server.cli.children import Child
from mrnav_server.cli.console import TrialFailedError, TwinConsole
from mrnav_server.client.rest import Rest, RestError

READY_S = 90.0
ARMED_S = 5.0
SEATED_S = 20.0


def insist(rest: Rest, twin: TwinConsole, ask: str) -> None:
    """Ask for a mode until it is granted: it may be refused until the tip was seen to rest.

    Raises:
        RestError: If it is refused for good.
    """
    deadline_s = rest.waiting.now_s() + ARMED_S
    while True:
        try:
            rest.post("/api/v1/mode", {"ask": ask})
        except RestError as error:
            if error.status != HTTPStatus.CONFLICT or rest.waiting.now_s() > deadline_s:
                raise
            twin.wait(0.2)
        else:
            return


def ask_auto(rest: Rest, twin: TwinConsole, area: str) -> None:
    """Ask for AUTO until its guards are satisfied.

    Raises:
        RestError: If it is refused for good.
        TrialFailedError: If the rig is in FAULT or STOP.
    """
    deadline_s = rest.waiting.now_s() + SEATED_S
    while True:
        try:
            rest.post("/api/v1/mode", {"ask": "auto", "area": area})
        except RestError as error:
            if twin.state["mode"] in ("FAULT", "STOP"):
                raise TrialFailedError(f"{twin.state['mode']}: {twin.state['reason']}") from None
            if error.status != HTTPStatus.CONFLICT or rest.waiting.now_s() > deadline_s:
                raise
            twin.wait(0.3)
        else:
            return


def wait_ready(file: Path, server: Child) -> dict[str, Any]:
    """Wait for the server's ready file and for its rig to be ready; return what the file says.

    Raises:
        TrialFailedError: If the server ends, or takes too long.
    """
    deadline_s = time.monotonic() + READY_S
    why = "it wrote no ready file"
    while time.monotonic() < deadline_s:
        server.check()
        try:
            ready: dict[str, Any] = json.loads(file.read_text())
            Rest(f"http://127.0.0.1:{ready['port']}", ready["operator_token"]).get("/readyz")
            return ready
        except (FileNotFoundError, json.JSONDecodeError):
            pass
        except RestError as error:
            why = str(error)
        time.sleep(0.1)
    raise TrialFailedError(f"the server was not ready within {READY_S:g} s: {why}")


def wait_tracking(rest: Rest) -> dict[str, Any]:
    """Wait for the robot to be seen; return the state that shows it.

    Raises:
        TrialFailedError: If it is not found.
    """
    deadline_s = rest.waiting.now_s() + SEATED_S
    while (state := rest.get("/api/v1/state"))["track"]["state"] != "tracking":
        if rest.waiting.now_s() > deadline_s:
            raise TrialFailedError(f"the robot was not found within {SEATED_S:g} s")
        rest.waiting.sleep(0.1)
    seen: dict[str, Any] = state
    return seen
