"""The guards guard: each must catch the fault that it is there for."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LEAK = """
import asyncio

async def forever():
    await asyncio.Event().wait()

kept = []

async def test_leak():
    kept.append(asyncio.create_task(forever()))
    await asyncio.sleep(0)
"""
BLOCK = """
import time

async def test_block():
    time.sleep(5.2)
"""
CLEAN = """
import asyncio

async def brief():
    await asyncio.sleep(0)

async def test_clean():
    async with asyncio.TaskGroup() as group:
        group.create_task(brief())

def test_sync():
    pass
"""
WARNS = """
import warnings

def test_warns():
    warnings.warn("a library will drop this", DeprecationWarning)
"""


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(part) for part in command], cwd=cwd, capture_output=True, text=True, timeout=100, check=False
    )


def run_pytest(folder: Path, source: str) -> subprocess.CompletedProcess[str]:
    shutil.copy(ROOT / "tests" / "conftest.py", folder / "conftest.py")
    shutil.copy(ROOT / "pyproject.toml", folder / "pyproject.toml")
    (folder / "test_sample.py").write_text(source)
    return run(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_sample.py", cwd=folder)


@pytest.mark.parametrize(
    ("source", "said"),
    [(LEAK, "leaked tasks: "), (BLOCK, "blocked event loop: "), (WARNS, "DeprecationWarning")],
    ids=["leaked task", "blocked loop", "warning"],
)
def test_a_faulty_test_fails(tmp_path: Path, source: str, said: str) -> None:
    done = run_pytest(tmp_path, source)
    assert done.returncode == 1, done.stdout + done.stderr
    assert said in done.stdout


def test_a_clean_test_passes(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, CLEAN)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("module", "line", "contract"),
    [
        ("core/errors.py", "import mrnav_server.loops.latest", "Imports go down only"),
        ("sim/__init__.py", "import mrnav_server.vision.vessel_model", "Imports go down only"),
        ("core/errors.py", "import asyncio", "core computes"),
    ],
    ids=["upward import", "sideways import", "impure core"],
)
def test_a_forbidden_import_breaks_the_layers(tmp_path: Path, module: str, line: str, contract: str) -> None:
    shutil.copytree(
        ROOT / "mrnav_server",
        tmp_path / "mrnav_server",
        ignore=shutil.ignore_patterns("__pycache__", "static"),
    )
    shutil.copy(ROOT / "pyproject.toml", tmp_path / "pyproject.toml")
    faulty = tmp_path / "mrnav_server" / module
    faulty.write_text(faulty.read_text() + f"\n{line}\n")
    lint_imports = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    done = run(sys.executable, "-c", lint_imports, "--no-cache", cwd=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr
    broken = [row for row in done.stdout.splitlines() if row.endswith("BROKEN")]
    assert any(row.startswith(contract) for row in broken), done.stdout


@pytest.mark.parametrize(
    ("source", "rule"),
    [
        ("import asyncio\n\n_ = asyncio.create_task\n", "TID251"),
        ("import time\n\n_ = time.time()\n", "TID251"),
        ("import torch\n\n_ = torch\n", "TID253"),
        ("print('hello')\n", "T201"),
    ],
    ids=["create_task", "wall clock", "heavy import", "print"],
)
def test_the_linter_refuses(source: str, rule: str) -> None:
    done = subprocess.run(
        [
            *(sys.executable, "-m", "ruff", "check", "--no-cache", "--output-format", "concise"),
            *(
                "--config",
                str(ROOT / "pyproject.toml"),
                "--stdin-filename",
                "mrnav_server/loops/sample.py",
                "-",
            ),
        ],
        input=source,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert rule in done.stdout
