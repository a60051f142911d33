"""Exports read by the programs they are for, and read back."""

import csv
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import orjson
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from typer.testing import CliRunner

from mrnav_server.cli.main import app
from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.tlx_record import read_tlx
from mrnav_server.loops.trial_log import header_line, log_line, read_log
from mrnav_server.study.export import export_trials
from mrnav_server.study.import_trials import import_trials
from mrnav_server.study.study_data import read_study
from mrnav_server.study.trial_report import write_trial_report
from tests.recorded_trials import BEGIN_S, GO_S, RecordedTrial, shipped_vessel, way_px
from tests.study.fabricated_study import Fabricator, answer, small_way

HAND = {
    "seq": 7,
    "sender_s": 3.5,
    "received_s": BEGIN_S + 0.25,
    "p_m": [0.1, -0.2, 0.3],
    "clutch": True,
    "valid": True,
    "new_pose": False,
}


def read_rows(folder: Path, topic: str) -> list[dict[str, Any]]:
    rows = []
    for file in sorted(folder.glob("*.mcap")):
        with file.open("rb") as stream:
            for _, _, message in make_reader(stream).iter_messages(topics=[f"/{topic}"]):
                rows.append(json.loads(message.data))
    return rows


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people's trials, one with a questionnaire."""
    root = tmp_path_factory.mktemp("study") / "trials"
    folder = RecordedTrial(condition="with_autonomy").record(root)
    answer(folder, 60)
    lines = [orjson.loads(line) for line in (folder / "log.jsonl").read_bytes().splitlines()]
    for extra in (
        ("fail", {"reason": ""}),
        ("hand", HAND),
        ("hand", HAND | {"p_m": [None, 0.0, 1.0]}),
        ("event", {"event": "fault", "reason": 'a "quoted"\nline, and more'}),
        ("not_known_yet", {"any": [1, {"thing": 0.1}]}),
    ):
        lines.insert(-1, {**lines[-2], "topic": extra[0], "data": extra[1]})
    for seq, line in enumerate(lines):
        if seq:
            line["seq"] = seq
    (folder / "log.jsonl").write_bytes(b"".join(orjson.dumps(line) + b"\n" for line in lines))
    RecordedTrial("P02", "without_autonomy", notes="ein µ").record(root)
    return root.parent


@pytest.fixture(scope="module")
def exported(trials: Path) -> Path:
    return export_trials(trials).folder


def logged(study: Path, topic: str) -> list[tuple[dict[str, Any], float]]:
    """Return data and wall time of a topic's lines, as the logs hold them."""
    logs = sorted(study.glob("trials/*/log.jsonl"))
    return [(dict(line.data), line.t_wall) for log in logs for line in read_log(log) if line.topic == topic]


