"""Places of particles, in columns below a face of triangles and squares."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from palmfield.errors import SceneError
from palmfield.hand.triangles import signed_areas
from palmfield.skin.base import NEEDS_AXIS
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
