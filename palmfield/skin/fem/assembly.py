"""Matrices of a skin layer: mass, damping, elastic and relaxing stiffness over its free degrees of freedom."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any

import numpy as np
import warp as wp
from scipy import sparse

from palmfield.device import load_ahead, resolve, run_kernel
from palmfield.errors import SceneError
from palmfield.locked import Lazy
from palmfield.phases import phase
from palmfield.skin.base import BASES, NEEDS_AXIS, SIDES, BaseKind, Foundation, SideKind, Springs
from palmfield.skin.fem.linear_body import Matrices, Part
from palmfield.skin.materials.material import Material
from palmfield.skin.mesh.element import corner_slopes, displacement_shape, prism_rule, volume_basis
from palmfield.skin.mesh.ordering import dissection_order
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.types import Float, Int
from warp_kernels import block_solves, elimination, wedge


@dataclass(frozen=True)
class SkinSystem:
    """M u'' + C u' + E u + sum over parts K_p (u + sum_i g_i (u - q_i) + t u') = F, q_i' = (u - q_i) / tau_i.

    mass M [kg], damping C [N s/m], elastic E [N/m]: symmetric csr matrices over n free degrees of freedom, (n, n).
        They are assembled at first use.
    directions: csr, shape (3 * (nodes + foundation nodes), n), orthonormal columns. directions @ u is the displacement
        of the nodes of the mesh, then of the foundation.
    parts: relaxing stiffnesses, one for each relaxation law, with its g_i, tau_i and t = eta / G_r.
    material: material of the surface.
    dof_map: csr, shape (3 * nodes, n), the upper rows of `directions`. dof_map @ u is the displacement of the nodes of
        the mesh, node by node.
    surface_node: surface node above each free degree of freedom, shape (n,).
    supported: whether base or sides hold the body against a push, so that a static solution exists.
    materials: materials of the parts, available before the parts are assembled.
    made_of: all inputs of the matrices, for `palmfield.cache.digest`.
    """

    mesh: WedgeMesh
    material: Material
    directions: sparse.csr_matrix
    dof_map: sparse.csr_matrix
    surface_node: Int
    supported: bool
    materials: tuple[Material, ...]
    made_of: tuple[Any, ...]
    matrices: Lazy[Matrices]
    order: Lazy[Int]

    @property
    def mass(self) -> sparse.csr_matrix:
        return self.matrices.value.mass

    @property
    def damping(self) -> sparse.csr_matrix:
        return self.matrices.value.damping

    @property
    def elastic(self) -> sparse.csr_matrix:
        return self.matrices.value.elastic

    @property
    def parts(self) -> Sequence[Part]:
        return self.matrices.value.parts

    @property
    def ndof(self) -> int:
        return self.dof_map.shape[1]

    def elimination_order(self) -> Int:
        """Return the order of elimination of the unknowns, shape (n,): old index at each new place."""
        return self.order.value

    def scaled_by(self, other: "SkinSystem") -> list[float] | None:
        """Return the factors by which the matrices mass, damping, elastic and parts differ for another material.

        other: system of the other material on the same mesh
        Returns None if more than the material differs, or if several materials, springs or dashpots contribute.
        """
        (one, *rest), (another, *others) = (tuple(dict.fromkeys(system.made_of[1])) for system in (self, other))
        mesh, theirs = self.mesh, other.mesh
        same = np.array_equal(mesh.nodes, theirs.nodes) and np.array_equal(mesh.elements, theirs.elements)
        below, side, springs, shear_spring, _, sponge_1_s = self.made_of[2:]
        plain = not below.sheets and springs == Springs(0.0, 0.0) and shear_spring == 0.0
        plain = plain and side != "absorbing" and sponge_1_s is None and other.made_of[-1] is None
        bulk, shear = another.bulk_Pa / one.bulk_Pa, another.shear_relaxed_Pa / one.shear_relaxed_Pa
        fits = one.bulk_relaxes == another.bulk_relaxes and (not one.bulk_relaxes or math.isclose(bulk, shear))
        if rest or others or not (same and plain and fits and self.made_of[2:] == other.made_of[2:]):
            return None
        return [another.density_kg_m3 / one.density_kg_m3, 1.0, bulk, shear]


def assemble(
    mesh: WedgeMesh,
    material: Material | Sequence[Material],
    *,
    base: BaseKind | Springs | Foundation = "bonded",
    side: SideKind = "fixed",
    foundation_Pa_m: tuple[float, float] | None = None,
    absorbing_Hz: float | None = None,
    sponge_1_s: Float | None = None,
) -> SkinSystem:
    """Assemble a layer.

    material: material of the whole layer, or of each row of elements, from the surface down.
    base: "bonded" (no motion), "free_slip" (no motion along the normal of the base), "free" (no traction), Springs, or
        a Foundation (sheets below the mesh; the sides continue along them).
    side: "fixed" (no motion), "free" (no traction), "absorbing" (dashpots), or "roller" (no motion along the normal of
        the side, which is square to the axis). A free-slip base under roller sides lets the disc spin about its axis:
        round-off then adds an arbitrary rotation to its static sideways motion. Its normal motion is right.
    foundation_Pa_m: (normal, tangential) stiffness per area [Pa/m] of the material below, in place of `base`. The
        tangential part is a shear spring and relaxes with the deepest material; the normal part is elastic.
    absorbing_Hz: frequency at which the dashpots of absorbing sides match the material [Hz], > 0.
    sponge_1_s: damping per mass of each column of elements [1/s], shape (triangles,); none by default.
    Raises SceneError for other conditions, a roller side without an axis, another number of materials than rows,
    absorbing sides without a frequency, and foundation stiffnesses not >= 0.
    """
    if (isinstance(base, str) and base not in BASES) or side not in SIDES:
        raise SceneError(f"base '{base}', side '{side}': base is one of {', '.join(BASES)}, side of {', '.join(SIDES)}")
    rows = materials_of_rows(mesh, material)
    springs, shear_spring = Springs(0.0, 0.0), 0.0
    below = base if isinstance(base, Foundation) else Foundation((), base)
    if foundation_Pa_m is not None:
        normal, tangential = foundation_Pa_m
        if not (normal >= 0.0 and tangential >= 0.0):
            raise SceneError(f"foundation stiffness is ({normal}, {tangential}) Pa/m; give two numbers, 0 or above")
        below, springs, shear_spring = Foundation((), "free"), Springs(normal, 0.0), tangential
    elif isinstance(below.base, Springs):
        springs = below.base
    matched_Hz = absorbing_Hz if side == "absorbing" else None
    if side == "absorbing" and matched_Hz is None:
        raise SceneError("absorbing sides need absorbing_Hz, the frequency at which their dashpots match")
    if matched_Hz is not None and not 0.0 < matched_Hz < np.inf:
        # Checked here, because the matrices are made at first use
        raise SceneError(f"absorbing sides: frequency is {matched_Hz} Hz; give one above 0")
    held_base: BaseKind = "free" if isinstance(below.base, Springs) else below.base
    directions = _free_directions(mesh, held_base, side, below)
    columns = directions.tocsc()
    surface_node = ((columns.indices[columns.indptr[:-1]] // 3) % mesh.surface_nodes).astype(np.int32)
    held = replace(springs, tangential_Pa_m=springs.tangential_Pa_m + shear_spring)

    @phase("matrices")
    def matrices() -> Matrices:
        project = directions.T.tocsr()
        # If each unknown is one component of a node, a selection takes half the time of two products
        components = project.indices if project.nnz == project.shape[0] and (project.data == 1.0).all() else None

        def free(matrix: sparse.csr_matrix) -> sparse.csr_matrix:
            if components is not None:
                result = matrix[components][:, components]
            else:
                result = sparse.csr_matrix(project @ matrix @ directions)
            result.sort_indices()
            result.eliminate_zeros()
            return result

        sums = _sums(mesh, rows, below, springs, shear_spring, matched_Hz, sponge_1_s)
        # The sum of one part is freed before the next part is made
        parts = tuple(Part(free(matrix), owner) for matrix, owner in map(sums.relaxing.pop, list(sums.relaxing)))
        mass, damping, elastic = (free(sums.total.pop(name)) for name in ("mass", "damping", "elastic"))
        return Matrices(mass, damping, elastic, parts)

    return SkinSystem(
        mesh=mesh,
        material=rows[0],
        directions=directions,
        dof_map=directions[: 3 * len(mesh.nodes)],
        surface_node=surface_node,
        supported=_supported(mesh, held_base, side, held),
        materials=_materials_of_parts(rows, below, shear_spring),
        made_of=(mesh, rows, below, side, springs, shear_spring, matched_Hz, sponge_1_s),
        matrices=Lazy(matrices),
        order=Lazy(partial(dissection_order, mesh, surface_node)),
    )


def _materials_of_parts(rows: list[Material], below: Foundation, shear_spring: float) -> tuple[Material, ...]:
    """Return the first material of each relaxation law, in the order of `_sums`."""
    met = [*rows, *(sheet.material for sheet in below.sheets), *([rows[-1]] if shear_spring > 0.0 else [])]
    first: dict[tuple, Material] = {}
    for material in met:
        first.setdefault(material.law, material)
    return tuple(first.values())


def _sums(
    mesh: WedgeMesh,
    rows: list[Material],
    below: Foundation,
    springs: Springs,
    shear_spring: float,
    matched_Hz: float | None,
    sponge_1_s: Float | None,
) -> "_Sums":
    """Return the matrices over all nodes; other arguments as for `assemble`.

    springs, shear_spring: below the mesh [Pa/m]; matched_Hz: frequency of absorbing sides, None for other sides
    """
    deviatoric, volumetric, unit_mass = element_matrices(mesh)
    pattern = _Pattern(mesh)
    sums = _Sums(3 * (len(mesh.nodes) + below.levels * mesh.surface_nodes))
    mass = _by_row(mesh, [row.density_kg_m3 for row in rows]) * unit_mass
    sums.add("mass", pattern.scalars(mass))
    if sponge_1_s is not None:
        sums.add("damping", pattern.scalars(np.tile(sponge_1_s, len(rows))[:, None, None] * mass))
    if matched_Hz is not None:
        from palmfield.skin.fem.absorbing import side_dashpots, side_springs

        of_rows = side_dashpots(mesh, rows, matched_Hz)
        sums.add("damping", of_rows)
    held_bulk = [0.0 if row.bulk_relaxes else row.bulk_Pa for row in rows]
    sums.add("elastic", pattern.blocks((_by_row(mesh, held_bulk), volumetric)))
    for law in dict.fromkeys(row.law for row in rows):
        own = [row if row.law == law else None for row in rows]
        stiff = [(_by_row(mesh, [row.shear_relaxed_Pa if row else 0.0 for row in own]), deviatoric)]
        bulk = [row.bulk_Pa if row and row.bulk_relaxes else 0.0 for row in own]
        if any(bulk):
            stiff.append((_by_row(mesh, bulk), volumetric))
        sums.relax(next(row for row in own if row), pattern.blocks(*stiff))
    if matched_Hz is not None and below.walled:
        sums.relax(rows[-1], side_springs(mesh, rows[-1], matched_Hz) * of_rows)
    if below.sheets or springs != Springs(0.0, 0.0) or shear_spring > 0.0:
        # Most scenes have none of these terms
        from palmfield.skin.fem.foundation import BaseFace, rim_dashpots, sheet_mass, sheet_stiffness

        face, first, degree = BaseFace(mesh), 3 * int(mesh.base[0]), below.degree
        for sheet in below.sheets:
            material, height = sheet.material, sheet.thickness_m
            shear, volume = sheet_stiffness(face, height, degree)
            sums.relax(material, material.shear_relaxed_Pa * shear, first)
            if material.bulk_relaxes:
                sums.relax(material, material.bulk_Pa * volume, first)
            else:
                sums.add("elastic", material.bulk_Pa * volume, first)
            sums.add("mass", material.density_kg_m3 * sheet_mass(face, height, degree), first)
            if sponge_1_s is not None:
                sums.add("damping", material.density_kg_m3 * sheet_mass(face, height, degree, sponge_1_s), first)
            if matched_Hz is not None:
                sides = rim_dashpots(mesh, material, height, degree, matched_Hz)
                sums.add("damping", sides, first)
                if below.walled:
                    sums.relax(material, side_springs(mesh, material, matched_Hz) * sides, first)
            first += 3 * max(degree, 1) * mesh.surface_nodes
        along, out = face.product("along", "along"), face.product("out", "out")
        sums.add("elastic", springs.normal_Pa_m * out + springs.tangential_Pa_m * along, first)
        sums.add("damping", springs.normal_Pa_s_m * out + springs.tangential_Pa_s_m * along, first)
        if shear_spring > 0.0:
            sums.relax(rows[-1], shear_spring * along, first)
    return sums


class _Sums:
    """Sums over the components of all nodes, shape (size, size); relaxing: by relaxation law."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.total = {name: sparse.csr_matrix((size, size)) for name in ("mass", "damping", "elastic")}
        self.relaxing: dict[tuple, tuple[sparse.csr_matrix, Material]] = {}

    def add(self, name: str, matrix: sparse.csr_matrix, first: int = 0) -> None:
        """Add a block that begins in row `first`."""
        block, before = placed(matrix, first, self.size), self.total[name]
        self.total[name] = before + block if before.nnz else block

    def relax(self, law: Material, stiffness: sparse.csr_matrix, first: int = 0) -> None:
        block = placed(stiffness, first, self.size)
        before, owner = self.relaxing.get(law.law, (None, law))
        self.relaxing[law.law] = (block if before is None else before + block, owner)