class TestTables:
    def test_pandas_and_polars_read_what_was_logged(self, trials: Path, exported: Path) -> None:
        tracks = logged(trials, "track")
        frames = (
            pd.read_csv(exported / "csv/track.csv", parse_dates=["wall_time"]).to_dict("records"),
            pd.read_parquet(exported / "parquet/track.parquet").to_dict("records"),
            pl.read_csv(exported / "csv/track.csv", try_parse_dates=True).to_dicts(),
            pl.read_parquet(exported / "parquet/track.parquet").to_dicts(),
        )
        for rows in frames:
            assert len(rows) == len(tracks) == 840
            for row, (data, t_wall) in zip(rows[::97], tracks[::97], strict=True):
                assert row["t_s"] == data["taken_s"] - BEGIN_S
                assert [row["vessel_x_px"], row["vessel_y_px"]] == data["vessel"]
                assert row["x_um"] == data["vessel"][0] * shipped_vessel().um_per_px
                assert row["sigma_um"] == data["sigma_um"]
                assert row["frame"] == data["frame"]
                at = pd.Timestamp(row["wall_time"])
                assert at.tzinfo is not None
                assert at.timestamp() == pytest.approx(t_wall, abs=1e-5)

    def test_nothing_loses_its_label(self, exported: Path) -> None:
        for file in exported.glob("parquet/*.parquet"):
            table = pd.read_parquet(file)
            assert set(table["operator_kind"]) == {"human"}
            assert set(table["simulated_rig"]) == {True}
            assert set(zip(table["participant"], table["condition"], strict=True)) <= {
                ("P01", "with_autonomy"),
                ("P02", "without_autonomy"),
            }

    def test_units_are_with_the_columns(self, exported: Path) -> None:
        with (exported / "columns.csv").open(encoding="utf-8") as stream:
            said = {(row["table"], row["column"]): row for row in csv.DictReader(stream)}
        readme = (exported / "README.md").read_text(encoding="utf-8")
        assert "People on a simulated rig" in readme
        for file in exported.glob("parquet/*.parquet"):
            for field in pq.read_schema(file):
                if file.stem != "not_known_yet":
                    assert field.metadata[b"unit"].decode() == said[file.stem, field.name]["unit"]
                    assert f"`{field.name}`" in readme
        assert said["track", "x_um"]["unit"] == "µm"
        assert said["command", "speed_um_per_s"]["unit"] == "µm/s"

    def test_a_vector_with_a_gap_and_a_text_with_a_line_end(self, exported: Path) -> None:
        hands = pd.read_csv(exported / "csv/hand.csv")
        assert hands["hand_x_m"].isna().tolist() == [False, True]
        assert hands[["hand_y_m", "hand_z_m"]].to_numpy().tolist() == [[-0.2, 0.3], [0.0, 1.0]]
        events = pd.read_csv(exported / "csv/event.csv")
        assert events["reason"].tolist() == ['a "quoted"\nline, and more']

    def test_one_row_a_trial(self, trials: Path, exported: Path) -> None:
        table = pd.read_parquet(exported / "parquet/trials.parquet")
        assert table["participant"].tolist() == ["P01", "P02"]
        assert table["status"].tolist() == ["ended", "ended"]
        assert table["result"].tolist() == [True, True]
        assert table["reached"].tolist() == [True, True]
        assert table["duration_s"][1] == pytest.approx(14.0, abs=0.1)
        assert table["lines"][0] == sum(1 for _ in read_log(min(trials.glob("trials/*/log.jsonl"))))

    def test_a_track_table_is_a_trajectory_for_the_metrics(self, tmp_path: Path) -> None:
        export_trials(RecordedTrial().record(tmp_path), tmp_path / "out", ("csv",))
        found = CliRunner().invoke(app, ["metrics", str(tmp_path / "out/csv/track.csv"), "--json"])
        assert json.loads(found.stdout)["va_um_per_s"] > 500.0


class TestMcap:
    def test_counts_stamps_and_schemas(self, trials: Path, exported: Path) -> None:
        file = min(exported.glob("mcap/*.mcap"))
        lines = list(read_log(min(trials.glob("trials/*/log.jsonl"))))
        with file.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            assert summary is not None
            assert summary.statistics is not None
            names = {each.id: each.topic for each in summary.channels.values()}
            counts = {names[at]: n for at, n in summary.statistics.channel_message_counts.items()}
            for topic in {line.topic for line in lines}:
                assert counts[f"/{topic}"] == sum(line.topic == topic for line in lines)
            assert counts["/foxglove/robot"] == counts["/track"] == 420
            record = next(iter(reader.iter_metadata()))
            assert record.metadata["operator_kind"] == "human"
            by_seq = {line.seq: line for line in lines}
            for schema, channel, message in reader.iter_messages():
                assert schema is not None
                Draft202012Validator(json.loads(schema.data)).validate(json.loads(message.data))
                if not channel.topic.startswith("/foxglove"):
                    line = by_seq[message.sequence]
                    assert channel.metadata["operator_kind"] == "human"
                    assert message.log_time == round(line.t_wall * 1e9)
                if channel.topic == "/track":
                    assert abs(message.publish_time - message.log_time) < 1e6

    def test_foxglove_draws_robot_area_and_events(self, exported: Path) -> None:
        folder = exported / "mcap"
        poses = read_rows(folder, "foxglove/robot")
        assert poses[0]["frame_id"] == "vessel"
        place = poses[0]["pose"]["position"]
        assert place["x"] == pytest.approx(way_px()[0, 0] * 10e-6, abs=2e-5)
        scenes = read_rows(folder, "foxglove/scene")
        model = scenes[0]["entities"][0]
        assert model["cylinders"][0]["size"]["x"] == pytest.approx(1e-3)
        assert len(model["lines"]) >= 1
        assert "participant P01 on a simulated rig" in model["texts"][0]["text"]
        said = [each["message"] for each in read_rows(folder, "foxglove/log")]
        assert "go" in said
        assert "reached" in said


