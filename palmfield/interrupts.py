"""Ctrl-C where it can do no harm."""

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import ClassVar


class interrupts_held:
    """Ctrl-C waits until the yielded function is called, or until the end of the block, and is raised there.

    with interrupts_held() as check:
        for part in parts:
            part()
            check()

    What handled Ctrl-C before handles it then: KeyboardInterrupt by default, or what the program's own handler does. An
    error that leaves the block comes first, and Ctrl-C is dropped. Nothing is held inside another such block, whose own
    function raises; where the process ignores Ctrl-C or is ended by it without Python; and elsewhere than in the main
    thread, where signals can't be caught and Ctrl-C does not arrive.
    """

    _inside: ClassVar[bool] = False
    """Whether the main thread is in such a block."""
    # Each call of sim.step() makes one: a class takes fewer Python calls than a generator
    _before: Callable[[int, FrameType | None], object] | None = None
    _arrived = False

    def __enter__(self) -> Callable[[], None]:
        if interrupts_held._inside or threading.current_thread() is not threading.main_thread():
            return _nothing
        before = signal.getsignal(signal.SIGINT)
        if not callable(before):
            return _nothing
        signal.signal(signal.SIGINT, self._note)
        self._before = before
        interrupts_held._inside = True
        return self._check

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._before is None:
            return
        # Before the handler: once that is back, Ctrl-C may be raised at any place
        interrupts_held._inside = False
        signal.signal(signal.SIGINT, self._before)
        if kind is None:
            self._check()

    def _note(self, number: int, frame: object) -> None:
        self._arrived = True

    def _check(self) -> None:
        if self._arrived:
            self._arrived = False
            assert self._before is not None
            self._before(signal.SIGINT, None)


def _nothing() -> None:
    """Ctrl-C is not held here."""
