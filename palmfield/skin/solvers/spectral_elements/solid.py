"""Surfaces of curved quadrilaterals with GLL nodes, extruded into hexahedra, sheet by sheet."""

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Sheet
from palmfield.types import Float, Int, Patch


@dataclass(frozen=True)
class Quads:
    """A surface of quadrilaterals of order N, counter-clockwise seen from outside; neighbours share nodes.

    nodes: positions [m], shape (s, 3). drop: vector from the surface to the base below a node [m], shape (s, 3).
    cells: nodes of each quadrilateral, first index along edge 0-1, second along 0-3, shape (m, n, n), int32.
    rim: True at boundary nodes of the surface, shape (s,). rim_normals: unit outward normals of the side, perpendicular
    to the drop, shape (s, 2, 3): two at corners of a box, one at other boundary nodes, and 0 elsewhere.
    """

    nodes: Float
    drop: Float
    cells: Int
    rim: np.ndarray
    rim_normals: Float


def number(corners: Int, order: int) -> Int:
    """Return the node numbers of quadrilaterals with vertices (m, 4), shape (m, n, n); neighbours share nodes.

    Vertices keep their numbers. Edges come next, from the lower to the higher vertex, then interiors.
    """
    n, inner = order + 1, order - 1
    count = int(corners.max()) + 1
    quads = len(corners)
    cells = np.empty((quads, n, n), dtype=np.int64)
    for vertex, (i, j) in enumerate(((0, 0), (order, 0), (order, order), (0, order))):
        cells[:, i, j] = corners[:, vertex]
    if inner:
        middle = slice(1, order)
        sides: dict[tuple[int, int], tuple[Any, Any]] = {
            (0, 1): (middle, 0),
            (1, 2): (order, middle),
            (3, 2): (middle, order),
            (0, 3): (0, middle),
        }
        pairs = np.concatenate([corners[:, list(ends)] for ends in sides])
        edges, edge_of = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True)
        forward = np.arange(inner)
        along = np.where((pairs[:, 0] < pairs[:, 1])[:, None], forward, forward[::-1])
        names = (count + edge_of.reshape(-1)[:, None] * inner + along).reshape(4, quads, inner)
        for name, place in zip(names, sides.values(), strict=True):
            cells[:, place[0], place[1]] = name
        count += len(edges) * inner
        interior = count + np.arange(quads * inner * inner)
        cells[:, middle, middle] = interior.reshape(quads, inner, inner)
    return cells.astype(np.int32)


def rim_edges(cells: Int) -> tuple[Int, Int]:
    """Return the nodes of boundary edges, in the direction with the surface on the left, (b, n), and their cells."""
    sides = np.concatenate([cells[:, :, 0], cells[:, -1, :], cells[:, ::-1, -1], cells[:, 0, ::-1]])
    ends = np.sort(sides[:, [0, -1]], axis=1)
    _, index, uses = np.unique(ends, axis=0, return_index=True, return_counts=True)
    border = np.sort(index[uses == 1])
    return sides[border], (border % len(cells)).astype(np.int32)


def finish(positions: Float, drops: Float, cells: Int, order: int) -> Quads:
    """Return the Quads of positions and drops by cell, (m, n, n, 3), with means at shared nodes, and rim normals."""
    count = int(cells.max()) + 1
    nodes, drop = np.empty((count, 3)), np.empty((count, 3))
    nodes[cells] = positions
    drop[cells] = drops
    edges, _ = rim_edges(cells)
    tangents = np.einsum("im,bmc->bic", rule(order).derivative, nodes[edges])
    outward = np.cross(drop[edges], tangents)
    outward /= np.linalg.norm(outward, axis=2, keepdims=True)
    normals = np.zeros((count, 2, 3))
    rim = np.zeros(count, dtype=bool)
    # An edge of the rim is the first edge of one end node and the second edge of the other
    for slot, part in ((0, slice(0, order)), (1, slice(order, order + 1))):
        normals[edges[:, part], slot] = outward[:, part]
    # Only corners keep two normals; elsewhere the two are nearly equal, and their mean is more accurate
    rim[edges] = True
    first, second = normals[:, 0].copy(), normals[:, 1].copy()
    smooth = np.einsum("sc,sc->s", first, second) > math.cos(math.radians(30.0))
    mean = first[smooth] + second[smooth]
    normals[smooth, 0] = mean / np.linalg.norm(mean, axis=1, keepdims=True)
    normals[smooth, 1] = 0.0
    return Quads(nodes, drop, cells, rim, normals)


