"""The version that trials are recorded under."""

import shutil
import subprocess
import sys
from pathlib import Path

import mrnav_server
from mrnav_server import __version__
from mrnav_server.loops.software import software_version

_PACKAGE = Path(mrnav_server.__file__).parent


def version_of(copy: Path) -> str:
    code = "from mrnav_server.loops.software import software_version; print(software_version())"
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=copy, capture_output=True, text=True, check=True, timeout=60
    )
    return run.stdout.strip()


def test_it_names_an_edited_checkout(tmp_path: Path) -> None:
    assert software_version().startswith(f"{__version__}+")
    shutil.copytree(_PACKAGE, tmp_path / "mrnav_server", ignore=shutil.ignore_patterns("__pycache__"))
    assert version_of(tmp_path) == software_version()
    file = tmp_path / "mrnav_server" / "core" / "metrics.py"
    content = file.read_bytes()
    file.write_bytes(content.replace(b"\n", b"\r\n"))
    assert version_of(tmp_path) == software_version()
    file.write_bytes(content + b"# edited\n")
    assert version_of(tmp_path) != software_version()