def placed(matrix: sparse.csr_matrix, first: int, size: int) -> sparse.csr_matrix:
    """Return a matrix of shape (size, size) with the given diagonal block from row `first` on."""
    if matrix.shape == (size, size):
        return matrix
    entries = matrix.tocoo()
    return sparse.csr_matrix((entries.data, (entries.row + first, entries.col + first)), shape=(size, size))


def materials_of_rows(mesh: WedgeMesh, material: Material | Sequence[Material]) -> list[Material]:
    """Return one material for each row of elements. Raises SceneError for another number of materials than rows."""
    count = (mesh.levels - 1) // 2
    rows = [material] * count if isinstance(material, Material) else list(material)
    if len(rows) != count:
        raise SceneError(f"{len(rows)} materials for {count} rows of elements: give one, or one for each row")
    return rows


def _by_row(mesh: WedgeMesh, values: list[float]) -> Float:
    """Return the value of its row for each element, shape (m, 1, 1)."""
    return np.repeat(values, len(mesh.surface_triangles6))[:, None, None]


def _supported(mesh: WedgeMesh, base: str, side: str, springs: Springs) -> bool:
    if base == "bonded" or (side == "fixed" and len(mesh.side)):
        return True
    if springs.normal_Pa_m > 0.0 and (springs.tangential_Pa_m > 0.0 or side == "roller"):
        return True
    # A frictionless base allows only rotations, without load, if the body is closed or has roller sides.
    return base == "free_slip" and (side == "roller" or not len(mesh.side))