class TestImport:
    @pytest.mark.parametrize("form", ["csv", "parquet", "mcap"])
    def test_the_logs_come_back_to_the_last_byte(
        self, form: str, trials: Path, exported: Path, tmp_path: Path
    ) -> None:
        found = import_trials(exported / form, tmp_path / "new", results=False)
        assert len(found.trials) == 2
        assert found.changed == []
        for trial in found.trials:
            before, after = trials / "trials" / trial, tmp_path / "new/trials" / trial
            assert (after / "log.jsonl").read_bytes() == (before / "log.jsonl").read_bytes()
            assert read_tlx(after) == read_tlx(before)

    def test_an_imported_study_is_measured_as_before(self, tmp_path: Path) -> None:
        way = small_way()
        Fabricator(tmp_path / "old/trials").study([way], operators=1)
        export_trials(tmp_path / "old", tmp_path / "out", ("mcap",))
        found = import_trials(tmp_path / "out", tmp_path / "new")
        assert [why for _, why in found.unmeasured] == [
            "the vessel model bend is not at hand with the mask of then"
        ] * 2
        old, new = (
            read_study(tmp_path / name, find_vessel=lambda _: way.vessel).trials for name in ("old", "new")
        )
        assert [(each.metrics, each.handover, each.task) for each in new] == [
            (each.metrics, each.handover, each.task) for each in old
        ]

    def test_a_result_is_written(self, tmp_path: Path) -> None:
        folder = RecordedTrial().record(tmp_path / "old")
        export_trials(folder, tmp_path / "out", ("parquet",))
        import_trials(tmp_path / "out", tmp_path / "new")
        write_trial_report(folder, shipped_vessel())
        result = (tmp_path / "new/trials" / folder.name / "result.json").read_text()
        assert result == (folder / "result.json").read_text()

    def test_again_changes_nothing_and_another_log_is_never_overwritten(
        self, trials: Path, exported: Path, tmp_path: Path
    ) -> None:
        first = import_trials(trials, tmp_path, results=False)
        assert import_trials(exported / "csv", tmp_path).present == first.trials
        log = tmp_path / "trials" / first.trials[0] / "log.jsonl"
        log.write_bytes(log.read_bytes() + b'{"seq":9999}\n')
        before = log.read_bytes()
        with pytest.raises(ConfigError, match="never overwritten"):
            import_trials(exported / "csv", tmp_path)
        assert log.read_bytes() == before

    def test_people_and_simulated_operators_are_never_pooled(self, exported: Path, tmp_path: Path) -> None:
        RecordedTrial("SIM01", operator_kind="simulated").record(tmp_path / "trials")
        with pytest.raises(ConfigError, match="never pooled"):
            import_trials(exported / "csv", tmp_path)
        assert len(list((tmp_path / "trials").iterdir())) == 1
        RecordedTrial("P09").record(tmp_path / "trials")
        with pytest.raises(ConfigError, match="--operators human"):
            export_trials(tmp_path)
        assert export_trials(tmp_path, formats=("csv",), operators="simulated").simulated

    def test_an_edited_export_says_so_and_a_missing_column_is_named(self, tmp_path: Path) -> None:
        export_trials(RecordedTrial().record(tmp_path), tmp_path / "out", ("csv",))
        file = tmp_path / "out/csv/track.csv"
        table = pd.read_csv(file)
        table.loc[3, "confidence"] = 0.5
        table.to_csv(file, index=False)
        found = import_trials(tmp_path / "out", tmp_path / "edited", results=False)
        assert found.changed == found.trials
        table.drop(columns="confidence").to_csv(file, index=False)
        with pytest.raises(ConfigError, match=r"track\.csv lacks the column confidence"):
            import_trials(tmp_path / "out", tmp_path / "other")
        table.assign(frame="x").to_csv(file, index=False)
        with pytest.raises(ConfigError, match=r"track\.csv.*frame"):
            import_trials(tmp_path / "out", tmp_path / "other")
        assert list((tmp_path / "other").glob("trials/*")) == []

    def test_a_cut_off_log(self, tmp_path: Path) -> None:
        log = RecordedTrial().record(tmp_path / "t", close=False) / "log.jsonl"
        RecordedTrial("P02").record(tmp_path / "t")
        whole = b"".join(log.read_bytes().splitlines(keepends=True)[:100])
        log.write_bytes(whole + b'{"seq":101,"t_mono')
        done = export_trials(tmp_path / "t", tmp_path / "out", ("parquet",))
        assert done.left_out == []
        table = pl.read_parquet(tmp_path / "out/parquet/trials.parquet")
        assert table["status"].to_list() == ["running", "ended"]
        assert table["result"].to_list() == [False, True]
        assert import_trials(tmp_path / "out", tmp_path / "new", results=False).changed == []
        assert (tmp_path / "new/trials" / log.parent.name / "log.jsonl").read_bytes() == whole

    def test_a_damaged_trial_is_left_out_and_named(self, tmp_path: Path) -> None:
        log = RecordedTrial().record(tmp_path / "t") / "log.jsonl"
        RecordedTrial("P02").record(tmp_path / "t")
        log.write_bytes(log.read_bytes().replace(b'"seq":5,', b'"seq":,', 1))
        done = export_trials(tmp_path / "t", tmp_path / "out", ("csv",))
        assert len(done.trials) == 1
        assert "line 6" in done.left_out[0][1]


