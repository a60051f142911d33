"""Defaults, file and variables; every fault is named."""

import dataclasses
import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from mrnav_server.core.errors import ConfigError
from mrnav_server.settings import Settings, load_settings

KEY = st.from_regex(r"\A[a-z][a-z0-9]{0,11}(_[a-z0-9]{1,6})?\Z")
SECTIONS = list(Settings.model_fields)


@pytest.fixture(autouse=True)
def _no_file_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def written(text: str) -> Path:
    file = Path("lab.toml")
    file.write_text(text)
    return file


def fault(file: str | None = None, **env: str) -> str:
    """Return what is wrong with a file's text and variables."""
    with pytest.raises(ConfigError) as error:
        load_settings(written(file) if file is not None else None, env)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_the_defaults_are_a_simulated_rig_for_this_machine_alone() -> None:
    defaults = load_settings(None, {})
    assert defaults == Settings()
    assert (defaults.manipulator.driver, defaults.rig.camera, defaults.rig.vessel) == (
        "simulated",
        "simulated",
        "bifurcation",
    )
    assert (defaults.server.host, defaults.server.port, defaults.server.hand_port) == (
        "127.0.0.1",
        8000,
        9000,
    )
    assert not defaults.server.insecure


def test_variables_win_over_the_file_and_the_file_over_defaults() -> None:
    file = written("[server]\nport = 8100\nhand_port = 9100\n[limits]\nworkspace_max_um = [1, 2, 3]\n")
    read = load_settings(file, {"MRNAV_SERVER__PORT": "8200", "PATH": "/bin", "OTHER_MRNAV_X": "1"})
    assert (read.server.port, read.server.hand_port) == (8200, 9100)
    assert read.limits.workspace_max_um == (1.0, 2.0, 3.0)
    assert read.limits.ahead_s == Settings().limits.ahead_s


def test_the_file_of_this_folder_is_read_if_there_is_one() -> None:
    Path("mrnav.toml").write_text("[server]\nport = 8100\n")
    assert load_settings(None, {}).server.port == 8100


def test_variables_are_converted_to_the_type_of_their_setting() -> None:
    env = {
        "MRNAV_SERVER__PORT": "0",
        "MRNAV_SERVER__INSECURE": "true",
        "MRNAV_SERVER__OPERATOR_TOKEN": "1234567890123456",
        "MRNAV_LIMITS__AHEAD_S": "0.05",
        "MRNAV_LIMITS__WORKSPACE_MAX_UM": "[1, 2, 3]",
        "MRNAV_SERVER__ORIGINS": '["https://lab.example"]',
    }
    read = load_settings(None, env)
    assert (read.server.port, read.server.insecure, read.limits.ahead_s) == (0, True, 0.05)
    assert read.server.operator_token == "1234567890123456"
    assert read.limits.workspace_max_um == (1.0, 2.0, 3.0)
    assert read.server.origins == ("https://lab.example",)


def test_one_error_names_every_fault() -> None:
    file = """
        sim_typo = 3
        [server]
        port = true
        prot = 5
        [limits]
        ahead_s = "0.1"
        workspace_min_um = [1, 2]
        jerk_um_per_s3 = inf
        [hand]
        hold_s = 7
        """
    told = fault(file, MRNAV_X="1", MRNAV_CAMERA__FSP="4", MRNAV_RIG__CAMERA="webcam", MRNAV_SIM__SEED="x")
    for part in (
        "11 faults",
        "sim_typo (lab.toml): unknown setting",
        "server.port (lab.toml) True: should be a valid integer",
        "server.prot (lab.toml): unknown setting; did you mean port?",
        "limits.ahead_s (lab.toml) '0.1': should be a valid number",
        "limits.workspace_min_um.2 (lab.toml)",
        "limits.jerk_um_per_s3 (lab.toml) inf: should be a finite number",
        "hold_s must lie between 0.05 and 0.2 s",
        "MRNAV_X: unknown variable",
        "camera.fsp (MRNAV_CAMERA__FSP): unknown setting; did you mean fps?",
        "rig.camera (MRNAV_RIG__CAMERA) 'webcam': should be 'simulated'",
    ):
        assert part in told


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e999"])
def test_numbers_that_measure_nothing_are_refused(text: str) -> None:
    assert "limits.ahead_s (MRNAV_LIMITS__AHEAD_S)" in fault(MRNAV_LIMITS__AHEAD_S=text)
    assert "limits.ahead_s (lab.toml)" in fault(f"[limits]\nahead_s = {text}\n")


def test_the_cameras_picture_has_its_ranges() -> None:
    read = load_settings(written("[camera]\nwidth_px = 800\nindex = 1\n"), {"MRNAV_CAMERA__FPS": "25"})
    assert (read.camera.index, read.camera.width_px, read.camera.height_px, read.camera.fps) == (
        1,
        800,
        1200,
        25,
    )
    assert "camera (MRNAV_CAMERA__FPS): camera.fps is 0" in fault(MRNAV_CAMERA__FPS="0")
    assert "camera.index (MRNAV_CAMERA__INDEX)" in fault(MRNAV_CAMERA__INDEX="-1")