def box_quads(x: Float, y: Float, thickness_m: float, order: int) -> Quads:
    """Return the rectangles between grid lines x and y [m] in the plane z = 0; the body is below."""
    cols, rows = len(x) - 1, len(y) - 1
    i, j = np.meshgrid(np.arange(cols), np.arange(rows), indexing="ij")
    low = (i * (rows + 1) + j).ravel()
    corners = np.stack([low, low + rows + 1, low + rows + 2, low + 1], axis=1)
    share = 0.5 * (1.0 + rule(order).nodes)
    px = x[:-1, None] + np.diff(x)[:, None] * share
    py = y[:-1, None] + np.diff(y)[:, None] * share
    n = order + 1
    positions = np.zeros((cols, rows, n, n, 3))
    positions[..., 0] = px[:, None, :, None]
    positions[..., 1] = py[None, :, None, :]
    flat = positions.reshape(-1, n, n, 3)
    drops = np.broadcast_to(np.array([0.0, 0.0, -thickness_m]), flat.shape)
    return finish(flat, drops, number(corners, order), order)


BULGE = 0.15


"""Bulge of the middle of the sides of the inner square, as a share of the half width: it removes half the kink of the
arcs of the rim."""


def disc_quads(thickness_m: float, half_m: float, core: int, radii_m: Float, order: int) -> Quads:
    """Return a disc: `core` x `core` cells in a bulged square of half width half_m [m], then rings of 4 `core` cells.

    radii_m: mean outer radius of each ring [m], ascending; the last is the radius of the disc
    """
    radius_m = float(radii_m[-1])
    middle = half_m * (1.0 + BULGE)
    edges = (np.concatenate([[middle], radii_m]) - middle) / (radius_m - middle)
    rings = len(radii_m)
    n = order + 1
    share = 0.5 * (1.0 + rule(order).nodes)
    s = -1.0 + 2.0 * (np.arange(core)[:, None] + share) / core
    r = edges[:-1, None] + np.diff(edges)[:, None] * share

    def square(a: Float, b: Float) -> Float:
        return half_m * np.stack([a * (1.0 + BULGE * (1.0 - b**2)), b * (1.0 + BULGE * (1.0 - a**2))], axis=-1)

    a = np.broadcast_to(s[:, None, :, None], (core, core, n, n))
    b = np.broadcast_to(s[None, :, None, :], (core, core, n, n))
    blocks = [square(a, b).reshape(-1, n, n, 2)]
    grid = np.arange((core + 1) ** 2).reshape(core + 1, core + 1)
    corners = [np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=-1).reshape(-1, 4)]
    # Counter-clockwise round the boundary of the square, by quarters
    around = np.concatenate([grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1], grid[:-1, 0]])
    loops = np.concatenate([around[None], grid.size + np.arange(4 * core * rings).reshape(rings, 4 * core)])
    angle = 0.25 * math.pi * s
    for quarter in range(4):
        turn = 0.5 * math.pi * quarter
        inner = square(np.ones_like(s), s) @ np.array(
            [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
        )
        outer = radius_m * np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=-1)
        inner, outer = inner[None, :, None, :, :], outer[None, :, None, :, :]
        part = r[:, None, :, None, None]
        blocks.append(((1.0 - part) * inner + part * outer).reshape(-1, n, n, 2))
        here = np.arange(quarter * core, (quarter + 1) * core)
        after = (here + 1) % (4 * core)
        corners.append(
            np.stack([loops[:-1, here], loops[1:, here], loops[1:, after], loops[:-1, after]], axis=-1).reshape(-1, 4)
        )
    flat = np.concatenate(blocks)
    positions = np.concatenate([flat, np.zeros((*flat.shape[:-1], 1))], axis=-1)
    drops = np.broadcast_to(np.array([0.0, 0.0, -thickness_m]), positions.shape)
    return finish(positions, drops, number(np.concatenate(corners), order), order)


