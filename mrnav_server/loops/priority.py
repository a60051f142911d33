"""Scheduling: what moves the magnet runs before other programs, as far as the system allows."""

import os

import cv2
from threadpoolctl import threadpool_limits

_PREFERRED = -10
_ORDINARY = 0


def prefer_this_process() -> bool:
    """Run this process before others; tell whether it was allowed. Call it before any thread starts.

    All threads share the preference. One that waited behind other programs while it holds the
    interpreter's lock would hold up the control loop with it.

    Linux allows it to root and to CAP_SYS_NICE; elsewhere nothing changes and nothing fails.
    """
    return _set_priority(0, _PREFERRED)


def compute_in_calling_threads() -> None:
    """Have OpenCV and the linear algebra behind numpy start no threads of their own.

    On a busy machine a call that shares its few microseconds of work with a second thread waits for that
    thread to be scheduled: tens of milliseconds, for the tracker or for the control loop.
    """
    cv2.setNumThreads(1)
    threadpool_limits(1)


def make_ordinary(process: int) -> None:
    """Take that preference from a child process, given by its id."""
    _set_priority(process, _ORDINARY)


def _set_priority(process: int, niceness: int) -> bool:
    if not hasattr(os, "setpriority"):
        return False
    try:
        os.setpriority(os.PRIO_PROCESS, process, niceness)
    except (PermissionError, ProcessLookupError):
        return False
    return True
