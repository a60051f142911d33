"""What a client needs to come in, in files that this user alone can read."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import orjson
import platformdirs


@dataclass(frozen=True, slots=True)
class Ready:
    """What a client needs to come in.

    Attributes:
        url: The page, with the operator's token.
        port: Page, WebSockets, video and REST.
        hand_port: Hand link.
        operator_token: Lets its bearer control the rig.
        viewer_token: Lets its bearer watch, and stop.
    """

    url: str
    port: int
    hand_port: int
    operator_token: str
    viewer_token: str


def own_file() -> Path:
    """Return the file by which this process's server is found on this machine."""
    return _folder() / f"server-{os.getpid()}.json"


def running_servers() -> list[Ready]:
    """Return the servers of this user on this machine; what a killed server left behind is removed."""
    found = []
    for file in sorted(_folder().glob("server-*.json")):
        try:
            if _has_ended(int(file.stem.removeprefix("server-"))):
                file.unlink(missing_ok=True)
                continue
            found.append(Ready(**json.loads(file.read_bytes())))
        except (OSError, ValueError, TypeError):
            continue
    return found


@contextmanager
def announced(ready: Ready, file: Path) -> Iterator[None]:
    """Keep a file for a ``with`` block; it appears whole, as one line of JSON."""
    part = file.with_name(f".{file.name}.{os.getpid()}")
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as out:
        out.write(orjson.dumps(ready) + b"\n")
    part.replace(file)
    try:
        yield
    finally:
        file.unlink(missing_ok=True)


def _folder() -> Path:
    return Path(platformdirs.user_state_dir("mrnav")) / "servers"


def _has_ended(pid: int) -> bool:
    """Tell whether a process is surely gone; only POSIX can be asked without harm."""
    if os.name != "posix":
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        return False
    return False
