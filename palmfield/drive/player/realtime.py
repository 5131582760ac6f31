"""Priority over all else on the machine, for a process that writes a few bytes at the right moment."""

import ctypes
import gc
import os
import sys

PRIORITY = 60
PR_SET_TIMERSLACK = 29
MCL_CURRENT, MCL_FUTURE = 1, 2


def collect_no_garbage() -> None:
    """No pause for reference cycles, of which a player makes none; wake up when a wait is over, not 50 us later."""
    gc.collect()
    gc.freeze()
    gc.disable()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


def take_priority() -> str:
    """Ask for SCHED_FIFO and for memory that stays in RAM; returns what was got, in words, and why not all."""
    if not hasattr(os, "sched_setscheduler"):
        return "normal priority (this system has no SCHED_FIFO)"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError as error:
        return (
            f"normal priority ({(error.strerror or 'refused').lower()}: a line '@realtime - rtprio {PRIORITY}' in "
            "/etc/security/limits.conf permits SCHED_FIFO)"
        )
    said = f"SCHED_FIFO {PRIORITY}"
    if sys.platform == "linux" and ctypes.CDLL(None).mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        said += ", memory not locked"
    return said