@st.composite
def any_log(draw: st.DrawFn) -> list[tuple[str, dict[str, Any]]]:
    """Draw lines of known and unknown topics, with known fields and any values."""
    value = st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**53), 2**53)
        | st.floats(allow_nan=False, width=64)
        | texts,
        lambda each: st.lists(each, max_size=4),
        max_leaves=5,
    )
    topic = st.sampled_from(["hand", "event", "learned", "area", "unheard_of"])
    key = st.sampled_from(["seq", "p_m", "clutch", "event", "reason", "looks", "offset_um", "id", "else"])
    return draw(st.lists(st.tuples(topic, st.dictionaries(key, value, max_size=5)), max_size=6))


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)


@given(lines=any_log(), t_wall=st.floats(1e9, 2e9))
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
def test_any_log_comes_back_from_any_format(
    lines: list[tuple[str, dict[str, Any]]], t_wall: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    root = tmp_path_factory.mktemp("any")
    trial = "20261123-101500-001-P01"
    (root / trial).mkdir()
    content = [header_line(trial, RecordedTrial().header())]
    content += [log_line(seq, seq / 7, t_wall + seq / 7, *each) for seq, each in enumerate(lines, start=1)]
    (root / trial / "log.jsonl").write_bytes(b"".join(content))
    export_trials(root / trial, root / "out")
    for form in ("csv", "parquet", "mcap"):
        found = import_trials(root / "out" / form, root / form, results=False)
        assert (root / form / "trials" / trial / "log.jsonl").read_bytes() == b"".join(content)
        assert found.changed == []


class TestCommands:
    @pytest.fixture
    def trial(self, tmp_path: Path) -> Path:
        return RecordedTrial("SIM01", operator_kind="simulated").record(tmp_path / "study/trials")

    def test_out_and_back(self, trial: Path, tmp_path: Path) -> None:
        study, runner = trial.parents[1], CliRunner()
        done = runner.invoke(app, ["study", "export", str(study), "--format", "csv", "--json"])
        found = json.loads(done.stdout.splitlines()[-1])
        assert found["simulated"] is True
        assert found["counts"]["track"] == 420
        assert all(Path(file).is_file() for file in found["files"])
        again = runner.invoke(app, ["export", str(trial), "--out", str(study / "export"), "--format", "csv"])
        assert isinstance(again.exception, ConfigError)
        assert "--out" in str(again.exception)
        back = runner.invoke(
            app, ["study", "import", str(study / "export"), str(tmp_path / "new"), "--no-results", "--json"]
        )
        assert json.loads(back.stdout.splitlines()[-1])["trials"] == [trial.name]
        nothing = runner.invoke(app, ["study", "import", str(tmp_path / "no"), str(tmp_path / "new")])
        assert "is not there" in str(nothing.exception)


def test_the_wall_time_is_in_utc(exported: Path) -> None:
    table = pl.read_parquet(exported / "parquet/trial.parquet")
    go = table.filter(pl.col("mark") == "go")
    assert go["mark_s"].to_list() == [GO_S, GO_S]
    assert go["t_s"].to_list() == [GO_S - BEGIN_S] * 2
    assert table.schema["wall_time"] == pl.Datetime("us", "UTC")
    assert (datetime.now(UTC) - go["wall_time"][0]).total_seconds() < 3600
