"""Skin problems by reduced models of implicit meshes: for loads that keep their shape, exact in time.

A spot at rest, or pressures that are sums of a few patterns, push with few shapes. The mesh's matrices are projected on
the Krylov space of those (palmfield.skin.reduction.krylov), which takes one factorisation and some tens of solves in
place of a solve for every step. Meshes and their errors are those of palmfield.skin.solvers.wedges.
"""

import math
import time
from dataclasses import replace

import numpy as np

from palmfield.errors import SceneError
from palmfield.skin.approximation.estimate import load_frequency, load_width
from palmfield.skin.approximation.refine import Answer, Numerics, ratio_of, resized, settle
from palmfield.skin.approximation.trim_absorbing_rim import extent
from palmfield.skin.blas import one_blas_thread
from palmfield.skin.fem.body import build
from palmfield.skin.fem.load import SurfaceQuadrature, bell, sampled
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.materials.material import shear_wave
from palmfield.skin.problem import Body, Load, Motion, Slab, Spot, Traction, points_on_face, rising
from palmfield.skin.reduction.dynamic_stiffness import Pencil
from palmfield.skin.reduction.krylov import Krylov
from palmfield.skin.reduction.reduced import Projection, Reduced
from palmfield.skin.reduction.stepping import ROUND, SAFETY, SHIFT
from palmfield.skin.solvers.wedges import GROWTH, expected_dofs, first_sizes, refusal_implicit, run_cost
from palmfield.types import Float, Int

MOST_SHAPES = 8
"""Patterns of a load above which its models are no longer small."""

MOST_VECTORS = 300
SHARE = 0.1
"""Part of the wanted accuracy that the reduction may take."""

VECTORS = 60.0
"""Vectors that a model takes, about."""


def refusal_reduced(body: Body, load: Load) -> str | None:
    """Why this solver can't, in a sentence, or None."""
    if isinstance(load, Spot) and len(np.unique(load.centres(), axis=0)) > 1:
        return "a reduced model is made for loads that keep their shape, and this spot moves"
    if isinstance(load, Traction) and at_least(load) > MOST_SHAPES:
        return f"a reduced model takes pressures that are sums of at most {MOST_SHAPES} patterns"
    if isinstance(body, Slab) and body.shape == "infinite":
        return "a reduced model needs a body with an end: give the slab a shape 'box' or 'disc'"
    return refusal_implicit(body, load)


def at_least(load: Traction) -> int:
    """How many patterns the pressure has, counted up to MOST_SHAPES + 1 in a random mixture of the points."""
    mixture = np.random.default_rng(0).standard_normal((load.pressure_Pa.shape[1], MOST_SHAPES + 1))
    sizes = np.linalg.svd(load.pressure_Pa @ mixture, compute_uv=False)
    return int((sizes > 1e-6 * sizes.max(initial=0.0)).sum())


def patterns(load: Traction) -> tuple[Float, Float]:
    """Patterns (m, n) of the pressure, and their shares over the load's times (f, m), up to 1e-6 of the largest."""
    left, sizes, right = np.linalg.svd(load.pressure_Pa, full_matrices=False)
    kept = sizes > 1e-6 * sizes.max(initial=0.0)
    return right[kept], left[:, kept] * sizes[kept]


def cost_reduced(body: Body, load: Load, times: Float, at: Float, accuracy: float) -> float:
    """Predicted time [s] on one core, to a factor of a few."""
    first = expected_dofs(body, first_sizes(body, load, np.asarray(at, dtype=float), accuracy))
    grown = max(1.0, GROWTH * 0.05 / accuracy) if isinstance(body, Slab) else 1.0
    return 1.8 * run_cost(grown * first, VECTORS)


