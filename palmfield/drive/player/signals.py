"""Signals of the caller's process while a board sounds: the player hears of them at once, the caller when it can."""

import contextlib
import os
import signal
import socket
import time
from collections.abc import Iterator
from types import FrameType

from palmfield.drive.exit_signals import handling, in_main_thread, leave

ENDS = ("SIGTERM", "SIGHUP", "SIGQUIT")
"""They end a process without running `finally`; as SystemExit they do. SIGINT is KeyboardInterrupt already."""


@contextlib.contextmanager
def signals_to(alarm: socket.socket, silent_within_s: float) -> Iterator[None]:
    """In the block numbers of signals go to a socket as they come, also while Python is busy elsewhere.

    alarm: never blocks; silent_within_s: time that the board takes to be silent before Ctrl-Z stops this process
    Nothing is caught elsewhere than in the main thread, nor what the process ignores (as SIGHUP under nohup).
    """
    if not in_main_thread():
        yield
        return

    def stop(number: int, _frame: FrameType | None) -> None:
        time.sleep(silent_within_s)
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        # Here it goes on, after SIGCONT
        signal.signal(number, stop)
        with contextlib.suppress(OSError):
            alarm.send(bytes([signal.SIGCONT]))

    with handling({**dict.fromkeys(ENDS, leave), "SIGTSTP": stop}):
        wakeup = signal.set_wakeup_fd(alarm.fileno(), warn_on_full_buffer=False)
        try:
            yield
        finally:
            signal.set_wakeup_fd(wakeup)
