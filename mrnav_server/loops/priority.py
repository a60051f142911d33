"""Scheduling: what moves the magnet runs before what draws pictures, as far as the system allows."""

import os
import threading

_PREFERRED = -10
_ORDINARY = 0


def prefer_this_process() -> bool:
    """Run this thread, and those that it starts, before other processes; tell whether it was allowed.

    Linux allows it to root and to CAP_SYS_NICE; elsewhere nothing changes and nothing fails.
    """
    return _set_priority(0, _PREFERRED)


def make_ordinary(thread_or_process: int | None = None) -> None:
    """Give up that preference for a thread that only computes, or for a child process.

    Args:
        thread_or_process: Its native id; None means the calling thread.
    """
    _set_priority(threading.get_native_id() if thread_or_process is None else thread_or_process, _ORDINARY)


def _set_priority(native_id: int, niceness: int) -> bool:
    if not hasattr(os, "setpriority"):
        return False
    try:
        os.setpriority(os.PRIO_PROCESS, native_id, niceness)
    except (PermissionError, ProcessLookupError):
        return False
    return True
