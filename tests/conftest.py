"""Guards over every test: none leaves a task running, blocks the event loop, or writes to the user's home."""

import asyncio
import inspect
import logging
from collections.abc import AsyncIterator, Iterator

import pytest
from hypothesis import settings

# The same examples every time: a change is judged by what it changes. `make explore` looks for new ones.
# No deadline: a busy machine is slow, and speed is not what a test is about.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=1000, print_blob=True, deadline=None)
settings.load_profile("same")

BLOCKED_LOOP_CEILING_S = 5.0
"""A callback that holds the loop longer fails its test; a busy machine alone holds one for over a second."""
GRACE_S = 0.2
"""A task that was told to end may take this long to do so."""


class _SlowCallbacks(logging.Handler):
    """Keeps asyncio's own reports of callbacks that held the loop."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.reports: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        if message.startswith("Executing ") and message.endswith("seconds"):
            self.reports.append(message)


@pytest.fixture
async def _loop_guard() -> AsyncIterator[None]:
    """Fail the test if it leaks a task or holds the loop for longer than the ceiling."""
    loop = asyncio.get_running_loop()
    loop.set_debug(True)
    loop.slow_callback_duration = BLOCKED_LOOP_CEILING_S
    before = asyncio.all_tasks()
    slow = _SlowCallbacks()
    logger = logging.getLogger("asyncio")
    logger.addHandler(slow)
    try:
        yield
        current = asyncio.current_task()
        left = {task for task in asyncio.all_tasks() - before if task is not current}
        if left:
            _, left = await asyncio.wait(left, timeout=GRACE_S)
        for task in left:
            task.cancel()
        if left:
            await asyncio.wait(left, timeout=GRACE_S)
    finally:
        logger.removeHandler(slow)
    if left:
        pytest.fail("leaked tasks: " + "; ".join(sorted(repr(task) for task in left)), pytrace=False)
    if slow.reports:
        pytest.fail("blocked event loop: " + "; ".join(slow.reports), pytrace=False)


@pytest.fixture(autouse=True)
def _guarded(request: pytest.FixtureRequest) -> None:
    """Put the loop guard around asynchronous tests; synchronous ones need no loop."""
    function = getattr(request.node, "obj", None)
    inner = getattr(getattr(function, "hypothesis", None), "inner_test", function)
    if inspect.iscoroutinefunction(inner):
        request.getfixturevalue("_loop_guard")


@pytest.fixture(autouse=True)
def _ordinary_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep commands that run inside the test process from preferring it over other programs for good."""
    monkeypatch.setattr("mrnav_server.loops.priority._set_priority", lambda *_: False)


@pytest.fixture(autouse=True, scope="session")
def _own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the servers of tests, and of processes that they start, apart from the user's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
