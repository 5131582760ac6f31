"""Run a whole sweep: points, batches of workers and their death, and continuation after an interruption."""

import json
import logging
import platform
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.progress import MofNCompleteColumn

from palmfield.errors import OutputError, PalmfieldError, SceneError
from palmfield.session.recorded_run import CONVENTIONS
from palmfield.studies.sweeps.batch import (
    MOST_IN_BATCH,
    MOST_ON_GPU,
    Batch,
    Failed,
    Point,
    Results,
    Task,
    batches,
    run_batch,
)
from palmfield.studies.sweeps.cluster import Slot, gpu_memory_bytes, local_cluster, remote_cluster, slots, visible_gpus
from palmfield.studies.sweeps.design import Design, Value, grid
from palmfield.studies.sweeps.groups import Group, groups_of, in_words
from palmfield.studies.sweeps.keys import SceneKeys, scene_keys
from palmfield.studies.sweeps.overview import Overview, overview
from palmfield.studies.sweeps.picture import plot_sweep
from palmfield.studies.sweeps.store import DONE, FAILED, SweepStore, open_dataset, size_bytes
from palmfield.terminal import bars
from palmfield.threads import cores

LOG = logging.getLogger("palmfield.studies")
LARGE_BYTES = 2e9
LONG_S = 3600.0
"""Predicted duration above which a sweep needs confirmation [s]."""
SURE_BATCHES = 2
"""Number of batches of each worker after which the remaining time is predicted. The first batch builds the model."""
SURE_S = 120.0
"""Time after which the remaining time is predicted in any case, if at least one point is done [s]."""
MOST_PER_GPU = 8
"""Largest number of workers that share a GPU. While it computes for one, the others prepare tasks in Python."""
PICTURE = "sweep.png"
EXTRA = ("dask", "distributed", "zarr")
Ask = Callable[[str], bool]


@dataclass(frozen=True)
class Sweep:
    """Result of a sweep.

    out: folder of the sweep
    files: paths of its files by name
    points, done: number of all points, and of completed points
    failed: reasons why points failed, by number in the design
    """

    out: Path
    files: dict[str, Path]
    points: int
    done: int
    failed: dict[int, str]
    _opened: list[xr.Dataset] = field(default_factory=list, repr=False)

    @property
    def dataset(self) -> xr.Dataset:
        """Numbers of all points. The dataset is opened at the first use and read lazily."""
        if not self._opened:
            self._opened.append(open_dataset(self.files["sweep.zarr"]))
        return self._opened[0]


