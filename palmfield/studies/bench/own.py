"""palmfield's own methods to compute a field, for the benchmark. Each line of METHODS is one method."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.acoustics.field import FieldEvaluator
from palmfield.studies.bench.problem import Method, Problem
from palmfield.types import Air, Complex, Float32

State = tuple[FieldEvaluator, Float32, Complex]


def evaluator(**options: Any) -> Callable[[Problem], State]:
    """Return a `prepare` function that makes a FieldEvaluator with these options."""

    def prepare(problem: Problem) -> State:
        air = Air(temperature_C=problem.temperature_C)
        field = FieldEvaluator(problem.array(), air, problem.device, absorption_Np_m=problem.absorption_Np_m, **options)
        return field, problem.points(), problem.drive

    return prepare


def pressure(state: State) -> NDArray[np.complex64]:
    field, points, drive = state
    return field.pressure(points, drive).pressure


def pressure_gradient(state: State) -> NDArray[np.complex64]:
    field, points, drive = state
    result = field.pressure(points, drive, gradient=True)
    assert result.gradient is not None
    return np.column_stack([result.pressure, result.gradient])


ALL_CORES = "palmfield, all cores"
"""Name of the method that does not run on a GPU."""
METHODS = [
    Method("palmfield", "piston", evaluator(threads=1), pressure),
    Method(ALL_CORES, "piston", evaluator(), pressure),
    Method("palmfield with gradient", "piston", evaluator(threads=1), pressure_gradient),
    Method("palmfield, accurate", "piston", evaluator(threads=1, mode="accurate"), pressure),
    Method("palmfield, accurate, with gradient", "piston", evaluator(threads=1, mode="accurate"), pressure_gradient),
    Method("palmfield, spheres", "sphere", evaluator(threads=1), pressure),
]
