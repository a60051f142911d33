"""Export, verification and loading of TorchScript policies, with each fault that must be refused."""

import hashlib
import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mrnav_server.autonomy import torchscript
from mrnav_server.autonomy.policy import PolicyError
from mrnav_server.autonomy.torchscript import export_policy, load_policy, verify
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import observation
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.network import PolicyNetwork
from mrnav_server.vision.vessel_model import vessel_map


def room(name: str, side_px: int) -> VesselMap:
    mask = np.zeros((100, 100), np.uint8)
    mask[10 : 10 + side_px, 10 : 10 + side_px] = 255
    return vessel_map(name, mask, robot_radius_um=100.0)


ROOM = room("room", 70)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    torch.manual_seed(0)
    network = PolicyNetwork(ROOM, hidden=16)
    for parameter in network.head.parameters():
        torch.nn.init.normal_(parameter)
    export_policy(network, folder, ROOM, preset="best", seed=0)
    return folder


@pytest.fixture
def folder(exported: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copytree(exported, tmp_path / "room"))


def edit_manifest(folder: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    edit(manifest)
    path.write_text(json.dumps(manifest))


def put_policy(folder: Path, archive: bytes) -> None:
    """Replace the policy by another whose hash the manifest names."""
    (folder / "policy.pt").write_bytes(archive)
    edit_manifest(folder, lambda m: m.update(policy_sha256=hashlib.sha256(archive).hexdigest()))


def test_a_sound_policy_is_accepted_and_answers(exported: Path) -> None:
    assert verify(exported, ROOM) == torchscript.Verdict(ok=True, reason="")
    policy = load_policy(exported, ROOM)
    assert (policy.name, policy.kind) == ("room-best", "torchscript")
    points = np.full((3, 2), 45.0)
    logits = policy.logits(observation(points, points, points + 10))
    assert logits.shape == (3, 40)
    assert logits.dtype == np.float32
    assert torch.get_num_threads() == 1


def test_a_policy_names_no_file_of_the_machine_that_made_it(exported: Path) -> None:
    here = Path(torchscript.__file__).parents[2].as_posix().encode()
    with zipfile.ZipFile(exported / "policy.pt") as archive:
        telling = [name for name in archive.namelist() if here in archive.read(name)]
    assert telling == []


def test_the_export_answers_as_the_network(tmp_path: Path) -> None:
    network = PolicyNetwork(ROOM, hidden=16)
    torch.nn.init.normal_(network.head[-1].weight)  # type: ignore[arg-type]
    export_policy(network, tmp_path, ROOM, "best", 0)
    points = np.argwhere(ROOM.free)[:, ::-1][::37].astype(float)
    seen = observation(points, points, points[::-1])
    with torch.no_grad():
        wanted = network(torch.from_numpy(seen)).numpy()
    np.testing.assert_allclose(load_policy(tmp_path, ROOM).logits(seen), wanted, atol=1e-4)


@pytest.mark.parametrize("name", ["policy.pt", "manifest.json"])
def test_a_missing_file_is_refused(folder: Path, name: str) -> None:
    (folder / name).unlink()
    verdict = verify(folder, ROOM)
    assert not verdict.ok
    assert name in verdict.reason
    assert "missing" in verdict.reason
    assert "mrnav train" in verdict.reason


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6, 0.99])
def test_a_flipped_bit_is_refused_before_torchscript_reads_it(
    folder: Path, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "policy.pt"
    content = bytearray(path.read_bytes())
    content[int(len(content) * share)] ^= 1
    path.write_bytes(content)

    def touched(*_: object, **__: object) -> None:
        pytest.fail("TorchScript was given an altered file")

    monkeypatch.setattr(torch.jit, "load", touched)
    with pytest.raises(PolicyError, match="altered"):
        load_policy(folder, ROOM)


def test_another_map_is_refused(folder: Path) -> None:
    verdict = verify(folder, room("room", 72))
    assert not verdict.ok
    assert "another map" in verdict.reason


@pytest.mark.parametrize(
    "field", ["name", "preset", "seed", "map_name"], ids=lambda field: f"altered {field}"
)
def test_an_altered_identity_is_refused(folder: Path, field: str) -> None:
    edit_manifest(folder, lambda m: m["identity"].update({field: "other"}))
    assert "altered" in verify(folder, ROOM).reason


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda m: m["golden"]["logits"][0].__setitem__(3, 1e3), "answers differently"),
        (lambda m: m["golden"]["observations"].clear(), "golden"),
        (lambda m: m.pop("golden"), "golden"),
        (lambda m: m.pop("identity"), "identity"),
        (lambda m: m["identity"].update(extra=1), "identity"),
        (lambda m: m.pop("policy_sha256"), "altered"),
        (lambda m: m.update(outputs=8), "outputs"),
        (lambda m: m.update(format=2), "format"),
        (lambda m: m.pop("inputs"), "manifest"),
    ],
)
def test_an_altered_manifest_is_refused(
    folder: Path, edit: Callable[[dict[str, Any]], None], said: str
) -> None:
    edit_manifest(folder, edit)
    verdict = verify(folder, ROOM)
    assert not verdict.ok
    assert said in verdict.reason


@pytest.mark.parametrize("text", ["", "[]", "{", "null", "{}"])
def test_a_manifest_that_is_none_is_refused(folder: Path, text: str) -> None:
    (folder / "manifest.json").write_text(text)
    assert "not a policy manifest" in verify(folder, ROOM).reason


def test_a_wrong_shape_is_refused(folder: Path, tmp_path: Path) -> None:
    class Narrow(torch.nn.Module):
        def forward(self, observations: torch.Tensor) -> torch.Tensor:
            return observations[:, :3] * 2.0

    other = tmp_path / "narrow"
    export_policy(Narrow(), other, ROOM, "best", 0)
    put_policy(folder, (other / "policy.pt").read_bytes())
    assert "(16, 3)" in verify(folder, ROOM).reason


def test_what_is_not_torchscript_is_refused(folder: Path) -> None:
    put_policy(folder, b"not an archive")
    assert "not TorchScript" in verify(folder, ROOM).reason


def test_a_refusal_is_a_configuration_error() -> None:
    assert issubclass(PolicyError, ConfigError)