def sweep(
    scene: str | Path,
    design: Design | Mapping[str, Sequence[Any] | np.ndarray],
    out: str | Path,
    *,
    keys: Mapping[str, Value | None] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    device: str | None = None,
    accuracy: float | None = None,
    duration_s: float | None = None,
    errors: bool = False,
    picture: bool = True,
    progress: bool = False,
    yes: bool = False,
    ask: Ask | None = None,
) -> Sweep:
    """Simulate a scene at all points of a design and write one labelled dataset, out/sweep.zarr, and a picture.

    palmfield.sweep("palm.xml", {"stimulus.am_frequency_Hz": [50, 100, 200]}, "out/frequencies")

    scene: a file
    design: values by key, of which every combination is a point; or a result of `grid`, `listed`, `random` or `sobol`
        of `palmfield.studies.sweeps`. Keys are INSTANCE.KEY or PLUGIN.KEY, or one number of a vector, such as
        "stimulus.focus_m[0]"
    keys: values that all points share; None removes a key from the scene
    out: folder, created if missing; an interrupted sweep in it continues, and failed points are computed again
    workers: number of processes on this machine; by default as many as cores and memory allow, at most 8 for each GPU;
        0 computes in this process, without Dask
    scheduler: address of a running Dask cluster, instead of workers; its workers must be able to read the scene
    device, accuracy: see `palmfield.load`
    duration_s: duration of each point [s], by default that of the scene
    errors: whether the error of each point is estimated, which takes longer than most runs
    picture: whether a picture is drawn; progress: whether a progress bar is shown on the standard error of a terminal
    yes: whether a sweep of more than 2 GB or an hour needs no confirmation; otherwise `ask` is called with a question
    After Ctrl-C, a full disk or loss of workers the results so far are kept, and the same call continues. A failed
    point is recorded.
    Raises SceneError for invalid keys and values before anything runs; PalmfieldError for a cluster that cannot be
    reached; OutputError for a folder that cannot be written or contains another sweep, and if `ask` returns false.
    """
    design = design if isinstance(design, Design) else grid(design)
    _check_arguments(scene, workers, scheduler)
    if scheduler is not None:
        with remote_cluster(scheduler):
            pass  # check before files are created
    path, out = Path(scene).resolve(), Path(out)
    checked = scene_keys(scene, design, keys or {})
    view = overview(path, design, checked, device=device, accuracy=accuracy, duration_s=duration_s)
    gpus = visible_gpus() if view.device.startswith("cuda") and workers != 0 and scheduler is None else []
    groups = groups_of(path, design, checked, device, accuracy)
    most = MOST_ON_GPU if view.device.startswith("cuda") else MOST_IN_BATCH
    memory = _memory_bytes(view, groups, most)
    count = _worker_count(workers, gpus, design.count, memory, gpu_memory_bytes() if gpus else 0)
    size = size_bytes(design, view.labels, errors)
    summary = _in_words(view, design, size, memory, None if scheduler else count)
    LOG.info("%s", summary)
    stepped = in_words(groups)
    if stepped:
        LOG.info("%s", stepped)
    if size > LARGE_BYTES:
        _confirm(f"{size / 1e9:.1f} GB may be written to {out}", yes, ask)
    store = SweepStore(out, design, view.labels, _attributes(view, design, checked, accuracy, errors, stepped), errors)
    missing = [int(number) for number in np.flatnonzero(store.status.ravel() != DONE)]
    if len(missing) < design.count:
        LOG.info("continuing: %d points are done", design.count - len(missing))
    # In a worker its only GPU has number 0
    where = "cuda:0" if gpus else device
    task = Task(path, where, accuracy, view.duration_s, view.times, errors)
    points = _Points(missing, groups, design, checked, most)
    if missing:
        # An old picture of fewer points would be wrong
        (out / PICTURE).unlink(missing_ok=True)
        if scheduler is not None:
            results = _on_cluster(lambda: remote_cluster(scheduler), task, points)
        elif count:
            results = _on_cluster(lambda: local_cluster(count, gpus), task, points)
        else:
            results = _here(task, points)
        with closing(results):
            _collect(results, store, len(missing), max(count, 1), progress, yes, ask)
    files = {"sweep.zarr": store.path}
    if picture:
        try:
            plot_sweep(open_dataset(store.path), out / PICTURE)
            files[PICTURE] = out / PICTURE
        except OutputError as error:
            LOG.warning("no %s: %s", PICTURE, error)
    failed = {int(number): store.failure(int(number)) for number in np.flatnonzero(store.status.ravel() == FAILED)}
    return Sweep(out, files, design.count, store.done, failed)


def _check_arguments(scene: str | Path, workers: int | None, scheduler: str | None) -> None:
    missing = [name for name in EXTRA if find_spec(name) is None]
    if missing:
        raise PalmfieldError(f"sweeps need {', '.join(missing)}; install the extra: pip install 'palmfield[sweep]'")
    if not isinstance(scene, str | Path):
        raise SceneError(f"scene is {scene!r}; allowed: the path of a file, which the workers read")
    if workers is not None and scheduler is not None:
        raise PalmfieldError("--workers starts workers here and --scheduler uses others; give one of them")
    if workers is not None and workers < 0:
        raise PalmfieldError(f"--workers has value {workers}; allowed: 0 (in this process) or more")


