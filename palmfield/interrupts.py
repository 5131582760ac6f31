"""Delay Ctrl-C to consistent states, leave native calls at once, and end a process by other signals with finally."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from types import FrameType, TracebackType
from typing import ClassVar, TypeVar

T = TypeVar("T")
Handler = Callable[[int, FrameType | None], None]


class interrupts_delayed:
    """A context that delays Ctrl-C until the yielded function is called or the block ends.

    with interrupts_delayed() as check:
        for part in parts:
            part()
            check()

    The previous handler then handles Ctrl-C: KeyboardInterrupt by default, or the handler of the program. After an
    error in the block, Ctrl-C is ignored. The context has no effect in a nested block (the outer block delays Ctrl-C),
    if the process ignores Ctrl-C or ends by it without Python, and in other threads.
    """

    _inside: ClassVar[bool] = False
    """Whether the main thread is in a block of this class."""
    # A class, because each sim.step() enters a block and a generator takes more Python calls
    _before: Callable[[int, FrameType | None], object] | None = None
    _arrived = False

    def __enter__(self) -> Callable[[], None]:
        if interrupts_delayed._inside or threading.current_thread() is not threading.main_thread():
            return _nothing
        before = signal.getsignal(signal.SIGINT)
        if not callable(before):
            return _nothing
        signal.signal(signal.SIGINT, self._note)
        self._before = before
        interrupts_delayed._inside = True
        return self._check

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._before is None:
            return
        # Reset before the handler is restored, after which Ctrl-C may be raised anywhere
        interrupts_delayed._inside = False
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
    """Do nothing, because Ctrl-C is not delayed."""


def left_by_interrupts(work: Callable[[], T]) -> T:
    """Run a function with long native calls, such as an eigenproblem, in another thread; return its result.

    Ctrl-C ends the wait at once. The thread then completes its present call, and its result is dropped. Python cannot
    raise KeyboardInterrupt inside such a call. Outside the main thread, the function is simply called.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    done: Future[T] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=run, name="palmfield-native", daemon=True).start()
    return done.result()


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
