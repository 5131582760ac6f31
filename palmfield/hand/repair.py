"""Repair the faults of a mesh that can be repaired safely, and report the others with their positions."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from palmfield.hand.holes import boundary_loops, cap, least_area_faces, plane_axes
from palmfield.hand.triangles import (
    consistent_winding,
    directed_edges,
    face_components,
    face_normals,
    unique_edges,
    volume,
    winding_numbers,
)
from palmfield.types import Float, Int

# Vertices closer than this share of the extent are merged: UV seams and STL repeat positions, exactly or rounded.
MERGE_SHARE = 1e-6
# A face is degenerate if its height is below this share of its longest side.
FLAT_SHARE = 1e-6
SMALL_HOLE_EDGES = 6
CRUMB_SHARE = FIN_SHARE = 0.01
# A wrist opening is in the last sixth of the length, is cut across it and has a long perimeter (ANSUR II: 0.85 of the
# hand length; an elbow about half of the length of forearm and hand).
WRIST_END_SHARE, WRIST_COSINE, WRIST_AROUND_SHARE = 1.0 / 6.0, 0.6, 0.4
MOST_PLACES, WITHIN_POINTS = 50, 100
Outcome = Literal["repaired", "refused", "noted"]
NO_VOLUME = "it encloses no volume; give a closed hand, not a flat sheet"


@dataclass(frozen=True)
class Finding:
    """One kind of fault: name, count, outcome, positions in the unit of the mesh, shape (k, 3), and description."""

    name: str
    count: int
    outcome: Outcome
    places: Float
    text: str


class Repair:
    """A mesh during repair; faults that cannot be repaired are reported as refused, and the mesh is not changed there.

    vertices: shape (n, 3); faces: shape (m, 3); findings: findings in the order of the steps
    carry: matrix from values at the vertices of the file to values at `vertices`, shape (n, n_file)
    """

    def __init__(self, vertices: Float, faces: Int) -> None:
        self.vertices, self.faces = vertices, faces
        self.carry = sparse.csr_array(sparse.eye_array(len(vertices)))
        self.findings: list[Finding] = []

    @property
    def refused(self) -> list[Finding]:
        return [finding for finding in self.findings if finding.outcome == "refused"]

    def note(self, name: str, count: int, outcome: Outcome, places: Float, text: str) -> None:
        if count:
            self.findings.append(Finding(name, count, outcome, np.reshape(places, (-1, 3))[:MOST_PLACES], text))

    def keep(self, vertices: Int) -> None:
        """Keep these vertices, in this order; they must include all vertices of faces."""
        new = np.full(len(self.vertices), -1, dtype=np.int32)
        new[vertices] = np.arange(len(vertices))
        self.vertices, self.carry, self.faces = self.vertices[vertices], self.carry[vertices], new[self.faces]

    def add(self, rows: sparse.csr_array, points: Float, faces: Int) -> None:
        """Add faces and vertices; `rows` computes the values at new vertices from those at present ones."""
        self.carry = sparse.csr_array(sparse.vstack([self.carry, rows @ self.carry]))
        self.vertices = np.concatenate([self.vertices, points])
        self.faces = np.concatenate([self.faces, faces]).astype(np.int32)


def repair(vertices: Float, faces: Int) -> Repair:
    """Repair the mesh of a hand; the result is valid if it has no refused finding.

    vertices: any unit, shape (n, 3); faces: shape (m, 3), int32, of existing vertices, m > 0
    """
    mesh = Repair(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32))
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(mesh.vertices).all(axis=1))
    if not finite.all():
        _drop_not_finite(mesh, finite)
        return mesh
    _merge(mesh)
    _drop_degenerate(mesh)
    _drop_duplicates(mesh)
    _drop_fins(mesh)
    if len(mesh.faces) == 0:
        mesh.note("no faces", 1, "refused", np.zeros((0, 3)), "its faces have no area; export it again")
        return mesh
    if float(np.ptp((mesh.vertices @ plane_axes(mesh.vertices).T)[:, 2])) < MERGE_SHARE * float(np.ptp(mesh.vertices)):
        mesh.note("no volume", 1, "refused", np.zeros((0, 3)), NO_VOLUME)
    if mesh.refused:
        return mesh
    _split_pinched(mesh)
    _drop_crumbs(mesh)
    mesh.keep(np.unique(mesh.faces))
    own = len(mesh.faces)
    _close(mesh)
    _check_closed(mesh)
    _split_pinched(mesh)
    if not mesh.refused:
        _turn_outward(mesh, own)
    return mesh


def _drop_not_finite(mesh: Repair, finite: NDArray[np.bool_]) -> None:
    whole = finite[mesh.faces].all(axis=1)
    near = np.unique(mesh.faces[~whole])
    places = mesh.vertices[near[finite[near]]]
    bad = int((~finite).sum())
    text = f"{bad} of {len(finite)} vertices are not finite numbers; export it again"
    mesh.note("not finite vertices", bad, "refused", places, text)
    mesh.faces = mesh.faces[whole]
    mesh.keep(np.unique(mesh.faces))


def _merge(mesh: Repair) -> None:
    """Merge vertices of equal position."""
    _, first, inverse = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    pairs = cKDTree(mesh.vertices[first]).query_pairs(MERGE_SHARE * extent, output_type="ndarray")
    links = sparse.coo_array((np.ones(len(pairs)), pairs.T), shape=(len(first), len(first)))
    number, label = sparse.csgraph.connected_components(links, directed=False)
    of_vertex = label[inverse.reshape(-1)]
    representative = np.full(number, len(mesh.vertices))
    np.minimum.at(representative, of_vertex, np.arange(len(mesh.vertices)))
    target = representative[of_vertex]
    used = np.zeros(len(target), dtype=np.bool_)
    used[mesh.faces] = True
    merged = used & (target != np.arange(len(target)))
    mesh.faces = target[mesh.faces].astype(np.int32)
    text = "vertices at equal positions (UV seams, STL corners) were merged"
    mesh.note("split vertices", int(merged.sum()), "repaired", mesh.vertices[merged], text)
    text = "vertices without a face were removed"
    mesh.note("unused vertices", int((~used).sum()), "repaired", np.zeros((0, 3)), text)
    mesh.keep(np.unique(mesh.faces))


def _drop_degenerate(mesh: Repair) -> None:
    """Remove faces without area if two corners coincide; otherwise flip the edge of their longest side."""
    faces = mesh.faces
    repeated = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    places = [mesh.vertices[faces[repeated]].mean(axis=1)]
    faces = faces[~repeated]
    sides = np.stack(
        [np.linalg.norm(mesh.vertices[faces[:, (i + 1) % 3]] - mesh.vertices[faces[:, i]], axis=1) for i in range(3)]
    )
    flat = 2.0 * face_normals(mesh.vertices, faces)[1] <= FLAT_SHARE * sides.max(axis=0) ** 2
    places.append(mesh.vertices[faces[flat]].mean(axis=1))
    dropped = np.zeros(len(faces), dtype=np.bool_)
    for needle in np.flatnonzero(flat):
        i = int(np.argmax(sides[:, needle]))
        a, b, tip = (int(faces[needle, (i + k) % 3]) for k in range(3))
        neighbour = np.flatnonzero(((faces == a).any(axis=1) & (faces == b).any(axis=1)) & ~dropped)
        neighbour = neighbour[neighbour != needle]
        if len(neighbour) != 1 or tip in faces[neighbour[0]]:
            dropped[needle] = True
            continue
        other = faces[neighbour[0]].copy()
        faces[needle], faces[neighbour[0]] = np.where(other == a, tip, other), np.where(other == b, tip, other)
    mesh.faces = faces[~dropped]
    where = np.concatenate(places)
    mesh.note("degenerate faces", len(where), "repaired", where, "faces without area were removed")


def _drop_duplicates(mesh: Repair) -> None:
    first = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_index=True)[1]
    extra = np.ones(len(mesh.faces), dtype=np.bool_)
    extra[first] = False
    places = mesh.vertices[mesh.faces[extra]].mean(axis=1)
    mesh.note("duplicate faces", int(extra.sum()), "repaired", places, "duplicate faces were removed")
    mesh.faces = mesh.faces[~extra]


def _drop_fins(mesh: Repair) -> None:
    """Remove small sheets attached to edges of more than two faces; refuse other such edges."""
    edges, count = unique_edges(mesh.faces)
    bad = edges[count > 2]
    places = mesh.vertices[bad].mean(axis=1)
    whole = float(face_normals(mesh.vertices, mesh.faces)[1].sum())
    removed = 0
    while len(bad):
        sheet = face_components(mesh.faces, bad)
        area = np.bincount(sheet, weights=face_normals(mesh.vertices, mesh.faces)[1])
        open_edges = {tuple(edge) for edge in edges[count == 1].tolist()}
        directed = np.sort(directed_edges(mesh.faces), axis=1)
        owner = np.tile(sheet, 3)
        keys = {tuple(edge) for edge in bad.tolist()}
        hanging = {int(s) for edge, s in zip(map(tuple, directed.tolist()), owner, strict=True) if edge in keys}
        loose = {int(s) for edge, s in zip(map(tuple, directed.tolist()), owner, strict=True) if edge in open_edges}
        fins = [s for s in hanging & loose if area[s] < FIN_SHARE * whole]
        if not fins:
            break
        removed_faces = np.isin(sheet, fins)
        removed += int(removed_faces.sum())
        mesh.faces = mesh.faces[~removed_faces]
        edges, count = unique_edges(mesh.faces)
        bad = edges[count > 2]
    if removed:
        text = f"faces of sheets attached to edges with three faces were removed ({removed})"
        mesh.note("non-manifold edges", len(places), "repaired", places, text)
    where = mesh.vertices[bad].mean(axis=1)
    text = "edges are shared by more than two faces; remove the extra faces"
    mesh.note("non-manifold edges", len(bad), "refused", where, text)


def _split_pinched(mesh: Repair) -> None:
    """Split a vertex without open edges at which several fans of faces meet, into one vertex per fan."""
    faces = mesh.faces
    start, end = directed_edges(np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)).T
    flat = faces.ravel()
    swap = flat[start] > flat[end]
    low, high = np.where(swap, end, start), np.where(swap, start, end)
    order = np.lexsort((flat[high], flat[low]))
    low, high = low[order], high[order]
    same = (flat[low][1:] == flat[low][:-1]) & (flat[high][1:] == flat[high][:-1])
    a = np.concatenate([low[:-1][same], high[:-1][same]])
    b = np.concatenate([low[1:][same], high[1:][same]])
    links = sparse.coo_array((np.ones(len(a)), (a, b)), shape=(len(flat), len(flat)))
    number, fan = sparse.csgraph.connected_components(links, directed=False)
    edges, count = unique_edges(faces)
    opened = np.isin(flat, edges[count == 1])
    # A vertex with open edges is not split, because the faces that close its holes may join the fans
    label = np.where(opened, flat + number, fan)
    _, first, part = np.unique(label, return_index=True, return_inverse=True)
    origin = flat[first]
    repeated = np.bincount(origin, minlength=len(mesh.vertices)) > 1
    if not repeated.any():
        return
    text = "vertices at which the surface only touches itself were split"
    mesh.note("pinched vertices", int(repeated.sum()), "repaired", mesh.vertices[repeated], text)
    mesh.vertices, mesh.carry = mesh.vertices[origin], mesh.carry[origin]
    mesh.faces = part.reshape(-1, 3).astype(np.int32)


def _drop_crumbs(mesh: Repair) -> None:
    label = face_components(mesh.faces)
    area = np.bincount(label, weights=face_normals(mesh.vertices, mesh.faces)[1])
    crumbs = np.flatnonzero(area < CRUMB_SHARE * area.sum())
    middle = [mesh.vertices[np.unique(mesh.faces[label == body])].mean(axis=0) for body in range(len(area))]
    text = f"bodies with less than {100 * CRUMB_SHARE:g} % of the area were removed"
    mesh.note("crumbs", len(crumbs), "repaired", np.array([middle[c] for c in crumbs]), text)
    largest = int(np.argmax(area))
    others = [b for b in range(len(area)) if b != largest and b not in crumbs]
    shells = [b for b in others if _within(mesh.vertices, mesh.faces[label == largest], mesh.faces[label == b])]
    text = "bodies inside the largest one, which sound does not reach, were removed"
    mesh.note("inner shells", len(shells), "repaired", np.array([middle[b] for b in shells]), text)
    removed_faces = np.union1d(crumbs, shells)
    mesh.faces = mesh.faces[~np.isin(label, removed_faces)]
    bodies = np.setdiff1d(np.arange(len(area)), removed_faces)
    if len(bodies) > 1:
        text = f"it has {len(bodies)} separate bodies; keep only the hand"
        mesh.note("several bodies", len(bodies), "refused", np.array([middle[b] for b in bodies]), text)


def _within(vertices: Float, outer: Int, inner: Int) -> bool:
    """Return whether a sample of vertices of body `inner` is inside body `outer`, which may have holes."""
    used = np.unique(inner)
    some = vertices[used[:: max(1, len(used) // WITHIN_POINTS)]]
    return bool((np.abs(winding_numbers(vertices, outer, some)) > 0.5).all())


def _close(mesh: Repair) -> None:
    """Close small holes and the wrist; refuse other holes."""
    loops = boundary_loops(mesh.faces)
    small = [loop for loop in loops if len(loop) <= SMALL_HOLE_EDGES]
    large = [loop for loop in loops if len(loop) > SMALL_HOLE_EDGES]
    middle = {id(loop): mesh.vertices[loop].mean(axis=0) for loop in loops}
    wrist = [loop for loop in large if _is_wrist(mesh.vertices, loop)]
    filled = [loop[least_area_faces(mesh.vertices[loop])] for loop in small]
    mesh.faces = np.concatenate([mesh.faces, *filled]).astype(np.int32)
    text = f"holes of at most {SMALL_HOLE_EDGES} edges were filled"
    mesh.note("small holes", len(small), "repaired", np.array([middle[id(loop)] for loop in small]), text)
    holes = [loop for loop in large if len(wrist) != 1 or loop is not wrist[0]]
    text = "it is not watertight: holes remain; fill them in the modelling program"
    mesh.note("holes", len(holes), "refused", np.array([middle[id(loop)] for loop in holes]), text)
    if len(wrist) != 1:
        return
    loop = wrist[0]
    closed = cap(mesh.vertices[loop], _edges_between(mesh.faces, loop))
    where = middle[id(loop)]
    if closed is None:
        text = f"its rim of {len(loop)} edges cannot be closed; cut it straight across"
        mesh.note("open wrist", 1, "refused", where, text)
        return
    inner, faces = closed
    number = np.concatenate([loop, len(mesh.vertices) + np.arange(len(inner))])
    rows = np.repeat(np.arange(len(inner)), len(loop))
    share = np.full(len(rows), 1.0 / len(loop))
    spread = sparse.csr_array((share, (rows, np.tile(loop, len(inner)))), shape=(len(inner), len(mesh.vertices)))
    mesh.add(spread, inner, number[faces])
    text = f"a loop of {len(loop)} edges was closed by {len(faces)} triangles"
    mesh.note("open wrist", 1, "repaired", where, text)


def _edges_between(faces: Int, loop: Int) -> set[tuple[int, int]]:
    """Return pairs of loop numbers, the lower first, that an edge of the mesh outside the loop already joins."""
    place = {vertex: number for number, vertex in enumerate(loop.tolist())}
    edges, count = unique_edges(faces)
    both = edges[np.isin(edges, loop).all(axis=1) & (count > 1)].tolist()
    pairs = [(place[a], place[b]) for a, b in both]
    return {(min(pair), max(pair)) for pair in pairs}


def _check_closed(mesh: Repair) -> None:
    """Refuse a mesh in which filling a hole gave an edge three faces."""
    edges, count = unique_edges(mesh.faces)
    places = mesh.vertices[edges[count > 2]].mean(axis=1)
    text = "filling the holes would give edges with more than two faces; fill them in the modelling program"
    mesh.note("holes", len(places), "refused", places, text)


def _is_wrist(vertices: Float, loop: Int) -> bool:
    """Return whether a loop goes around one end of the mesh, across its length."""
    along = plane_axes(vertices)[0]
    height = (vertices - vertices.mean(axis=0)) @ along
    place = (vertices[loop].mean(axis=0) - vertices.mean(axis=0)) @ along
    length = float(np.ptp(height))
    around = float(np.linalg.norm(vertices[loop] - np.roll(vertices[loop], -1, axis=0), axis=1).sum())
    at_end = min(place - height.min(), height.max() - place) < WRIST_END_SHARE * length
    across = abs(plane_axes(vertices[loop])[2] @ along) > WRIST_COSINE
    return bool(at_end and across and around > WRIST_AROUND_SHARE * length)


def _turn_outward(mesh: Repair, own: int) -> None:
    """Make the winding consistent and outward; report flips among the first `own` faces, those of the file."""
    before = mesh.faces
    faces = consistent_winding(before)
    if len(np.unique(directed_edges(faces), axis=0)) < 3 * len(faces):
        mesh.note("one-sided surface", 1, "refused", np.zeros((0, 3)), "it has no inside; export it as a closed body")
        return
    size = volume(mesh.vertices, faces)
    if abs(size) < 1e-9 * float(np.ptp(mesh.vertices, axis=0).max()) ** 3:
        mesh.note("no volume", 1, "refused", np.zeros((0, 3)), NO_VOLUME)
        return
    if size < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    # A flipped face differs in the order of its corners
    turned = (_orientation(before) != _orientation(faces))[:own]
    places = mesh.vertices[faces[:own][turned]].mean(axis=1)
    if turned.mean() > 0.5:
        text = f"{int(turned.sum())} faces pointed inwards; all were reversed"
        mesh.note("inside out", 1, "repaired", mesh.vertices.mean(axis=0), text)
    else:
        mesh.note("flipped faces", int(turned.sum()), "repaired", places, "faces that pointed inwards were reversed")
    mesh.faces = faces


def _orientation(faces: Int) -> np.ndarray:
    """Return True for faces whose corners, from the lowest number on, are ascending."""
    first = np.argmin(faces, axis=1)
    row = np.arange(len(faces))
    return faces[row, (first + 1) % 3] < faces[row, (first + 2) % 3]
