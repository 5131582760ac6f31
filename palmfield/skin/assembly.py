"""Matrices of a skin layer: mass, elastic and relaxing stiffness over its free degrees of freedom."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import warp as wp
from scipy import sparse

from palmfield.device import resolve
from palmfield.errors import SceneError
from palmfield.skin.element import (
    corner_slopes,
    displacement_shape,
    prism_rule,
    triangle_rule,
    triangle_shape,
    volume_basis,
)
from palmfield.skin.material import Material
from palmfield.skin.wedges import WedgeMesh
from palmfield.types import Float, Int
from warp_kernels import wedge

Base = Literal["bonded", "free_slip", "free"]
Side = Literal["fixed", "free", "roller"]
BASES = ("bonded", "free_slip", "free")
SIDES = ("fixed", "free", "roller")


@dataclass(frozen=True)
class Part:
    """Stiffness [N/m], symmetric csr of shape (n, n), that relaxes as a material's shear modulus; of G_r."""

    stiffness: sparse.csr_matrix
    material: Material


@dataclass(frozen=True)
class SkinSystem:
    """M u'' + E u + sum over parts K_p (u + sum_i g_i (u - q_i) + t u') = F, q_i' = (u - q_i) / tau_i, t = eta / G_r.

    mass [kg], elastic [N/m]: symmetric csr matrices over n free degrees of freedom, shape (n, n)
    parts: what relaxes, a part for each material
    material: of the surface
    dof_map: nodal displacements (3 * nodes, by node) = dof_map @ u, csr, shape (3 * nodes, n), orthonormal columns
    surface_node: surface node under which each free degree of freedom lies, shape (n,)
    """

    mesh: WedgeMesh
    material: Material
    mass: sparse.csr_matrix
    elastic: sparse.csr_matrix
    parts: tuple[Part, ...]
    dof_map: sparse.csr_matrix
    surface_node: Int

    @property
    def ndof(self) -> int:
        return self.mass.shape[0]


