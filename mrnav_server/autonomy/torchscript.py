"""Policies as TorchScript: export, verification before anything is loaded, and inference.

A policy is two files beside the vessel model: ``policy.pt``, and ``manifest.json``, which says what it is,
which map it was trained on, and which outputs it must give. The identity is also stored inside ``policy.pt``,
so that neither file can change alone.
"""

import hashlib
import io
import json
import platform
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mrnav_server import __version__
from mrnav_server.autonomy.policy import PolicyError
from mrnav_server.core.arrays import Float32Array
from mrnav_server.core.navigation import ACTIONS, observation
from mrnav_server.core.vessel import VesselMap

POLICY_FILE = "policy.pt"
MANIFEST_FILE = "manifest.json"
FORMAT = 1
INPUTS = 6
OUTPUTS = len(ACTIONS)
GOLDEN_COUNT = 16
TOLERANCE = 1e-3
"""Largest difference of a golden logit; rounding differs between processors."""
WARM_UP_CALLS = 12
_IDENTITY_FILE = "identity.json"


@dataclass(frozen=True, slots=True)
class Identity:
    """What a policy is.

    Attributes:
        name: For people and logs.
        preset: Training preset.
        seed: Training seed.
        map_name: The vessel model that it was trained on.
        map_sha256: That model's digest; the policy runs on no other.
    """

    name: str
    preset: str
    seed: int
    map_name: str
    map_sha256: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a policy may be used; ``reason`` says why not, and is empty when it may."""

    ok: bool
    reason: str


class TorchPolicy:
    """A verified TorchScript policy, frozen and warmed up. Made by `load_policy`.

    Attributes:
        identity: What it is.
    """

    kind = "torchscript"

    def __init__(self, module: torch.jit.ScriptModule, identity: Identity) -> None:
        self.identity = identity
        # The method itself: a module's call costs microseconds that count beside so small a network.
        self._score: Callable[[torch.Tensor], torch.Tensor] = module.forward

    @property
    def name(self) -> str:
        """Return the policy's name."""
        return self.identity.name

    def logits(self, observations: Float32Array) -> Float32Array:
        """Score the actions; see `Policy.logits`."""
        with torch.inference_mode():
            scores: Float32Array = self._score(torch.from_numpy(observations)).numpy()
        return scores


