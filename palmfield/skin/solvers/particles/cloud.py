"""Particles, in columns below a face, and their pairs: volumes, masses, area vectors for gradients and forces.

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

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import Delaunay

from palmfield.errors import SceneError
from palmfield.hand.triangles import signed_areas
from palmfield.skin.base import NEEDS_AXIS
from palmfield.skin.materials.material import Material
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.problem import Body, Layer, Slab
from palmfield.types import Float, Int

FEWEST_CELLS = 3
"""Least number of cells through the depth. With two cells the error on a thin bonded layer is 20 % at any spacing."""


@dataclass(frozen=True)
class Columns:
    """Columns of particles, from the face down.

    face: positions of the particles of the face [m], shape (n, 3). inward: unit directions, (n, 3). depth: [m], (n,).
    triangles: (t, 3), squares: (q, 4), counter-clockwise seen from outside; one of them may be empty.
    shares: depths of the levels as shares of the depth, from 0 to 1, shape (l,).
    sheet: sheet between a level and the next, shape (l - 1,).
    rim: particles on the edge of the face, shape (r,); a corner of a box appears twice.
    rim_normals: unit outward normals at these particles, (r, 3); NaN for a layer without axis.
    spacing_m: mean distance of neighbours in the face [m].
    """

    face: Float
    inward: Float
    depth: Float
    triangles: Int
    squares: Int
    shares: Float
    sheet: Int
    rim: Int
    rim_normals: Float
    spacing_m: float

    @property
    def count(self) -> int:
        return len(self.face) * len(self.shares)

    def points(self) -> Float:
        """Return all particles [m], level by level, shape (l n, 3)."""
        return (self.face + (self.shares[:, None] * self.depth)[..., None] * self.inward).reshape(-1, 3)


def columns_of(body: Body, spacing_m: float, fewest_cells: int = FEWEST_CELLS) -> Columns:
    """Return the columns of a box or disc (square lattice, fitted at the rim) or below the triangles of a layer.

    spacing_m: target distance of particles [m]. It is reduced so that whole numbers fit, and in depth so that there are
        fewest_cells. In a layer it determines only the levels, because the edges of the patch are given.
    Raises SceneError for a spacing <= 0 or above half of the body length along the face, an inverted layer, and a layer
    with roller sides whose patch has no axis.
    """
    if not (math.isfinite(spacing_m) and spacing_m > 0.0):
        raise SceneError(f"particles: spacing_m is {spacing_m}; give a length above 0")
    if isinstance(body, Layer):
        return _below_patch(body, spacing_m, fewest_cells)
    across = min(body.size_m) if body.size_m is not None else 2.0 * (body.radius_m or 0.0)
    if spacing_m > 0.5 * across:
        raise SceneError(
            f"particles: spacing_m is {spacing_m}, but the body is {across} m wide; give at most half of that"
        )
    thicknesses = np.array([sheet.thickness_m for sheet in body.sheets])
    shares, sheet_of = _levels(thicknesses / thicknesses.sum(), body.thickness_m, spacing_m, fewest_cells)
    flat, squares, triangles, rim, rim_normals = (
        _box(body, spacing_m) if body.shape == "box" else _disc(body, spacing_m)
    )
    count = len(flat)
    return Columns(
        face=np.column_stack([flat, np.zeros(count)]),
        inward=np.tile([0.0, 0.0, -1.0], (count, 1)),
        depth=np.full(count, body.thickness_m),
        triangles=triangles,
        squares=squares,
        shares=shares,
        sheet=sheet_of,
        rim=rim,
        rim_normals=rim_normals,
        spacing_m=_mean_edge(flat, triangles, squares),
    )


def _levels(sheet_shares: Float, depth_m: float, spacing_m: float, fewest_cells: int) -> tuple[Float, Int]:
    spacing_m = min(spacing_m, depth_m / fewest_cells)
    edges = np.concatenate([[0.0], np.cumsum(sheet_shares)])
    edges[-1] = 1.0
    levels, sheet_of = [np.zeros(1)], []
    for number, share in enumerate(sheet_shares):
        steps = max(1, math.ceil(share * depth_m / spacing_m - 1e-6))
        levels.append(np.linspace(edges[number], edges[number + 1], steps + 1)[1:])
        sheet_of += [number] * steps
    return np.concatenate(levels), np.array(sheet_of, dtype=np.int32)


def _mean_edge(flat: Float, triangles: Int, squares: Int) -> float:
    lengths = [
        np.linalg.norm(flat[faces] - flat[np.roll(faces, -1, axis=1)], axis=-1).ravel()
        for faces in (triangles, squares)
    ]
    return float(np.concatenate(lengths).mean())


def _box(body: Slab, spacing_m: float) -> tuple[Float, Int, Int, Int, Float]:
    assert body.size_m is not None
    lines = []
    for size in body.size_m:
        # With an even number of steps there is a particle in the middle
        steps = 2 * math.ceil(0.5 * size / spacing_m - 1e-6)
        lines.append(np.linspace(-0.5 * size, 0.5 * size, steps + 1))
    columns, rows = (len(line) for line in lines)
    x, y = np.meshgrid(*lines)
    number = np.arange(columns * rows, dtype=np.int32).reshape(rows, columns)
    squares = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    sides = ((number[:, 0], (-1, 0)), (number[:, -1], (1, 0)), (number[0], (0, -1)), (number[-1], (0, 1)))
    rim = np.concatenate([side for side, _ in sides])
    normals = np.concatenate([np.tile([*normal, 0.0], (len(side), 1)) for side, normal in sides])
    return np.column_stack([x.ravel(), y.ravel()]), squares, np.zeros((0, 3), dtype=np.int32), rim, normals


def _disc(body: Slab, spacing_m: float) -> tuple[Float, Int, Int, Int, Float]:
    """Return the square lattice in the disc, a ring of particles on its rim, and triangles between them."""
    radius = body.radius_m or 0.0
    half = math.floor(radius / spacing_m)
    line = np.arange(-half, half + 1) * spacing_m
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) < radius - 0.7 * spacing_m
    lattice = np.column_stack([x[inside], y[inside]])
    ring = max(6, round(2.0 * math.pi * radius / spacing_m))
    angle = 2.0 * math.pi * np.arange(ring) / ring
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    flat = np.concatenate([lattice, radius * circle])
    triangles = Delaunay(flat).simplices.astype(np.int32)
    area = signed_areas(flat, triangles)
    triangles[area < 0.0] = triangles[area < 0.0][:, ::-1]
    triangles = triangles[np.abs(area) > 0.5e-6 * spacing_m**2]

    number = np.full(inside.shape, -1, dtype=np.int32)
    number[inside] = np.arange(len(lattice))
    squares = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    squares = squares[squares.min(axis=1) >= 0]
    # Both halves of a whole square are Delaunay triangles with either diagonal.
    in_lattice = triangles.max(axis=1) < len(lattice)
    keys = {tuple(sorted(triangle)) for triangle in triangles[in_lattice].tolist()}
    whole: list[list[int]] = []
    used: set[tuple[int, ...]] = set()
    for square in squares.tolist():
        for first in (0, 1):
            p, q, r, s = square[first:] + square[:first]
            halves = (tuple(sorted((p, q, r))), tuple(sorted((p, r, s))))
            if halves[0] in keys and halves[1] in keys:
                whole.append(square)
                used.update(halves)
                break
    rest = [t for t in triangles.tolist() if tuple(sorted(t)) not in used]
    rim = np.arange(len(lattice), len(flat), dtype=np.int32)
    return (
        flat,
        np.array(whole, dtype=np.int32).reshape(-1, 4),
        np.array(rest, dtype=np.int32).reshape(-1, 3),
        rim,
        np.column_stack([circle, np.zeros(ring)]),
    )


def _below_patch(body: Layer, spacing_m: float, fewest_cells: int) -> Columns:
    patch = body.patch
    whole = extrude(patch, np.array([0.0, 1.0]))  # raises an error with the position of an inverted column
    rim = np.flatnonzero(patch.rim).astype(np.int32)
    if body.side == "roller" and patch.axis is None:
        raise SceneError(NEEDS_AXIS)
    normals = whole.side_normals[: len(rim)] if patch.axis is not None else np.full((len(rim), 3), np.nan)
    thicknesses = np.array([sheet.thickness_m for sheet in body.sheets])
    shares, sheet_of = _levels(thicknesses / thicknesses.sum(), float(np.median(patch.depth)), spacing_m, fewest_cells)
    faces = np.asarray(patch.faces, dtype=np.int32)
    return Columns(
        face=np.asarray(patch.vertices, dtype=float),
        inward=np.asarray(patch.inward, dtype=float),
        depth=np.asarray(patch.depth, dtype=float),
        triangles=faces,
        squares=np.zeros((0, 4), dtype=np.int32),
        shares=shares,
        sheet=sheet_of,
        rim=rim,
        rim_normals=normals,
        spacing_m=_mean_edge(patch.vertices, faces, np.zeros((0, 4), dtype=np.int32)),
    )


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
