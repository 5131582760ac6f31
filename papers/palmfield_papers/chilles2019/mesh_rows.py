"""Row C13g: static deflection on the mesh of the paper relative to the converged one; quadratic and linear elements."""

from functools import cache

import numpy as np
from scipy import sparse

from palmfield.skin import Spot, static
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.body import build
from palmfield.skin.fem.factor import factorise
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import static as static_of_system
from palmfield.skin.fem.traction import PressureHistory
from palmfield.skin.mesh.body_mesh import Sizes
from palmfield.skin.mesh.element import EDGES
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float
from palmfield_papers.answer import Answer, Compute, Setting
from palmfield_papers.chilles2019.setup import RADIUS_M, Case, case_of, reading, slab_of

LATERAL_M, ROW_M = 2e-3, 10e-3
"""Largest lateral dimension and length through the thickness of elements in the paper.

Section IV.C: "a maximum lateral dimension of 2 mm, and 10 mm length through the thickness".
"""
SPOT_RADIUS_M, FAR_LATERAL_M = 0.02, 4e-3
"""Radius beyond which elements are larger in a quick run, and their size.

They change the deflection by 2e-5 and halve the time.
"""
CONVERGED = 0.002


def their_mesh(quick: bool) -> Sizes:
    return Sizes(
        centre_m=(0.0, 0.0), fine_radius_m=SPOT_RADIUS_M, fine_m=LATERAL_M,
        coarse_m=FAR_LATERAL_M if quick else LATERAL_M,
        row_m=ROW_M, deepest_row_m=ROW_M, refinements=0, reach_m=RADIUS_M, ring_m=0.0, match_Hz=100.0,
    )  # fmt: skip


@cache
def converged(case: Case) -> tuple[float, float]:
    """Return the deflection in the centre per pascal [m] from the axisymmetric solver, and its relative error."""
    motion = static(slab_of(case), _load(case), [[0.0, 0.0]], accuracy=CONVERGED)
    return float(motion.displacement_m[0, 0, 2]), motion.error


def _load(case: Case) -> Spot:
    return Spot(case.fwhm_m, np.zeros(1), np.ones(1), law="held")


@cache
def on_their_mesh(case: Case, order: str) -> float:
    """Return the deflection in the centre per pascal [m] with wedges as in the paper. order: quadratic or linear"""
    system = build(slab_of(case), their_mesh(case.quick))
    force = PressureHistory(_load(case), system.mesh, system).final_force()
    moved = static_of_system(system, force) if order == "quadratic" else _linear(system, force)
    return float((SurfaceProbe(system.mesh, np.zeros((1, 3)), system).vectors @ moved)[2])


def _linear(system: SkinSystem, force: Float) -> Float:
    """Return the static displacement (ndof,) in the space of linear wedges, which is a subspace of the quadratic ones.

    Their volumetric strain is in the projection space. So they are standard linear elements, without reduced
    integration.
    """
    corners, shares = _from_corners(system.mesh)
    spread = sparse.kron(shares, sparse.identity(3), format="csr")
    moves = np.diff(system.dof_map.indptr).reshape(-1, 3)[corners].ravel() > 0
    basis = sparse.csr_matrix(system.dof_map.T @ spread[:, np.flatnonzero(moves)])
    matrix = system.elastic + sum(part.stiffness for part in system.parts)
    reduced = sparse.csr_matrix(basis.T @ matrix @ basis)
    return np.asarray(basis @ factorise(reduced).solve(basis.T @ force))


def _from_corners(mesh: WedgeMesh) -> tuple[np.ndarray, sparse.csr_matrix]:
    """Return which nodes are corners of elements, and the matrix from corners to all nodes, (nodes, corners)."""
    levels = mesh.elements.reshape(len(mesh.elements), 3, 6)
    corners = np.unique(levels[:, (0, 2), :3])
    column = np.full(len(mesh.nodes), -1)
    column[corners] = np.arange(len(corners))
    shares: dict[tuple[int, int], float] = {(int(node), int(column[node])): 1.0 for node in corners}
    for local in range(18):
        level, place = divmod(local, 6)
        ends = [place] if place < 3 else list(EDGES[place - 3])
        sides = [0, 2] if level == 1 else [level]
        if place < 3 and level != 1:
            continue
        share = 1.0 / (len(ends) * len(sides))
        for end in ends:
            for side in sides:
                nodes, of = levels[:, level, place], column[levels[:, side, end]]
                shares.update({(int(node), int(one)): share for node, one in zip(nodes, of, strict=True)})
    rows, columns = np.array(list(shares)).T
    return corners, sparse.csr_matrix((list(shares.values()), (rows, columns)), (len(mesh.nodes), len(corners)))


def mesh_ratio(setting: Setting) -> Answer:
    case, order = case_of(setting), reading(setting, "chilles_element_order")
    best, error = converged(case)
    value = on_their_mesh(case, order) / best
    return Answer(
        value, error * value, note=f"{order} wedges, two rows of 10 mm; converged: {1e6 * 12.0 * best:.4g} um at 12 Pa"
    )


ANSWERS: dict[str, Compute] = {"C13g": mesh_ratio}
