"""The process: what it announces, how it ends."""

import gc
import json
import os
import signal
import stat
import threading
import time
import urllib.request
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import httpx
import pytest

from mrnav_server.app.ready import Ready
from mrnav_server.app.serve import bound_socket, serve
from mrnav_server.core.errors import ConfigError, DeviceError
from mrnav_server.settings import Settings
from tests.app.fake_rig import OPERATOR_TOKEN, SETTINGS, VIEWER_TOKEN, FakeRig
from tests.rig_process import wait_for


@pytest.fixture(autouse=True)
def collected_again() -> Iterator[None]:
    """A process that serves exempts all that it has loaded from the collector: this one goes on."""
    yield
    gc.unfreeze()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_the_rig_and_ends_well(tmp_path: Path, number: int) -> None:
    rig, file, announced = FakeRig(), tmp_path / "ready.json", list[Ready]()

    def announce(ready: Ready) -> None:
        announced.append(ready)
        content = json.loads(file.read_text())
        assert content["url"] == f"http://127.0.0.1:{ready.port}/?token={OPERATOR_TOKEN}"
        assert (content["hand_port"], content["viewer_token"]) == (4242, VIEWER_TOKEN)
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        os.kill(os.getpid(), number)

    before = signal.getsignal(number)
    serve(lambda _: rig, SETTINGS, announce, file)
    assert announced[0].port > 0
    assert rig.asked == [("stopped",)]
    assert not file.exists()
    assert signal.getsignal(number) is before


def test_clients_may_come_once_it_is_announced() -> None:
    statuses: list[int] = []

    def visit(port: int) -> None:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=10) as answer:
                statuses.append(answer.status)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    def announce(ready: Ready) -> None:
        threading.Thread(target=visit, args=(ready.port,)).start()

    serve(FakeRig, SETTINGS, announce)
    assert statuses == [200]


def test_clients_see_how_the_rig_stops() -> None:
    rig, ports, statuses = FakeRig(), list[int](), list[int]()

    def visit() -> None:
        time.sleep(0.3)  # longer than uvicorn takes to notice that it should end
        with urllib.request.urlopen(f"http://127.0.0.1:{ports[0]}/healthz", timeout=10) as answer:
            statuses.append(answer.status)

    def announce(ready: Ready) -> None:
        ports.append(ready.port)
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()

    rig.closing = visit
    serve(lambda _: rig, SETTINGS, announce)
    assert statuses == [200]


def test_missing_tokens_are_made() -> None:
    announced: list[Ready] = []

    def announce(ready: Ready) -> None:
        announced.append(ready)
        os.kill(os.getpid(), signal.SIGTERM)

    serve(FakeRig, Settings.model_validate({"server": {"port": 0, "hand_port": 0}}), announce)
    assert len(announced[0].operator_token) == len(announced[0].viewer_token) == 32
    assert announced[0].operator_token != announced[0].viewer_token


def test_a_taken_port_is_a_configuration_error() -> None:
    with bound_socket("127.0.0.1", 0) as other:
        other.listen()
        port = other.getsockname()[1]
        taken = Settings.model_validate({"server": {"port": port}})
        with pytest.raises(ConfigError, match=f"port {port}"):
            serve(FakeRig, taken, lambda _: None)


def test_a_certificate_that_cannot_be_used_is_a_configuration_error(tmp_path: Path) -> None:
    server = {"tls_certificate": str(tmp_path / "no.pem"), "tls_key": str(tmp_path / "no.key")}
    with pytest.raises(ConfigError, match="tls_certificate"):
        serve(FakeRig, Settings.model_validate({"server": server}), lambda _: None)


def test_a_failing_rig_ends_the_process() -> None:
    rig = FakeRig()
    rig.failure = DeviceError("the camera is gone")
    with pytest.raises(ExceptionGroup) as failed:
        serve(lambda _: rig, SETTINGS, lambda _: None)
    assert failed.value.exceptions == (rig.failure,)


def test_a_rig_that_cannot_start_is_a_configuration_error() -> None:
    rig = FakeRig()
    rig.failure = ConfigError("hand port 9000 is taken")
    with pytest.raises(ConfigError, match="hand port 9000"):
        serve(lambda _: rig, SETTINGS, lambda _: None)


def test_a_change_of_the_vessel_is_a_change_of_rigs_behind_the_same_ports(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rigs, announced = list[FakeRig](), list[Ready]()

    def build(settings: Settings) -> FakeRig:
        rigs.append(FakeRig(settings))
        if len(rigs) in (2, 3):
            rigs[-1].failure = ConfigError("cannot start the rig: the camera is still in use")
        return rigs[-1]

    def is_in_use(base: str, headers: dict[str, str], vessel: str) -> bool:
        try:
            models = httpx.get(f"{base}/api/v1/vessels", headers=headers, timeout=20).json()
        except httpx.TransportError:
            return False  # accepted by the rig that ends
        return {"name": vessel, "own": False, "in_use": True} in models

    def change(port: int) -> None:
        base = f"http://127.0.0.1:{port}"
        headers = {"Authorization": f"Bearer {OPERATOR_TOKEN}", "X-MRNAV-Session": "a-secret-of-this-page"}
        try:
            for vessel in ("network", "serpentine"):
                answer = httpx.post(f"{base}/api/v1/vessels/{vessel}/choose", headers=headers, timeout=20)
                assert answer.status_code == 202, answer.text
                wait_for(partial(is_in_use, base, headers, vessel), 20.0, f"vessel {vessel}")
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    def announce(ready: Ready) -> None:
        announced.append(ready)
        threading.Thread(target=change, args=(ready.port,)).start()

    monkeypatch.setattr("mrnav_server.app.serve._AGAIN_S", 0.01)
    serve(build, SETTINGS, announce)
    # The devices of the first one could not be opened at once.
    vessels = ["bifurcation", *["network"] * 3, "serpentine"]
    assert [rig.settings.rig.vessel for rig in rigs] == vessels
    assert [rig.settings.server.hand_port for rig in rigs[1:]] == [4242] * 4
    assert len(announced) == 1
    assert all(rig.asked[-1] == ("stopped",) for rig in rigs if rig.failure is None)
