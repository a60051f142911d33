"""STOP as it is on the wire."""

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing

import pytest

from mrnav_server.devices.sensapex.raw_stop import RawStop
from mrnav_server.devices.sensapex.smcp1 import ALL_DEVICES, COMMAND, Kind, Message, decode

VENDORS_IDS = {0x237, 0x23B, 0x257, 0x25B, 0x277, 0x27B, 0x297, 0x29B}


@pytest.fixture
def controller() -> Iterator[socket.socket]:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(5.0)
        yield peer


def stop_to(controller: socket.socket, device_id: int = 1) -> RawStop:
    return RawStop("127.0.0.1", controller.getsockname()[1], device_id)


def received(controller: socket.socket) -> Message:
    return decode(controller.recv(2048))


def test_one_send_is_one_stop(controller: socket.socket) -> None:
    with closing(stop_to(controller, 3)) as stop:
        assert stop.send()
        message = received(controller)
    assert (message.receiver, message.kind, message.options, message.blocks) == (3, Kind.STOP, COMMAND, ())
    assert 0x200 < message.sender < 0x2FF
    assert message.sender not in VENDORS_IDS
    controller.settimeout(0.05)
    with pytest.raises(TimeoutError):
        controller.recv(2048)


def test_no_stop_is_taken_for_a_repetition(controller: socket.socket) -> None:
    """Two processes, and two STOPs of one process, differ in sender or number."""
    with closing(stop_to(controller)) as one, closing(stop_to(controller)) as other:
        sent = set()
        for stop in (one, other) * 20:
            assert stop.send()
            message = received(controller)
            sent.add((message.sender, message.id))
    assert len(sent) == 40


def test_numbers_start_anew_after_sixteen_bits(controller: socket.socket) -> None:
    with closing(stop_to(controller)) as stop:
        assert all(stop.send() for _ in range(0x10001))


def test_all_devices_can_be_stopped(controller: socket.socket) -> None:
    with closing(stop_to(controller, ALL_DEVICES)) as stop:
        stop.send()
        assert received(controller).receiver == ALL_DEVICES


def test_a_controller_that_is_gone_does_not_end_the_stops(controller: socket.socket) -> None:
    """The kernel's news of a closed port must not eat the next datagram."""
    with closing(stop_to(controller)) as stop:
        target = controller.getsockname()
        controller.close()
        assert all(stop.send() for _ in range(3))
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as back:
            back.bind(target)
            back.settimeout(5.0)
            assert stop.send()
            assert received(back).kind == Kind.STOP


def test_a_network_that_takes_nothing_is_told_and_not_raised(controller: socket.socket) -> None:
    stop = stop_to(controller)
    stop.close()
    assert not stop.send()


def test_it_sends_from_any_thread(controller: socket.socket) -> None:
    with closing(stop_to(controller)) as stop:
        threads = [threading.Thread(target=stop.send) for _ in range(8)]
        for thread in threads:
            thread.start()
        ids = {received(controller).id for _ in threads}
        for thread in threads:
            thread.join()
    assert len(ids) == 8


def test_it_imports_nothing_heavy() -> None:
    """The supervisor's process needs it at once."""
    code = (
        "import sys, mrnav_server.devices.sensapex.raw_stop\n"
        "sys.exit(any(name in sys.modules for name in ('numpy', 'asyncio', 'cv2', 'pydantic', 'torch')))"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