def patch_quads(patch: Patch, order: int) -> Quads:
    """Return the triangles of a patch, each cut into three: vertex, middle of an edge, centroid, middle of an edge."""
    faces = np.asarray(patch.faces, dtype=np.int64)
    vertices = len(patch.vertices)
    edges, edge_of = np.unique(
        np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0, return_inverse=True
    )
    middle = vertices + edge_of.reshape(-1, 3)
    centre = vertices + len(edges) + np.arange(len(faces))
    corners = np.concatenate(
        [np.stack([faces[:, i], middle[:, i], centre, middle[:, i - 1]], axis=1) for i in range(3)]
    )
    points = np.concatenate([patch.vertices, patch.vertices[edges].mean(axis=1), patch.vertices[faces].mean(axis=1)])
    down = np.asarray(patch.inward) * np.asarray(patch.depth)[:, None]
    downs = np.concatenate([down, down[edges].mean(axis=1), down[faces].mean(axis=1)])
    share = 0.5 * (1.0 + rule(order).nodes)
    a, b = np.meshgrid(share, share, indexing="ij")
    weights = np.stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b], axis=-1)
    positions = np.einsum("ijv,mvc->mijc", weights, points[corners])
    drops = np.einsum("ijv,mvc->mijc", weights, downs[corners])
    return finish(positions, drops, number(corners, order), order)


@dataclass(frozen=True)
class Rule:
    """GLL rule of a polynomial order N, n = N + 1 nodes; it integrates polynomials of degree 2 N - 1 exactly.

    nodes: ascending, shape (n,). weights: shape (n,). derivative: D[i, m] = l_m'(x_i), shape (n, n).
    top: Legendre polynomial of degree N at the nodes, shape (n,).
    top_weights: weights for the share of `top` in a function, in the inner product of the rule, shape (n,).
    """

    nodes: Float
    weights: Float
    derivative: Float
    top: Float
    top_weights: Float


@functools.cache
def rule(order: int) -> Rule:
    """Return the rule of order N >= 1 (Canuto et al., Spectral Methods, 2006, sections 2.3 and 3.8)."""
    top_series = np.zeros(order + 1)
    top_series[order] = 1.0
    inner = np.real(legendre.legroots(legendre.legder(top_series))) if order > 1 else np.zeros(0)
    nodes = np.concatenate([[-1.0], np.sort(inner), [1.0]])
    top = legendre.legval(nodes, top_series)
    weights = 2.0 / (order * (order + 1) * top**2)
    gaps = nodes[:, None] - nodes + np.eye(order + 1)
    derivative = top[:, None] / (top * gaps)
    np.fill_diagonal(derivative, 0.0)
    # Rows sum to 0, so that a rigid shift gives exactly 0 strain
    np.fill_diagonal(derivative, -derivative.sum(axis=1))
    return Rule(nodes, weights, derivative, top, weights * top / (weights @ top**2))


def lagrange(order: int, x: Float) -> Float:
    """Return the values of the Lagrange polynomials of this order at x, shape (len(x), n)."""
    vandermonde = legendre.legvander(rule(order).nodes, order)
    at = legendre.legvander(np.asarray(x, dtype=np.float64), order)
    return np.asarray(np.linalg.solve(vandermonde.T, at.T).T, dtype=np.float64)


@dataclass(frozen=True)
class Solid:
    """Hexahedra below a surface. Node id = level * surface_nodes + surface node; level 0 is the face.

    order: N; nodes: positions [m], shape (levels * surface_nodes, 3)
    elements: nodes, shape (E, n^3), int32; the last direction runs inwards
    sheet: sheet of each element, shape (E,)
    surface_nodes, levels: counts; quads: the surface
    """

    order: int
    nodes: Float
    elements: Int
    sheet: Int
    surface_nodes: int
    levels: int
    quads: Quads

    def place(self, element: int) -> str:
        """Return the centre of an element for a message."""
        return ", ".join(f"{x:.4g}" for x in self.nodes[self.elements[element]].mean(axis=0))


