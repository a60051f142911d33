"""An event loop whose time jumps to the next timer as soon as nothing is left to do.

Whatever runs on it goes as fast as the machine computes, and takes as much virtual time as it would take on a
machine that computes at no cost. Sockets are real: as long as one has something to read, time stands still.

Jobs of ``run_in_executor`` and ``asyncio.to_thread`` take turns with the loop: one runs, in a thread of its
own, while the loop stands still, until it ends or waits on the loop's ``waiting``. So a camera's thread, or a
client that blocks, has its place in the same order of events each time.
"""

import asyncio
import select
import selectors
import socket
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
from typing import ParamSpec, TypeVar, TypeVarTuple, Unpack

_BEGIN_S = 1000.0
"""Far from 0, as a real monotonic clock mostly is."""

_T = TypeVar("_T")
_P = ParamSpec("_P")
_Ts = TypeVarTuple("_Ts")


class VirtualTimeEndedError(RuntimeError):
    """The loop was closed while a job waited on it. Reaction: the job unwinds."""


class _Selector(selectors.DefaultSelector):
    """Asks the sockets without waiting; where nothing is ready, the wait is taken as passed."""

    now_s = _BEGIN_S

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0.0)
        if ready or timeout is None:
            # Without a timer nothing but the world outside can wake the loop.
            return ready or super().select(None)
        self.now_s += max(timeout, 0.0)
        return []


@dataclass(frozen=True, slots=True)
class _Wait:
    """What a job waits for: a time, or earlier something to read."""

    until_s: float
    readable: socket.socket | None = None


class _Job:
    """A function in a thread that runs only while the loop stands still."""

    def __init__(self, loop: "VirtualTimeLoop", call: Callable[[], None]) -> None:
        self._loop = loop
        self._call = call
        self._go, self._back = threading.Semaphore(0), threading.Semaphore(0)
        self._wait: _Wait | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._came = False
        threading.Thread(target=self._run, name="virtual time", daemon=True).start()

    def resume(self, *, came: bool = False) -> None:
        """Run until it waits or ends; on the loop's thread."""
        self._forget()
        self._came = came
        self._go.release()
        self._back.acquire()
        wait = self._wait
        if wait is None or self._loop.is_closed():
            self._loop.jobs.discard(self)
            return
        self._timer = self._loop.call_at(wait.until_s, self.resume)
        if wait.readable is not None:
            self._loop.add_reader(wait.readable, self._on_readable)

    def pause(self, wait: _Wait) -> bool:
        """Wait on the job's own thread; tell whether there is something to read."""
        self._require_open()
        self._wait = wait
        self._back.release()
        self._go.acquire()
        self._require_open()
        return self._came

    def _require_open(self) -> None:
        if self._loop.is_closed():
            raise VirtualTimeEndedError("virtual time has ended")

    def _on_readable(self) -> None:
        self.resume(came=True)

    def _forget(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        if self._wait is not None and self._wait.readable is not None and not self._loop.is_closed():
            self._loop.remove_reader(self._wait.readable)
        self._wait = None

    def _run(self) -> None:
        self._go.acquire()
        _running.job = self
        try:
            self._call()
        finally:
            self._wait = None
            self._back.release()


class _Running(threading.local):
    job: _Job | None = None


_running = _Running()


class VirtualWaiting:
    """How blocking code waits in virtual time; only within a job of the loop.

    Args:
        loop: The loop.
    """

    def __init__(self, loop: "VirtualTimeLoop") -> None:
        self._loop = loop

    def now_s(self) -> float:
        """Return the virtual time."""
        return self._loop.time()

    def sleep(self, duration_s: float) -> None:
        """Wait for a while; zero lets everything else run that is due."""
        _own_job().pause(_Wait(self.now_s() + max(duration_s, 0.0)))

    def readable(self, source: socket.socket, until_s: float) -> bool:
        """Wait until there is something to read, at most until a time; tell whether there is."""
        job = _own_job()
        if select.select([source], [], [], 0.0)[0]:
            return True
        return until_s > self.now_s() and job.pause(_Wait(until_s, source))


def _own_job() -> _Job:
    if _running.job is None:
        raise RuntimeError("only a job of the virtual loop may wait on it: call it through run_in_executor")
    return _running.job


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """The event loop of a simulated rig that need not keep up with real time.

    Attributes:
        waiting: How its jobs wait.
        jobs: Those that have not ended.
    """

    def __init__(self) -> None:
        self._virtual = _Selector()
        super().__init__(self._virtual)
        self.waiting = VirtualWaiting(self)
        self.jobs: set[_Job] = set()

    def time(self) -> float:
        """Return the virtual time in seconds."""
        return self._virtual.now_s

    def run_in_executor(
        self, executor: Executor | None, func: Callable[[Unpack[_Ts]], _T], *args: *_Ts
    ) -> asyncio.Future[_T]:
        """Run a job in turns with the loop, whatever the executor: all take the same care."""
        done: asyncio.Future[_T] = self.create_future()

        def work() -> None:
            try:
                settle = partial(_give, done, func(*args))
            except BaseException as error:  # noqa: BLE001 - handed to whoever awaits the job
                settle = partial(_fail, done, error)
            if not self.is_closed():
                self.call_soon_threadsafe(settle)

        job = _Job(self, work)
        self.jobs.add(job)
        self.call_soon_threadsafe(job.resume)
        return done

    def close(self) -> None:
        """Close the loop; jobs that still wait are unwound."""
        super().close()
        for job in tuple(self.jobs):
            job.resume()


def _give(done: asyncio.Future[_T], result: _T) -> None:
    if not done.cancelled():
        done.set_result(result)


def _fail(done: asyncio.Future[_T], error: BaseException) -> None:
    if not done.cancelled():
        done.set_exception(error)


class AtOnce(Executor):
    """Runs what is submitted before it returns: in virtual time, thinking takes none."""

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Run a function; return its result, which is there."""
        done: Future[_T] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 - handed to whoever asks for the result
            done.set_exception(error)
        return done
