"""Threads of this process that share out the blocks of a computation. Safe after a fork, and from several threads."""

import functools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat, starmap
from queue import SimpleQueue

Calls = Sequence[Callable[[], object]]
"""What one block asks for, in this order."""

_Offer = tuple[threading.Lock, Iterator[Calls], "SimpleQueue[BaseException | None]"]
"""Taken by whoever gets the lock; blocks that nobody has begun; where a helper says that it is done."""


_most: list[int] = []


def cores() -> int:
    """Cores that this process may use: all that the system gives it, or fewer by `limit`."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min([there, *_most])


def python_threads() -> int:
    """Threads for calls so short that they wait for Python's lock in between.

    On 16 cores the harmonics of a disc took 0.6 of the time of one thread with 4 threads, 0.7 with 8.
    """
    return min(cores(), 4)


def limit(count: int | None) -> None:
    """Use at most `count` cores from now on, >= 1; None for all. What is already shared out among threads stays so.

    For processes that share a machine: each would otherwise take all of its cores.
    """
    if count is not None and count < 1:
        raise ValueError(f"the limit is {count} cores; allowed: at least 1, or None")
    _most[:] = [] if count is None else [count]


@functools.cache
def pool() -> ThreadPoolExecutor:
    """Threads shared by all evaluators of this process."""
    return ThreadPoolExecutor(cores(), thread_name_prefix="palmfield-field")


def share(blocks: Sequence[Calls], threads: int) -> None:
    """Do all blocks, on this thread and on up to `threads` - 1 helpers; return when all are done.

    It takes 20 us where an executor takes 100: this thread works too, and what passes between threads is in C. The
    threads share one iterator, so that a slow core does fewer blocks, and a helper that comes late does none.
    Raises the first error of a block, when no helper works any more.
    """
    helpers = min(threads, len(blocks)) - 1
    if helpers < 1:
        for calls in blocks:
            for call in calls:
                call()
        return
    waiting = _helpers()
    todo, done = iter(blocks), SimpleQueue[BaseException | None]()
    offers = []
    for _ in range(helpers):
        offer = threading.Lock()
        offers.append(offer)
        waiting.put((offer, todo, done))
    errors: list[BaseException | None] = []
    try:
        for calls in todo:
            for call in calls:
                call()
    except BaseException as error:
        errors.append(error)
    # An offer that no helper has taken yet is taken back; the others still work on the caller's arrays
    waited = len(errors)
    for offer in offers:
        waited += not offer.acquire(blocking=False)
    while len(errors) < waited:
        try:
            # In C from the queue into the list, so that Ctrl-C can't fall in between and one be waited for for ever
            errors.extend(starmap(done.get, repeat((), waited - len(errors))))
        except KeyboardInterrupt as error:
            errors.append(error)
            waited += 1
    try:
        for failure in errors:
            if failure is not None:
                raise failure
    finally:
        failure = None
        errors.clear()  # an error holds this frame, which would hold the error


@functools.cache
def _helpers() -> "SimpleQueue[_Offer]":
    """The queue from which the helpers of this process, as many as cores, take offers."""
    waiting = SimpleQueue[_Offer]()
    for i in range(cores()):
        threading.Thread(target=_help, args=(waiting,), name=f"palmfield-helper-{i}", daemon=True).start()
    return waiting


def _help(waiting: "SimpleQueue[_Offer]") -> None:
    while True:
        offer, todo, done = waiting.get()
        if not offer.acquire(blocking=False):
            continue
        error = _do_all(todo)
        done.put(error)
        del offer, todo, done, error  # else it would keep the last caller's arrays until the next call


def _do_all(todo: Iterator[Calls]) -> BaseException | None:
    """Do what is left; returns what it raised. A function of its own, so that none of the calls outlives it."""
    try:
        for calls in todo:
            for call in calls:
                call()
    except BaseException as error:
        return error
    return None


def _forget() -> None:
    pool.cache_clear()
    _helpers.cache_clear()


if hasattr(os, "register_at_fork"):
    # A child inherits pool and queue but none of the threads, and would wait for them for ever
    os.register_at_fork(after_in_child=_forget)
