"""Priority of this process's threads while they follow something that does not wait."""

import contextlib
import gc
import os
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

MAKER_PRIORITY, FOLLOWER_PRIORITY = 40, 30
"""Of who makes frames while a player, which has more, sends them; and of who fits a hand to what a tracker tells."""
SWITCH_S = 200e-6
"""After which one of Python's threads lets another go on [s]: a virtual board's takes bytes meanwhile."""


@contextlib.contextmanager
def realtime(priority: int) -> Iterator[str]:
    """In the block the thread that calls has SCHED_FIFO where that is permitted; gives what it got in words.

    Only for a thread that mostly waits; what it starts has normal priority.
    """
    before: tuple[int, Any] | None = None
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            known = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
            before = known
    try:
        yield "normal priority" if before is None else f"SCHED_FIFO {priority}"
    finally:
        if before is not None:
            os.sched_setscheduler(0, *before)


@contextlib.contextmanager
def undisturbed() -> Iterator[str]:
    """As `realtime`, for the thread that makes frames; meanwhile nothing collects garbage, and threads switch soon."""
    collects, interval_s = gc.isenabled(), sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)
    try:
        with realtime(MAKER_PRIORITY) as got:
            yield got
    finally:
        sys.setswitchinterval(interval_s)
        if collects:
            gc.enable()


def follower(target: Callable[[], object]) -> threading.Thread:
    """A thread, not yet started, of something that must not wait; it ends with the process."""

    def run() -> None:
        with realtime(FOLLOWER_PRIORITY):
            target()

    return threading.Thread(target=run, daemon=True)