def element_matrices(mesh: WedgeMesh) -> tuple[Float, Float, Float]:
    """Return deviatoric and volumetric stiffness (m, 18, 18, 3, 3) [m] and mass (m, 18, 18) [m^3], for unit values."""
    points, rule = prism_rule()
    values, slopes = displacement_shape(points)
    basis = volume_basis(points)
    count, quad, funcs, nodes = len(mesh.elements), len(points), basis.shape[1], mesh.elements.shape[1]
    device = resolve("cpu")
    load_ahead((wedge, elimination, block_solves), device)  # matrices are factorised next

    def upload(values: Float, dtype: Any) -> Any:
        return wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=dtype, device=device)

    def room(shape: tuple[int, ...], dtype: Any) -> Any:
        return wp.zeros(shape, dtype=dtype, device=device)

    gradients = room((count, quad, nodes), wp.vec3d)
    weights = room((count, quad), wp.float64)
    corners = upload(mesh.nodes[mesh.elements[:, [0, 1, 2, 12, 13, 14]]], wp.vec3d)
    run_kernel(
        wedge.wedge_gradients,
        dim=(count, quad),
        inputs=[corners, upload(corner_slopes(points), wp.vec3d), upload(slopes, wp.vec3d), upload(rule, wp.float64)],
        outputs=[gradients, weights],
        device=device,
    )
    constraint = room((count, funcs, nodes), wp.vec3d)
    gram = room((count, funcs, funcs), wp.float64)
    run_kernel(
        wedge.wedge_constraint,
        dim=(count, funcs),
        inputs=[gradients, weights, upload(basis, wp.float64)],
        outputs=[constraint, gram],
        device=device,
    )
    deviatoric = room((count, nodes, nodes), wp.mat33d)
    volumetric = room((count, nodes, nodes), wp.mat33d)
    mass = room((count, nodes, nodes), wp.float64)
    inverse = upload(np.linalg.inv(gram.numpy()), wp.float64)
    run_kernel(
        wedge.wedge_matrices,
        dim=(count, nodes, nodes),
        inputs=[gradients, weights, upload(values, wp.float64), constraint, inverse],
        outputs=[deviatoric, volumetric, mass],
        device=device,
    )
    return deviatoric.numpy(), volumetric.numpy(), mass.numpy()


