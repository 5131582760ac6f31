"""How fine an implicit solution must be, and how far it then is from the converged one: coarser runs tell.

Errors fall by a power of the size of steps and elements, so that two of them show what is left (Richardson).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from palmfield.skin.mesh.body_mesh import Sizes, rows_of
from palmfield.skin.problem import Body, Layer, Slab
from palmfield.types import Float

RATIO = 4.0 / 3.0
"""Element sizes of the coarser over those of the finer mesh; a layer's triangles are quartered, so there it is 2."""
MESH_ORDER = 2.0
"""Between such meshes the disc's errors fall with an order of 2.5 to 4; 3 told too small an error in a test."""
FINEST_RATIO = 2.0
"""Largest ratio of the sizes of one mesh and the next finer."""
LEAST_MORE = 1.1
"""Least ratio of two meshes' edges that Richardson's rule is trusted with."""
SHRINK = 0.7
"""Extent of the smaller of two endless slabs."""
WIDER = 2.0
"""Their difference over the error of the wider one, at least. For the palm preset, 12 mm, at 200 Hz under and 20 mm
beside a spot it is 3 to 5 once the meshes agree."""
BELT = 1.0
"""Error by an absorbing layer's sides over the difference from one without the belt along them, see extent."""
UNTOLD = 1.0
"""That error where load or points lie so near the sides that nothing can be taken away."""
MOST_DOFS = 400_000
"""Above this the factors of the matrix take more than 10 GB."""
ROUNDS = 3


@dataclass(frozen=True)
class Numerics:
    """Sizes of the mesh, step [s], spectral radius at infinite frequency, and device."""

    sizes: Sizes
    step_s: float
    rho_inf: float
    device: str


@dataclass(frozen=True)
class Answer:
    """Displacement [m] and velocity [m/s] at the asked times and points, (t, n, 3), and the mesh's numbers."""

    displacement: Float
    velocity: Float
    dofs: int
    triangles: int
    rows: int


@dataclass(frozen=True)
class Settled:
    """The finest answer, its sizes, and what other meshes, rows in depth and extents say of its error."""

    fine: Answer
    sizes: Sizes
    mesh_error: float
    rows_error: float
    reach_error: float

    @property
    def error(self) -> float:
        return self.mesh_error + self.rows_error + self.reach_error

    @property
    def source(self) -> str:
        return (
            f"two meshes {self.mesh_error:.2g}, more rows {self.rows_error:.2g}, two extents {self.reach_error:.2g}, "
            "added"
        )


def settle(
    body: Body, now: Numerics, run: Callable[..., Answer], coarse: Answer, accuracy: float, pinned: bool
) -> Settled:
    """Widen what absorbs, then add rows, then refine, until the errors fit the accuracy; at most ROUNDS times each.

    run: (numerics, element factor, extent factor) -> Answer; coarse: that of now, one mesh coarser
    pinned: neither widen nor refine, only tell the errors
    """
    reach_error = 0.0
    if isinstance(body, Slab) and (body.shape == "infinite" or body.side == "absorbing"):
        reach_error = difference(coarse, run(now, ratio_of(body, now.sizes), SHRINK)) / WIDER
        for _ in range(ROUNDS):
            if pinned or reach_error <= 0.3 * accuracy:
                break
            now = replace(now, sizes=resized(now.sizes, 1.0, 1.0 / SHRINK))
            wider = run(now, ratio_of(body, now.sizes))
            reach_error, coarse = difference(wider, coarse) / WIDER, wider
    elif isinstance(body, Layer) and body.side == "absorbing":
        smaller = run(now, ratio_of(body, now.sizes), SHRINK)
        # The same triangles: nothing could be taken away
        told = smaller.triangles < coarse.triangles
        reach_error = BELT * difference(coarse, smaller) if told else UNTOLD
    now, coarse, rows_error = deepen(body, now, run, coarse, accuracy, pinned)
    fine = run(now)
    mesh_error = richardson(coarse, fine)
    for _ in range(ROUNDS):
        room = min(FINEST_RATIO, (MOST_DOFS / fine.dofs) ** (1.0 / 3.0))
        # Rounded, so that another unit of load does not make another mesh
        ratio = max(ratio_of(body, now.sizes), round(min((mesh_error / (0.5 * accuracy)) ** (1.0 / 3.0), room), 2))
        if pinned or mesh_error <= 0.6 * accuracy or fine.dofs * ratio**3 > MOST_DOFS:
            break
        now, coarse = replace(now, sizes=resized(now.sizes, 1.0 / ratio, 1.0)), fine
        fine = run(now)
        mesh_error = richardson(coarse, fine)
    return Settled(fine, now.sizes, mesh_error, rows_error, reach_error)


