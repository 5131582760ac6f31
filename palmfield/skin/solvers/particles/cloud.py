"""Particles and their pairs: volumes, masses, and the area vectors for gradients and forces.

The area vector of a pair is a_sj = integral of N_s grad N_j over the cells between particles; N are the (tri)linear
shape functions. This is the projection of the gradient with lumped volumes (averaged in Dohrmann et al. 2000, Int. J.
Numer. Meth. Engng 47, 1549; smoothed in Chen, Wu, Yoon & You 2001, ibid. 50, 435). On a square lattice it is the kernel
gradient of total-Lagrangian SPH after linear correction. The weights are 2/9, 1/18 and 1/72 on the faces, edges and
corners of the cube round a particle. At the faces of the body two conditions are exact; corrected kernels satisfy only
the first:
    sum_j a_sj (X_j - X_s) = V_s I              gradients of linear fields are exact.
    sum_s a_sj = area vector of the face at j   uniform stress is in balance with its traction.
The forces are f_sj = P_s a_sj on the particle of the site and -f_sj on its neighbour. They are the derivative of
sum_s V_s psi(F_s), so linear and angular momentum and energy are those of the body.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material
from palmfield.skin.problem import Body
from palmfield.skin.solvers.particles.columns import FEWEST_CELLS, Columns, columns_of
from palmfield.types import Float, Int


@dataclass(frozen=True)
class Cloud:
    """Particles of a body: n particles, s sites, at most k pairs per site and b pairs with a particle as neighbour.

    points: rest positions [m], shape (n, 3). mass: [kg], (n,).
    free: projector on the directions in which each particle may move, (n, 3, 3).
    materials: one for each law. law: law of each site, (s,). owner: particle of each site, ascending, (s,).
    volume: [m^3], (s,). site_start: first site of each particle, then the number of sites, (n + 1,).
    count: number of pairs of each site, (s,). neighbour: other particle, (s, k). offset: X_j - X_s [m], (s, k, 3).
    area: a_sj [m^2], (s, k, 3). spring: stiffness weight against deviations from the gradient of the site [m], (s, k).
    moment: sum_j spring offset offset^T [m^3], (s, 3, 3).
    has_memory: whether the site and its neighbours have one material, (s,).
    incoming: s * k + slot of the pairs with a particle as neighbour, (n, b). incoming_count: number of these, (n,).
    surface: number of each particle in the face, -1 below the face, (n,). face_area: outward area vector [m^2] of the
        particles of the face, which come first, (f, 3). columns: columns of the particles.
    """

    points: Float
    mass: Float
    free: Float
    materials: tuple[Material, ...]
    law: Int
    owner: Int
    volume: Float
    site_start: Int
    count: Int
    neighbour: Int
    offset: Float
    area: Float
    spring: Float
    moment: Float
    has_memory: Int
    incoming: Int
    incoming_count: Int
    surface: Int
    face_area: Float
    columns: Columns


def build_cloud(body: Body, spacing_m: float, fewest_cells: int = FEWEST_CELLS) -> Cloud:
    """Return the particles of a body. Raises SceneError as columns_of, and for an inverted cell, with its place."""
    columns = columns_of(body, spacing_m, fewest_cells)
    points = columns.points()
    materials = tuple(dict.fromkeys(sheet.material for sheet in body.sheets))
    law_of_sheet = np.array([materials.index(sheet.material) for sheet in body.sheets], dtype=np.int32)
    rows, nodes, areas, shares = _cell_pairs(columns, points, law_of_sheet, len(materials))

    keys, site_of = np.unique(rows, return_inverse=True)
    owner, law = (keys // len(materials)).astype(np.int32), (keys % len(materials)).astype(np.int32)
    sites, particles = len(keys), len(points)
    volume = np.bincount(site_of, weights=shares, minlength=sites).astype(np.float64)
    vectors = [sparse.coo_matrix((areas[:, c], (site_of, nodes)), shape=(sites, particles)).tocsr() for c in range(3)]
    for matrix in vectors:
        matrix.sort_indices()
    pattern = vectors[0]
    row = np.repeat(np.arange(sites, dtype=np.int32), np.diff(pattern.indptr))
    column = pattern.indices
    pair_area = np.column_stack([matrix.data for matrix in vectors])
    other = column != owner[row]
    row, column, pair_area = row[other], column[other], pair_area[other]
    offset = points[column] - points[owner[row]]
    # The least-squares weight for this area vector; at faces and thin cells a few have the wrong sign
    spring = np.maximum(np.einsum("pc,pc->p", pair_area, offset), 0.0) / np.einsum("pc,pc->p", offset, offset)
    moment = np.zeros((sites, 3, 3))
    np.add.at(moment, row, spring[:, None, None] * offset[:, :, None] * offset[:, None, :])

    count = np.bincount(row, minlength=sites).astype(np.int32)
    slot = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)).astype(np.int32)
    width = int(count.max())
    neighbour = np.repeat(owner[:, None], width, axis=1)
    neighbour[row, slot] = column
    incoming_count = np.bincount(column, minlength=particles).astype(np.int32)
    by_column = np.argsort(column, kind="stable")
    place = np.arange(len(row)) - np.repeat(np.cumsum(incoming_count) - incoming_count, incoming_count)
    incoming = np.zeros((particles, int(incoming_count.max())), dtype=np.int32)
    incoming[column[by_column], place] = (row * width + slot)[by_column]

    density = np.array([material.density_kg_m3 for material in materials])
    several = np.bincount(owner, minlength=particles) > 1
    mixed = several[owner]
    np.logical_or.at(mixed, row, several[column])
    face_area = _face_areas(columns, points)
    surface = np.full(particles, -1, dtype=np.int32)
    surface[: len(columns.face)] = np.arange(len(columns.face))
    return Cloud(
        points=points,
        mass=np.bincount(owner, weights=volume * density[law], minlength=particles).astype(np.float64),
        free=_free_directions(columns, points, body),
        materials=materials,
        law=law,
        owner=owner,
        volume=volume,
        site_start=np.searchsorted(owner, np.arange(particles + 1)).astype(np.int32),
        count=count,
        neighbour=neighbour.astype(np.int32),
        offset=_padded(offset, row, slot, sites, width),
        area=_padded(pair_area, row, slot, sites, width),
        spring=_padded(spring, row, slot, sites, width),
        moment=moment,
        has_memory=(~mixed).astype(np.int32),
        incoming=incoming,
        incoming_count=incoming_count,
        surface=surface,
        face_area=face_area,
        columns=columns,
    )


def _padded(values: Float, row: Int, slot: Int, sites: int, width: int) -> Float:
    result = np.zeros((sites, width, *values.shape[1:]))
    result[row, slot] = values
    return result


def _cell_pairs(columns: Columns, points: Float, law_of_sheet: Int, laws: int) -> tuple[Int, Int, Float, Float]:
    """Return site keys and particles of all pairs of all cells, area vectors, and volume shares (0 for other pairs).

    The key of a site is particle * laws + law, so that a particle between two materials has a site in each. The volume
    share of a cell is in the entry of the site with its own particle."""
    rows, nodes, areas, shares = [], [], [], []
    for faces in (columns.triangles, columns.squares):
        if len(faces) == 0:
            continue
        corners = faces.shape[1]
        shape, slopes, weights = _prism_rule(corners)
        for level, sheet in enumerate(columns.sheet):
            upper = faces + level * len(columns.face)
            cells = np.concatenate([upper + len(columns.face), upper], axis=1)
            jacobian = np.einsum("mic,qid->mqcd", points[cells], slopes)
            determinant = np.linalg.det(jacobian)
            _check_cells(determinant, jacobian, points[cells])
            measure = determinant * weights
            gradients = np.einsum("mqdc,qjd->mqjc", np.linalg.inv(jacobian), slopes)
            part = measure @ shape
            pairs = np.einsum("mq,qi,mqjc->mijc", measure, shape, gradients)
            own = np.zeros(pairs.shape[:3])
            own[:, np.arange(2 * corners), np.arange(2 * corners)] = part
            key = cells.astype(np.int64) * laws + law_of_sheet[sheet]
            rows.append(np.broadcast_to(key[:, :, None], own.shape).ravel())
            nodes.append(np.broadcast_to(cells[:, None, :], own.shape).ravel())
            areas.append(pairs.reshape(-1, 3))
            shares.append(own.ravel())
    return np.concatenate(rows), np.concatenate(nodes), np.concatenate(areas), np.concatenate(shares)


def _check_cells(determinant: Float, jacobian: Float, corners: Float) -> None:
    scale = np.prod(np.linalg.norm(jacobian, axis=2), axis=2)
    shape = np.divide(determinant, scale, out=np.zeros_like(scale), where=scale > 0.0).min(axis=1)
    worst = int(np.argmin(shape))
    if not shape[worst] > 1e-9:
        place = ", ".join(f"{x:.4g}" for x in corners[worst].mean(axis=0))
        raise SceneError(f"the cell between particles near ({place}) m is flat or inverted: smooth the surface there")


def _face_rule(corners: int) -> tuple[Float, Float, Float]:
    """Return shape functions (q, corners), slopes (q, corners, 2) and weights (q,) of a triangle or a square."""
    if corners == 3:
        # Strang & Fix, degree 2: the midpoints of the sides.
        x, y = np.array([0.5, 0.5, 0.0]), np.array([0.0, 0.5, 0.5])
        slopes = np.tile([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]], (3, 1, 1))
        return np.column_stack([1.0 - x - y, x, y]), slopes, np.full(3, 1.0 / 6.0)
    gauss = 1.0 / np.sqrt(3.0)
    x, y = gauss * np.array([-1.0, 1.0, 1.0, -1.0]), gauss * np.array([-1.0, -1.0, 1.0, 1.0])
    at_x, at_y = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    along, across = 1.0 + np.outer(x, at_x), 1.0 + np.outer(y, at_y)
    return along * across / 4.0, np.stack([at_x * across, at_y * along], axis=-1) / 4.0, np.ones(4)


def _prism_rule(corners: int) -> tuple[Float, Float, Float]:
    """Return the same as _face_rule for the solid on a face: 2 * corners shape functions, lower face first."""
    shape, slopes, weights = _face_rule(corners)
    values, gradients = [], []
    for z in (-1.0 / np.sqrt(3.0), 1.0 / np.sqrt(3.0)):
        low, high = 0.5 * (1.0 - z), 0.5 * (1.0 + z)
        values.append(np.concatenate([low * shape, high * shape], axis=1))
        lower = np.concatenate([low * slopes, -0.5 * shape[..., None]], axis=2)
        upper = np.concatenate([high * slopes, 0.5 * shape[..., None]], axis=2)
        gradients.append(np.concatenate([lower, upper], axis=1))
    return np.concatenate(values), np.concatenate(gradients), np.concatenate([weights, weights])


def _face_areas(columns: Columns, points: Float) -> Float:
    """Return outward area vectors of the particles of the face, (f, 3): integrals of shape function times normal."""
    total = np.zeros((len(columns.face), 3))
    for faces in (columns.triangles, columns.squares):
        if len(faces):
            shape, slopes, weights = _face_rule(faces.shape[1])
            tangents = np.einsum("mic,qid->mqcd", points[faces], slopes)
            normals = np.cross(tangents[..., 0], tangents[..., 1])
            np.add.at(total, faces, np.einsum("q,qi,mqc->mic", weights, shape, normals))
    return total


def _free_directions(columns: Columns, points: Float, body: Body) -> Float:
    """Return the projectors on the directions in which each particle may move, shape (n, 3, 3)."""
    per_level, levels = len(columns.face), len(columns.shares)
    fixed: dict[int, list[Float]] = {}
    base = (levels - 1) * per_level + np.arange(per_level)
    rim = (columns.rim + per_level * np.arange(levels)[:, None]).ravel()
    if body.base == "bonded":
        fixed |= {int(i): list(np.eye(3)) for i in base}
    elif body.base == "free_slip":
        normals = _face_areas(columns, points[base])
        fixed |= {int(i): [n / np.linalg.norm(n)] for i, n in zip(base, normals, strict=True)}
    if body.side == "fixed":
        fixed |= {int(i): list(np.eye(3)) for i in rim}
    elif body.side == "roller":
        for place, normal in zip(rim, np.tile(columns.rim_normals, (levels, 1)), strict=True):
            fixed.setdefault(int(place), []).append(normal)
    free = np.tile(np.eye(3), (len(points), 1, 1))
    for i, directions in fixed.items():
        _, singular, basis = np.linalg.svd(np.array(directions))
        stiff = basis[: int(np.sum(singular > 1e-6))]
        free[i] -= stiff.T @ stiff
    return free
