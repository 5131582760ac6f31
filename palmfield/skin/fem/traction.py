"""Consistent nodal forces of a load on the skin (a spot, or pressures at scattered points), at one time or several."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import ConvexHull, Delaunay, cKDTree

from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.load import SurfaceQuadrature, halvings_for
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.mesh.element import triangle_rule
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.skin.problem import GAUSSIAN, Load, Spot, Traction
from palmfield.skin.stepper import SurfaceLoads
from palmfield.types import Float, Int

STEEPEST = 3.0
"""Ratio of the longest edge of a triangle to its longest edge seen from above; steeper triangles are left out."""
COVERED = 0.2
"""Largest relative difference between the surface joined by points round a body and the sum of their areas."""
WRAPPED = 0.1
"""Share of steep triangles above which the points count as points round a body."""
NEIGHBOURS = 9
"""Number of points nearest to a place among which the three corners of its triangle are chosen."""
CLOSEST = 6
"""Number of points, with the point itself, whose areas are averaged: quadrature points of a triangle differ in area."""
LONGEST = 3.0
"""Largest distance of a corner from the place, in spacings; there is no pressure in wider gaps."""
DISC = 1.0 / np.sqrt(np.pi)
"""Radius of a disc of the area of a point, in spacings (roots of areas)."""
SAME_SIDE = 0.3
"""Least cosine between the normals of a place and a point: it excludes points on the other side of a finger."""
FLAT = 1e-6
"""Area of a triangle, in squared spacings, below which its corners count as points on a line."""
CHUNK = 20_000


def sampled(mesh: WedgeMesh, system: SkinSystem, load: Traction) -> sparse.csr_matrix:
    """Return the nodal forces [N] of pressures [Pa] at the points of a traction, csr, shape (n, p).

    The pressure of `field_at` is integrated on a rule about as dense as the points. Forces at the points themselves
    would be a rough load on elements that are not much larger than the areas of the points. A thin layer responds more
    to a rough load: a bonded layer of 1 mm round a bone moved up to 200 times too far. Forces at the points are used
    only for points that are `alone`, and for quadrature points of the body (`face_points`).
    """
    probe = SurfaceProbe(mesh, load.points, system)
    forces = sparse.csr_matrix(-(probe.operator.T @ sparse.diags(load.weights_m2)))
    net = seen_from_above(load)
    if net is None and of_rule(mesh, system, load.points):
        return forces
    corners = mesh.nodes[mesh.surface_triangles6[:, :3]]
    halvings = halvings_for(corners[np.unique(probe.triangles)], load.weights_m2)
    reach = net.longest_m.max() if net else 2.0 * math.sqrt(float(load.weights_m2.max()))
    middles = corners.mean(axis=1)
    size = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    near = cKDTree(net.points if net else load.points).query(middles)[0] <= size + reach
    quadrature = SurfaceQuadrature(mesh, system, halvings, np.flatnonzero(near).astype(np.int32))
    between = field_at(load, probe.normals, quadrature.points, quadrature.normals, quadrature.weights)
    return sparse.csr_matrix(quadrature.operator @ between + forces @ sparse.diags(alone(between, load).astype(float)))


def field_at(
    load: Traction, normals: Float, places: Float, facing: Float, weights_m2: Float | None
) -> sparse.csr_matrix:
    """Return the matrix from pressures at the points of a traction to pressures at places of a face, csr, (q, p).

    The pressure is linear between the points, and constant over half a spacing beyond the outermost points.
    Points seen from above are joined by Delaunay triangles in x and y. Skin farther above or below a triangle than its
    longest edge has no pressure. Points round a body are joined by triangles in the surface of the body. If points
    lie on a line, or their areas do not match the gaps between them, their forces are spread over discs of these areas.
    The force is preserved for the mean magnitude of the pressure over time: it is pressure times areas of points.

    normals: outward unit normals at the points, (p, 3).
    places [m], facing: places of the face and outward normals there, (q, 3).
    weights_m2: area of each place, (q,), to preserve the force; None if only pressures are needed.
    """
    net = seen_from_above(load)
    if net:
        between = net.between(places, len(load.points))
        if weights_m2 is None:
            return between
    else:
        assert weights_m2 is not None
        here = (load.points, normals, load.weights_m2, places, facing)
        between = between_points(*here)
        covered = float(weights_m2 @ between.sum(axis=1).A1)
        if abs(covered / float(load.weights_m2.sum()) - 1.0) > COVERED:
            return spread_forces(*here, weights_m2)
    pushed = between.T @ weights_m2
    mean = np.abs(load.pressure_Pa).mean(axis=0) * ((pushed > 0.0) | (net is not None))
    force = float(mean @ pushed)
    return between * (float(mean @ load.weights_m2) / force) if force > 0.0 else between


def alone(between: sparse.csr_matrix, load: Traction) -> NDArray[np.bool_]:
    """Return which points of a traction have no place nearby, (p,); their forces act separately.

    Points of a net finer than the places are not alone, because neighbouring points represent them."""
    missed = np.asarray(between.getnnz(axis=0)) == 0
    return missed if missed.all() or seen_from_above(load) is None else np.zeros_like(missed)


def face_pressure(load: Traction, nodes: Int, shares: Float, places: Float, area_m2: Float) -> sparse.csr_matrix:
    """Return the matrix from pressures at the points of a traction to pressures at nodes of a face, csr, (s, p).

    The force is preserved. Each node has the mean pressure over its own part of the face.
    nodes, shares: nodes of the face round each place and their shares there, both (q, k).
    places: places of a rule on the whole face [m], (q, 3); area_m2: outward area vectors of the places, (q, 3).
    """
    weights = np.linalg.norm(area_m2, axis=1)
    facing = area_m2 / weights[:, None]
    nearest = cKDTree(places).query(load.points)[1]
    between = field_at(load, facing[nearest], places, facing, weights)
    single = np.flatnonzero(alone(between, load))
    pushed = load.weights_m2[single] / weights[nearest[single]]
    between = between + sparse.coo_matrix((pushed, (nearest[single], single)), shape=between.shape)
    rows = np.broadcast_to(np.arange(len(places))[:, None], nodes.shape)
    entries = ((shares * weights[:, None]).ravel(), (nodes.ravel(), rows.ravel()))
    gather = sparse.coo_matrix(entries, shape=(int(nodes.max()) + 1, len(places))).tocsr()
    own = gather.sum(axis=1).A1
    return sparse.csr_matrix(sparse.diags(1.0 / own) @ gather @ between)


def of_rule(mesh: WedgeMesh, system: SkinSystem, points: Float) -> bool:
    """Return whether the points are quadrature points of the triangles of the mesh after any number of quarterings."""
    halvings = math.log(len(points) / (len(triangle_rule()[0]) * len(mesh.surface_triangles6)), 4.0)
    if halvings < 0.0 or not halvings.is_integer():
        return False
    own = SurfaceQuadrature(mesh, system, round(halvings))
    spacing = math.sqrt(float(own.weights.min()))
    return bool(cKDTree(own.points).query(points)[0].max() < 1e-3 * spacing)


@dataclass(frozen=True)
class Net:
    """Triangles in x and y between the points of a traction and added points half a spacing beyond the outermost.

    points: [m], (m, 3). owner: number of the point with the same pressure, (m,). delaunay: triangulation in x and y.
    longest_m: longest edge of each triangle [m]. steep: triangles that are left out.
    """

    points: Float
    owner: Int
    delaunay: Delaunay
    longest_m: Float
    steep: NDArray[np.bool_]

    def between(self, places: Float, count: int) -> sparse.csr_matrix:
        """Return the matrix from pressures at `count` points to pressures at places [m], (q, 3), csr, (q, count)."""
        net = self.delaunay
        # The search for a point outside the net would go through all triangles
        low, high = net.min_bound, net.max_bound
        near = np.flatnonzero(np.all((places[:, :2] >= low) & (places[:, :2] <= high), axis=1))
        hull = ConvexHull(net.points).equations
        near = near[np.all(places[near, :2] @ hull[:, :2].T + hull[:, 2] <= 1e-9 * np.ptp(net.points), axis=1)]
        place = np.full(len(places), -1)
        place[near] = net.find_simplex(places[near, :2])
        inside = np.flatnonzero(place >= 0)
        turn = net.transform[place[inside]]
        two = np.einsum("qij,qj->qi", turn[:, :2], places[inside, :2] - turn[:, 2])
        shares = np.column_stack([two, 1.0 - two.sum(axis=1)])
        corner = net.simplices[place[inside]]
        away = np.linalg.norm(places[inside] - np.einsum("qi,qic->qc", shares, self.points[corner]), axis=1)
        shares[self.steep[place[inside]] | (away > self.longest_m[place[inside]])] = 0.0
        rows, columns = np.repeat(inside, 3), self.owner[corner.ravel()]
        return sparse.coo_matrix((shares.ravel(), (rows, columns)), shape=(len(places), count)).tocsr()


def seen_from_above(load: Traction) -> Net | None:
    """Return the net of the points of a traction; None for points on a line or round a body, or areas with gaps."""
    flat = load.points[:, :2]
    if len(flat) < 3 or np.linalg.matrix_rank(flat - flat.mean(axis=0), tol=1e-9) < 2:
        return None
    outer, beyond = beyond_rim(Delaunay(flat), np.sqrt(load.weights_m2))
    owner = np.concatenate([np.arange(len(flat)), outer]).astype(np.int32)
    points = np.concatenate([load.points, np.column_stack([beyond, load.points[outer, 2]])])
    net = Delaunay(points[:, :2])
    sides = points[net.simplices] - points[np.roll(net.simplices, 1, axis=1)]
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    steep = longest > STEEPEST * np.linalg.norm(sides[..., :2], axis=2).max(axis=1)
    covered = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)[~steep].sum()
    total = float(load.weights_m2.sum())
    if steep.mean() > WRAPPED or not 0.5 * total < covered < 2.0 * total:
        return None
    return Net(points, owner, net, longest, steep)


def beyond_rim(net: Delaunay, spacing: Float) -> tuple[Int, Float]:
    """Return the numbers of the outermost points, (m,), and places half a spacing outside them, (m, 2)."""
    edges = net.convex_hull
    along = net.points[edges[:, 1]] - net.points[edges[:, 0]]
    out = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    inwards = np.einsum("ec,ec->e", out, net.points[edges[:, 0]] - net.points.mean(axis=0)) < 0.0
    out[inwards] *= -1.0
    outer, place = np.unique(edges, return_inverse=True)
    normal = np.zeros((len(outer), 2))
    np.add.at(normal, place.ravel(), 0.5 * np.repeat(out, 2, axis=0))
    # The place outside a corner has the same distance from both edges
    size2 = np.maximum((normal**2).sum(axis=1, keepdims=True), 0.25)
    return outer.astype(np.int32), net.points[outer] + 0.5 * spacing[outer, None] * normal / size2


class PressureHistory:
    """The pressure of a load on a layer over time.

    operator: csr, shape (n, q), from pressure at the points of the load [Pa] to consistent nodal force [N]
    knots_s: times of the load [s]
    Raises SceneError for a load whose points lie off the surface.
    """

    def __init__(self, load: Load, mesh: WedgeMesh, system: SkinSystem) -> None:
        self.load = load
        self.knots_s = np.asarray(load.times_s, dtype=float)
        self._shape: Float | None = None
        if isinstance(load, Spot):
            quadrature = SurfaceQuadrature(mesh, system)
            self.points, self.operator = quadrature.points, quadrature.operator
            self.centres = load.centres()
            if not np.ptp(self.centres, axis=0).any():
                # A stationary spot is one pattern with a varying level.
                self._shape = self._bell(self.centres[0])
        else:
            self.operator = sampled(mesh, system, load)

    def loads(self, clock: Float) -> SurfaceLoads:
        """Return the loads of the substeps between ascending times [s], (s + 1,), for a stepper with inputs `operator`.

        In each substep the load is replaced by a straight line with the same impulse and first moment. A load that is
        linear over the substep is unchanged. The effect of a jump or a bend in a substep is right to second order.
        """
        course = self._weight if self._shape is not None else self.pressure
        ends = [self._ends(course, *step) for step in itertools.pairwise(clock.tolist())]
        if self._shape is not None:
            first, last = np.array(ends).T[..., None]
            return SurfaceLoads(self._shape[None, None], first[None], last[None])
        unit = np.eye(2 * len(ends))[None]
        return SurfaceLoads(np.array(ends).reshape(1, 2 * len(ends), -1), unit[:, ::2], unit[:, 1::2])

    def _ends(self, course: Callable[[float], Any], start_s: float, end_s: float) -> tuple[Any, Any]:
        """Return both ends of the line for a substep, by two Gauss points between knots: exact for a linear course."""
        inside = self.knots_s[(self.knots_s > start_s) & (self.knots_s < end_s)]
        edges = np.concatenate([[start_s], inside, [end_s]])
        first = last = 0.0
        for a, b in itertools.pairwise(edges):
            for node in (-1.0, 1.0):
                t = 0.5 * (a + b) + 0.5 * (b - a) * node / math.sqrt(3.0)
                share, x = 0.5 * (b - a) / (end_s - start_s), (t - start_s) / (end_s - start_s)
                value = course(t)
                first = first + share * (4.0 - 6.0 * x) * value
                last = last + share * (6.0 * x - 2.0) * value
        return first, last

    def final_force(self) -> Float:
        """Return the force [N], (n,), of the load after its last time."""
        return self.operator @ self.pressure(float(self.knots_s[-1]))

    def pressure(self, t: float) -> Float:
        """Return the pressure [Pa] at the points of the load at time t [s]; 0 before the load, constant after it."""
        if self._shape is not None:
            return self._weight(t) * self._shape
        weights = self._knot_weights(t)
        if isinstance(self.load, Traction):
            return weights @ np.asarray(self.load.pressure_Pa)
        return float(weights @ np.asarray(self.load.peak_Pa)) * self._bell(weights @ self.centres)

    def _weight(self, t: float) -> float:
        """Return the peak [Pa] of a spot at time t [s]."""
        assert isinstance(self.load, Spot)
        return float(self._knot_weights(t) @ np.asarray(self.load.peak_Pa))

    def _knot_weights(self, t: float) -> Float:
        """Return the weights of the times of the load at time t [s], shape (f,)."""
        knots, weights = self.knots_s, np.zeros(len(self.knots_s))
        place = int(np.searchsorted(knots, t, side="right")) - 1
        if place >= 0:
            moves = place < len(knots) - 1 and self.load.law != "held"
            share = (t - knots[place]) / (knots[place + 1] - knots[place]) if moves else 0.0
            weights[place] += 1.0 - share
            weights[min(place + 1, len(knots) - 1)] += share
        return weights

    def _bell(self, centre: Float) -> Float:
        assert isinstance(self.load, Spot)
        return bell(self.points, centre, self.load.fwhm_m)


def bell(points: Float, centre: Float, fwhm_m: float) -> Float:
    """Return pressure over peak of a spot at points (n, 3), by their distance in x and y from its centre (2,)."""
    return np.exp(-GAUSSIAN * ((points[:, :2] - centre) ** 2).sum(axis=1) / fwhm_m**2)


def between_points(points: Float, normals: Float, areas_m2: Float, places: Float, facing: Float) -> sparse.csr_matrix:
    """Return the matrix from pressures at points to pressures at places, csr, (q, p), linear on triangles of points.

    Rows sum to 1; rows of places without pressure sum to 0. The corners of a triangle are near points, projected on
    the tangent plane at the place. The triangle with the least mean squared distance of corners is used, as in a
    Delaunay triangulation (Rajan 1994, Discrete Comput. Geom. 12, 189). A place outside all triangles has the pressure
    of the nearest point, up to the radius of a disc of the area of this point.

    points, normals: [m] and outward unit vectors, shape (p, 3). areas_m2: area of each point, (p,).
    places, facing: positions [m] and outward unit vectors of the places, shape (q, 3).
    """
    tree = cKDTree(points)
    spacing = _spacing(tree, points, areas_m2)
    parts = [
        _shares(tree, points, normals, spacing, places[n : n + CHUNK], facing[n : n + CHUNK])
        for n in range(0, len(places), CHUNK)
    ]
    return sparse.csr_matrix(sparse.vstack(parts))


def spread_forces(
    points: Float, normals: Float, areas_m2: Float, places: Float, facing: Float, weights_m2: Float
) -> sparse.csr_matrix:
    """Return the matrix from pressures at points to pressures at places, csr, (q, p); each point acts on a disc.

    The pressure falls from the middle of the disc as a parabola; its force is pressure times the area of the point. If
    no place lies on the disc, the column is empty. Arguments as for `between_points`; weights_m2: areas of places, (q,)
    """
    # Parabola with the second moment of the disc
    reach = np.sqrt(1.5 * areas_m2 / np.pi)
    neighbours = cKDTree(places).query_ball_point(points, reach)
    columns = np.repeat(np.arange(len(points)), [len(one) for one in neighbours])
    rows = np.concatenate([np.asarray(one, dtype=int) for one in neighbours])
    far = np.linalg.norm(places[rows] - points[columns], axis=1) / reach[columns]
    shape = np.where((facing[rows] * normals[columns]).sum(axis=1) > SAME_SIDE, np.maximum(1.0 - far**2, 0.0), 0.0)
    force = np.bincount(columns, shape * weights_m2[rows], len(points))
    scale = np.divide(areas_m2, force, out=np.zeros_like(force), where=force > 0.0)
    return sparse.coo_matrix((shape * scale[columns], (rows, columns)), (len(places), len(points))).tocsr()


def _spacing(tree: cKDTree, points: Float, areas_m2: Float) -> Float:
    """Return the root of the mean area of each point and the points around it [m], shape (p,)."""
    own = np.sqrt(areas_m2)
    count = min(CLOSEST, len(points))
    far, who = (part.reshape(len(points), count) for part in tree.query(points, count))
    around = far <= LONGEST * own[:, None]
    return np.asarray(np.sqrt((areas_m2[who] * around).sum(axis=1) / around.sum(axis=1)))


def _shares(
    tree: cKDTree, points: Float, normals: Float, spacing: Float, places: Float, facing: Float
) -> sparse.csr_matrix:
    count = min(NEIGHBOURS, len(points))
    far, chosen = (part.reshape(len(places), count) for part in tree.query(places, count))
    same_side = np.einsum("qkc,qc->qk", normals[chosen], facing) > SAME_SIDE
    far = np.where(same_side, far, np.inf)
    first = far.argmin(axis=1)
    rows = np.arange(len(places))
    step = spacing[chosen[rows, first]]
    flat = _in_plane(points[chosen] - places[:, None], facing) / step[:, None, None]
    corners, shares = _triangle(flat, far <= LONGEST * step[:, None])
    inside = corners[:, 0] >= 0
    outside = ~inside & (far[rows, first] <= DISC * step)
    three = np.take_along_axis(chosen[inside], corners[inside], axis=1)
    row = np.concatenate([np.repeat(rows[inside], 3), rows[outside]])
    column = np.concatenate([three.ravel(), chosen[outside, first[outside]]])
    value = np.concatenate([shares[inside].ravel(), np.ones(int(outside.sum()))])
    return sparse.coo_matrix((value, (row, column)), (len(places), len(points))).tocsr()


def _in_plane(steps: Float, normals: Float) -> Float:
    """Return the two components of vectors (q, k, 3) perpendicular to normals (q, 3), shape (q, k, 2)."""
    helper = np.eye(3)[np.abs(normals).argmin(axis=1)]
    along = np.cross(normals, helper)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    axes = np.stack([along, np.cross(normals, along)], axis=1)
    return np.einsum("qkc,qac->qka", steps, axes)


def _triangle(flat: Float, counted: np.ndarray) -> tuple[Int, Float]:
    """Return the corners (q, 3) of the Delaunay triangle that contains 0 and their shares there; -1 if there is none.

    flat: near points, shape (q, k, 2); counted: whether a point may be a corner, (q, k)
    """
    best = np.full(len(flat), np.inf)
    corners, shares = np.full((len(flat), 3), -1), np.zeros((len(flat), 3))
    squared = (flat**2).sum(axis=2)
    cross = flat[:, :, None, 0] * flat[:, None, :, 1] - flat[:, :, None, 1] * flat[:, None, :, 0]
    for a, b, c in itertools.combinations(range(flat.shape[1]), 3):
        parts = np.stack([cross[:, b, c], cross[:, c, a], cross[:, a, b]], axis=1)
        twice = parts.sum(axis=1)
        good = counted[:, a] & counted[:, b] & counted[:, c] & (np.abs(twice) > FLAT)
        parts = np.divide(parts, twice[:, None], out=np.full_like(parts, -1.0), where=good[:, None])
        mean = (parts * squared[:, [a, b, c]]).sum(axis=1)
        better = (parts.min(axis=1) >= -1e-12) & (mean < best)
        best[better], corners[better], shares[better] = mean[better], (a, b, c), parts[better]
    return corners.astype(np.int32), shares
