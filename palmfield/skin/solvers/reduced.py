"""Skin problems by reduced models of wedges, exact in time, for loads that consist of few patterns.

A spot at rest is one pattern. The matrices of the mesh are projected on the Krylov space of the patterns
(palmfield.skin.reduction.krylov). This needs one factorisation and some tens of solves instead of a solve for every
step. Meshes and their errors are those of palmfield.skin.solvers.wedges.
"""

import itertools
import math
import time
from dataclasses import replace
from typing import cast

import numpy as np

from palmfield.blas import one_blas_thread
from palmfield.skin.approximation.load_scales import load_frequency, motion_width
from palmfield.skin.approximation.refine import Discretisation, MeshSolution, ratio_of, refine_until_converged, resized
from palmfield.skin.approximation.richardson import differences
from palmfield.skin.approximation.truncate_domain import trim_absorbing_rim
from palmfield.skin.costs import assembly_s, reduced_s
from palmfield.skin.fem.body import build
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.traction import bell, sampled
from palmfield.skin.problem import Body, Load, Motion, SkinProblem, Slab, Spot, Traction, between, normals_on_face
from palmfield.skin.projection import Projection
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.reduction.krylov import SAFETY, SHIFT, Krylov, TooManyVectorsError, grow_until, steady_change
from palmfield.skin.reduction.reduced_stepper import ReducedStepper
from palmfield.skin.solvers.wedges import first_sizes, last_dofs, on_mesh, refusal_wedges, slowest_wave
from palmfield.skin.stepper import SurfaceLoads
from palmfield.types import Float, Int

MOST_SHAPES = 8
"""Largest number of patterns of a load for a reduced model."""

MOST_VECTORS = 300
SHARE = 0.1
"""Largest share of the target accuracy for the error of the reduction."""

VECTORS = 33.0
"""Approximate number of vectors of a model."""

SAME_LENGTH = 1e-9
"""Largest difference of two step lengths that count as equal, over the duration of the run: round-off."""


def refusal_reduced(body: Body, load: Load) -> str | None:
    """Return the reason why this solver cannot solve a problem, in a sentence, or None."""
    if isinstance(load, Spot) and len(np.unique(load.centres(), axis=0)) > 1:
        return "a reduced model needs loads of constant shape, but this spot moves"
    if isinstance(load, Traction) and at_least(load) > MOST_SHAPES:
        return f"a reduced model needs pressures that are sums of at most {MOST_SHAPES} patterns"
    if isinstance(body, Slab) and body.shape == "infinite":
        return "a reduced model needs a finite body: give the slab a shape 'box' or 'disc'"
    return refusal_wedges(body, load)


def at_least(load: Traction) -> int:
    """Return the number of patterns of the pressure, at most MOST_SHAPES + 1, counted in random sums of the points."""
    mixture = np.random.default_rng(0).standard_normal((load.pressure_Pa.shape[1], MOST_SHAPES + 1))
    sizes = np.linalg.svd(load.pressure_Pa @ mixture, compute_uv=False)
    return int((sizes > 1e-6 * sizes.max(initial=0.0)).sum())


def patterns(load: Traction) -> tuple[Float, Float]:
    """Return the patterns of the pressure, (m, n), down to 1e-6 of the largest, and their shares over time, (f, m)."""
    left, sizes, right = np.linalg.svd(load.pressure_Pa, full_matrices=False)
    kept = sizes > 1e-6 * sizes.max(initial=0.0)
    return right[kept], left[:, kept] * sizes[kept]


def cost_reduced(problem: SkinProblem) -> float:
    """Return the predicted time [s] on one core, to a factor of a few."""
    dofs = last_dofs(problem)
    return 0.2 + 1.15 * (assembly_s(dofs) + reduced_s(dofs, len(problem.times) + len(problem.load.times_s), VECTORS))


def solve_reduced(problem: SkinProblem) -> Motion:
    """Return the displacement and velocity of the skin under a load of few patterns, from rest, on the CPU.

    Raises SceneError if refusal_reduced returns a reason, for an inverted element, points off the face, bad numbers.
    """
    begin = time.perf_counter()
    body, load, accuracy, judged = problem.body, problem.load, problem.accuracy, problem.judged
    problem.refuse("reduced", refusal_reduced)
    points = problem.points
    now = Discretisation(first_sizes(body, load, points, accuracy), math.inf, 1.0)
    models: list[tuple[int, Float]] = []

    def run(discretisation: Discretisation, factor: float = 1.0, reach: float = 1.0) -> MeshSolution:
        sizes = resized(discretisation.sizes, factor, reach)
        part = trim_absorbing_rim(body, load, points, reach)
        with one_blas_thread:
            solution, order, error = _run(
                part, load, problem.times, points, replace(discretisation, sizes=sizes), SHARE * accuracy, judged
            )
        models.append((order, error))
        return solution

    coarse = run(now, ratio_of(body, now.sizes))
    result = refine_until_converged(body, now, run, coarse, accuracy, False, judged, SHARE * accuracy)
    order, reduction = models[-1]
    return problem.solved(
        result.fine.displacement,
        result.fine.velocity,
        result.errors + reduction,
        f"{order} vectors {reduction[judged]:.2g}, {result.source}",
        f"reduced: wedges, {result.fine.dofs} unknowns, edges {1e3 * result.sizes.fine_m:.2f} mm, {order} vectors",
        begin,
    )