def extrude(quads: Quads, sheets: tuple[Sheet, ...], deep: tuple[int, ...]) -> Solid:
    """Return the solid of `deep` elements through each sheet; thicknesses of sheets are shares of the drop.

    Raises SceneError, with the place [m], if a column of elements narrows to a point and is inverted below it.
    """
    order = quads.cells.shape[1] - 1
    ends = np.concatenate([[0.0], np.cumsum([sheet.thickness_m for sheet in sheets])])
    ends /= ends[-1]
    parts = zip(itertools.pairwise(ends), deep, strict=True)
    edges = np.concatenate([[0.0], *(low + (high - low) * np.arange(1, m + 1) / m for (low, high), m in parts)])
    layers = len(edges) - 1
    inner = 0.5 * (1.0 + rule(order).nodes[:-1])
    shares = np.concatenate([(edges[:-1, None] + np.diff(edges)[:, None] * inner).ravel(), [1.0]])
    levels, count = len(shares), len(quads.nodes)
    nodes = (quads.nodes + shares[:, None, None] * quads.drop).reshape(-1, 3)
    # First and second direction are exchanged, so that the axes are right-handed with the third inwards
    flat = quads.cells.transpose(0, 2, 1)
    offset = count * (order * np.arange(layers)[:, None] + np.arange(order + 1))
    elements = flat[None, :, :, :, None] + offset[:, None, None, None, :]
    solid = Solid(
        order=order,
        nodes=nodes,
        elements=elements.reshape(layers * len(flat), -1).astype(np.int32),
        sheet=np.repeat(np.repeat(np.arange(len(sheets)), deep), len(flat)).astype(np.int32),
        surface_nodes=count,
        levels=levels,
        quads=quads,
    )
    _check_turns(solid)
    return solid


def _check_turns(solid: Solid) -> None:
    """Raise SceneError if an edge of the base points against the same edge of the surface; det J > 0 there again."""
    n = solid.order + 1
    box = solid.elements.reshape(-1, n, n, n)[:, [0, -1]][:, :, [0, -1]][..., [0, -1]]
    corners = solid.nodes[box]
    worst = np.full(len(box), np.inf)
    for axis in (1, 2):
        edges = np.diff(corners, axis=axis)
        along = (edges[..., 0, :] * edges[..., 1, :]).sum(axis=-1)
        worst = np.minimum(worst, along.reshape(len(box), -1).min(axis=1))
    element = int(np.argmin(worst))
    if not worst[element] > 0.0:
        raise SceneError(inside_out(solid, element))


def inside_out(solid: Solid, element: int) -> str:
    return (
        f"skin element {element} near ({solid.place(element)}) m is flat or inverted: make the layer thinner "
        "there, or smooth the surface and its inward directions"
    )


def face_areas(solid: Solid) -> Float:
    """Return the outward area vectors of the surface nodes by GLL quadrature [m^2], shape (surface_nodes, 3)."""
    return _areas(solid, solid.nodes[: solid.surface_nodes])


def base_areas(solid: Solid) -> Float:
    """Return the area vectors of the nodes of the base, outwards [m^2], shape (surface_nodes, 3)."""
    return -_areas(solid, solid.nodes[-solid.surface_nodes :])


def cell_areas(x: Float, order: int) -> Float:
    """Return the area vectors of the nodes of cells with positions x by GLL quadrature [m^2], both (m, n, n, 3)."""
    gll = rule(order)
    area = np.cross(np.einsum("im,emjc->eijc", gll.derivative, x), np.einsum("jm,eimc->eijc", gll.derivative, x))
    area *= np.outer(gll.weights, gll.weights)[..., None]
    return area


def _areas(solid: Solid, nodes: Float) -> Float:
    cells = solid.quads.cells
    flat = cell_areas(nodes[cells], solid.order).reshape(-1, 3)
    return np.stack([np.bincount(cells.ravel(), flat[:, c], minlength=len(nodes)) for c in range(3)], axis=1)
