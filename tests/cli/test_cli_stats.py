import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mrnav_server.cli.main import app
from mrnav_server.core.errors import ConfigError
from mrnav_server.study.statistics_samples import read_samples

A = [11.1, 12.4, 10.2, 11.8, 12.9, 10.6]
B = [16.8, 18.1, 15.0, 17.7, 19.5, 15.9]
ROWS = [f"P{who},{name},{value}" for name, values in (("B", B), ("A", A)) for who, value in enumerate(values)]


def written(folder: Path, *lines: str, header: str = "participant,condition,value") -> Path:
    file = folder / "values.csv"
    file.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return file


def test_json_holds_both_analyses(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["stats", str(written(tmp_path, *ROWS)), "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout.splitlines()[-1])
    assert found["conditions"] == ["A", "B"]
    assert found["paired"]["t"] == pytest.approx(-23.04886, abs=1e-5)
    assert found["paired"]["wilcoxon_p"] == 0.03125
    assert found["pooled"]["u_p"] == pytest.approx(0.00216450, abs=1e-8)
    assert "independent" in found["pooled"]["label"]


def test_the_table_names_both(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["stats", str(written(tmp_path, *ROWS)), "--test", "wilcoxon"])
    assert result.exit_code == 0, result.output
    assert "primary: Wilcoxon signed-rank" in result.stdout
    assert "0.0312" in result.stdout
    assert "as published" in result.stdout


def test_a_metric_column_shares_alpha(tmp_path: Path) -> None:
    rows = [f"{row},{metric}" for metric in ("Va", "C") for row in ROWS]
    file = written(tmp_path, *rows, header="participant,condition,value,metric")
    result = CliRunner().invoke(app, ["stats", str(file), "--json"])
    metrics = json.loads(result.stdout.splitlines()[-1])["metrics"]
    assert list(metrics) == ["Va", "C"]
    assert metrics["Va"]["paired"]["p_holm"] == pytest.approx(2 * metrics["Va"]["paired"]["p"])


def test_power(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["stats", "--power", "0.8", "--effect", "0.5", "--json"])
    assert json.loads(result.stdout)["participants"] == 34
    assert "0.5" in CliRunner().invoke(app, ["stats", "--participants", "34", "--effect", "0.5"]).stdout
    both = CliRunner().invoke(app, ["stats", str(written(tmp_path, *ROWS)), "--power", "0.8"])
    assert isinstance(both.exception, ConfigError)


@pytest.mark.parametrize(
    ("header", "lines", "says"),
    [
        ("participant,value", ["P1,3"], "lacks condition .it has participant, value."),
        ("participant,condition,value", ["P1,A,1", "P1,B,fast"], "line 3: column value holds 'fast'"),
        ("participant,condition,value", ["P1,A,inf"], "line 2: column value"),
        ("participant,condition,value", [",A,1"], "line 2: column participant is empty"),
        ("participant,condition,value", ["P1"], "line 2: column condition is empty"),
        ("participant,condition,value", ["P1,A,1"], "two conditions to compare, not A"),
        ("participant,condition,value", ["P1,A,1", "P1,B,1", "P1,C,1"], "not A, B, C"),
        ("participant,condition,value", [], "holds no rows"),
    ],
)
def test_bad_input_names_the_place_and_the_remedy(
    tmp_path: Path, header: str, lines: list[str], says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        read_samples(written(tmp_path, *lines, header=header))


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ConfigError, match="not readable"):
        read_samples(tmp_path / "x.csv")
    with pytest.raises(ConfigError, match="not readable"):
        read_samples(tmp_path / "nowhere.csv")


def test_spreadsheets_write_a_mark_and_spaces(tmp_path: Path) -> None:
    file = tmp_path / "x.csv"
    file.write_text("\ufeffparticipant, condition ,value\nP1, A ,1\nP1,B,\n", encoding="utf-8")
    found = read_samples(file)["value"]
    assert (found.first, found.second, found.missing) == ("A", "B", 1)
