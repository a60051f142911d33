"""The web application in a thread, over trials on disk and a rig without devices."""

import asyncio
import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mrnav_server.app.server import create_app
from mrnav_server.app.study_progress import LedStudy
from mrnav_server.settings import Settings
from tests.app.fake_rig import OPERATOR_TOKEN, SERVER, FakeRig, listening


@contextmanager
def pages_server(trials: Path, study: LedStudy | None = None, **server: object) -> Iterator[str]:
    """Serve the pages over the trials in a folder, and lead a study; yields the address.

    Args:
        trials: Where they are.
        study: What to lead through.
        server: Further settings of section ``server``.
    """
    settings = Settings.model_validate({"server": SERVER | server, "recording": {"root": str(trials)}})
    ready, over = threading.Event(), threading.Event()
    ports: list[int] = []

    async def serve() -> None:
        rig = FakeRig(settings)
        async with listening(create_app(rig, settings, study)) as port:
            ports.append(port)
            ready.set()
            for seq in itertools.count(1):
                rig.publish(seq)
                rig.show(seq)
                if await asyncio.to_thread(over.wait, 0.1):
                    break

    thread = threading.Thread(target=asyncio.run, args=(serve(),))
    thread.start()
    try:
        assert ready.wait(30.0)
        yield f"http://127.0.0.1:{ports[0]}"
    finally:
        over.set()
        thread.join(30.0)


def signed_in(url: str, path: str, token: str = OPERATOR_TOKEN) -> str:
    """Return a page's address with a token."""
    return f"{url}{path}{'&' if '?' in path else '?'}token={token}"
