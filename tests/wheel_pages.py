"""Serves the installed package and fetches all that its pages refer to; run where there is no network.

``python -m tests.wheel_pages MRNAV FOLDER``. Prints what was fetched as JSON.
"""

import array
import fcntl
import json
import re
import socket
import struct
import sys
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import httpx

from tests.rig_process import RigProcess

PAGES = ("/", "/xr", "/tlx", "/results", "/docs", "/api/v1/openapi.json", "/api/v1/twin.schema.json")
_HTML = re.compile(r'<(?:script|link|img)[^>]*?\s(?:src|href)="([^"]+)"')
_IMPORT_MAP = re.compile(r'<script type="importmap"[^>]*>(.*?)</script>', re.DOTALL)
_JS = re.compile(
    r"""^\s*(?:import|export)\b[^;"'=()]*?\bfrom\s*["']([^"']+)|^\s*import\s*["']([^"']+)"""
    r"""|\bimport\(\s*["']([^"']+)["']\s*\)""",
    re.MULTILINE,
)
_CSS = re.compile(r"""url\(["']?([^"')]+)|@import\s+["']([^"']+)""")
_SIOCGIFFLAGS, _SIOCSIFFLAGS, _IFF_UP = 0x8913, 0x8914, 1


def raise_loopback() -> None:
    """Bring up the loopback device of a fresh network namespace."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        request = array.array("B", struct.pack("16sh22x", b"lo", 0))
        fcntl.ioctl(control, _SIOCGIFFLAGS, request, True)
        flags = struct.unpack_from("h", request, 16)[0]
        fcntl.ioctl(control, _SIOCSIFFLAGS, struct.pack("16sh22x", b"lo", flags | _IFF_UP))


def references(text: str, kind: str, imports: dict[str, str]) -> list[str]:
    """Return what a file loads, as it is written there; fills the page's import map."""
    if "html" in kind:
        for found in _IMPORT_MAP.findall(text):
            imports.update(json.loads(found)["imports"])
        return [*_HTML.findall(text), *(target for target in imports.values() if not target.endswith("/"))]
    pattern = _JS if "javascript" in kind else _CSS if "css" in kind else None
    found = ["".join(groups) for groups in pattern.findall(text)] if pattern else []
    return [mapped(name, imports) for name in found if not name.startswith("data:")]


def mapped(name: str, imports: dict[str, str]) -> str:
    """Return where a bare module name leads."""
    for prefix, target in sorted(imports.items(), key=lambda entry: -len(entry[0])):
        if name == prefix or (prefix.endswith("/") and name.startswith(prefix)):
            return target + name[len(prefix) :]
    return name


def main() -> None:
    """Fetch until nothing new is referred to."""
    raise_loopback()
    rig = RigProcess(Path(sys.argv[2]), command=(sys.argv[1],))
    fetched: dict[str, int] = {}
    imports: dict[str, str] = {}
    try:
        waiting = [urljoin(rig.url, page) for page in PAGES]
        while waiting:
            url = waiting.pop()
            if url in fetched:
                continue
            if urlsplit(url).netloc != urlsplit(rig.url).netloc:
                raise SystemExit(f"a page refers to another host: {url}")
            answer = rig.http.get(url, follow_redirects=True)
            if answer.status_code != httpx.codes.OK:
                raise SystemExit(f"{url}: {answer.status_code}")
            fetched[url] = len(answer.content)
            kind = answer.headers.get("content-type", "")
            waiting += [urljoin(url, name) for name in references(answer.text, kind, imports)]
    finally:
        rig.end()
    sys.stdout.write(json.dumps({urlsplit(url).path: size for url, size in fetched.items()}))


if __name__ == "__main__":
    main()
