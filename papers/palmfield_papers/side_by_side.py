"""Papers side by side, each in a process of its own: they share no runs."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, TypeVar

T = TypeVar("T")
Told = Callable[[str, str], None]
"""Hears of a paper's progress: its name and the entry that begins, or nothing when one has ended."""


def side_by_side(work: Callable[[str, Told], T], names: Sequence[str], jobs: int, told: Told) -> list[T]:
    """work(name, told) of each name, in the order of names, `jobs` of them at a time.

    work: can be pickled, and returns what it has when KeyboardInterrupt is raised in it, which happens once
    After Ctrl-C, names that have not begun are left out.
    """
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, ProcessPoolExecutor(min(jobs, len(names)), mp_context=context) as pool:
        heard: Any = manager.Queue()
        ending: Any = manager.Event()

        def listen() -> None:
            for news in iter(heard.get, None):
                told(*news)

        listener = threading.Thread(target=listen, daemon=True)
        listener.start()
        running: list[Future[list[T]]] = []
        try:
            # Processes inherit it: what is idle or still imports has nothing to write, and would print a traceback
            with _held():
                running += [pool.submit(_one, work, name, heard, ending) for name in names]
        except KeyboardInterrupt:
            _end(running, ending)
        _wait(running, ending)
        heard.put(None)
        listener.join()
        return [result for one in running if not one.cancelled() for result in one.result()]


def _wait(running: Sequence[Future[Any]], ending: Any) -> None:
    """Until all have ended."""
    while True:
        try:
            wait(running)
            return
        except KeyboardInterrupt:
            _end(running, ending)


def _end(running: Sequence[Future[Any]], ending: Any) -> None:
    """A terminal's Ctrl-C reaches all processes, but one that is sent reaches this one alone."""
    ending.set()
    for one in running:
        one.cancel()
    for process in multiprocessing.active_children():
        if process.pid is not None:
            os.kill(process.pid, signal.SIGINT)


def _one(work: Callable[[str, Told], T], name: str, heard: Any, ending: Any) -> list[T]:
    """What came of it; nothing where it has not begun."""
    if ending.is_set():
        return []
    before = signal.signal(signal.SIGINT, _once)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    except KeyboardInterrupt:
        return []
    try:
        return [work(name, lambda *news: heard.put(news))]
    finally:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)


def _once(number: int, frame: object) -> None:
    """A second Ctrl-C must not cut off the writing of what is done."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


@contextmanager
def _held() -> Iterator[None]:
    """Ctrl-C waits for the end of the block, in this thread and for good in processes that begin in it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
