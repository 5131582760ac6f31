"""A patch of surface, extruded into a solid of wedges."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmfield.errors import SceneError
from palmfield.hand.triangles import directed_edges
from palmfield.skin.materials.material import Material, Sheet
from palmfield.skin.mesh.element import CORNERS, EDGES, corner_slopes, prism_rule
from palmfield.types import Float, Int, Patch


@dataclass(frozen=True)
class WedgeMesh:
    """Quadratic wedges below a surface. Node id = level * surface_nodes + surface node; level 0 is the skin surface.

    nodes: positions [m], shape (levels * surface_nodes, 3), float64.
    elements: nodes of each wedge in the order of element.py, shape (m, 18), int32.
    surface_nodes: number S of nodes in a level: the vertices of the patch, then the midpoints of its edges.
    levels: number of node levels, 2 L + 1 for L elements through the depth.
    surface_triangles6: surface nodes of each triangle: vertices, then edges 01, 12, 20, shape (t, 6), int32.
    side: nodes of the lateral boundary, all levels, right-angled corners twice. base: nodes of the deepest level.
    side_normals: unit normals at these nodes, perpendicular to `axis`, (len(side), 3); empty without an axis.
    axis: axis of the patch for roller sides, or None.
    """

    nodes: Float
    elements: Int
    surface_nodes: int
    levels: int
    surface_triangles6: Int
    base: Int
    side: Int
    side_normals: Float
    axis: Float | None

    def surface_normals(self, level: int = 0) -> Float:
        """Return the unit outward normals of one level, shape (S, 3): area-weighted means over adjacent triangles."""
        points = self.nodes[level * self.surface_nodes : (level + 1) * self.surface_nodes]
        a, b, c = (points[self.surface_triangles6[:, i]] for i in range(3))
        area = np.cross(b - a, c - a)
        total = np.zeros_like(points)
        for i in range(6):
            np.add.at(total, self.surface_triangles6[:, i], area)
        return total / np.linalg.norm(total, axis=1, keepdims=True)


def extrude(patch: Patch, fractions: Float) -> WedgeMesh:
    """Return the mesh of the solid between the patch and its offset by `depth` along `inward`.

    fractions: depths of the element boundaries as shares of the patch depth, 0 first, 1 last, rising, shape (L+1,).
    Raises SceneError for other fractions, and for an inverted or flat element, with its place [m].
    """
    shares = np.asarray(fractions, dtype=float)
    if (
        shares.ndim != 1
        or len(shares) < 2
        or shares[0] != 0.0
        or shares[-1] != 1.0
        or not np.all(np.diff(shares) > 0.0)
    ):
        raise SceneError(f"depth fractions are {np.round(shares, 4).tolist()}; they must rise from 0 to 1")
    layers = len(shares) - 1
    levels = 2 * layers + 1
    shares = np.interp(np.arange(levels) / 2.0, np.arange(layers + 1), shares)

    faces = np.asarray(patch.faces, dtype=np.int32)
    corners = len(patch.vertices)
    pairs = faces[:, EDGES].reshape(-1, 2)
    edges, edge_of, uses = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True, return_counts=True)
    triangles6 = np.concatenate([faces, corners + edge_of.reshape(-1, 3)], axis=1).astype(np.int32)
    surface_nodes = corners + len(edges)

    columns = patch.vertices + (shares[:, None] * patch.depth)[..., None] * patch.inward
    nodes = np.concatenate([columns, columns[:, edges].mean(axis=2)], axis=1).reshape(-1, 3)

    # Element levels are numbered from base to surface, so that zeta points outwards and det J > 0.
    stacks = [
        np.concatenate([triangles6 + (2 * layer + down) * surface_nodes for down in (2, 1, 0)], axis=1)
        for layer in range(layers)
    ]
    elements = np.concatenate(stacks).astype(np.int32)
    _check_volumes(nodes, elements)

    outer = (uses == 1) & patch.rim[edges].all(axis=1)
    rim = np.concatenate([np.flatnonzero(patch.rim), corners + np.flatnonzero(outer)])
    normals = np.zeros((0, 3))
    if patch.axis is not None:
        directed = np.column_stack([pairs, corners + edge_of.ravel()])[outer[edge_of.ravel()]]
        at_rim, turned, other = _rim_normals(patch.vertices, directed, patch.axis, surface_nodes)
        normals = np.tile(np.concatenate([at_rim[rim], other]), (levels, 1))
        rim = np.concatenate([rim, turned])
    return WedgeMesh(
        nodes=nodes,
        elements=elements,
        surface_nodes=surface_nodes,
        levels=levels,
        surface_triangles6=triangles6,
        base=np.arange((levels - 1) * surface_nodes, levels * surface_nodes, dtype=np.int32),
        side=(rim + surface_nodes * np.arange(levels)[:, None]).ravel().astype(np.int32),
        side_normals=normals,
        axis=patch.axis,
    )


def _rim_normals(vertices: Float, directed: Int, axis: Float, surface_nodes: int) -> tuple[Float, Int, Float]:
    """Return unit normals, perpendicular to the axis, at the nodes of directed rim edges (start, end, middle); else 0.

    Also returns the vertices where the rim turns by more than 75 degrees (corners of a box), and their second normals:
    a roller side holds both directions there.
    """
    outwards = np.cross(vertices[directed[:, 1]] - vertices[directed[:, 0]], axis)
    total = np.zeros((surface_nodes, 3))
    for column in directed.T:
        np.add.at(total, column, outwards)
    arriving, leaving = np.zeros_like(total), np.zeros_like(total)
    unit = outwards / np.linalg.norm(outwards, axis=1, keepdims=True)
    arriving[directed[:, 1]], leaving[directed[:, 0]] = unit, unit
    cosine = np.sum(arriving * leaving, axis=1)
    turned = np.flatnonzero((cosine < 0.26) & arriving.any(axis=1) & leaving.any(axis=1)).astype(np.int32)
    total[turned] = arriving[turned]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0.0), turned, leaving[turned]


def _check_volumes(nodes: Float, elements: Int) -> None:
    """Raise SceneError unless every element has det J > 0, relative to its size, at quadrature points and corners.

    If inward directions meet in a point above the base, the base is rotated by half a turn and det J > 0 again. So
    each edge of the base must also point in the direction of the same edge of the surface.
    """
    corner_points = [[x, y, z] for z in (-1.0, 1.0) for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))]
    slopes = corner_slopes(np.concatenate([prism_rule()[0], corner_points]))
    corners = nodes[elements[:, CORNERS]]
    jacobian = np.einsum("mai,qaj->mqij", corners, slopes)
    scale = np.prod(np.linalg.norm(jacobian, axis=2), axis=2)
    shape = np.divide(np.linalg.det(jacobian), scale, out=np.zeros_like(scale), where=scale > 0.0).min(axis=1)
    down, up = (np.roll(c, -1, axis=1) - c for c in (corners[:, :3], corners[:, 3:]))
    shape[np.einsum("mad,mad->ma", down, up).min(axis=1) <= 0.0] = -1.0
    worst = int(np.argmin(shape))
    if not shape[worst] > 1e-9:
        place = ", ".join(f"{x:.4g}" for x in corners[worst].mean(axis=0))
        raise SceneError(
            f"skin element {worst} near ({place}) m is flat or inverted: make the layer thinner there, or smooth "
            "the surface and its inward directions"
        )


def output_triangles(mesh: WedgeMesh) -> Int:
    """Return four flat triangles over surface nodes for each quadratic triangle, counter-clockwise, (4 t, 3), int32."""
    pieces = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
    return mesh.surface_triangles6[:, pieces].reshape(-1, 3)


def closed_boundary(mesh: WedgeMesh) -> tuple[Float, Int]:
    """Return skin surface, base and cut side of a layer as one closed triangle mesh: vertices and faces.

    Vertices [m] have shape (2 S, 3); the first S are the surface nodes of the skin. Faces have shape (m, 3).
    """
    count, top = mesh.surface_nodes, output_triangles(mesh)
    vertices = np.concatenate([mesh.nodes[:count], mesh.nodes[-count:]])
    edges = directed_edges(top)
    _, index, uses = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    rim = edges[index[uses == 1]]
    a, b = rim[:, 0], rim[:, 1]
    side = np.concatenate([np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)])
    return vertices, np.concatenate([top, top[:, ::-1] + count, side]).astype(np.int32)


def element_rows(sheets: Sequence[Sheet], fractions: Float) -> tuple[Float, list[Material]]:
    """Return depth fractions of rows of elements, each in one sheet, (L+1,), and the material of each row.

    sheets: from the surface down; thicknesses are shares of their sum
    fractions: depth fractions for a layer of one sheet, 0 first, 1 last; they set the number of rows of each sheet.
    """
    index = np.arange(len(fractions), dtype=float)
    total = sum(sheet.thickness_m for sheet in sheets)
    result, materials = [0.0], []
    for sheet in sheets:
        top, bottom = result[-1], result[-1] + sheet.thickness_m / total
        first, last = np.interp([top, bottom], fractions, index)
        count = max(1, round(last - first))
        inner = np.interp(np.linspace(first, last, count + 1)[1:-1], index, fractions)
        result += [*inner.tolist(), bottom]
        materials += [sheet.material] * count
    result[-1] = 1.0
    return np.array(result), materials
