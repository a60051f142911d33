import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from mrnav_server.cli.main import app
from mrnav_server.core.vessel import VesselMap
from mrnav_server.study import published
from mrnav_server.study.latex_table import latex_table
from mrnav_server.study.pdf_table import table_blocks
from mrnav_server.study.report_content import report
from mrnav_server.study.report_table import Cell, Table, number, p_value, text
from mrnav_server.study.statistics_samples import read_samples
from mrnav_server.study.study_data import Study, read_study
from mrnav_server.study.study_report import picture
from mrnav_server.study.style import styled
from tests.study.fabricated_study import Fabricator, answer, small_way

WAY = small_way()


def bend(_: str) -> VesselMap:
    return WAY.vessel


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Study:
    folder = tmp_path_factory.mktemp("simulated")
    Fabricator(folder).study([WAY], operators=3)
    return read_study(folder, find_vessel=bend)


@pytest.fixture(scope="module")
def human(tmp_path_factory: pytest.TempPathFactory) -> Study:
    folder = tmp_path_factory.mktemp("human")
    for number_of, trial in enumerate(Fabricator(folder).study([WAY], 3, kind="human", code="P")):
        # With autonomy comes first of each pair.
        answer(trial, (20 if number_of % 2 == 0 else 60) + 5 * (number_of // 2))
    return read_study(folder, find_vessel=bend)


def words(figure: Figure) -> list[str]:
    return [each.get_text() for each in figure.texts]


@pytest.mark.timeout(600)
def test_the_command_writes_the_report(
    simulated: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mrnav_server.study.study_data._bundled", bend)
    command = ["study", "report", str(simulated.folder), "--out", str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout.splitlines()[-1])
    assert (found["trials"], found["operators"], found["simulated"]) == (6, 3, True)
    page = Path(found["html"]).read_text()
    # One file that needs nothing else, with every figure inside.
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert page.count("data:image/svg+xml;base64") == 4
    assert Path(found["pdf"]).read_bytes().startswith(b"%PDF")
    files = [Path(name) for name in found["files"]]
    names = {path.name for path in files}
    figures = ("five-metrics", "pairs", "handover", "trajectories")
    widths = ("", "-column")
    assert {
        f"{name}{width}.{kind}" for name in figures for width in widths for kind in ("svg", "png")
    } <= names
    # Text stays text, which a journal can edit.
    assert "average" in (tmp_path / "out" / "figures" / "five-metrics.svg").read_text()
    tables = ("comparison", "paired", "pooled", "normality", "handover", "further", "trials", "environment")
    assert {f"{name}.{kind}" for name in tables for kind in ("csv", "tex")} <= names
    assert all(path.stat().st_size > 0 for path in files)
    for path in (tmp_path / "out" / "tables").glob("*.tex"):
        assert path.read_text().isascii()
        assert "?" not in path.read_text()
        assert "(simulated operators on a simulated rig: no evidence about people)" in path.read_text()


def test_a_folder_that_cannot_be_is_named(
    simulated: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mrnav_server.study.study_data._bundled", bend)
    (tmp_path / "file").touch()
    command = ["study", "report", str(simulated.folder), "--out", str(tmp_path / "file" / "out")]
    assert "--out" in str(CliRunner().invoke(app, command).exception)


def test_the_same_study_gives_the_same_figures(simulated: Study) -> None:
    with styled():
        first, second = (picture(report(simulated).figures[0].alone(), "svg") for _ in range(2))
    assert first == second


def test_everything_simulated_says_so(simulated: Study) -> None:
    content = report(simulated)
    assert "simulated" in content.title
    assert "no evidence about people" in content.origin
    with styled():
        for figure in content.figures:
            assert "simulated" in words(figure.alone())
            assert "simulated operators" in figure.caption
    said = " ".join(
        [
            *(section.words for section in content.sections),
            *(figure.caption for figure in content.figures),
            *(" ".join((table.title, *table.notes)) for table in content.tables),
        ]
    )
    said = said.replace("Simulated operators are no participants", "").replace("five participants", "")
    assert "participant" not in said


def test_people_on_hardware_are_participants_and_not_marked(human: Study) -> None:
    trials = [replace(t, header=replace(t.header, simulated_rig=False)) for t in human.trials]
    content = report(replace(human, trials=tuple(trials)))
    assert content.title == "Study report"
    with styled():
        assert all("simulated" not in words(figure.alone()) for figure in content.figures)
    assert "participants" in content.figures[0].caption
    # On the simulated rig they are people still, but the figures are marked.
    on_rig = report(human)
    assert on_rig.origin == "participants on a simulated rig"
    with styled():
        assert "simulated rig" in words(on_rig.figures[0].alone())


def test_workload_is_reported_for_people_alone(human: Study, simulated: Study) -> None:
    table = next(each for each in report(human).tables if each.name == "workload")
    assert "workload" in {figure.name for figure in report(human).figures}
    beside = next(each for each in report(human).tables if each.name == "tlx")
    weighted = next(csv.DictReader(beside.csv().splitlines()))
    assert (weighted["published: without"], weighted["published: with"]) == ("48.4", "14.0")
    rows = list(csv.DictReader(table.csv().splitlines()))
    assert [row["metric"].split()[0] for row in rows][:2] == ["weighted", "raw"]
    # Mark minus 0, 5 .. 25, in both conditions alike: the difference is that of the marks.
    raw = next(row for row in rows if row["metric"].startswith("raw"))
    assert float(raw["difference: mean"]) == pytest.approx(-40.0 + 3 * 0.0, abs=1.3)
    assert "workload" not in {table.name for table in report(simulated).tables}
    said = {section.heading: section.words for section in report(simulated).sections}
    assert "simulated operators answer no questionnaire" in said["Workload"]
    silent = replace(human, trials=tuple(replace(trial, answers=None) for trial in human.trials))
    said = {section.heading: section.words for section in report(silent).sections}
    assert "/tlx" in said["Workload"]
    # Answers that somehow lie in a simulated operator's folder are not reported either.
    forged = [replace(t, answers=human.trials[0].answers) for t in simulated.trials]
    assert "workload" not in {t.name for t in report(replace(simulated, trials=tuple(forged))).tables}


def test_the_published_figures_stand_beside(simulated: Study) -> None:
    tables = {table.name: table for table in report(simulated).tables}
    rows = [[cell.text for cell in row] for row in tables["comparison"].rows]
    assert rows[0][0] == "Va ↑ (µm/s)"
    assert rows[0][-3:] == ["1687", "2401", "714"]
    assert rows[1][-3:] == ["17.17", "11.38", "−5.79"]
    assert rows[0][6] == "3 of 3"
    assert "lower S is smoother" in tables["comparison"].notes[0]
    assert "treated as independent" in tables["pooled"].notes[0]
    assert published.TLX["weighted"]["without_autonomy"] == 48.4
    # Three pairs cannot be significant by rank, and the table says it.
    assert any("smallest reachable p" in note for note in tables["paired"].notes)


def test_values_are_what_the_statistics_read(simulated: Study, tmp_path: Path) -> None:
    values = next(each for each in report(simulated).files if each.name == "values")
    (tmp_path / "values.csv").write_text(values.csv())
    measures = read_samples(tmp_path / "values.csv")
    assert {"Va", "TOC", "G", "S", "C", "take-over"} <= set(measures)
    assert measures["Va"].pairs().participants == ("SIM01", "SIM02", "SIM03")


def test_cells() -> None:
    assert number(-0.001, 2) == Cell("0.00", -0.001)
    assert number(-1.5, 1).text == "−1.5"
    assert number(float("nan"), 1) == Cell("–", None)
    assert [p_value(p).text for p in (0.0312, 0.001, 0.00094, 3e-10, float("nan"))] == [
        "0.031",
        "0.001",
        "9·10⁻⁴",
        "3·10⁻¹⁰",
        "–",
    ]


TABLE = Table(
    "t",
    "50 % & more",
    ("who_is", "group: p", "group: x", "hidden"),
    (
        (text("a<b>"), p_value(3e-10), number(1000.0, 0), text("y")),
        (text("µm"), p_value(0.5), number(-0.25, 2), text("z")),
    ),
    ("note_1",),
    ("hidden",),
)


def test_a_table_as_csv_latex_and_html() -> None:
    assert TABLE.csv().splitlines() == [
        "who_is,group: p,group: x,hidden",
        "a<b>,3e-10,1000.0,y",
        "µm,0.5,-0.25,z",
    ]
    latex = latex_table(TABLE, "simulated")
    assert r"\caption{50 \% \& more (simulated).}\label{tab:t}" in latex
    assert r"\begin{tabular}{lrr}" in latex
    assert r" & \multicolumn{2}{c}{group} \\" in latex
    assert r"\cmidrule(lr){2-3}" in latex
    # The decimal points of a column stand one below the other.
    aligned = r"1000\phantom{.}\phantom{0}\phantom{0}"
    assert rf"a\textless{{}}b\textgreater{{}} & 3$\cdot$10$^{{-10}}$ & {aligned} \\" in latex
    assert r"$\mu$m & 0.500 & $-$0.25 \\" in latex
    page = TABLE.html(3)
    assert "Table 3. 50 % &amp; more" in page
    assert "a&lt;b&gt;" in page
    assert '<th class="group" colspan="2">group</th>' in page
    assert "hidden" not in page


def test_a_long_table_goes_on_on_the_next_page() -> None:
    rows = tuple((text(f"row {n}"), p_value(0.5), number(1.0, 0), text("")) for n in range(120))
    long = replace(TABLE, rows=rows)
    assert r"\begin{longtable}{lrr}" in latex_table(long, "simulated")
    blocks = table_blocks(long, 7, room_in=4.0, page_in=10.0)
    assert len(blocks) == 3
    assert blocks[0].height_in <= 4.0
    assert max(block.height_in for block in blocks) <= 10.0
    shown: list[str] = []
    for block in blocks:
        page = Figure(figsize=(7.2, block.height_in))
        block.draw(page)
        shown += words(page)
        assert all(0.0 <= each.get_position()[0] <= 1.0 for each in page.texts)
        assert all(0.0 <= each.get_position()[1] <= 1.0 for each in page.texts)
    assert [each for each in shown if each.startswith("row ")] == [f"row {n}" for n in range(120)]
    assert shown.count("Table 7. 50 % & more, continued") == 2
    assert shown.count("note_1") == 1


def test_each_task_is_reported_by_itself(simulated: Study) -> None:
    assert "by-task" not in {table.name for table in report(simulated).tables}
    # The last operator's pair went elsewhere.
    apart = [
        replace(trial, task="elsewhere" if trial.header.participant == "SIM03" else trial.task)
        for trial in simulated.trials
    ]
    tables = {table.name: table for table in report(replace(simulated, trials=tuple(apart))).tables}
    rows = list(csv.DictReader(tables["by-task"].csv().splitlines()))
    assert [row["task"] for row in rows] == ["bend"] * 5 + ["elsewhere"] * 5
    own = [t.metrics.average_speed_um_per_s for t in apart if t.task == "elsewhere"]
    assert sorted([float(rows[5][f"{how} autonomy: mean"]) for how in ("with", "without")]) == sorted(own)
