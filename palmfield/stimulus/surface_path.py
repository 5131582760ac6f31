"""Paths on a triangle mesh: plane paths drawn along the surface, and shortest paths through points.

A line on the mesh is straight across an edge if it is straight with both triangles in one plane (K. Polthier, M.
Schmies, Straightest geodesics on polyhedral surfaces, 1998).
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import SceneError
from palmfield.hand.geodesic import Piece, shortest_way
from palmfield.hand.triangles import closest_on_each, face_normals, numbered_edges, vertex_normals
from palmfield.stimulus.curves import PlanePath, folded, zigzag_about
from palmfield.types import Float, Int, Surface

REACH_m = 0.02
"""Largest distance of a start or waypoint from the surface; beyond it an error is raised."""

TOUCH_m = 1e-9
"""Distance [m] at which a path has reached the edge of an open mesh: far above rounding, far below sizes of skin."""

ALONG = 1e-9
"""Sine of the angle to an edge below which a path is parallel to it and does not reach it."""

CLOSING_ROUNDS = 12
CLOSING_SHARE = 0.02
"""Largest gap of a closed path, as a share of its length, that is closed by a straight line."""


@dataclass(frozen=True)
class SurfacePath:
    """A path on a triangle mesh that follows the mesh when its vertices move.

    Between two consecutive points the path is straight and within the triangle of the first point.
    faces: triangle of each point, shape (n,); barycentric: weights of its corners, shape (n, 3)
    arc_m: arc length from the start on the original mesh [m], shape (n,)
    closed: whether the last point is the first one; an open path is traversed there and back
    """

    faces: Int
    barycentric: Float
    arc_m: Float
    closed: bool

    @property
    def length_m(self) -> float:
        """Length of one turn, or of one way of an open path."""
        return float(self.arc_m[-1])

    def at(self, arc_m: ArrayLike, vertices: Float, mesh_faces: Int) -> tuple[Float, Float]:
        """Return positions [m] and unit outward normals, shape (k, 3) each, at any arc lengths [m], shape (k,).

        vertices: present vertices of the mesh [m], shape (v, 3); mesh_faces: its triangles, shape (m, 3)
        Normals are interpolated from angle-weighted vertex normals.
        """
        corners = mesh_faces[self.faces]
        used = np.zeros(len(vertices), dtype=np.bool_)
        used[corners] = True
        around = mesh_faces[used[mesh_faces].any(axis=1)]
        near, local = np.unique(around, return_inverse=True)
        normals = np.zeros((len(vertices), 3))
        normals[near] = vertex_normals(vertices[near], local.reshape(-1, 3).astype(np.int32))
        points = np.einsum("ni,nij->nj", self.barycentric, vertices[corners])
        outward = np.einsum("ni,nij->nj", self.barycentric, normals[corners])
        segment, share = self._between(arc_m)
        normal = (1.0 - share) * outward[segment] + share * outward[segment + 1]
        position = (1.0 - share) * points[segment] + share * points[segment + 1]
        return position, normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def positions(self, arc_m: ArrayLike, vertices: Float, mesh_faces: Int) -> Float:
        """Return only the positions of `at`, shape (k, 3), which is much faster for few arc lengths."""
        segment, share = self._between(arc_m)
        ends: list[Float] = []
        for n in (segment, segment + 1):
            corners = vertices[mesh_faces[self.faces[n]]]
            ends.append((self.barycentric[n][:, None, :] @ corners)[:, 0])
        first, last = ends
        return (1.0 - share) * first + share * last

    def _between(self, arc_m: ArrayLike) -> tuple[NDArray[np.intp], Float]:
        """Return the segment of each arc length, shape (k,), and the share of the segment before it, shape (k, 1)."""
        arc = folded(arc_m, self.arc_m[-1], self.closed)
        segment = np.minimum(np.maximum(self.arc_m.searchsorted(arc, "right") - 1, 0), len(self.arc_m) - 2)
        step = self.arc_m[segment + 1] - self.arc_m[segment]
        # Between points that coincide the share is 0, for any rounding
        return segment, ((arc - self.arc_m[segment]) / np.maximum(step, 1e-300))[:, None]


@dataclass(frozen=True)
class _Mesh:
    """A mesh. corners: shape (m, 3, 3); normals: unit, shape (m, 3); across[f, i]: face beyond the edge opposite corner
    i, -1 if there is none or more than one."""

    corners: Float
    normals: Float
    across: Int


@dataclass(frozen=True)
class _Place:
    """A point of the mesh: face, position [m], and the unit tangent that corresponds to x of the plane path."""

    face: int
    position: Float
    x: Float


def drawn(surface: Surface, start_point: ArrayLike, direction: ArrayLike, path: PlanePath) -> SurfacePath:
    """Draw a plane path on a surface, segment by segment along straight lines of the mesh.

    start_point: origin of the plane of the path [m], shape (3,), moved to the nearest point of the surface. From there
        a straight line, which is not drawn, goes to the first point of the path.
    direction: +x of the path, shape (3,), of any length; projected to the tangent plane. +y is 90 degrees
        counter-clockwise from it, seen from outside.
    An open path keeps its arc lengths. A closed path would not meet its start on curved skin. Its turning is therefore
    reduced evenly by the rotation due to the curvature (Gauss-Bonnet), and the remaining gap is closed. Its `arc_m` is
    scaled to the length of the plane path, from which the true length differs slightly (see `_closed_walk`).
    Raises SceneError for a start more than 20 mm off the surface, a direction along the normal, triangles without area,
    a path that leaves an open mesh or ends within TOUCH_m of its edge (with the arc length), and a closed path that
    misses its start by more than 2 % of its length, as on skin that is too curved for its size.
    """
    start = _vector("start_point", start_point)
    along = _vector("direction", direction)
    _check(surface)
    mesh = _mesh(surface)
    face, position = _nearest(surface, start, "start of the path")
    normal = mesh.normals[face]
    tangent = along - (along @ normal) * normal
    if np.linalg.norm(tangent) < 1e-6 * max(float(np.linalg.norm(along)), 1e-300):
        raise SceneError(
            f"direction {along.tolist()} has no component along the skin; give one that is not along its normal"
        )
    place = _Place(face, position, tangent / np.linalg.norm(tangent))
    _, place = _walk(mesh, place, path.points[:1])
    legs = np.diff(path.corners, axis=0)
    if not path.closed:
        piece, _ = _walk(mesh, place, legs)
        return _skin_path(surface, piece, False)
    piece, end = _closed_walk(mesh, place, legs)
    gap = float(np.linalg.norm(end.position - place.position))
    if gap > CLOSING_SHARE * path.length_m:
        raise SceneError(
            f"closed path of {1e3 * path.length_m:.1f} mm misses its start by {1e3 * gap:.1f} mm, because the skin "
            "is curved here; make it smaller, or place it elsewhere"
        )
    shut = shortest_way(surface, (end.face, end.position), (place.face, place.position), 0)
    closed = _skin_path(surface, _joined([piece, shut]), True)
    return replace(closed, arc_m=closed.arc_m * (path.length_m / closed.length_m))


def through(surface: Surface, waypoints: ArrayLike) -> SurfacePath:
    """Return the open shortest path along a surface through points in order.

    waypoints: [m], shape (k, 3), at least two; each is moved to the nearest point of the surface
    Raises SceneError for another shape, a waypoint more than 20 mm off the surface, equal consecutive points, and
    points on disconnected parts of the mesh.
    """
    points = np.asarray(waypoints, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
        raise SceneError(f"waypoints have shape {points.shape}; give (k, 3) in metres, at least two points")
    _check(surface)
    places = [_nearest(surface, _vector(f"waypoint {i}", p), f"waypoint {i}") for i, p in enumerate(points)]
    for i, (one, other) in enumerate(pairwise(places)):
        if np.linalg.norm(other[1] - one[1]) < 1e-9:
            raise SceneError(f"waypoints {i} and {i + 1} are the same point of the surface; remove one")
    pieces = [shortest_way(surface, one, other, i) for i, (one, other) in enumerate(pairwise(places))]
    return _skin_path(surface, _joined(pieces), False)


def zigzag_through(surface: Surface, waypoints: ArrayLike, width_m: float, stroke_m: float) -> SurfacePath:
    """Return an open zigzag along a surface about the shortest path through points in order.

    Its corners are at a distance of width_m / 2 on both sides of that path, every stroke_m along it; strokes are the
    shortest paths from corner to corner. It begins on the right as seen from outside. Raises SceneError like `through`,
    for bad sizes, and if the surface ends within the width.
    """
    line = through(surface, waypoints)
    mesh = _mesh(surface)
    along, left = zigzag_about(line.length_m, width_m, stroke_m)
    corners = np.einsum("ni,nij->nj", line.barycentric, surface.vertices[surface.faces[line.faces]])
    # Coincident points of the path have no direction
    starts = np.flatnonzero(np.diff(line.arc_m) > TOUCH_m)
    places = []
    for arc, offset in zip(along, left, strict=True):
        n = int(starts[max(line.arc_m[starts].searchsorted(arc, "right") - 1, 0)])
        ahead = corners[n + 1] - corners[n]
        ahead = ahead / np.linalg.norm(ahead)
        place = _Place(int(line.faces[n]), corners[n] + (arc - line.arc_m[n]) * ahead, ahead)
        _, end = _walk(mesh, place, np.array([[0.0, offset]]))
        places.append((end.face, end.position))
    pieces = [shortest_way(surface, one, other, i) for i, (one, other) in enumerate(pairwise(places))]
    return _skin_path(surface, _joined(pieces), False)


def _vector(name: str, value: ArrayLike) -> Float:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise SceneError(f"{name} = {vector.tolist()} is not a point or direction; give three finite numbers")
    return vector


def _check(surface: Surface) -> None:
    flat = np.flatnonzero(face_normals(surface.vertices, surface.faces)[1] == 0.0)
    if len(flat):
        raise SceneError(f"the mesh has {len(flat)} triangles without area, the first is {flat[0]}; repair it first")


def _nearest(surface: Surface, point: Float, name: str) -> tuple[int, Float]:
    """Return the face and the point of the surface nearest to a point."""
    # In millimetres, because in metres the absolute tolerance at edges is too large for small triangles
    corners, points = 1e3 * surface.vertices[surface.faces], np.tile(1e3 * point, (len(surface.faces), 1))
    feet = 1e-3 * closest_on_each(corners, points)
    distance = np.linalg.norm(feet - point, axis=1)
    face = int(np.argmin(distance))
    if distance[face] > REACH_m:
        raise SceneError(
            f"{name} {point.tolist()} is {1e3 * distance[face]:.1f} mm from the surface; allowed: at most "
            f"{1e3 * REACH_m:g} mm: move it onto the skin"
        )
    return face, feet[face]


def _mesh(surface: Surface) -> _Mesh:
    faces = surface.faces
    owner = np.tile(np.arange(len(faces)), 3)
    # The edge from corner i to i + 1 is opposite corner i + 2
    opposite = np.repeat([2, 0, 1], len(faces))
    _, which, count = numbered_edges(faces)
    order = np.argsort(which, kind="stable")
    order = order[count[which[order]] == 2].reshape(-1, 2)
    across = np.full((len(faces), 3), -1, dtype=np.int32)
    for one, other in (order.T, order.T[::-1]):
        across[owner[one], opposite[one]] = owner[other]
    return _Mesh(surface.vertices[faces], face_normals(surface.vertices, faces)[0], across)


def _cross(a: Float, b: Float) -> Float:
    # numpy.cross takes ten times as long for one pair
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _walk(mesh: _Mesh, start: _Place, legs: Float) -> tuple[Piece, _Place]:
    """Walk straight along each leg [m], shape (n, 2), in a parallel-transported plane."""
    face, position, x = start.face, start.position, start.x
    faces: list[int] = []
    points = [position]
    done = 0.0
    for leg in legs:
        remaining = math.hypot(leg[0], leg[1])
        entered = -1
        while remaining > 0.0:
            normal = mesh.normals[face]
            ahead = leg[0] * x + leg[1] * _cross(normal, x)
            ahead /= math.sqrt(ahead @ ahead)
            corner, way = _exit(mesh, face, position, ahead, entered)
            if way >= remaining:
                way, corner = remaining, -1
            position = position + way * ahead
            remaining -= way
            done += way
            if way > 0.0:
                faces.append(face)
                points.append(position)
            if corner < 0:
                break
            beyond = int(mesh.across[face, corner])
            if beyond < 0:
                raise SceneError(
                    f"the path leaves the mesh after {1e3 * done:.1f} mm, or ends on its edge; make it shorter, "
                    "rotate it, or start elsewhere"
                )
            edge = mesh.corners[face][corner - 1] - mesh.corners[face][corner - 2]
            edge = edge / math.sqrt(edge @ edge)
            # With both triangles in one plane, a tangent keeps its components along the edge and across it
            across, other = _cross(normal, edge), _cross(mesh.normals[beyond], edge)
            x = (x @ edge) * edge + (x @ across) * other
            x /= math.sqrt(x @ x)
            entered = int(np.flatnonzero(mesh.across[beyond] == face)[0])
            face = beyond
    return (faces, points), _Place(face, position, x)


def _exit(mesh: _Mesh, face: int, position: Float, ahead: Float, entered: int) -> tuple[int, float]:
    """Return the corner opposite the edge through which a ray leaves a triangle, and the distance to that edge [m].

    The edge opposite `entered`, through which the ray entered, is excluded, so that a ray along an edge does not cross
    it repeatedly. An edge of the mesh is reached TOUCH_m before it, so that the result for a path that ends there does
    not depend on rounding; a ray along the edge does not reach it.
    """
    corners, normal = mesh.corners[face], mesh.normals[face]
    best, way = -1, math.inf
    for i in range(3):
        inward = _cross(normal, corners[i - 1] - corners[i - 2])
        # Height above the edge opposite corner i, and the speed at which the ray approaches it
        rate = -(ahead @ inward)
        height = (position - corners[i - 2]) @ inward
        least = 0.0
        if mesh.across[face, i] < 0:
            length = math.sqrt(inward @ inward)
            height, least = height - TOUCH_m * length, ALONG * length
        if rate > least and i != entered:
            reach = max(height / rate, 0.0)
            if reach < way:
                best, way = i, reach
    return best, way


def _closed_walk(mesh: _Mesh, start: _Place, legs: Float) -> tuple[Piece, _Place]:
    """Return the walk along the legs of a closed path that ends closest to its start.

    Each iteration distributes the rotation of the frame and the gap of the last iteration evenly along the path. A gap
    may remain, because vertices rotate the frame in jumps.
    """
    lengths = np.linalg.norm(legs, axis=1)
    share = (np.cumsum(lengths) - 0.5 * lengths) / lengths.sum()
    normal = mesh.normals[start.face]
    shift = np.zeros(2)
    angle = 0.0
    best: tuple[float, Piece, _Place] | None = None
    for _ in range(CLOSING_ROUNDS):
        cosine, sine = np.cos(angle * share), np.sin(angle * share)
        turned = np.stack([cosine * legs[:, 0] - sine * legs[:, 1], sine * legs[:, 0] + cosine * legs[:, 1]], axis=1)
        piece, end = _walk(mesh, start, turned + shift * (lengths / lengths.sum())[:, None])
        gap = start.position - end.position
        missing = float(np.linalg.norm(gap))
        if best is None or missing < best[0]:
            best = missing, piece, end
        x = end.x - (end.x @ normal) * normal
        x /= max(float(np.linalg.norm(x)), 1e-12)
        angle = -math.atan2(float(_cross(start.x, x) @ normal), float(start.x @ x))
        shift = shift + np.array([gap @ x, gap @ _cross(normal, x)])
    assert best is not None
    return best[1], best[2]


def _joined(pieces: list[Piece]) -> Piece:
    faces = [face for piece in pieces for face in piece[0]]
    points = [*pieces[0][1], *(point for piece in pieces[1:] for point in piece[1][1:])]
    return faces, points


def _skin_path(surface: Surface, piece: Piece, closed: bool) -> SurfacePath:
    from trimesh.triangles import points_to_barycentric

    segments, places = piece
    points = np.array(places)
    faces = np.array([*segments, segments[-1]], dtype=np.int32)
    # The default method squares lengths and loses digits on thin triangles: a weight had an error of 5e-9
    weights = points_to_barycentric(surface.vertices[surface.faces[faces]], points, method="cross")
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return SurfacePath(faces, weights, np.concatenate([[0.0], np.cumsum(steps)]), closed)