class _Pattern:
    """Place of the node pair of each element in the global matrix."""

    def __init__(self, mesh: WedgeMesh) -> None:
        self.nodes = len(mesh.nodes)
        width = mesh.elements.shape[1]
        rows = np.repeat(mesh.elements, width, axis=1).ravel().astype(np.int64)
        keys, slots = np.unique(rows * self.nodes + np.tile(mesh.elements, (1, width)).ravel(), return_inverse=True)
        self.indices = keys % self.nodes
        self.starts = np.searchsorted(keys // self.nodes, np.arange(self.nodes + 1))
        ends = np.concatenate([[0], np.cumsum(np.bincount(slots, minlength=len(keys)))])
        # Adds the values of all pairs of each slot, in the order of the elements
        self._sum = sparse.csr_matrix((np.ones(len(slots)), np.argsort(slots, kind="stable"), ends))

    def blocks(self, *parts: tuple[Float, Float]) -> sparse.csr_matrix:
        """Return the sum of factors (m, 1, 1) times element blocks (m, 18, 18, 3, 3), csr, 3 components per node."""
        values: Float = reduce(np.add, [factor[..., None, None] * blocks for factor, blocks in parts])
        data = (self._sum @ values.reshape(-1, 9)).reshape(-1, 3, 3)
        return sparse.bsr_matrix((data, self.indices, self.starts), shape=(3 * self.nodes, 3 * self.nodes)).tocsr()

    def scalars(self, values: Float) -> sparse.csr_matrix:
        """Return the sum of element scalars (m, 18, 18), the same for each component."""
        sums = self._sum @ values.ravel()
        one = sparse.csr_matrix((sums, self.indices, self.starts), shape=(self.nodes, self.nodes))
        return sparse.kron(one, sparse.identity(3), format="csr")


def _free_directions(mesh: WedgeMesh, base: BaseKind, side: SideKind, below: Foundation) -> sparse.csr_matrix:
    """Return the orthonormal directions in which each node may move, as columns over the components of all nodes.

    below: its node levels lie below the mesh; the sides continue along them and the last level lies on the base
    """
    levels = mesh.levels + below.levels
    count = levels * mesh.surface_nodes
    on_base = np.arange(count - mesh.surface_nodes, count)
    rim = mesh.side[: len(mesh.side) // mesh.levels]
    on_side = (rim + mesh.surface_nodes * np.arange(levels)[:, None]).ravel()
    frames = np.tile(np.eye(3), (count, 1, 1))
    free = np.full(count, 3)
    held: dict[int, list[Float]] = {}
    if base == "free_slip":
        held = {int(n): [d] for n, d in zip(on_base, mesh.surface_normals(mesh.levels - 1), strict=True)}
    if side == "roller":
        if mesh.axis is None:
            raise SceneError(NEEDS_AXIS)
        for n, d in zip(on_side, np.tile(mesh.side_normals[: len(rim)], (levels, 1)), strict=True):
            held.setdefault(int(n), []).append(d)
    for node, directions in held.items():
        _, singular, basis = np.linalg.svd(np.array(directions))
        rank = int(np.sum(singular > 1e-6))
        frames[node] = np.roll(basis, -rank, axis=0).T
        free[node] = 3 - rank
    if base == "bonded":
        free[on_base] = 0
    if side == "fixed":
        free[on_side] = 0
    elif below.walled and side == "free":
        free[on_side[len(mesh.side) :]] = 0
    blocks = sparse.bsr_matrix((frames, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count))
    kept = np.flatnonzero((np.arange(3) < free[:, None]).ravel())
    result = sparse.csr_matrix(blocks.tocsr()[:, kept])
    result.eliminate_zeros()
    return result
