"""Handlers of signals that would end a process without running `finally`, so that a board would continue to sound."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from types import FrameType

Handler = Callable[[int, FrameType | None], None]


def leave(number: int, _frame: FrameType | None) -> None:
    """Signal handler: end the process by an exception, so that `finally` runs."""
    raise SystemExit(128 + number)


def in_main_thread() -> bool:
    """Return whether Python runs signal handlers in this thread."""
    return threading.current_thread() is threading.main_thread()


@contextlib.contextmanager
def handling(handlers: Mapping[str, Handler]) -> Iterator[None]:
    """Set signal handlers by name in the block, except for signals that the process ignores or the system lacks.

    SIGHUP is ignored under nohup. Outside the main thread no handler is set.
    """
    if not in_main_thread():
        yield
        return
    available = {getattr(signal, name): new for name, new in handlers.items() if hasattr(signal, name)}
    handled = {number: new for number, new in available.items() if signal.getsignal(number) is not signal.SIG_IGN}
    before = {number: signal.signal(number, new) for number, new in handled.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
