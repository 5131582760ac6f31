"""Set the priority of threads that must follow a device in real time."""

import contextlib
import gc
import os
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

MAKER_PRIORITY, FOLLOWER_PRIORITY = 40, 30
"""Priorities of the thread that makes frames, and of the thread that fits a hand to samples.

The player has a higher priority.
"""
SWITCH_S = 200e-6
"""Switch interval of Python threads [s]. It is short, so that the thread of a virtual board can read bytes in time."""


@contextlib.contextmanager
def realtime(priority: int) -> Iterator[str]:
    """Give the calling thread SCHED_FIFO in the block, if permitted; yield a description of its priority.

    Use it only for a thread that mostly waits. Threads that this thread starts have normal priority.
    """
    before: tuple[int, Any] | None = None
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            present = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
            before = present
    try:
        yield "normal priority" if before is None else f"SCHED_FIFO {priority}"
    finally:
        if before is not None:
            os.sched_setscheduler(0, *before)


@contextlib.contextmanager
def undisturbed() -> Iterator[str]:
    """Apply `realtime` to the thread that makes frames, with SWITCH_S and without garbage collection."""
    collects, interval_s = gc.isenabled(), sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)
    try:
        with realtime(MAKER_PRIORITY) as priority:
            yield priority
    finally:
        sys.setswitchinterval(interval_s)
        if collects:
            gc.enable()


def follower(target: Callable[[], object]) -> threading.Thread:
    """Return a daemon thread with FOLLOWER_PRIORITY. It is not started yet."""

    def run() -> None:
        with realtime(FOLLOWER_PRIORITY):
            target()

    return threading.Thread(target=run, daemon=True)
