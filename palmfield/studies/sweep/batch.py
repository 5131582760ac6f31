"""Points that one process computes together, and how a design is cut into such batches."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from palmfield import threads
from palmfield.errors import PalmfieldError
from palmfield.session.simulation import Simulation
from palmfield.simulation.build import keep_model
from palmfield.studies.sweep.design import Value
from palmfield.studies.sweep.point import Numbers, measured
from palmfield.types import Float

MOST_IN_BATCH = 8
"""Points that a killed worker may cost."""
BATCHES_PER_WORKER = 4
"""At least so many, where there are points enough, so that workers end at about the same time."""


@dataclass(frozen=True)
class Task:
    """What all points of a sweep have in common.

    scene: file, as the workers see it; device, accuracy: see `palmfield.session.load.compiled`
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


def run_batch(task: Task, points: Sequence[Mapping[str, Value | None]]) -> list[Numbers | Failed]:
    """Numbers of points that share a model, one after another; a point that fails leaves its error.

    points: keys of each, as `palmfield.Simulation` takes them
    """
    if task.threads is not None:
        threads.limit(task.threads)
    return [_run(task, keys) for keys in points]


def _run(task: Task, keys: Mapping[str, Value | None]) -> Numbers | Failed:
    try:
        simulation = Simulation(task.scene, device=task.device, accuracy=task.accuracy, keys=keys)
        numbers = measured(simulation, task.duration_s, task.times, task.errors)
        # Each model may hold factors of a gigabyte; the next point takes the layer of the last one, if any
        keep_model(simulation.runtime.model)
        return numbers
    except PalmfieldError as error:
        return Failed(str(error))
    except MemoryError:
        return Failed("there is not enough memory; give fewer workers, or a larger --accuracy")
    except Exception as error:
        # What fails here must not take the other points with it
        return Failed(f"{type(error).__name__}: {' '.join(str(error).split())}")


def batches(points: Iterable[int], model_keys: Mapping[int, Any], workers: int) -> list[Batch]:
    """Cut points into batches that share a model, and share them out so that few workers make the same model.

    points: numbers of those that are to be computed; model_keys: of each, what it must share with others of its batch
    workers: how many there are, >= 1. Batches come in the order in which they should begin.
    """
    groups: dict[Any, list[int]] = defaultdict(list)
    for point in points:
        groups[model_keys[point]].append(point)
    shares: list[list[Batch]] = [[] for _ in range(workers)]
    loads = [0] * workers
    largest_first = sorted(groups.values(), key=len, reverse=True)
    total = sum(len(group) for group in largest_first)
    size = max(1, min(MOST_IN_BATCH, math.ceil(total / (workers * BATCHES_PER_WORKER))))
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
