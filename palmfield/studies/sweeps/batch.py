"""Split the points of a sweep into batches, and compute a batch in one process."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from palmfield import threads
from palmfield.config import StimulusConfig
from palmfield.errors import PalmfieldError
from palmfield.session.open_scene import as_text
from palmfield.session.simulation import Simulation
from palmfield.session.worlds import axes_of, open_worlds
from palmfield.simulation.build import keep_model
from palmfield.simulation.build_worlds import Shared
from palmfield.studies.sweeps.groups import Keys
from palmfield.studies.sweeps.point import Numbers, measured
from palmfield.types import Float

MOST_IN_BATCH = 16
"""Largest number of points in a batch, which are worlds of one simulation. A killed worker loses its whole batch."""
MOST_ON_GPU = 64
"""Largest number of points in a batch for fields on a GPU. A GPU needs more worlds to be fully used."""
BATCHES_PER_WORKER = 4
"""Target number of batches for each worker. With several batches, workers end at about the same time."""


@dataclass(frozen=True)
class Task:
    """Settings that all points of a sweep share.

    scene: path of the scene on the workers; device, accuracy: see `palmfield.session.open_scene.compiled`
    duration_s: duration of each run [s]
    times: times of the time series [s], shape (t,)
    errors: whether errors are estimated
    threads: largest number of threads of a worker, None for no change
    """

    scene: Path
    device: str | None
    accuracy: float | None
    duration_s: float
    times: Float
    errors: bool
    threads: int | None = None


@dataclass(frozen=True)
class Failed:
    """A point without results. reason: the error, in one line"""

    reason: str


Results = Mapping[int, Numbers | Failed]
"""Results by the number of the point in the design."""


class Batch(NamedTuple):
    """Points that share a model. worker: number of the preferred worker; points: their numbers in the design"""

    worker: int
    points: tuple[int, ...]


class Point(NamedTuple):
    """A point in the form for the process that computes it.

    keys: all keys that differ from those of the scene, as for `palmfield.Simulation`
    differing: those of the keys that may differ between worlds of one model
    """

    keys: Keys
    differing: Keys


def run_batch(task: Task, base: Keys, shared: Shared | None, points: Sequence[Point]) -> Sequence[Numbers | Failed]:
    """Return the numbers of points that share a model, computed as worlds of one simulation.

    If one of them fails, they are computed one by one. A point that fails then returns its error.
    base, shared: see `palmfield.studies.sweeps.groups.Group`
    """
    if task.threads is not None:
        threads.limit(task.threads)
    if shared is not None and len(points) > 1:
        # After an error, points run one by one to find which one failed
        with suppress(Exception):
            return _measured(task, _worlds(task, base, shared, points))
    return [_run(task, base, shared, point) for point in points]


def _run(task: Task, base: Keys, shared: Shared | None, point: Point) -> Numbers | Failed:
    """Return the numbers of one point."""
    try:
        if shared is not None and shared.modal:
            (numbers,) = _measured(task, _worlds(task, base, shared, [point]))
        else:
            alone = Simulation(task.scene, device=task.device, accuracy=task.accuracy, keys=point.keys)
            (numbers,) = _measured(task, alone)
        return numbers
    except PalmfieldError as error:
        error.about = tuple(name for name in error.about if name != "world 0")
        return Failed(str(error))
    except MemoryError:
        return Failed("the memory is not sufficient; give fewer workers, or a larger --accuracy")
    except Exception as error:
        # A failure here must not affect the other points
        return Failed(f"{type(error).__name__}: {' '.join(str(error).split())}")


def _measured(task: Task, simulation: Simulation) -> list[Numbers]:
    numbers = measured(simulation, task.duration_s, task.times, task.errors)
    # Each model may hold factors of a gigabyte; the next points reuse the last layer, if there is one
    runtime = simulation.runtimes[0]
    keep_model(runtime.spec, runtime.model)
    return numbers


def _worlds(task: Task, base: Keys, shared: Shared, points: Sequence[Point]) -> Simulation:
    """Return the points as worlds of one simulation."""
    keys: dict[str, Sequence[Any]] = {}
    for full in points[0].differing:
        values = [point.differing[full] for point in points]
        vector = axes_of(StimulusConfig, full.rpartition(".")[2]) > 0
        keys[full] = [tuple(as_text(value).split()) for value in values] if vector else values
    name, worlds = open_worlds(
        task.scene, len(points), device=task.device, accuracy=task.accuracy, keys=keys, base=base, shared=shared
    )
    if shared.modal and task.threads is not None:
        # Other workers of the group wait for the same modes
        threads.limit(None)
        for begin in worlds.models[0].begin:
            begin.value  # noqa: B018
        threads.limit(task.threads)
    return Simulation.of_worlds(name, worlds)


def batches(
    points: Iterable[int], model_keys: Mapping[int, Any], workers: int, most: int = MOST_IN_BATCH
) -> list[Batch]:
    """Split points into batches that share a model, so that few workers make the same model.

    points: numbers of the points to compute
    model_keys: for each point, a value that must be equal for all points of a batch
    workers: number of workers, >= 1
    most: largest number of points in a batch
    Returns the batches in the order in which they should begin.
    """
    groups: dict[Any, list[int]] = defaultdict(list)
    for point in points:
        groups[model_keys[point]].append(point)
    shares: list[list[Batch]] = [[] for _ in range(workers)]
    loads = [0] * workers
    largest_first = sorted(groups.values(), key=len, reverse=True)
    total = sum(len(group) for group in largest_first)
    size = max(1, min(most, math.ceil(total / (workers * BATCHES_PER_WORKER))))
    even_share = math.ceil(total / workers)
    for group in largest_first:
        # Only a group larger than the share of one worker is split; for other groups the model is made once
        pieces = max(1, math.ceil(len(group) / even_share))
        length = math.ceil(len(group) / pieces)
        for start in range(0, len(group), length):
            piece = group[start : start + length]
            worker = loads.index(min(loads))
            loads[worker] += len(piece)
            parts = [tuple(piece[at : at + size]) for at in range(0, len(piece), size)]
            shares[worker] += [Batch(worker, part) for part in parts]
    most = max((len(share) for share in shares), default=0)
    return [share[turn] for turn in range(most) for share in shares if turn < len(share)]
