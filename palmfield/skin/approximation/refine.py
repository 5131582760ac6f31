"""Resolution for a solution by wedges, and its error against the converged solution, from coarser runs.

Errors are proportional to a power of the size of steps and elements, so two runs give the error (Richardson).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from palmfield.skin.approximation.richardson import differences, error_of_coarser, error_of_finer
from palmfield.skin.mesh.body_mesh import Sizes, graded_fractions
from palmfield.skin.mesh.wedges import element_rows
from palmfield.skin.problem import Body, Layer, Slab, depth_of
from palmfield.types import Float

RATIO = 4.0 / 3.0
"""Element size of the coarser mesh over that of the finer mesh; for a layer, whose triangles are quartered, it is 2."""
MESH_ORDER = 1.5
"""Assumed order of convergence. In the middle of a spot on a disc the order is 2.5 to 4. It is less under spots that
reach the sides, and with few triangles under them in nearly incompressible sheets: with order 2, the estimate was too
small in 4 of 19 round cases of a coverage run, by up to half of the error."""
FINEST_RATIO = 2.0
"""Largest ratio of the element sizes of one mesh and the next finer one."""
LEAST_MORE = 1.1
"""Least ratio of the edges of two meshes for which Richardson's rule is used."""
ALIKE = 1.3
"""Least ratio of the numbers of triangles of two meshes whose difference measures the error. With 43 and 41 triangles
on a small disc, the difference gave a fifth of the error."""
MOST_ORDER = 3.0
"""Highest order of convergence of quadratic elements: from one mesh to the next an error falls by no more. So a
difference that is small by chance does not count. Edges of 8, 6, 4.5 and 3.4 mm had errors of 0.5, 8.3, 7.7 and 4.0 %
on a sheet of 1.3 mm that is softer than the next."""
SHRINK = 0.7
"""Extent of the smaller of two domains of an infinite slab, over that of the larger."""
WIDER = 2.0
"""Difference between the two domains over the error of the larger. Measured values are 3 to 5 (palm preset, 12 mm, at
200 Hz, under a spot and 20 mm away, on fine meshes); 2 is used for safety."""
BELT = 1.0
"""Error of absorbing sides over the difference from a layer without a belt along its rim, see trim_absorbing_rim."""
UNKNOWN = 1.0
"""Value of an unknown error: absorbing sides without room to remove a belt, or two identical meshes."""
MOST_DOFS = 400_000
"""Largest number of unknowns; above it the factors of the matrix take more than 10 GB."""
ROUNDS = 3


@dataclass(frozen=True)
class Discretisation:
    """Sizes of the mesh, time step [s], and spectral radius at infinite frequency."""

    sizes: Sizes
    step_s: float
    rho_inf: float


@dataclass(frozen=True)
class MeshSolution:
    """Displacement [m] and velocity [m/s] at the requested times and points, (t, n, 3), and sizes of the mesh.

    normals: normals of the face at the points, (n, 3)
    """

    displacement: Float
    velocity: Float
    dofs: int
    triangles: int
    rows: int
    normals: Float


@dataclass(frozen=True)
class ConvergedSolution:
    """The finest solution, its sizes, and its errors due to meshes, rows in depth and extent, (3,) each.

    judged: index in QUANTITIES of the quantity whose error had to reach the target
    """

    fine: MeshSolution
    sizes: Sizes
    mesh_error: Float
    rows_error: Float
    reach_error: Float
    judged: int

    @property
    def errors(self) -> Float:
        return self.mesh_error + self.rows_error + self.reach_error

    @property
    def source(self) -> str:
        return (
            f"two meshes {self.mesh_error[self.judged]:.2g}, more rows {self.rows_error[self.judged]:.2g}, two extents "
            f"{self.reach_error[self.judged]:.2g}, added"
        )


Run = Callable[..., MeshSolution]
"""(discretisation, element factor, extent factor) -> MeshSolution"""