def _worker_count(workers: int | None, gpus: list[str], points: int, memory: int, on_gpu: int) -> int:
    """Return the number of processes: the requested number, or else as many as cores, memory and GPUs allow.

    memory: estimated memory of a worker, on host and GPU [bytes]
    on_gpu: free memory of each GPU [bytes]
    """
    if workers is not None:
        return workers
    import psutil

    room = int(0.8 * psutil.virtual_memory().available // memory)
    most = min(cores(), points, room)
    if gpus:
        share = min(MOST_PER_GPU, max(1, int(0.8 * on_gpu // memory)))
        return max(min(len(gpus), points), min(share * len(gpus), most))
    return max(1, most)


def _memory_bytes(view: Overview, groups: Sequence[Group], most: int) -> int:
    """Estimate the memory of a worker with up to `most` points at once."""
    worlds = max((min(most, len(group.points)) for group in groups if group.shared is not None), default=1)
    return view.memory_bytes + (worlds - 1) * view.point_bytes + max(group.modes_bytes for group in groups)


def _in_words(view: Overview, design: Design, size: int, memory_bytes: int, workers: int | None) -> str:
    """Describe a sweep in words before it begins."""
    counts = " x ".join(str(length) for length in design.shape)
    several = f" ({counts})" if len(design.shape) > 1 else ""
    memory = f"{memory_bytes / 1e9:.1f} GB of memory"
    who = {0: "this process", 1: "one worker", None: "each worker"}.get(workers, f"each of {workers} workers")
    return (
        f"{view.name}: {design.count} points{several} of {view.duration_s:g} s over {', '.join(design.keys)}; about "
        f"{memory} in {who}, at most {_bytes(size)} on disk"
    )


def _bytes(size: int) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{max(size / 1e6, 0.1):.1f} MB"


def _confirm(what: str, yes: bool, ask: Ask | None) -> None:
    """Raise OutputError if a very large sweep is not confirmed."""
    if yes or (ask is not None and ask(f"{what}. Go on?")):
        return
    raise OutputError(f"{what}: not confirmed; give --yes (yes=True), or fewer points")


def _attributes(
    view: Overview, design: Design, keys: SceneKeys, accuracy: float | None, errors: bool, stepped: str
) -> dict[str, Any]:
    packages = ("palmfield", "warp-lang", "mujoco", "numpy", "scipy", "xarray", "zarr", "dask")
    return {
        "title": "palmfield: a sweep over keys of a scene",
        "scene": view.name,
        "keys": json.dumps(keys.fixed, sort_keys=True),
        "solver": stepped or "each point uses the layer and the solver of a separate run",
        "conventions": json.dumps(CONVENTIONS),
        "versions": json.dumps({name: version(name) for name in packages} | {"python": platform.python_version()}),
        # A sweep continues only if these settings are equal
        "identity": {
            "design": design.as_json(),
            "scene (its file or one that it names)": view.scene_digest,
            "keys that all points share": keys.fixed,
            "duration": view.duration_s,
            "accuracy": accuracy,
            "errors": errors,
            "time axis": [len(view.times), float(view.times[-1])],
            "palmfield": version("palmfield"),
        },
    }


# -- computing -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Points:
    """Numbers of the missing points of a sweep, with the group and the keys of each.

    most: largest number of points in a batch
    """

    missing: Sequence[int]
    groups: Sequence[Group]
    design: Design
    keys: SceneKeys
    most: int

    @cached_property
    def _group_of(self) -> dict[int, int]:
        return {number: place for place, group in enumerate(self.groups) for number in group.points}

    def batches(self, workers: int) -> list[Batch]:
        """Return batches of points, see `palmfield.studies.sweeps.batch.batches`."""
        return batches(self.missing, self._group_of, workers, self.most)

    def group(self, number: int) -> Group:
        return self.groups[self._group_of[number]]

    def point(self, number: int) -> Point:
        values = self.design.point(number)
        return Point(self.keys.of_point(values), self.keys.differing(values))


def _here(task: Task, points: _Points) -> Generator[Results]:
    """Compute all points in this process, batch by batch."""
    for batch in points.batches(1):
        group = points.group(batch.points[0])
        results = run_batch(task, group.base, group.shared, [points.point(number) for number in batch.points])
        yield dict(zip(batch.points, results, strict=True))


def _on_cluster(connect: Callable[[], Any], task: Task, points: _Points) -> Generator[Results]:
    """Compute all points on Dask workers, and yield results of each completed batch."""
    with connect() as client:
        there = slots(client, task.scene)
        yield from computed(client, task, there, points.batches(len(there)), points.group, points.point)


def _collect(
    results: Generator[Results],
    store: SweepStore,
    points: int,
    workers: int,
    progress: bool,
    yes: bool,
    ask: Ask | None,
) -> None:
    """Write results as they arrive, and show progress. If the remaining time is long, ask once for confirmation."""
    done, failed, written, confirmed, started = 0, 0, 0, yes, time.monotonic()
    with bars(progress, MofNCompleteColumn()) as bar:
        row = bar.add_task("starting workers", total=points)
        for some in results:
            store.write(some)
            done, written = done + len(some), written + 1
            failed += sum(isinstance(result, Failed) for result in some.values())
            bar.update(row, completed=done, description=f"{failed} failed" if failed else "computing")
            spent = time.monotonic() - started
            remaining_s = spent / done * (points - done)
            if not confirmed and remaining_s > LONG_S and (written >= SURE_BATCHES * workers or spent > SURE_S):
                bar.stop()
                _confirm(f"{points - done} of {points} points are left, about {remaining_s / 3600:.1f} h", yes, ask)
                confirmed = True
                bar.start()


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
