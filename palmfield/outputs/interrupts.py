"""Ctrl-C where it can do no harm."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def interrupts_held() -> Iterator[Callable[[], None]]:
    """Ctrl-C waits until the yielded function is called, or until the end of the block, and is raised there.

    Elsewhere than in the main thread signals can't be caught, and Ctrl-C does not arrive.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    requested: list[int] = []

    def check() -> None:
        if requested:
            requested.clear()
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, lambda number, frame: requested.append(number))
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)
    check()