def assemble(
    mesh: WedgeMesh,
    material: Material,
    *,
    base: Base = "bonded",
    side: Side = "fixed",
    foundation_Pa_m: tuple[float, float] | None = None,
) -> SkinSystem:
    """Assemble a layer of one material.

    base: "bonded" (no motion), "free_slip" (no motion along the base's normal) or "free" (no traction)
    side: "fixed" (no motion), "free" (no traction) or "roller" (no motion along the side's normal, square to the axis)
        A free-slip base under roller sides leaves the disc free to spin about its axis: its static sideways motion is
        then any rotation that round-off leaves, its normal motion is right.
    foundation_Pa_m: (normal, tangential) stiffness by area [Pa/m] of what lies below, in place of `base`. The
        tangential part is a shear spring and relaxes with the material; the normal part is elastic.
    Raises SceneError for other conditions, a roller side without an axis, or foundation stiffnesses not >= 0.
    """
    if base not in BASES or side not in SIDES:
        raise SceneError(f"base '{base}', side '{side}': base is one of {', '.join(BASES)}, side of {', '.join(SIDES)}")
    deviatoric, volumetric, mass = element_matrices(mesh)
    pattern = _Pattern(mesh)
    relaxing = pattern.blocks(material.shear_relaxed_Pa * deviatoric)
    elastic = pattern.blocks(material.bulk_Pa * volumetric)
    support = 0.0 * elastic
    inertia = pattern.scalars(material.density_kg_m3 * mass)
    if foundation_Pa_m is not None:
        base = "free"
        normal, tangential = foundation_Pa_m
        if not (normal >= 0.0 and tangential >= 0.0):
            raise SceneError(f"foundation stiffness is ({normal}, {tangential}) Pa/m; give two numbers, 0 or above")
        along, across = _foundation(mesh)
        support = normal * along
        relaxing = relaxing + tangential * across
    dof_map = _free_directions(mesh, base, side)
    reduce = dof_map.T.tocsr()
    columns = dof_map.tocsc()
    if material.bulk_relaxes:
        relaxing = relaxing + elastic
        elastic = 0.0 * elastic
    return SkinSystem(
        mesh=mesh,
        material=material,
        mass=_csr(reduce @ inertia @ dof_map),
        elastic=_csr(reduce @ (elastic + support) @ dof_map),
        parts=(Part(_csr(reduce @ relaxing @ dof_map), material),),
        dof_map=dof_map,
        surface_node=((columns.indices[columns.indptr[:-1]] // 3) % mesh.surface_nodes).astype(np.int32),
    )


def element_matrices(mesh: WedgeMesh) -> tuple[Float, Float, Float]:
    """Deviatoric and volumetric stiffness (m, 18, 18, 3, 3) [m] and mass (m, 18, 18) [m^3] for unit moduli, density."""
    points, rule = prism_rule()
    values, slopes = displacement_shape(points)
    basis = volume_basis(points)
    count, quad, funcs, nodes = len(mesh.elements), len(points), basis.shape[1], mesh.elements.shape[1]
    device = resolve("cpu")

    def upload(values: Float, dtype: Any) -> Any:
        return wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=dtype, device=device)

    def room(shape: tuple[int, ...], dtype: Any) -> Any:
        return wp.zeros(shape, dtype=dtype, device=device)

    gradients = room((count, quad, nodes), wp.vec3d)
    weights = room((count, quad), wp.float64)
    corners = upload(mesh.nodes[mesh.elements[:, [0, 1, 2, 12, 13, 14]]], wp.vec3d)
    wp.launch(
        wedge.wedge_gradients,
        dim=(count, quad),
        inputs=[corners, upload(corner_slopes(points), wp.vec3d), upload(slopes, wp.vec3d), upload(rule, wp.float64)],
        outputs=[gradients, weights],
        device=device,
    )
    constraint = room((count, funcs, nodes), wp.vec3d)
    gram = room((count, funcs, funcs), wp.float64)
    wp.launch(
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
    wp.launch(
        wedge.wedge_matrices,
        dim=(count, nodes, nodes),
        inputs=[gradients, weights, upload(values, wp.float64), constraint, inverse],
        outputs=[deviatoric, volumetric, mass],
        device=device,
    )
    return deviatoric.numpy(), volumetric.numpy(), mass.numpy()


class _Pattern:
    """Where each element's node pair lands in the global matrix."""

    def __init__(self, mesh: WedgeMesh) -> None:
        self.nodes = len(mesh.nodes)
        width = mesh.elements.shape[1]
        rows = np.repeat(mesh.elements, width, axis=1).ravel().astype(np.int64)
        keys, self.slot = np.unique(rows * self.nodes + np.tile(mesh.elements, (1, width)).ravel(), return_inverse=True)
        self.indices = keys % self.nodes
        self.starts = np.searchsorted(keys // self.nodes, np.arange(self.nodes + 1))

    def _sum(self, values: Float) -> Float:
        return np.bincount(self.slot, weights=values.ravel(), minlength=len(self.indices)).astype(np.float64)

    def blocks(self, values: Float) -> sparse.csr_matrix:
        """Sum of element blocks (m, 18, 18, 3, 3) as a csr matrix over 3 components a node."""
        data = np.empty((len(self.indices), 3, 3))
        for i in range(3):
            for j in range(3):
                data[:, i, j] = self._sum(values[..., i, j])
        return self._matrix(data)

    def scalars(self, values: Float) -> sparse.csr_matrix:
        """Sum of element scalars (m, 18, 18), the same for each component."""
        one = sparse.csr_matrix((self._sum(values), self.indices, self.starts), shape=(self.nodes, self.nodes))
        return sparse.kron(one, sparse.identity(3), format="csr")

    def _matrix(self, data: Float) -> sparse.csr_matrix:
        return sparse.bsr_matrix((data, self.indices, self.starts), shape=(3 * self.nodes, 3 * self.nodes)).tocsr()


def _csr(matrix: Any) -> sparse.csr_matrix:
    result = sparse.csr_matrix(matrix)
    result.sort_indices()
    return result


def _free_directions(mesh: WedgeMesh, base: Base, side: Side) -> sparse.csr_matrix:
    """Orthonormal directions in which each node may move, as columns over the nodal components."""
    count = len(mesh.nodes)
    frames = np.tile(np.eye(3), (count, 1, 1))
    free = np.full(count, 3)
    held: dict[int, list[Float]] = {}
    if base == "free_slip":
        held = {int(n): [d] for n, d in zip(mesh.base, mesh.surface_normals(mesh.levels - 1), strict=True)}
    if side == "roller":
        if mesh.axis is None:
            raise SceneError("roller sides need a patch with an axis; this one has none: use side 'fixed' or 'free'")
        for n, d in zip(mesh.side, mesh.side_normals, strict=True):
            held.setdefault(int(n), []).append(d)
    for node, directions in held.items():
        _, singular, basis = np.linalg.svd(np.array(directions))
        rank = int(np.sum(singular > 1e-6))
        frames[node] = np.roll(basis, -rank, axis=0).T
        free[node] = 3 - rank
    if base == "bonded":
        free[mesh.base] = 0
    if side == "fixed":
        free[mesh.side] = 0
    blocks = sparse.bsr_matrix((frames, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count))
    kept = np.flatnonzero((np.arange(3) < free[:, None]).ravel())
    directions = sparse.csr_matrix(blocks.tocsr()[:, kept])
    directions.eliminate_zeros()
    return directions


def _foundation(mesh: WedgeMesh) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Integrals of N_i N_j n n^T and of N_i N_j (I - n n^T) over the base [m^2], over all nodal components."""
    offset = int(mesh.base[0])
    triangles = mesh.surface_triangles6 + offset
    a, b, c = (mesh.nodes[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    twice = np.linalg.norm(area, axis=1)
    normals = area / twice[:, None]
    points, weights = triangle_rule()
    shape = triangle_shape(points)
    pairs = twice[:, None, None] * np.einsum("q,qi,qj->ij", weights, shape, shape)
    along = np.einsum("ta,tb->tab", normals, normals)
    size = 3 * len(mesh.nodes)
    matrices = []
    for projector in (along, np.eye(3) - along):
        blocks = np.einsum("tij,tab->tiajb", pairs, projector)
        dofs = (3 * triangles[..., None] + np.arange(3)).reshape(len(triangles), 18)
        rows, columns = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel()
        matrices.append(sparse.coo_matrix((blocks.ravel(), (rows, columns)), shape=(size, size)).tocsr())
    return matrices[0], matrices[1]
