"""What `mrnav bench --json` prints."""

import json
import subprocess
from typing import Any

import pytest
from typer.testing import CliRunner

from mrnav_server.cli.main import app


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        figures = {"simulated": True, "of": command[2].removeprefix("benchmarks.")}
        return subprocess.CompletedProcess(command, 0, f"progress\n{json.dumps(figures)}\n")

    monkeypatch.setattr(subprocess, "run", run)


def printed(*names: str) -> dict[str, Any]:
    result = CliRunner().invoke(app, ["bench", *names, "--json"])
    assert result.exit_code == 0, result.output
    answer: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return answer


def test_a_single_benchmark_prints_its_own_object() -> None:
    assert printed("tracking") == {"simulated": True, "of": "tracking"}


def test_several_are_printed_by_name() -> None:
    answer = printed("tracking", "learning")
    assert set(answer) == {"tracking", "learning"}
    assert answer["learning"]["of"] == "learning"


def test_all_are_printed_by_name() -> None:
    answer = printed()
    assert {"tracking", "learning", "follower"} <= set(answer)
    assert all(figures["of"] == name for name, figures in answer.items())
