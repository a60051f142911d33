"""The Unity client's core, compiled here with Mono, against fake and live servers."""

import json
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mrnav_server.core.frames import HandPoint
from mrnav_server.core.wire_hand import ClientFrame, HandMessage, parse_hello, parse_message, welcome_line
from tests.rig_process import RigProcess

HERE = Path(__file__).parent / "unity"
CLIENT = Path(__file__).parents[2] / "clients" / "unity"
JSON_NET = Path("/usr/lib/cli/Newtonsoft.Json-5.0/Newtonsoft.Json.dll")

pytestmark = pytest.mark.skipif(
    shutil.which("mcs") is None or shutil.which("mono") is None or not JSON_NET.exists(),
    reason="Mono is missing: apt-get install mono-mcs mono-runtime libnewtonsoft-json5.0-cil",
)


def compiled(target: str, out: Path, sources: list[Path], *libraries: Path) -> Path:
    """Compile, with every warning an error."""
    done = subprocess.run(
        ["mcs", "-langversion:7.2", "-warnaserror+", f"-target:{target}", f"-out:{out}"]
        + [f"-r:{library}" for library in (JSON_NET, *libraries)]
        + [str(source) for source in sources],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return out


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unity")
    shutil.copy(JSON_NET, folder)
    return compiled("library", folder / "MrNav.Core.dll", sorted((CLIENT / "Runtime/Core").glob("*.cs")))


@pytest.fixture(scope="module")
def program(core: Path) -> Path:
    return compiled("exe", core.parent / "program.exe", [HERE / "Program.cs"], core)


def said(line: str) -> dict[str, Any]:
    message: dict[str, Any] = json.loads(line)
    return message


class HandServer:
    """A hand link that says what a test wants."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(20.0)
        self.port = self._listener.getsockname()[1]
        self.connection: socket.socket | None = None

    def accept(self) -> list[bytes]:
        """Take a connection; return the first packet's lines."""
        self.connection, _ = self._listener.accept()
        self.connection.settimeout(20.0)
        return self.packet()

    def packet(self) -> list[bytes]:
        assert self.connection is not None
        return self.connection.recv(65_536).splitlines(keepends=True)

    def send(self, line: bytes) -> None:
        assert self.connection is not None
        self.connection.sendall(line)

    def hang_up(self) -> None:
        if self.connection is not None:
            self.connection.close()

    def close(self) -> None:
        self.hang_up()
        self._listener.close()


@pytest.fixture
def server() -> Iterator[HandServer]:
    server = HandServer()
    yield server
    server.close()


@pytest.fixture
def watcher(program: Path, server: HandServer) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        ["mono", str(program), "watch", "127.0.0.1", str(server.port), "secret"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        yield process
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(20) == 0


def until(process: subprocess.Popen[str], **fields: str) -> None:
    """Read what the program says until it said all of this, in any order."""
    assert process.stdout is not None
    lines, missing = [], dict(fields)
    for line in process.stdout:
        lines.append(line)
        for key, value in said(line).items():
            if missing.get(key) == value:
                del missing[key]
        if not missing:
            return
    raise AssertionError(f"{missing} was not said: {lines}")


def test_the_components_compile(core: Path, tmp_path: Path) -> None:
    engine = compiled("library", tmp_path / "UnityEngine.dll", [HERE / "UnityEngine.cs"])
    sources = [*(CLIENT / "Runtime/Unity").glob("*.cs"), *(CLIENT / "Samples~/Tabletop").glob("*.cs")]
    assert len(sources) > 5
    # Unity fills in the fields that its inspector shows.
    compiled("library", tmp_path / "MrNav.Unity.dll", sources, core, engine)


def test_points_of_the_stage_in_unitys_axes(program: Path) -> None:
    table = said(
        subprocess.run(["mono", program, "frames"], capture_output=True, text=True, check=True).stdout
    )
    assert table["unity"] == pytest.approx([0.01, 0.03, -0.02])
    assert table["back"] == pytest.approx([1000.0, 2000.0, 3000.0])
    # The server converts the hand; both must mean the same axes.
    x, y, z = table["unity"]
    seen, meant = ClientFrame.UNITY.hand_point((x, y, z)), ClientFrame.STAGE.hand_point((0.01, 0.02, 0.03))
    assert (seen.x_m, seen.y_m, seen.z_m) == pytest.approx((meant.x_m, meant.y_m, meant.z_m))


def test_messages_are_whole_packets_that_the_server_understands(
    server: HandServer, watcher: subprocess.Popen[str]
) -> None:
    (first,) = server.accept()
    hello = parse_hello(first)
    assert (hello.role, hello.token, hello.frame) == ("operator", "secret", ClientFrame.UNITY)
    server.send(welcome_line("s-1", True, {}, {}))
    until(watcher, state="InControl")
    messages = [
        parse_message(line, ClientFrame.UNITY)
        for _ in range(5)
        for line in server.packet()
        if line.endswith(b"\n")
    ]
    assert len(messages) >= 5
    for message in messages:
        assert isinstance(message, HandMessage)
        # A pose with NaN is a hand that is not seen, in any language's way to write a number.
        assert not message.valid
        assert not message.clutch
        assert message.point == HandPoint(0.0, 0.0, 0.0)
    numbers = [message.seq for message in messages if isinstance(message, HandMessage)]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_a_lost_connection_is_built_anew(server: HandServer, watcher: subprocess.Popen[str]) -> None:
    for _ in range(2):
        assert parse_hello(server.accept()[0]).client == "watcher"
        server.send(welcome_line("s-1", True, {}, {}))
        until(watcher, state="InControl")
        server.hang_up()
        until(watcher, state="Connecting")


def test_a_hand_that_lost_control_says_so_and_sends_nothing(
    server: HandServer, watcher: subprocess.Popen[str]
) -> None:
    server.accept()
    server.send(welcome_line("s-1", False, {}, {}))
    until(watcher, notice="Another hand has control: it must give it back first.")
    assert server.connection is not None
    server.connection.settimeout(0.3)
    with pytest.raises(TimeoutError):
        server.packet()


def test_a_refused_token_is_not_tried_again(server: HandServer, watcher: subprocess.Popen[str]) -> None:
    server.accept()
    server.send(b'{"type":"error","code":"bad_token","message":"this token opens nothing"}\n')
    server.hang_up()
    until(watcher, notice="this token opens nothing", state="Ended")


def test_a_semi_autonomous_task_on_the_simulated_rig(program: Path, tmp_path: Path) -> None:
    rig = RigProcess(tmp_path)
    try:
        done = subprocess.run(
            [
                "mono",
                program,
                "task",
                "127.0.0.1",
                str(rig.ready["hand_port"]),
                rig.url,
                rig.ready["operator_token"],
            ],
            capture_output=True,
            text=True,
            timeout=100,
            check=False,
        )
    finally:
        rig.end()
    assert done.returncode == 0, done.stderr
    result = said(done.stdout.splitlines()[-1])
    modes = result["modes"]
    assert {modes[0], modes[-1]} == {"DISARMED"}
    assert "MANUAL" in modes[modes.index("AUTO") :]
    # The hand moved 12 mm away from the operator: 0.48 mm along stage -y, beside what autonomy had left.
    y_um = result["moved_um"][1]
    assert -1500.0 < y_um < -200.0
    assert result["authority"] == 1.0
    assert result["sent"] > 60
    assert result["trial"]["metrics"]["average_speed_um_per_s"] > 0.0
