"""The wheel in an environment of its own: no Node, no network, and every page is there."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CUT_OFF = ("unshare", "--map-root-user", "--net")
"""Runs a command where there is no network but the loopback device."""


def can_cut_off() -> bool:
    return bool(shutil.which(CUT_OFF[0])) and subprocess.run([*CUT_OFF, "true"], check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.skipif(not can_cut_off(), reason="this system lets nobody cut a process off the network")
def test_the_wheel_serves_every_page_without_node_and_network(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", tmp_path, ROOT], check=True)
    (wheel,) = tmp_path.glob("mrnav_server-*.whl")
    home = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    python = home / "bin" / "python"
    subprocess.run(
        [*pip, "--python", python, "install", "--quiet", "--no-deps", "--no-index", wheel], check=True
    )
    # Dependencies come from this environment: torch alone is larger than all else. Its own installation of
    # the package does not, for a .pth file is not read in a folder that another one names.
    (site,) = home.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    where = subprocess.run(
        [python, "-c", "import mrnav_server; print(mrnav_server.__file__)"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    assert where.startswith(str(site))

    path = f"{home / 'bin'}:/usr/sbin:/sbin"
    assert not shutil.which("node", path=path)
    pages: list[str | Path] = [sys.executable, "-m", "tests.wheel_pages", home / "bin" / "mrnav", tmp_path]
    done = subprocess.run(
        [shutil.which(CUT_OFF[0]) or "", *CUT_OFF[1:], *pages],
        cwd=ROOT,
        env=os.environ | {"PATH": path},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + (tmp_path / "stderr.txt").read_text()
    fetched = json.loads(done.stdout)
    assert {"/", "/xr", "/tlx", "/results"} <= set(fetched)
    assert {"/static/vendor/three/three.module.js", "/static/vendor/uplot/uPlot.esm.js"} <= set(fetched)
    assert all(size > 0 for size in fetched.values())