def refine_until_converged(
    body: Body,
    now: Discretisation,
    run: Run,
    coarse: MeshSolution,
    accuracy: float,
    pinned: bool,
    judged: int = 0,
    taken: float = 0.0,
) -> ConvergedSolution:
    """Widen absorbing bodies, add rows in depth and refine, each at most ROUNDS times, until the errors are small.

    coarse: solution on a mesh one step coarser than `now`; pinned: only estimate the errors, without changes
    taken: share of the accuracy for errors that are not estimated here
    judged: index in QUANTITIES of the quantity whose error must reach the accuracy
    """
    reach_error = np.zeros(3)
    if isinstance(body, Slab) and (body.shape == "infinite" or body.side == "absorbing"):
        reach_error = difference(coarse, run(now, ratio_of(body, now.sizes), SHRINK)) / WIDER
        for _ in range(ROUNDS):
            if pinned or reach_error[judged] <= 0.3 * accuracy:
                break
            now = replace(now, sizes=resized(now.sizes, 1.0, 1.0 / SHRINK))
            wider = run(now, ratio_of(body, now.sizes))
            reach_error, coarse = difference(wider, coarse) / WIDER, wider
    elif isinstance(body, Layer) and body.side == "absorbing":
        smaller = run(now, ratio_of(body, now.sizes), SHRINK)
        # Equal numbers of triangles: no outer ring was removed
        removed = smaller.triangles < coarse.triangles
        reach_error = BELT * difference(coarse, smaller) if removed else np.full(3, UNKNOWN)
    now, coarse, rows_error = refine_in_depth(body, now, run, coarse, accuracy, pinned, judged)
    fine = run(now)
    for _ in range(ROUNDS):
        # Small bodies have equal or nearly equal meshes for many sizes
        if pinned or fine.triangles >= ALIKE * coarse.triangles:
            break
        now = replace(now, sizes=resized(now.sizes, 1.0 / ratio_of(body, now.sizes), 1.0))
        fine = run(now)
    mesh_error = error_by_meshes(coarse, fine)
    left = max(accuracy - taken - float(rows_error[judged] + reach_error[judged]), 0.2 * accuracy)
    for _ in range(ROUNDS):
        room = min(FINEST_RATIO, (MOST_DOFS / fine.dofs) ** (1.0 / 3.0))
        # Rounded, so that rounding errors of the load do not change the mesh
        ratio = max(
            ratio_of(body, now.sizes), round(min((float(mesh_error[judged]) / (0.8 * left)) ** (1.0 / 3.0), room), 2)
        )
        if pinned or mesh_error[judged] <= left or fine.dofs * ratio**3 > MOST_DOFS:
            break
        now, coarse = replace(now, sizes=resized(now.sizes, 1.0 / ratio, 1.0)), fine
        fine = run(now)
        finer = max(math.sqrt(fine.triangles / coarse.triangles), 1.0)
        mesh_error = np.maximum(error_by_meshes(coarse, fine), mesh_error / finer**MOST_ORDER)
    return ConvergedSolution(fine, now.sizes, mesh_error, rows_error, reach_error, judged)


def refine_in_depth(
    body: Body, now: Discretisation, run: Run, coarse: MeshSolution, accuracy: float, pinned: bool, judged: int = 0
) -> tuple[Discretisation, MeshSolution, Float]:
    """Add rows in depth until their error is small enough; return discretisation, coarse solution and errors, (3,).

    On thin layers both meshes have the minimum number of rows, so their difference does not include the error in
    depth. This function then measures this error with more rows. If the finer mesh already has more rows than the
    coarser mesh, the returned errors are 0.
    """
    error = np.zeros(3)
    for _ in range(ROUNDS):
        if rows_below(body, now.sizes) > coarse.rows:
            break
        ratio = ratio_of(body, now.sizes)
        row, deepest = 0.5 * min(now.sizes.row_m, 0.5 * depth_of(body) / ratio), 0.7 * now.sizes.deepest_row_m
        thin = replace(now, sizes=replace(now.sizes, row_m=row, deepest_row_m=deepest))
        # A body of many sheets needs more change for another row, because each sheet has at least one
        while rows_below(body, thin.sizes.scaled(ratio)) <= coarse.rows:
            row, deepest = 0.5 * row, 0.5 * deepest
            thin = replace(now, sizes=replace(now.sizes, row_m=row, deepest_row_m=deepest))
        deeper = run(thin, ratio)
        more = max(deeper.rows / coarse.rows, LEAST_MORE)
        change = difference(deeper, coarse)
        error = error_of_coarser(change, more, MESH_ORDER)
        if pinned or error[judged] <= 0.3 * accuracy:
            break
        now, coarse, error = thin, deeper, error_of_finer(change, more, MESH_ORDER)
    return now, coarse, error


def error_by_meshes(coarse: MeshSolution, fine: MeshSolution) -> Float:
    """Return the errors of the finer of two meshes, (3,), from their difference, MESH_ORDER and their actual edges.

    They are UNKNOWN if both meshes have the same triangles.
    """
    if coarse.triangles == fine.triangles:
        return np.full(3, UNKNOWN)
    ratio = max(math.sqrt(fine.triangles / coarse.triangles), LEAST_MORE)
    return error_of_finer(difference(fine, coarse), ratio, MESH_ORDER)


def difference(solution: MeshSolution, other: MeshSolution) -> Float:
    """Return the relative differences of the QUANTITIES, (3,), L2 over times, the largest over the moving points."""
    one, reference = ((x.displacement, x.velocity) for x in (other, solution))
    return differences(one, reference, solution.normals)


def ratio_of(body: Body, sizes: Sizes) -> float:
    return 2.0 if isinstance(body, Layer) and not sizes.remesh else RATIO


def resized(sizes: Sizes, factor: float, reach: float) -> Sizes:
    return replace(sizes.scaled(factor), reach_m=reach * sizes.reach_m, ring_m=reach * sizes.ring_m)


def rows_below(body: Body, sizes: Sizes) -> int:
    return len(element_rows(body.sheets, graded_fractions(depth_of(body), sizes.row_m, sizes.deepest_row_m))[1])
