"""The container files: parsed, not built; what they promise about users, ports, health and settings."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from mrnav_server.settings import Settings, load_settings

ROOT = Path(__file__).parent.parent


def instructions() -> list[tuple[str, str]]:
    """Return the Dockerfile's instructions in order, continuation lines joined."""
    text = re.sub(r"^\s*#.*\n", "", (ROOT / "Dockerfile").read_text(), flags=re.MULTILINE)
    lines = text.replace("\\\n", " ").splitlines()
    return [(line.split(maxsplit=1)[0], line.split(maxsplit=1)[1].strip()) for line in lines if line.strip()]


def final_stage() -> list[tuple[str, str]]:
    found = instructions()
    last = max(i for i, (name, _) in enumerate(found) if name == "FROM")
    return found[last:]


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    parsed: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
    return parsed


@pytest.fixture(scope="module")
def service(compose: dict[str, Any]) -> dict[str, Any]:
    server: dict[str, Any] = compose["services"]["server"]
    return server


def image_env() -> dict[str, str]:
    pairs = [part for name, rest in final_stage() if name == "ENV" for part in shlex.split(rest)]
    return dict(pair.split("=", 1) for pair in pairs)


def test_the_image_is_built_in_stages_and_carries_no_build_tools() -> None:
    froms = [rest for name, rest in instructions() if name == "FROM"]
    assert len(froms) >= 2
    assert all("-slim" in image for image in froms)
    assert not any("pip install" in rest for name, rest in final_stage() if name == "RUN")


def test_the_server_does_not_run_as_root() -> None:
    users = [rest for name, rest in final_stage() if name == "USER"]
    assert users
    assert users[-1] not in {"root", "0"}


def test_both_health_checks_ask_healthz_with_python(service: dict[str, Any]) -> None:
    image = next(rest for name, rest in final_stage() if name == "HEALTHCHECK")
    for check in (image, " ".join(service["healthcheck"]["test"])):
        assert "python" in check
        assert ":8000/healthz" in check


def test_ports_are_bound_to_loopback(service: dict[str, Any]) -> None:
    assert service["ports"]
    assert all(port.startswith("127.0.0.1:") for port in service["ports"])


def test_trials_are_kept_in_a_volume(service: dict[str, Any], compose: dict[str, Any]) -> None:
    name, path = service["volumes"][0].split(":")
    assert name in compose["volumes"]
    assert path == image_env()["MRNAV_RECORDING__ROOT"]


def test_tokens_come_from_the_environment(service: dict[str, Any]) -> None:
    for name in ("MRNAV_SERVER__OPERATOR_TOKEN", "MRNAV_SERVER__VIEWER_TOKEN"):
        assert service["environment"][name].startswith(f"${{{name}:?")


def test_the_settings_in_force_are_valid(
    service: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = {"MRNAV_SERVER__OPERATOR_TOKEN": "o" * 16, "MRNAV_SERVER__VIEWER_TOKEN": "v" * 16}
    settings = load_settings(None, image_env() | service["environment"] | given)
    published = {int(port.rsplit(":", 1)[1]) for port in service["ports"]}
    assert published == {settings.server.port, settings.server.hand_port}
    assert "http://localhost:8000" in settings.server.origins
    assert settings.rig == Settings().rig
