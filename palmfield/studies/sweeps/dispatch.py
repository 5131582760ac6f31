"""Assign batches to workers, and handle the death of a worker."""

from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any

from palmfield.errors import PalmfieldError
from palmfield.studies.sweeps.batch import Batch, Failed, Point, Results, Task, run_batch
from palmfield.studies.sweeps.cluster import Slot
from palmfield.studies.sweeps.groups import Group


def computed(
    client: Any,
    task: Task,
    there: Sequence[Slot],
    todo: Sequence[Batch],
    group: Callable[[int], Group],
    point: Callable[[int], Point],
) -> Generator[Results]:
    """Yield results of all batches as Dask workers return them; each worker has one batch at a time.

    there: threads of the workers
    todo: see `palmfield.studies.sweeps.batch.batches`
    group, point: functions of the number of a point; all points of a batch are in one group
    If a worker dies, the points of its batch are computed again at the end. Each then runs alone on a worker. So a
    point fails only if it kills its worker by itself.
    Raises PalmfieldError if the scheduler is lost.
    """
    from distributed import KilledWorker, as_completed

    slots = list(there)
    queues = [deque(batch for batch in todo if batch.worker == number) for number in range(len(slots))]
    suspects: deque[int] = deque()
    under_way: dict[str, tuple[Any, tuple[int, ...], int]] = {}
    coming = as_completed(loop=client.loop)

    def submit(points: tuple[int, ...], slot: int) -> None:
        slots[slot] = _present(client, slots, slot)
        future = client.submit(
            run_batch, replace(task, threads=slots[slot].threads), group(points[0]).base, group(points[0]).shared,
            [point(number) for number in points],
            workers=[slots[slot].address], allow_other_workers=True, pure=False,
        )  # fmt: skip
        under_way[future.key] = future, points, slot
        coming.add(future)

    def begin(slot: int) -> None:
        """Submit the next batch of a thread. If its queue is empty, submit the last batch of the longest queue."""
        longest = max(queues, key=len)
        if queues[slot]:
            submit(queues[slot].popleft().points, slot)
        elif longest:
            submit(longest.pop().points, slot)
        elif suspects and not under_way:
            submit((suspects.popleft(),), slot)

    for slot in range(len(slots)):
        begin(slot)
    alone = False
    for future in coming:
        _, points, slot = under_way.pop(future.key)
        results: Results = {}
        if future.status == "finished":
            results = dict(zip(points, future.result(), strict=True))
        elif future.status == "error":
            error = future.exception()
            if isinstance(error, KilledWorker) and not alone:
                suspects.extend(points)
            else:
                results = dict.fromkeys(points, _failure(error))
        else:
            raise PalmfieldError(
                f"the connection to the scheduler is lost, with at least {len(points)} points in progress; repeat "
                "the command to continue"
            )
        future.release()
        # The worker gets its next batch before the results are written, so that it does not wait
        alone = not under_way and not any(queues)
        begin(slot)
        if results:
            yield results


def _present(client: Any, slots: Sequence[Slot], slot: int) -> Slot:
    """Return a thread. If its worker is lost, return a thread of the worker that replaces it."""
    own = slots[slot]
    present = client.nthreads()
    used = {other.address for other in slots}
    if own.address in present:
        return own
    return own._replace(address=next((address for address in present if address not in used), own.address))


def _failure(error: BaseException) -> Failed:
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return Failed("its worker was killed, also when it ran no other point; check the memory")
    return Failed(f"{type(error).__name__}: {' '.join(str(error).split())}")
