"""``mrnav metrics`` on files as other laboratories write them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from mrnav_server.cli.main import app
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import ConfigError
from tests.core.trajectories import circle, line, times

KEYS = {"va_um_per_s", "toc_s", "g", "s", "ldlj", "sparc", "flags"}


def written(folder: Path, t_s: FloatArray, xy_um: FloatArray) -> Path:
    file = folder / "track.csv"
    rows = [f"{t},{x},{y}" for t, (x, y) in zip(t_s.tolist(), xy_um.tolist(), strict=True)]
    file.write_text("\n".join(["t_s,x_um,y_um", *rows, ""]))
    return file


def answer(file: Path, *options: str) -> dict[str, Any]:
    done = CliRunner().invoke(app, ["metrics", str(file), "--json", *options], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def test_a_circle(tmp_path: Path) -> None:
    t_s = times(20)
    found = answer(written(tmp_path, t_s + 100.0, circle(1000.0, 1000.0)(t_s)))
    assert set(found) == KEYS
    assert found["toc_s"] == pytest.approx(20.0)
    assert found["va_um_per_s"] == pytest.approx(1000.0, rel=1e-3)
    assert found["g"] == pytest.approx(-3.0, abs=0.004)
    assert found["s"] == pytest.approx(0.0, abs=1e-3)
    assert found["flags"] == []


def test_a_noisy_line_is_flagged_by_its_own_noise(tmp_path: Path) -> None:
    t_s = times(20)
    noise_um = np.random.default_rng(5).normal(0.0, 5.0, (t_s.size, 2))
    file = written(tmp_path, t_s, line(2400.0)(t_s) + noise_um)
    assert answer(file)["flags"] == ["g_near_noise_floor", "s_near_noise_floor"]
    assert answer(file, "--sigma-um", "0.1")["flags"] == []


def test_what_the_motion_does_not_define_is_null(tmp_path: Path) -> None:
    t_s = times(5)
    found = answer(written(tmp_path, t_s, np.zeros((t_s.size, 2))))
    assert (found["g"], found["s"], found["sparc"]) == (None, None, None)
    assert found["flags"] == ["nothing_moves"]


def test_columns_may_stand_in_any_order_and_places_may_be_missing(tmp_path: Path) -> None:
    t_s = times(20)
    xy_um = circle(1000.0, 1000.0)(t_s)
    rows = [f"{y}, {t},a,{x}" for t, (x, y) in zip(t_s.tolist(), xy_um.tolist(), strict=True)]
    rows[300:315] = [f"nan, {t},a," for t in t_s[300:315]]
    (tmp_path / "odd.csv").write_text("\ufeffy_um, t_s ,note,x_um\n" + "\n".join(rows))
    found = answer(tmp_path / "odd.csv")
    assert found["g"] == pytest.approx(-3.0, abs=0.004)
    assert found["flags"] == ["gaps"]


def test_people_get_a_table_and_the_meaning_of_flags(tmp_path: Path) -> None:
    t_s = times(5)
    file = written(tmp_path, t_s, np.zeros((t_s.size, 2)))
    done = CliRunner().invoke(app, ["metrics", str(file)], catch_exceptions=False)
    assert "lower is smoother" in done.stdout
    assert "nothing_moves: the robot never reached" in done.stdout


GOOD = "0.0,1,2\n0.1,1,2\n0.2,1,2\n0.3,1,2\n"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("t_s,x_um\n" + GOOD, r"lacks y_um \(it has t_s, x_um\); write t_s,x_um,y_um"),
        ("", r"lacks t_s, x_um, y_um \(it has nothing\)"),
        ("t_s,x_um,y_um\n0.0,1,2\n", "holds 1 positions; the filters need"),
        ("t_s,x_um,y_um\n0.0,1,2\n,1,2\n", "line 3: column t_s is empty"),
        ("t_s,x_um,y_um\n0.0,1,2\n0.1,left,2\n", "line 3: column x_um holds 'left'; write a finite number"),
        ("t_s,x_um,y_um\n0.0,1,inf\n", "line 2: column y_um holds 'inf'"),
        ("t_s,x_um,y_um\n0.0,1\n0.1,1,\n0.05,1,2\n", "line 4: column t_s falls from 0.1 to 0.05; sort"),
    ],
)
def test_a_bad_file_is_told_with_its_place_and_the_remedy(tmp_path: Path, text: str, told: str) -> None:
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(ConfigError, match=told):
        CliRunner().invoke(app, ["metrics", str(file), "--json"], catch_exceptions=False)


def test_a_bad_noise_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--sigma-um must be a length"):
        CliRunner().invoke(app, ["metrics", "x.csv", "--sigma-um", "-1"], catch_exceptions=False)