def export_policy(
    module: torch.nn.Module, folder: Path, vessel: VesselMap, preset: str, seed: int
) -> Identity:
    """Freeze a network and write ``policy.pt`` and ``manifest.json``.

    Args:
        module: Maps float32 of shape (n, 6) in grid pixels to logits of shape (n, 40).
        folder: Where to; it is made.
        vessel: The vessel model that the network was trained on.
        preset: Training preset.
        seed: Training seed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    identity = Identity(f"{vessel.name}-{preset}", preset, seed, vessel.name, vessel.digest)
    archive = io.BytesIO()
    with _torchscript():
        frozen = torch.jit.freeze(torch.jit.script(module.eval()))
        torch.jit.save(frozen, archive, _extra_files={_IDENTITY_FILE: json.dumps(asdict(identity))})
    content = _slim(archive.getvalue())
    (folder / POLICY_FILE).write_bytes(content)
    golden = _golden_observations(vessel, seed)
    manifest = {
        "format": FORMAT,
        "identity": asdict(identity),
        "inputs": INPUTS,
        "outputs": OUTPUTS,
        "policy_sha256": hashlib.sha256(content).hexdigest(),
        "golden": {
            "observations": golden.tolist(),
            "logits": np.round(TorchPolicy(frozen, identity).logits(golden).astype(float), 5).tolist(),
        },
        "made_with": {
            "mrnav-server": __version__,
            "torch": str(torch.__version__),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    }
    (folder / MANIFEST_FILE).write_text(_compact(manifest) + "\n")
    return identity


def _slim(archive: bytes) -> bytes:
    """Return an archive compressed and without the entries that name files of the machine that made it."""
    kept = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as full, zipfile.ZipFile(kept, "w") as slim:
        for entry in full.infolist():
            if not entry.filename.endswith(".debug_pkl"):
                slim.writestr(entry, full.read(entry), compress_type=zipfile.ZIP_DEFLATED)
    return kept.getvalue()


def load_policy(folder: Path, vessel: VesselMap) -> TorchPolicy:
    """Verify a policy, load it, compare it with its golden outputs, and warm it up.

    Nothing is handed to TorchScript before the manifest, the map and the file's hash agree. Sets PyTorch to
    one thread: two on a busy machine are 10 to 70 times slower at this size.

    Args:
        folder: Holds ``policy.pt`` and ``manifest.json``.
        vessel: The vessel model in use.

    Raises:
        PolicyError: If a file is missing or altered, the policy belongs to another map, or it answers
            differently from what its manifest says.
    """
    manifest = _read_manifest(folder)
    identity = _check_map(manifest, folder, vessel)
    archive = _read_policy(manifest, folder)
    torch.set_num_threads(1)
    inside: dict[str, Any] = {_IDENTITY_FILE: ""}
    try:
        with _torchscript():
            load: Callable[..., torch.jit.ScriptModule] = torch.jit.load
            module = load(io.BytesIO(archive), map_location="cpu", _extra_files=inside).eval()
            module = torch.jit.optimize_for_inference(module)
    except RuntimeError as error:
        raise PolicyError(
            f"{folder / POLICY_FILE} is not TorchScript: {str(error).splitlines()[0]}"
        ) from None
    if json.loads(inside[_IDENTITY_FILE] or "null") != asdict(identity):
        raise PolicyError(
            f"{folder / MANIFEST_FILE} was altered: it is not the identity stored in the policy"
        )
    policy = TorchPolicy(module, identity)
    _check_golden(policy, manifest, folder)
    single = np.array(manifest["golden"]["observations"][:1], dtype=np.float32)
    for _ in range(WARM_UP_CALLS):
        policy.logits(single)
    return policy


def verify(folder: Path, vessel: VesselMap) -> Verdict:
    """Tell whether a policy may be used on a vessel, and if not, why."""
    try:
        load_policy(folder, vessel)
    except PolicyError as error:
        return Verdict(ok=False, reason=str(error))
    return Verdict(ok=True, reason="")


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / MANIFEST_FILE
    try:
        manifest = json.loads(path.read_text())
        sizes = manifest["format"], manifest["inputs"], manifest["outputs"]
    except FileNotFoundError:
        raise PolicyError(f"{path} is missing: train a policy with `mrnav train {folder.name}`") from None
    except (ValueError, KeyError, TypeError) as error:
        raise PolicyError(f"{path} is not a policy manifest ({error})") from None
    if sizes != (FORMAT, INPUTS, OUTPUTS):
        raise PolicyError(f"{path}: format, inputs and outputs are {sizes}, not {(FORMAT, INPUTS, OUTPUTS)}")
    checked: dict[str, Any] = manifest
    return checked


def _check_map(manifest: dict[str, Any], folder: Path, vessel: VesselMap) -> Identity:
    try:
        identity = Identity(**manifest["identity"])
    except (KeyError, TypeError) as error:
        raise PolicyError(f"{folder / MANIFEST_FILE}: bad identity ({error})") from None
    if identity.map_sha256 != vessel.digest:
        raise PolicyError(
            f"{identity.name} was trained on another map ({identity.map_name},"
            f" {str(identity.map_sha256)[:12]}…) than {vessel.name} ({vessel.digest[:12]}…)"
        )
    return identity


def _read_policy(manifest: dict[str, Any], folder: Path) -> bytes:
    path = folder / POLICY_FILE
    try:
        archive = path.read_bytes()
    except FileNotFoundError:
        raise PolicyError(f"{path} is missing: train it with `mrnav train {folder.name}`") from None
    if hashlib.sha256(archive).hexdigest() != manifest.get("policy_sha256"):
        raise PolicyError(f"{path} was altered: its sha256 is not the one in {MANIFEST_FILE}")
    return archive


def _check_golden(policy: TorchPolicy, manifest: dict[str, Any], folder: Path) -> None:
    try:
        seen = np.array(manifest["golden"]["observations"], dtype=np.float32)
        expected = np.array(manifest["golden"]["logits"], dtype=np.float32)
    except (KeyError, TypeError, ValueError) as error:
        raise PolicyError(f"{folder / MANIFEST_FILE}: bad golden outputs ({error})") from None
    if len(seen) == 0 or seen.shape[1:] != (INPUTS,) or expected.shape != (len(seen), OUTPUTS):
        raise PolicyError(
            f"{folder / MANIFEST_FILE}: bad golden outputs (shapes {seen.shape}, {expected.shape})"
        )
    try:
        given = policy.logits(seen)
    except RuntimeError as error:
        raise PolicyError(f"{policy.name} does not run: {str(error).splitlines()[-1]}") from None
    if given.shape != expected.shape:
        raise PolicyError(f"{policy.name} maps {seen.shape} to {given.shape}, not to {expected.shape}")
    off = float(np.abs(given - expected).max())
    if not off <= TOLERANCE:
        raise PolicyError(f"{policy.name} answers differently from its manifest (by {off:.3g})")


def _golden_observations(vessel: VesselMap, seed: int) -> Float32Array:
    """Draw the observations on which a policy must answer as it did when it was exported."""
    rows, columns = np.nonzero(vessel.free)
    points = np.stack([columns, rows], axis=1).astype(np.float64)
    chosen = points[np.random.default_rng(seed).integers(len(points), size=(3, GOLDEN_COUNT))]
    return observation(*chosen)


def _compact(manifest: dict[str, Any]) -> str:
    """Write the manifest indented, but each golden row on one line."""
    golden = manifest["golden"]
    rows = {
        name: "[\n" + ",\n".join(f"      {json.dumps(row)}" for row in golden[name]) + "\n    ]"
        for name in golden
    }
    text = json.dumps({**manifest, "golden": {name: f"@{name}" for name in rows}}, indent=2)
    for name, block in rows.items():
        text = text.replace(f'"@{name}"', block)
    return text


@contextmanager
def _torchscript() -> Iterator[None]:
    """Quiet PyTorch's notice that TorchScript is deprecated: it is the format that this project exports."""
    with warnings.catch_warnings():
        for category in (DeprecationWarning, FutureWarning):
            warnings.filterwarnings("ignore", message=r".*torch\.jit.*", category=category)
        yield
