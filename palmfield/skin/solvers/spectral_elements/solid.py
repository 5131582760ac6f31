"""Quadrilaterals extruded into hexahedra, sheet by sheet."""

import itertools
from dataclasses import dataclass

import numpy as np

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Sheet
from palmfield.skin.solvers.spectral_elements.quads import Quads, rule
from palmfield.types import Float, Int


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