def solve_reduced(
    body: Body, load: Load, times: Float, at: Float, *, accuracy: float = 0.05, device: str = "cpu"
) -> Motion:
    """Displacement and velocity of the skin under a load that keeps its shape, from rest.

    times: [s], rising, shape (t,); at: points of the face [m], shape (n, 3) or (n, 2)
    accuracy: wanted relative error, L2 over the times, largest over the points; device: it runs on the CPU
    Raises SceneError for what refusal_reduced names, an inverted element, points off the face, and bad numbers.
    """
    begin = time.perf_counter()
    reason = refusal_reduced(body, load)
    if reason is not None:
        raise SceneError(f"solver 'reduced': {reason}")
    asked, points = rising("times", times), points_on_face(body, at)
    now = Numerics(first_sizes(body, load, points, accuracy), math.inf, 1.0, device)
    models: list[tuple[int, float]] = []

    def run(numerics: Numerics, factor: float = 1.0, reach: float = 1.0) -> Answer:
        sizes = resized(numerics.sizes, factor, reach)
        part = extent(body, load, points, reach)
        with one_blas_thread:
            answer, order, error = _run(part, load, asked, points, replace(numerics, sizes=sizes), SHARE * accuracy)
        models.append((order, error))
        return answer

    found = settle(body, now, run, run(now, ratio_of(body, now.sizes)), accuracy, pinned=False)
    order, reduction = models[-1]
    return Motion(
        times_s=asked,
        points=points,
        displacement_m=found.fine.displacement,
        velocity_m_s=found.fine.velocity,
        error=found.error + reduction,
        error_source=f"{order} vectors {reduction:.2g}, {found.source}",
        solver=f"reduced: quadratic wedges, {found.fine.dofs} unknowns, edges {1e3 * found.sizes.fine_m:.2f} mm, "
        f"{order} vectors",
        seconds=time.perf_counter() - begin,
    )


def _run(
    body: Body, load: Load, asked: Float, points: Float, numerics: Numerics, tolerance: float
) -> tuple[Answer, int, float]:
    """The answer on one mesh, the vectors it took, and what the last of them changed."""
    system = build(body, numerics.sizes)
    mesh = system.mesh
    if isinstance(load, Spot):
        quadrature = SurfaceQuadrature(mesh, system)
        shape_at = bell(quadrature.points, load.centres()[0], load.fwhm_m)
        shapes, shares = quadrature.assemble(shape_at)[:, None], load.peak_Pa[:, None]
    else:
        pressures, shares = patterns(load)
        shapes = sampled(mesh, system, load) @ pressures.T
    read = SurfaceProbe(mesh, points, system).vectors
    clock, forces, rows = course(load, shares, asked)

    speed = min(shear_wave(sheet.material, 200.0)[0] for sheet in body.sheets)
    shift = SHIFT * 2.0 * math.pi * load_frequency(load, speed, load_width(load))
    krylov = Krylov(Pencil(system, system.elimination_order()), shift, np.asarray(shapes, dtype=float))

    def motion() -> tuple[Float, Float]:
        small = Projection(krylov.projected, krylov.pencil.materials, krylov.vectors.T @ shapes, read @ krylov.vectors)
        moved, speeds = Reduced(small, 0.0).run(forces, clock, load.law)
        begun = asked[:, None] >= clock[0]
        return np.where(begun, moved[rows], 0.0), np.where(begun, speeds[rows], 0.0)

    before, error = motion(), math.inf
    while error > tolerance:
        target = krylov.order + max(ROUND, krylov.order // 6)
        growing = 1
        while growing and krylov.order < target:
            growing = krylov.grow()
        now = motion()
        size, gap = (np.linalg.norm(x.reshape(len(asked), -1, 3), axis=(0, 2)) for x in (now[0], now[0] - before[0]))
        moving = size > 1e-9 * size.max(initial=0.0)
        error = SAFETY * float((gap[moving] / size[moving]).max(initial=0.0))
        before = now
        if not growing:
            break
        if error > tolerance and krylov.order > MOST_VECTORS:
            raise SceneError(
                f"solver 'reduced': error {error:.2g} with {krylov.order} vectors, {tolerance:.2g} wanted; use implicit"
            )
    shape = (len(asked), len(points), 3)
    triangles, levels = len(mesh.surface_triangles6), (mesh.levels - 1) // 2
    answer = Answer(before[0].reshape(shape), before[1].reshape(shape), system.ndof, triangles, levels)
    return answer, krylov.order, error


def course(load: Load, shares: Float, asked: Float) -> tuple[Float, Float, Int]:
    """Times at which force or answer is wanted (c,), the shares there (c, m), and the rows of the asked times (t,).

    shares: at the load's times, (f, m); they stay after the last
    """
    knots = load.times_s
    clock = np.unique(np.concatenate([knots, asked[asked > knots[0]]]))
    if load.law == "held":
        forces = shares[np.searchsorted(knots, clock, side="right") - 1]
    else:
        forces = np.stack([np.interp(clock, knots, column) for column in shares.T], axis=1)
    return clock, forces, np.minimum(np.searchsorted(clock, asked), len(clock) - 1).astype(np.int32)
