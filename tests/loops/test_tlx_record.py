import csv
import io
import json
from pathlib import Path

import pytest

from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.tlx import KEYS, Choice, shown_pairs
from mrnav_server.loops.tlx_record import TLX_NAME, TlxAnswers, keep_tlx, read_tlx, tlx_csv
from tests.recorded_trials import RecordedTrial


def answers(mental: int = 60) -> TlxAnswers:
    """Rate, and judge every pair for the scale that comes first."""
    choices = tuple(Choice(a, b, min(a, b, key=KEYS.index)) for a, b in shown_pairs("trial"))
    return TlxAnswers(dict(zip(KEYS, (mental, 20, 45, 30, 70, 35), strict=True)), choices)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three trials: a person's, a simulated operator's, and one that still runs."""
    root = tmp_path_factory.mktemp("trials")
    RecordedTrial("P01").record(root)
    RecordedTrial("SIM01", operator_kind="simulated").record(root)
    RecordedTrial("P03").record(root, close=False)
    return root


def trial(root: Path, number: int) -> str:
    return sorted(path.name for path in root.iterdir())[number - 1]


def test_answers_are_kept_once_and_replaced_only_on_purpose(root: Path) -> None:
    person = trial(root, 1)
    assert read_tlx(root / person) is None
    first = keep_tlx(root, person, answers(), 1000.0)
    assert read_tlx(root / person) == first
    stored = json.loads((root / person / TLX_NAME).read_text())
    assert (stored["weighted"], stored["raw"]) == (43.0, pytest.approx(43.333, abs=5e-4))
    assert len(stored["answers"]["choices"]) == 15
    assert keep_tlx(root, person, answers(), 2000.0) == first
    with pytest.raises(RefusedError, match="has other answers already: send replace"):
        keep_tlx(root, person, answers(80), 2000.0)
    second = keep_tlx(root, person, answers(80), 3000.0, replace=True)
    assert read_tlx(root / person) == second
    assert second.replaced == (answers(),)
    assert second.answers == answers(80)
    third = keep_tlx(root, person, answers(100), 4000.0, replace=True)
    assert third.replaced == (answers(), answers(80))


def test_only_people_after_the_trial_are_asked(root: Path) -> None:
    with pytest.raises(RefusedError, match="only people feel workload"):
        keep_tlx(root, trial(root, 2), answers(), 1000.0)
    with pytest.raises(RefusedError, match="still runs: end it first"):
        keep_tlx(root, trial(root, 3), answers(), 1000.0)
    with pytest.raises(RefusedError, match="there is no trial"):
        keep_tlx(root, "../elsewhere", answers(), 1000.0)
    assert not list(root.glob("*SIM01/tlx*"))


def test_bad_answers_leave_nothing_behind(root: Path) -> None:
    bad = TlxAnswers({**answers().ratings, "effort": 3}, answers().choices)
    with pytest.raises(RefusedError, match="effort must be a mark"):
        keep_tlx(root, trial(root, 3), bad, 1000.0)
    assert read_tlx(root / trial(root, 3)) is None


def test_the_table_has_a_row_a_questionnaire(tmp_path: Path) -> None:
    folder = RecordedTrial("P07", "without_autonomy").record(tmp_path)
    RecordedTrial("P08").record(tmp_path)
    keep_tlx(tmp_path, folder.name, answers(), 1234.5)
    (row,) = csv.DictReader(io.StringIO(tlx_csv(tmp_path)))
    assert (row["trial"], row["participant"], row["condition"]) == (folder.name, "P07", "without_autonomy")
    assert [row[f"rating_{key}"] for key in KEYS] == ["60", "20", "45", "30", "70", "35"]
    assert [row[f"weight_{key}"] for key in KEYS] == ["5", "4", "3", "2", "1", "0"]
    assert float(row["weighted"]) == 43.0
    assert float(row["raw"]) == pytest.approx(43.3333)
    judged = dict(each.split("=") for each in row["choices"].split(" "))
    assert len(judged) == 15
    assert all(chosen in pair.split("|") for pair, chosen in judged.items())


def test_a_damaged_questionnaire_is_named(tmp_path: Path) -> None:
    (tmp_path / TLX_NAME).write_text('{"trial": "x"}')
    with pytest.raises(ConfigError, match=r"tlx.json: not a questionnaire"):
        read_tlx(tmp_path)