def _run(
    body: Body,
    load: Load,
    requested: Float,
    points: Float,
    discretisation: Discretisation,
    tolerance: float,
    judged: int,
) -> tuple[MeshSolution, int, Float]:
    """Return the solution on one mesh, its number of vectors, and its errors, from the changes by the last vectors."""
    system = build(body, discretisation.sizes)
    mesh = system.mesh
    if isinstance(load, Spot):
        quadrature = SurfaceQuadrature(mesh, system)
        shape_at = bell(quadrature.points, load.centres()[0], load.fwhm_m)
        shapes, weights = quadrature.assemble(shape_at)[:, None], load.peak_Pa[:, None]
    else:
        pressures, weights = patterns(load)
        shapes = np.asarray(sampled(mesh, system, load) @ pressures.T)
    read = SurfaceProbe(mesh, points, system).vectors
    clock, weights, rows = course(load, weights, requested)
    frequency = load_frequency(load, slowest_wave(body, 200.0), motion_width(body, load))
    shift = SHIFT * 2.0 * math.pi * frequency
    krylov = Krylov(DynamicStiffness(system, system.elimination_order()), shift, shapes)

    def motion() -> Float:
        """Return the displacement and velocity at the requested times, (2, t, n, 3)."""
        unit = np.eye(krylov.order)
        small = Projection(krylov.projected, krylov.dynamics.materials, krylov.vectors.T @ shapes, unit)
        stepper = ReducedStepper(small, krylov.vectors, np.eye(shapes.shape[1]), None, common_length(clock), 0.0, True)
        values = carried(stepper, read, clock, weights, load.law)[rows]
        begun = (requested >= clock[0])[:, None, None]
        return np.where(begun, values, 0.0).swapaxes(0, 1).reshape(2, len(requested), -1, 3)

    normals = normals_on_face(body, points)
    changes: list[Float] = []

    def change(now: Float, before: Float) -> float:
        changes.append(differences((before[0], before[1]), (now[0], now[1]), normals))
        return float(changes[-1][judged])

    try:
        moved, _ = grow_until(krylov, motion, change, tolerance, MOST_VECTORS)
    except TooManyVectorsError as limit:
        # The largest model still gives a result, with the error of its last vectors
        moved = cast(Float, limit.reached)
    return on_mesh(system, moved[0], moved[1], normals), krylov.order, SAFETY * steady_change(changes)


def course(load: Load, weights: Float, requested: Float) -> tuple[Float, Float, Int]:
    """Return times of load or output (c,), weights at these times (c, m), and the rows of the requested times (t,).

    weights: weights at the times of the load, (f, m); they are constant after the last
    """
    knots = load.times_s
    clock = np.unique(np.concatenate([knots, requested[requested > knots[0]]]))
    rows = np.minimum(np.searchsorted(clock, requested), len(clock) - 1)
    return clock, between(load, weights, clock), rows.astype(np.int32)


def common_length(clock: Float) -> float:
    """Return the most common difference of neighbouring times [s], to round-off; 1 for a single time."""
    if len(clock) < 2:
        return 1.0
    lengths = np.diff(clock)
    width = SAME_LENGTH * (clock[-1] - clock[0])
    _, first, counts = np.unique(np.round(lengths / width), return_index=True, return_counts=True)
    return float(lengths[first[np.argmax(counts)]])


def carried(stepper: ReducedStepper, read: Float, clock: Float, weights: Float, law: str) -> Float:
    """Return displacement [m] and velocity [m/s], from rest, at the times of the clock, shape (c, 2, m).

    weights: weights of the inputs at these times, (c, k), "linear" in between or "held" at the earlier value
    Consecutive steps of equal length are one call of the stepper.
    """
    reader = stepper.reader(read)
    motion = np.zeros((len(clock), 2, reader.count))
    state = np.zeros((1, stepper.state_size))
    unit = np.eye(weights.shape[1])[None]
    lengths = np.diff(clock)
    changes = np.flatnonzero(np.abs(np.diff(lengths)) > SAME_LENGTH * (clock[-1] - clock[0])) + 1
    ends = [0, *changes.tolist(), len(lengths)] if len(lengths) else []
    for begin, end in itertools.pairwise(ends):
        first, last = weights[begin:end], weights[begin:end] if law == "held" else weights[begin + 1 : end + 1]
        loads = SurfaceLoads(unit, first[None], last[None])
        moved = stepper.step(state, loads, clock[begin], clock[end], reader)
        assert moved is not None
        motion[begin + 1 : end + 1] = moved[0]
    return motion