def deepen(
    body: Body, now: Numerics, run: Callable[..., Answer], coarse: Answer, accuracy: float, pinned: bool
) -> tuple[Numerics, Answer, float]:
    """Add rows in depth until their error fits; numerics, their coarse answer and that error.

    Two meshes of a thin layer both have the fewest rows there are: their difference says nothing of the depth. Where
    the finer one has more rows it does, and the error here is 0.
    """
    error = 0.0
    for _ in range(ROUNDS):
        if rows_below(body, now.sizes) > coarse.rows:
            break
        ratio = ratio_of(body, now.sizes)
        row, deepest = 0.5 * min(now.sizes.row_m, 0.5 * depth_of(body) / ratio), 0.7 * now.sizes.deepest_row_m
        thin = replace(now, sizes=replace(now.sizes, row_m=row, deepest_row_m=deepest))
        # A body of many sheets has a row for each as it is
        while rows_below(body, thin.sizes.scaled(ratio)) <= coarse.rows:
            row, deepest = 0.5 * row, 0.5 * deepest
            thin = replace(now, sizes=replace(now.sizes, row_m=row, deepest_row_m=deepest))
        deeper = run(thin, ratio)
        more = max(deeper.rows / coarse.rows, LEAST_MORE)
        gap = difference(deeper, coarse)
        error = gap / (1.0 - more**-MESH_ORDER)
        if pinned or error <= 0.3 * accuracy:
            break
        now, coarse, error = thin, deeper, gap / (more**MESH_ORDER - 1.0)
    return now, coarse, error


def richardson(coarse: Answer, fine: Answer) -> float:
    """Error of the finer of two meshes from their difference, at MESH_ORDER and the edges that they really have."""
    ratio = max(math.sqrt(fine.triangles / coarse.triangles), LEAST_MORE)
    return difference(fine, coarse) / (ratio**MESH_ORDER - 1.0)


def difference(answer: Answer, other: Answer) -> float:
    """Relative difference of the displacement, L2 over times, the largest of the points that move at all.

    At one time only, two meshes may agree at a point by chance: half of the largest difference of all points, in
    metres, is then the least for each.
    """
    size = np.linalg.norm(answer.displacement, axis=(0, 2))
    apart = np.linalg.norm(answer.displacement - other.displacement, axis=(0, 2))
    if len(answer.displacement) == 1:
        apart = np.maximum(apart, 0.5 * apart.max(initial=0.0))
    moving = size > 1e-9 * size.max(initial=0.0)
    return float((apart[moving] / size[moving]).max(initial=0.0))


def ratio_of(body: Body, sizes: Sizes) -> float:
    return 2.0 if isinstance(body, Layer) and not sizes.remesh else RATIO


def resized(sizes: Sizes, factor: float, reach: float) -> Sizes:
    return replace(sizes.scaled(factor), reach_m=reach * sizes.reach_m, ring_m=reach * sizes.ring_m)


def depth_of(body: Body) -> float:
    return float(np.median(body.patch.depth)) if isinstance(body, Layer) else body.thickness_m


def rows_below(body: Body, sizes: Sizes) -> int:
    return len(rows_of(body.sheets, depth_of(body), sizes.row_m, sizes.deepest_row_m)[1])
