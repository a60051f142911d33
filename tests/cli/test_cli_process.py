"""``mrnav serve`` as a process that cannot start: one line on stderr, exit 2, nothing else."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

TAKEN = "TAKEN"


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        (
            {"MRNAV_RIG__CAMERA": "usb", "MRNAV_CAMERA__INDEX": "97"},
            "cannot start the rig: USB camera 97 cannot be opened: /dev/video97 does not exist",
        ),
        ({"MRNAV_SERVER__PORT": TAKEN}, f"port {TAKEN} cannot be used"),
        ({"MRNAV_SERVER__HAND_PORT": TAKEN}, f"cannot listen on 127.0.0.1 port {TAKEN}"),
        ({"MRNAV_LIMITS__AHEAD_S": "soon"}, "limits.ahead_s (MRNAV_LIMITS__AHEAD_S) 'soon'"),
    ],
    ids=["missing camera", "busy web port", "busy hand port", "bad setting"],
)
def test_a_server_that_cannot_start_says_why_in_one_line(
    tmp_path: Path, variables: dict[str, str], said: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        settings = {
            "MRNAV_SERVER__PORT": "0",
            "MRNAV_SERVER__HAND_PORT": "0",
            "MRNAV_RECORDING__ROOT": str(tmp_path / "trials"),
        } | variables
        done = subprocess.run(
            [sys.executable, "-m", "mrnav_server.cli.main", "serve", "--ready-file", str(tmp_path / "ready")],
            env=os.environ | {name: port if value == TAKEN else value for name, value in settings.items()},
            capture_output=True,
            text=True,
            timeout=100,
            check=False,
        )
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("error: ")
    assert said.replace(TAKEN, port) in done.stderr
    assert done.stdout == ""
    assert not (tmp_path / "ready").exists()
