"""Which software this is, exactly."""

import hashlib
from functools import cache
from pathlib import Path

from mrnav_server import __version__


@cache
def software_version() -> str:
    """Return the version and twelve digits of the SHA-256 of all Python sources: ``0.1.0+3f9c2a1b8d07``.

    A release has the same digest wherever it is installed, and an edited checkout another one, so that a
    recorded trial names the code that recorded it.
    """
    package = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py"), key=lambda path: path.relative_to(package).as_posix()):
        # Line ends may be a checkout's own.
        content = file.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{file.relative_to(package).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return f"{__version__}+{digest.hexdigest()[:12]}"