def test_a_missing_unreadable_or_broken_file_is_named() -> None:
    with pytest.raises(ConfigError, match=r"no\.toml does not exist"):
        load_settings(Path("no.toml"), {})
    with pytest.raises(ConfigError, match="cannot be read"):
        load_settings(Path(), {})
    assert "is not TOML" in fault("[server")
    Path("lab.toml").write_bytes(b"a = '\xff'")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_settings(Path("lab.toml"), {})


def test_a_missing_file_hides_no_other_fault() -> None:
    with pytest.raises(ConfigError, match=r"2 faults.*does not exist.*MRNAV_SERVER__PORT"):
        load_settings(Path("no.toml"), {"MRNAV_SERVER__PORT": "http"})


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.4", "::", "microscope"])
def test_other_machines_need_tls_or_an_explicit_word(host: str) -> None:
    assert "server.insecure = true" in fault(MRNAV_SERVER__HOST=host)
    insecure = load_settings(None, {"MRNAV_SERVER__HOST": host, "MRNAV_SERVER__INSECURE": "true"})
    assert insecure.server.host == host
    tls = {"MRNAV_SERVER__TLS_CERTIFICATE": "a.pem", "MRNAV_SERVER__TLS_KEY": "b.pem"}
    assert load_settings(None, {"MRNAV_SERVER__HOST": host} | tls).server.tls_key == "b.pem"
    assert "belong together" in fault(MRNAV_SERVER__TLS_KEY="b.pem")


@pytest.mark.parametrize("host", ["127.0.0.1", "127.9.9.9", "::1", "localhost"])
def test_this_machine_needs_nothing(host: str) -> None:
    assert load_settings(None, {"MRNAV_SERVER__HOST": host}).server.host == host


def test_settings_that_contradict_each_other_are_refused() -> None:
    assert "both 9000" in fault(MRNAV_SERVER__PORT="9000")
    assert "set that instead" in fault(MRNAV_HAND_LINK__PORT="9001")
    token = "x" * 16
    assert "choose two" in fault(MRNAV_SERVER__OPERATOR_TOKEN=token, MRNAV_SERVER__VIEWER_TOKEN=token)


def test_tokens_are_never_shown() -> None:
    for name in ("OPERATOR_TOKEN", "VIEWER_TOKEN"):
        assert "s3cret" not in fault(**{f"MRNAV_SERVER__{name}": "s3cret"})
        assert "s3cret" not in fault(**{f"MRNAV_SERVER__{name}__X": "s3cret"})
    shown = load_settings(None, {"MRNAV_SERVER__OPERATOR_TOKEN": "s3cret-s3cret-s3cret"})
    assert "s3cret" not in repr(shown)


def test_tokens_are_made_where_there_are_none() -> None:
    given_one = load_settings(None, {"MRNAV_SERVER__VIEWER_TOKEN": "viewer-0123456789"})
    one, other = given_one.with_tokens().server, given_one.with_tokens().server
    assert one.viewer_token == "viewer-0123456789"
    assert one.operator_token != other.operator_token
    assert len(one.operator_token or "") == 32


def test_the_digest_tells_configurations_apart_but_not_tokens() -> None:
    plain = Settings()
    assert plain.digest() == Settings().digest() == plain.with_tokens().digest()
    assert load_settings(None, {"MRNAV_SIM__SEED": "1"}).digest() != plain.digest()


def test_settings_cannot_be_changed() -> None:
    settings = Settings()
    with pytest.raises(ValidationError):
        settings.server = settings.server
    for name in SECTIONS:
        section = getattr(settings, name)
        first = dataclasses.fields(section)[0].name
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(section, first, 1)


@pytest.mark.parametrize("section", SECTIONS)
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(key=KEY)
def test_any_unknown_key_is_refused(section: str, key: str) -> None:
    known = {f.name for f in dataclasses.fields(getattr(Settings(), section))}
    assume(key not in known)
    assert f"{section}.{key} (lab.toml): unknown setting" in fault(f"[{section}]\n{key} = 1\n")
    variable = f"MRNAV_{section}__{key}".upper()
    assert f"{section}.{key} ({variable}): unknown setting" in fault(**{variable: "1"})


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(section=KEY)
def test_any_unknown_section_is_refused(section: str) -> None:
    assume(section not in SECTIONS)
    assert f"{section} (lab.toml): unknown setting" in fault(f"[{section}]\nx = 1\n")


@pytest.mark.parametrize("section", SECTIONS)
def test_every_setting_survives_a_round_trip_through_a_file(section: str) -> None:
    values = json.loads(Settings().model_dump_json(exclude_none=True))[section]
    if section == "hand_link":
        del values["host"], values["port"]
    lines = "".join(f"{name} = {toml(value)}\n" for name, value in values.items())
    assert load_settings(written(f"[{section}]\n{lines}"), {}) == Settings()


def toml(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {toml(inner)}" for name, inner in value.items()) + "}"
    return json.dumps(value)
