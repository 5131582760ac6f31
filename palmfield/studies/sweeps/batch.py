"""Points that one process computes together, and how a design is cut into such batches."""

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
from palmfield.session.world_keys import axes_of
from palmfield.session.worlds import open_worlds
from palmfield.simulation.build import keep_model
from palmfield.simulation.build_worlds import Shared
from palmfield.studies.sweeps.groups import Keys
from palmfield.studies.sweeps.point import Numbers, measured
from palmfield.types import Float

MOST_IN_BATCH = 16
"""Points that are worlds of one simulation, at most: a killed worker costs as many."""
MOST_ON_GPU = 64
"""The same where fields are computed on a GPU, which more of them keep busy."""
BATCHES_PER_WORKER = 4
"""At least so many, where there are points enough, so that workers end at about the same time."""


@dataclass(frozen=True)
class Task:
    """What all points of a sweep have in common.

    scene: file, as the workers see it; device, accuracy: see `palmfield.session.open_scene.compiled`
    duration_s: of each run [s]; times: of courses [s], shape (t,); errors: whether errors are estimated
    threads: that a worker may use, None for what it uses anyway
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
    """A point without numbers. reason: the error, in a line"""

    reason: str


Results = Mapping[int, Numbers | Failed]
"""By the points' numbers in the design."""


class Batch(NamedTuple):
    """Points that share a model. worker: which of them it is meant for; points: their numbers in the design"""

    worker: int
    points: tuple[int, ...]


class Point(NamedTuple):
    """A point for the process that computes it.

    keys: all that differ from the scene's, as `palmfield.Simulation` takes them
    differing: those of them that worlds of one model may have each for itself
    """

    keys: Keys
    differing: Keys


def run_batch(task: Task, base: Keys, shared: Shared | None, points: Sequence[Point]) -> Sequence[Numbers | Failed]:
    """Numbers of points that share a model, as worlds of one simulation.

    Where one of them fails, they are computed one by one; a point that fails then leaves its error.
    base, shared: see `palmfield.studies.sweeps.groups.Group`
    """
    if task.threads is not None:
        threads.limit(task.threads)
    if shared is not None and len(points) > 1:
        # Which point failed, and why, is found by taking them one by one
        with suppress(Exception):
            return _measured(task, _worlds(task, base, shared, points))
    return [_run(task, base, shared, point) for point in points]


def _run(task: Task, base: Keys, shared: Shared | None, point: Point) -> Numbers | Failed:
    """Numbers of one point."""
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
        return Failed("there is not enough memory; give fewer workers, or a larger --accuracy")
    except Exception as error:
        # What fails here must not take the other points with it
        return Failed(f"{type(error).__name__}: {' '.join(str(error).split())}")


def _measured(task: Task, simulation: Simulation) -> list[Numbers]:
    numbers = measured(simulation, task.duration_s, task.times, task.errors)
    # Each model may hold factors of a gigabyte; the next points take the layer of the last ones, if any
    runtime = simulation.runtimes[0]
    keep_model(runtime.spec, runtime.model)
    return numbers


def _worlds(task: Task, base: Keys, shared: Shared, points: Sequence[Point]) -> Simulation:
    """Points as worlds of one simulation."""
    keys: dict[str, Sequence[Any]] = {}
    for full in points[0].differing:
        values = [point.differing[full] for point in points]
        vector = axes_of(StimulusConfig, full.rpartition(".")[2]) > 0
        keys[full] = [tuple(as_text(value).split()) for value in values] if vector else values
    worlds = open_worlds(
        task.scene, len(points), device=task.device, accuracy=task.accuracy, keys=keys, base=base, shared=shared
    )
    return Simulation.of_worlds(*worlds)


def batches(
    points: Iterable[int], model_keys: Mapping[int, Any], workers: int, most: int = MOST_IN_BATCH
) -> list[Batch]:
    """Cut points into batches that share a model, and share them out so that few workers make the same model.

    points: numbers of those that are to be computed; model_keys: of each, what it must share with others of its batch
    workers: how many there are, >= 1; most: points in a batch. Batches come in the order in which they should begin.
    """
    groups: dict[Any, list[int]] = defaultdict(list)
    for point in points:
        groups[model_keys[point]].append(point)
    shares: list[list[Batch]] = [[] for _ in range(workers)]
    loads = [0] * workers
    largest_first = sorted(groups.values(), key=len, reverse=True)
    total = sum(len(group) for group in largest_first)
    size = max(1, min(most, math.ceil(total / (workers * BATCHES_PER_WORKER))))
    fair = math.ceil(total / workers)
    for group in largest_first:
        # A group that is more than a worker's share is cut; any other one's model is made once
        pieces = max(1, math.ceil(len(group) / fair))
        length = math.ceil(len(group) / pieces)
        for start in range(0, len(group), length):
            piece = group[start : start + length]
            worker = loads.index(min(loads))
            loads[worker] += len(piece)
            parts = [tuple(piece[at : at + size]) for at in range(0, len(piece), size)]
            shares[worker] += [Batch(worker, part) for part in parts]
    most = max((len(share) for share in shares), default=0)
    return [share[turn] for turn in range(most) for share in shares if turn < len(share)]
