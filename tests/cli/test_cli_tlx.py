"""``mrnav tlx``: questionnaires as a table."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from mrnav_server.cli.main import app
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.tlx import KEYS, Choice, shown_pairs
from mrnav_server.loops.tlx_record import TlxAnswers, keep_tlx
from tests.recorded_trials import RecordedTrial


def test_questionnaires_as_a_table(tmp_path: Path) -> None:
    trial = RecordedTrial("P05").record(tmp_path / "trials").name
    choices = tuple(Choice(a, b, a) for a, b in shown_pairs("seed"))
    keep_tlx(tmp_path / "trials", trial, TlxAnswers(dict.fromkeys(KEYS, 50), choices), 1.0)
    printed = CliRunner().invoke(app, ["tlx", str(tmp_path / "trials")], catch_exceptions=False)
    assert printed.stdout.splitlines()[1].startswith(f"{trial},P05,with_autonomy")
    out = tmp_path / "tlx.csv"
    told = CliRunner().invoke(
        app, ["tlx", str(tmp_path / "trials"), "--out", str(out)], catch_exceptions=False
    )
    assert out.read_text() == printed.stdout
    assert "1 questionnaires" in told.stdout


def test_a_folder_that_is_none_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is no folder of trials"):
        CliRunner().invoke(app, ["tlx", str(tmp_path / "nowhere")], catch_exceptions=False)
