"""Distribute blocks of a computation to threads. This is safe after a fork, and when several threads use it."""

import functools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat, starmap
from queue import SimpleQueue

Calls = Sequence[Callable[[], object]]
"""Calls of one block, in order."""

_Offer = tuple[threading.Lock, Iterator[Calls], "SimpleQueue[BaseException | None]"]
"""What helpers get: a lock that one helper acquires, the blocks not yet begun, and a queue for the helper's result."""


_most: list[int] = []


def cores() -> int:
    """Return the number of cores that this process may use: those of the system, or fewer if `limit` was called."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min([there, *_most])


def python_threads() -> int:
    """Return the number of threads for short calls. Between such calls, threads wait for the GIL.

    On 16 cores the harmonics of a disc took 0.6 of the time of one thread with 4 threads, and 0.7 with 8.
    """
    return min(cores(), 4)


def limit(count: int | None) -> None:
    """Use at most `count` cores (>= 1) from now on; None for all cores. Computations in progress do not change.

    This is for several processes that share a machine, because each would otherwise use all cores.
    """
    if count is not None and count < 1:
        raise ValueError(f"the limit is {count} cores; allowed: at least 1, or None")
    _most[:] = [] if count is None else [count]


@functools.cache
def pool() -> ThreadPoolExecutor:
    """Return the thread pool shared by all evaluators of this process."""
    return ThreadPoolExecutor(cores(), thread_name_prefix="palmfield-field")


def share(blocks: Sequence[Calls], threads: int) -> None:
    """Run all blocks, on this thread and on up to `threads` - 1 helpers. Return when all blocks are done.

    The overhead is 20 us, compared with 100 us of an executor, because this thread works too and the queues are in C.
    The threads share one iterator. So a slow core does fewer blocks, and a late helper does none. Raises the first
    error of a block after all helpers have stopped.
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
        tuple(todo)  # so that helpers begin no further block
    # Withdraw offers that no helper has taken; wait for the others, which use the caller's arrays
    waited = len(errors)
    for offer in offers:
        waited += not offer.acquire(blocking=False)
    while len(errors) < waited:
        try:
            # From the queue to the list in C, so that Ctrl-C cannot lose a result and cause an endless wait
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
        errors.clear()  # an error refers to this frame, which would refer to the error


@functools.cache
def _helpers() -> "SimpleQueue[_Offer]":
    """Return the queue of offers for the helpers of this process. There is one helper for each core."""
    waiting = SimpleQueue[_Offer]()
    for i in range(cores()):
        threading.Thread(target=_help, args=(waiting,), name=f"palmfield-helper-{i}", daemon=True).start()
    return waiting


def in_parts(count: int, size: int, work: Callable[[slice], object]) -> None:
    """Call `work` for slices of a range, on all cores. The slices do not depend on the number of cores."""
    share([(functools.partial(work, slice(at, min(at + size, count))),) for at in range(0, count, size)], cores())


def _help(waiting: "SimpleQueue[_Offer]") -> None:
    while True:
        offer, todo, done = waiting.get()
        if not offer.acquire(blocking=False):
            continue
        error = _do_all(todo)
        done.put(error)
        del offer, todo, done, error  # otherwise it would keep the arrays of the last caller alive until the next call


def _do_all(todo: Iterator[Calls]) -> BaseException | None:
    """Run the remaining blocks; return their error. As a separate function it keeps no references to calls."""
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
    # A child process inherits pool and queue without threads, and would wait for them for ever
    os.register_at_fork(after_in_child=_forget)
