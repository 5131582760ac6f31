"""Compute papers in parallel, each in a separate process. This is possible because they share no runs."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, TypeVar

T = TypeVar("T")
Report = Callable[[str, str], None]
"""Function that gets the progress of a paper: its name, and the entry that begins, or "" when an entry ends."""


def side_by_side(work: Callable[[str, Report], T], names: Sequence[str], jobs: int, report: Report) -> list[T]:
    """Return work(name, report) for each name, in order, with `jobs` processes at a time.

    work: function that can be pickled; after KeyboardInterrupt, which is raised once, it returns its partial result
    After Ctrl-C, names that have not begun are skipped.
    """
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, ProcessPoolExecutor(min(jobs, len(names)), mp_context=context) as pool:
        messages: Any = manager.Queue()
        ending: Any = manager.Event()

        def listen() -> None:
            for news in iter(messages.get, None):
                report(*news)

        listener = threading.Thread(target=listen, daemon=True)
        listener.start()
        running: list[Future[list[T]]] = []
        try:
            # Processes inherit this: an idle or importing process has nothing to write, and would print a traceback
            with _interrupts_blocked():
                running += [pool.submit(_one, work, name, messages, ending) for name in names]
        except KeyboardInterrupt:
            _end(running, ending)
        _wait(running, ending)
        messages.put(None)
        listener.join()
        return [result for one in running if not one.cancelled() for result in one.result()]


def _wait(running: Sequence[Future[Any]], ending: Any) -> None:
    """Wait until all have ended."""
    while True:
        try:
            wait(running)
            return
        except KeyboardInterrupt:
            _end(running, ending)


def _end(running: Sequence[Future[Any]], ending: Any) -> None:
    """End the workers.

    Ctrl-C in a terminal reaches all processes, but a signal sent by a program reaches only this one.
    """
    ending.set()
    for one in running:
        one.cancel()
    for process in multiprocessing.active_children():
        if process.pid is not None:
            os.kill(process.pid, signal.SIGINT)


def _one(work: Callable[[str, Report], T], name: str, progress: Any, ending: Any) -> list[T]:
    """Return a list with the result. It is empty if the work has not begun."""
    if ending.is_set():
        return []
    before = signal.signal(signal.SIGINT, _once)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    except KeyboardInterrupt:
        return []
    try:
        return [work(name, lambda *news: progress.put(news))]
    finally:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)


def _once(number: int, frame: object) -> None:
    """Ignore a second Ctrl-C, so that results are written completely."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Delay Ctrl-C to the end of the block in this thread. Processes that begin in the block never get it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
