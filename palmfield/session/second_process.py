"""A second process that loads modules while this process computes, and then works on request.

It begins as a copy of this process, so modules that are already loaded need not be loaded again. It ends when this
process ends.
"""

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any

from palmfield.phases import phase, running
from palmfield.profile import Profile, own_peak_bytes

STOP_S, THREAD_S = 0.2, 0.05
"""Time for removing unfinished files, and time for the end of a thread [s]."""
IDLE_S = 10
"""Time without progress after which a second process counts as failed [s]."""
PR_SET_PDEATHSIG = 1
"""Option of prctl that sets the signal which a process gets when its parent ends."""


def possible(modules: Sequence[str]) -> bool:
    """Return whether this process can be copied: it has one thread and has loaded none of the modules."""
    if sys.platform != "linux" or set(modules) & sys.modules.keys():
        return False
    for thread in threading.enumerate():
        if thread is not threading.current_thread():
            # The thread of a progress bar that has just ended
            thread.join(THREAD_S)
    return threading.active_count() == 1


class SecondProcess:
    """A copy of this process that loads modules, and then calls a function with its end of a connection.

    At the end it sends its memory (`own_peak_bytes`) and, while this process is measured, its phases.
    talk: this end of the connection; it raises EOFError or OSError after the second process has ended
    """

    def __init__(self, modules: Sequence[str], work: Callable[[Connection], None]) -> None:
        """Start the process. Raises OSError if the system has no resources for it."""
        self.talk, other_end = Pipe()
        arguments = os.getpid(), self.talk, other_end, modules, work
        self._process = get_context("fork").Process(target=_second, args=arguments, daemon=True)
        self._process.start()
        other_end.close()

    def receive(self) -> Any:
        """Return what the process sends.

        Raises EOFError or OSError if it has ended, or has made no progress for IDLE_S.
        """
        # Progress is CPU time: a long computation may go on, as in one process; a stopped or blocked process may not.
        # Each second is counted, because this process may be stopped too (Ctrl-Z).
        used, idle = [""], 0
        while not self.talk.poll(1.0):
            facts = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2]
            before, used = used, facts.split()[11:13]
            idle = idle + 1 if used == before else 0
            if idle >= IDLE_S:
                raise TimeoutError(f"the process that draws pictures made no progress for {IDLE_S} s")
        return self.talk.recv()

    def end(self, working: bool = False) -> None:
        """End the process. working: whether it may first remove unfinished files, for at most STOP_S"""
        if working:
            self._process.terminate()
            self._process.join(STOP_S)
        self._process.kill()
        self._process.join()
        self.talk.close()


def _second(
    first: int, first_end: Connection, talk: Connection, modules: Sequence[str], work: Callable[[Connection], None]
) -> None:
    # Ctrl-C reaches both processes; the first one decides what ends
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _interrupt)
    first_end.close()
    running[:] = [Profile()] if running else []
    # After any error the first process does the work itself, and reports the error
    with suppress(KeyboardInterrupt, Exception):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
        if os.getppid() != first:
            return
        with suppress(ImportError), phase("imports"):
            for module in modules:
                import_module(module)
        work(talk)
        talk.send((own_peak_bytes(), running[-1].own_phases() if running else {}))


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt
