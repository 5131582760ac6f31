"""Shadows with diffraction at edges: the sound of each transducer at a point is weighted by the share passing bodies.

The weight is Kirchhoff's integral over a screen with the outline of the bodies, as seen from the points. For one
straight edge it is Fresnel's integral of the clearance; behind a finger it adds the sound round both sides and the tip.
"""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.groups import axes
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.polynomials import sine_cosine
from palmfield.acoustics.shadow import REACH_m
from palmfield.acoustics.surface_arp import Shades
from palmfield.device import SharedArray, filled, launch, recorded, whole_numbers
from palmfield.threads import Calls, cores, share
from palmfield.types import Float, Float32, Int
from warp_kernels import knife_edge as kernels
from warp_kernels import outline
from warp_kernels.knife_edge import NEIGHBOURS
from warp_kernels.pressure import vec6

GROUP = 3.75
"""Edge of the cells whose nodes have one common viewpoint, over the spacing of the nodes."""
TURN_m = 0.03
"""Distance equivalent to an angle of 90 degrees between normals, so that the sides of a finger are not neighbours."""
STIFFNESS = 0.03
"""Regularisation of the slopes between nodes that lie nearly on a line."""
PARTS_PER_THREAD = 4
LONGEST_m = 4e-3
"""Longest piece of an outline: half a wavelength, over which the length of the diffracted path hardly changes."""
STRETCH = 1.5
"""Largest relative length of an edge when bodies bend; longer edges lose pieces."""
CLEARANCE_m, LIFT_m = 5e-3, 6e-3
"""Heights above the highest point of a skin: of the plane below which obstacles are ignored, and of the viewpoint."""
NEARBY_m = 1e-5
"""Distance from a piece of an outline within which bodies do not block the sound."""
MARGIN_m = 0.04
"""Distance from the path of the sound within which bodies are included: Fresnel's v is 2.7 half way over 200 mm."""
SAME_m = 1e-8
"""Vertices nearer to each other than this are merged, since bodies may have separate vertices for each face."""
WIDEST = 2.8
"""Clearance, as Fresnel's v, beyond which an edge has no effect; from v = 2 on the diffracted sound is faded out."""


class ShadowNodes(NamedTuple):
    """Nodes: the m of n points at which shadows are computed, sorted by group; the nodes of a group share a viewpoint.

    numbers: point number of each node, shape (m,). groups: its group, shape (m,). starts: first node of each group, and
    m. neighbours, shares: nodes near each of the n points, and their interpolation weights, shape (NEIGHBOURS, n).
    """

    numbers: Int
    groups: Int
    starts: Int
    neighbours: Int
    shares: Float32


def shadow_nodes(points: Float, normals: Float, spacing_m: float) -> ShadowNodes:
    """Return nodes about `spacing_m` apart among points [m] with unit outward normals, both of shape (n, 3), n >= 1.

    The interpolation is a plane fitted to near nodes along the surface, which is exact for linear variation.
    """
    chosen = _middle_ones(points, _cells(points, normals, spacing_m))
    of_cell = _cells(points[chosen], normals[chosen], GROUP * spacing_m)
    order = np.argsort(of_cell, kind="stable")
    numbers, groups = chosen[order].astype(np.int32), of_cell[order].astype(np.int32)
    starts = np.searchsorted(groups, np.arange(groups[-1] + 2)).astype(np.int32)
    neighbours, shares = _shares(points, normals, numbers)
    return ShadowNodes(
        numbers,
        groups,
        starts,
        np.ascontiguousarray(neighbours.T.astype(np.int32)),
        np.ascontiguousarray(shares.T.astype(np.float32)),
    )


def _cells(points: Float, normals: Float, edge_m: float) -> Int:
    """Return the cell of each point, by cube and main direction of the normal, numbered from 0 without gaps."""
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (normals[np.arange(len(axis)), axis] > 0.0)
    keys = np.column_stack([np.floor(points / edge_m).astype(np.int64), facing])
    return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1), np.int32)


def _middle_ones(points: Float, cells: Int) -> Int:
    """Return for each cell the point nearest to the mean of its points."""
    count = np.bincount(cells)
    middles = np.column_stack([np.bincount(cells, column) / count for column in points.T])
    away = ((points - middles[cells]) ** 2).sum(axis=1)
    order: Int = np.lexsort((away, cells)).astype(np.int32)
    firsts = np.searchsorted(cells[order], np.arange(len(count)))
    return np.asarray(order[firsts], dtype=np.int32)


def _shares(points: Float, normals: Float, numbers: Int) -> tuple[Int, Float]:
    """Return the nodes near each point and their interpolation weights, shapes (n, NEIGHBOURS)."""
    tree = cKDTree(np.hstack([points, TURN_m * normals])[numbers])
    distance, nearest = tree.query(np.hstack([points, TURN_m * normals]), k=min(NEIGHBOURS, len(numbers)))
    distance, nearest = distance.reshape(len(points), -1), nearest.reshape(len(points), -1)
    reach = np.maximum(1.05 * distance[:, -1:], 1e-6)
    weights = (1.0 - (distance / reach) ** 2) ** 2 if distance.shape[1] > 1 else np.ones_like(distance)
    offsets = (points[numbers[nearest]] - points[:, None]) / reach[..., None]
    # Only along the surface, which contains the nodes
    offsets -= np.einsum("nki,ni->nk", offsets, normals)[..., None] * normals[:, None]
    rows = np.concatenate([np.ones((*offsets.shape[:2], 1)), offsets], axis=2)
    matrix = np.einsum("nk,nki,nkj->nij", weights, rows, rows)
    matrix[:, 1:, 1:] += STIFFNESS * weights.sum(axis=1)[:, None, None] * np.eye(3)
    first = np.zeros((len(points), 4, 1))
    first[:, 0] = 1.0
    shares = weights * np.einsum("nki,ni->nk", rows, np.linalg.solve(matrix, first)[..., 0])
    missing = NEIGHBOURS - shares.shape[1]
    return np.pad(nearest, ((0, 0), (0, missing))), np.pad(shares, ((0, 0), (0, missing)))


class OutlineMesh:
    """Edges of the obstacles with the faces on both sides, for any number of sets of points.

    tree: hierarchy of the bodies, which moves with them; vertices: vertices in a reference pose [m], shape (v, 3);
    faces: shape (f, 3)
    """

    def __init__(self, tree: wp.Mesh, vertices: Float, faces: Int):
        self.device = str(tree.device)
        self._tree = tree
        edges, lengths, longest = _edges(vertices, faces)
        # Sorted so that consecutive entries are near each other
        by_place = _along_a_curve(vertices[edges[:, :2]].mean(axis=1), *_span(vertices))
        edges, lengths = edges[by_place], lengths[by_place]
        listed = _along_a_curve(vertices[faces].mean(axis=1), *_span(vertices))
        longest = longest[listed]
        pieces = np.ceil(STRETCH / LONGEST_m * np.concatenate([lengths, longest])).astype(np.int64)
        of_run = [*range(0, len(edges), outline.RUN), *range(len(edges), len(edges) + len(faces), outline.RUN)]
        slots = np.concatenate([[0], np.cumsum(np.add.reduceat(pieces, of_run))])
        self.runs, self.most, self.faces = len(slots) - 1, int(slots[-1]), len(faces)
        self.slots = whole_numbers(slots, self.device)
        self.mesh = filled(
            outline.Mesh(),
            tree=tree.id,
            points=tree.points,
            planes=wp.zeros(len(faces), dtype=wp.vec4, device=self.device),
            corners=wp.array(np.asarray(faces, np.int32), dtype=wp.vec3i, device=self.device),
            edges=wp.array(edges, dtype=wp.vec4i, device=self.device),
            listed=whole_numbers(listed, self.device),
            balls=wp.zeros(self.runs, dtype=wp.vec4, device=self.device),
        )

    def calls(self) -> Calls:
        """Return launches that compute the planes of the faces from the vertices."""
        make = _launcher(self.device)
        return [
            make(outline.face_planes, self.faces, [self.mesh, 0], self.device),
            make(outline.run_balls, self.runs, [self.mesh], self.device),
        ]


class Emitters:
    """Transducers of the arrays of a scene as input of the kernels for the weights.

    arrays: arrays in their present pose. rows: row of each transducer in the weights, shape (N,). device: as returned
    by `device.resolve`
    """

    def __init__(self, arrays: PhasedArray, rows: Int, device: str):
        self.device, self.rows, self.count = device, len(rows), len(arrays.sides)
        width = kernels.WIDTH["cpu"]
        numbers, boards = [], []
        for board, own in enumerate(arrays.sides):
            blocks = -(-len(own) // width)
            numbers.append(np.pad(own, (0, blocks * width - len(own)), "edge"))
            boards += [board] * blocks
        self._numbers = np.concatenate(numbers)
        self._fills: NDArray[np.bool_] = np.concatenate([np.append(False, np.diff(part) == 0) for part in numbers])
        self.blocks = len(boards)
        self._places = [SharedArray(len(self._numbers), wp.float32, device) for _ in range(3)]
        self._rows = SharedArray(len(self._numbers), wp.int32, device)
        self._boards = SharedArray(self.count, wp.vec4, device)
        self._around = [SharedArray(self.count, kind, device) for kind in (wp.vec3, wp.vec3, wp.vec3, wp.vec2)]
        self.emitters = filled(
            kernels.Emitters(),
            rows=self._rows.array,
            boards=whole_numbers(boards, device),
            **{name: place.array for name, place in zip("xyz", self._places, strict=True)},
        )
        names = "centres", "right", "up", "sizes"
        around = {name: one.array for name, one in zip(names, self._around, strict=True)}
        self.board = filled(outline.Board(), **around)
        frequency = arrays.groups[0].array.frequency_Hz
        self.wavelength_m = sound_speed(arrays.air) / frequency
        sine, cosine = sine_cosine()
        self.waves = filled(
            kernels.Waves(),
            turns_per_m=1.0 / self.wavelength_m,
            fades=0.25 * WIDEST**2,
            sine=vec6(*sine),
            cosine=vec6(*cosine),
        )
        self.move(arrays, rows)

    def move(self, arrays: PhasedArray, rows: Int) -> None:
        """Set new positions of the same transducers, and their rows in the weights."""
        self._rows.put(np.where(self._fills, -1, rows[self._numbers]))
        for shared, values in zip(self._places, arrays.array.positions[self._numbers].T, strict=True):
            shared.put(values)
        facing = np.ascontiguousarray(arrays.facing.T)
        self._boards.put(np.column_stack([facing, arrays.heights]))
        turns = axes(facing / np.linalg.norm(facing, axis=1)[:, None])
        corners = arrays.corners.reshape(self.count, 8, 3)
        centres = corners.mean(axis=1)
        sizes = np.abs(np.einsum("bki,bji->bkj", corners - centres[:, None], turns[:, :2])).max(axis=1)
        for shared, values in zip(self._around, (centres, turns[:, 0], turns[:, 1], sizes), strict=True):
            shared.put(values)

    @property
    def facing(self) -> Any:
        """Mean direction of each array and height of its centre along it [m], on the device, shape (parts,)."""
        return self._boards.array


class KnifeEdges:
    """Weights of the sound of each transducer at the points of one surface behind bodies, for successive poses.

    It is part of the state of one simulation and not thread-safe; on the CPU it starts threads itself.

    shades: weights on the device, computed by `evaluate` or by the launches of `stages`
    """

    def __init__(
        self, mesh: OutlineMesh, emitters: Emitters, nodes: ShadowNodes, points: int, threads: int | None = None
    ):
        """points: number of points; threads: number of threads on the CPU, 1 or more, None is all cores of this
        process
        """
        device = self.device = emitters.device
        self._mesh, self._emitters, self.nodes = mesh, emitters, nodes
        self._threads = 1 if device != "cpu" else cores() if threads is None else threads
        self._groups = len(nodes.starts) - 1
        views, count = self._groups * emitters.count, len(nodes.numbers)
        self._starts, self._of_node = whole_numbers(nodes.starts, device), whole_numbers(nodes.groups, device)
        self._looks = filled(
            outline.Views(),
            eyes=wp.zeros(views, dtype=wp.vec3, device=device),
            planes=wp.zeros((views, outline.PLANES), dtype=wp.vec4, device=device),
        )
        self._pieces = filled(
            outline.Pieces(),
            middles=wp.zeros((views, mesh.most), dtype=wp.vec4, device=device),
            ways=wp.zeros((views, mesh.most), dtype=wp.vec3, device=device),
            counts=wp.zeros((views, mesh.runs), dtype=wp.int32, device=device),
            totals=wp.zeros(views, dtype=wp.vec2i, device=device),
            listed=wp.zeros((views, mesh.most), dtype=wp.int32, device=device),
        )
        self._across = SharedArray((count * emitters.count, outline.LANES), wp.vec2, device)
        blocks, rows = -(-points // kernels.BLOCK), -(-emitters.rows // kernels.BLOCK) * kernels.BLOCK
        columns = blocks * kernels.BLOCK
        self._at_nodes = [wp.zeros((count, rows), dtype=wp.float32, device=device) for _ in range(2)]
        at_points = [wp.zeros((blocks, rows, kernels.BLOCK), dtype=wp.float32, device=device) for _ in range(2)]
        self.shades = Shades(*at_points)
        self._clear: Any = wp.zeros(count, dtype=wp.float32, device=device)
        self._neighbours = SharedArray((kernels.NEIGHBOURS, columns), wp.int32, device)
        self._shares = SharedArray((kernels.NEIGHBOURS, columns), wp.float32, device)
        self._chosen: Int | None = None
        self._count = points
        if points == nodes.shares.shape[1]:
            self.choose(np.arange(points, dtype=np.int32))
        self._places = SharedArray(count, wp.vec3, device), SharedArray(count, wp.vec3, device)
        self._stages: list[list[Calls]] = []

    def choose(self, points: Int) -> None:
        """Set the points for the next weights, as numbers among the points of the nodes; the count is fixed."""
        if points is not self._chosen:
            for shared, values in ((self._neighbours, self.nodes.neighbours), (self._shares, self.nodes.shares)):
                shared.host[:, : self._count] = values[:, points]
                shared.upload()
            self._chosen = points

    def evaluate(self, places: Float | Float32, normals: Float | Float32) -> bool:
        """Compute `shades`; return False, with `shades` unchanged, if no body blocks the sound of any transducer.

        places: nodes [m]; normals: unit outward normals there; array frame, shapes (m, 3); the mesh must be up to date
        """
        for shared, values in zip(self._places, (places, normals), strict=True):
            shared.host[...] = values
            shared.upload()
        if not self._stages:
            where, outward = self._places
            own: Int = np.arange(len(self.nodes.numbers), dtype=np.int32)
            self._stages = self.stages(where.array, outward.array, own)
        look, across, *rest = self._stages
        share(look, self._threads)
        share(across, self._threads)
        self._across.download()
        if self.device != "cpu":
            wp.synchronize_stream(self.device)
        near, around = self._across.host[..., 0].max(axis=1), self._across.host[..., 1].sum(axis=1)
        if near.max() == 0.0 and around.max() < 0.5:
            return False
        for stage in rest:
            share(stage, self._threads)
        return True

    def stages(self, points: Any, normals: Any, numbers: Int) -> list[list[Calls]]:
        """Return the launches of each stage, as lists that can run in parallel.

        Stages: find bodies near the paths; find their blocking edges; weights at nodes; weights at points.

        points, normals: vec3 arrays on the device; numbers: numbers of the nodes among the points, shape (m,)
        """
        device, gpu, mesh, emitters = self.device, self.device != "cpu", self._mesh, self._emitters
        make, width = _launcher(device), kernels.WIDTH["gpu" if gpu else "cpu"]
        looks, pieces, of_nodes = self._looks, self._pieces, whole_numbers(numbers, device)
        nodes = filled(kernels.Nodes(), points=points, numbers=of_nodes, groups=self._of_node)
        look: list[Calls] = []
        for first, count in _parts(self._groups, self._threads):
            view, views = first * emitters.count, count * emitters.count
            placed = [points, normals, of_nodes, self._starts, emitters.facing, emitters.board]
            placed += [CLEARANCE_m, LIFT_m, MARGIN_m, looks, first]
            searched = [mesh.mesh, looks, mesh.slots, LONGEST_m, NEARBY_m, REACH_m, pieces, view]
            look.append(
                [
                    make(outline.place_views, (count, emitters.count), placed, device),
                    make(outline.find_pieces, (views, mesh.runs), searched, device),
                    make(outline.list_pieces, views, [pieces, mesh.slots, view], device),
                ]
            )
        across: list[Calls] = []
        for first, count in _parts(len(numbers), self._threads):
            arguments = [points, of_nodes, self._of_node, looks, pieces, emitters.board, emitters.wavelength_m, WIDEST]
            dim = count, emitters.count, outline.LANES
            across.append([make(outline.look_across, dim, [*arguments, self._across.array, first], device)])
        weigh: list[Calls] = []
        give: list[Calls] = []
        blocks, parts = emitters.blocks * (kernels.WIDTH["cpu"] // width), PARTS_PER_THREAD * self._threads
        for first, count in _parts(len(numbers), 1 if gpu else parts):
            inputs = [nodes, emitters.emitters, emitters.waves, self._across.array, pieces, *self._at_nodes]
            weigh.append([make(kernels.node_weights(gpu), (count, blocks), [*inputs, emitters.count, first], device)])
        checked = [self._across.array, emitters.count, self._clear]
        weigh.append([make(kernels.find_clear, len(numbers), checked, device)])
        point_blocks, rows, _ = self.shades.real.shape
        for first, count in _parts(point_blocks, 1 if gpu else parts):
            inputs = [self._neighbours.array, self._shares.array, *self._at_nodes, *self.shades, self._clear, first]
            size = (rows, point_blocks * kernels.BLOCK) if gpu else count
            give.append([make(kernels.spread(gpu), size, inputs, device)])
        return [look, across, weigh, give]


def _launcher(device: str) -> Callable[..., Callable[[], object]]:
    """Return the function for launches: recorded on the CPU, immediate on a GPU, where a graph captures them."""
    return recorded if device == "cpu" else launch


def _parts(count: int, parts: int) -> list[tuple[int, int]]:
    """Return first index and length of each of up to `parts` parts of `count` items."""
    ends = np.unique(np.linspace(0, count, min(parts, count) + 1).astype(int)).tolist()
    return [(first, last - first) for first, last in itertools.pairwise(ends)]


def _span(vertices: Float) -> tuple[Float, float]:
    """Return the lowest corner of the box of points [m], shape (3,), and its longest edge [m]."""
    low = vertices.min(axis=0)
    return low, float((vertices.max(axis=0) - low).max())


def _along_a_curve(points: Float, low: Float, size_m: float) -> Int:
    """Return the order of points along a Morton curve through a box, in which neighbours are mostly close, (n,)."""
    steps = np.clip((points - low) / max(size_m, SAME_m) * 1023.0, 0, 1023).astype(np.int64)
    keys = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            keys |= ((steps[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.asarray(np.argsort(keys, kind="stable"), np.int32)


def _edges(vertices: Float, faces: Int) -> tuple[Int, Float, Float]:
    """Return edges as in `outline.Mesh`, shape (e, 4), their lengths [m], and the longest edge of each face [m]."""
    same = np.unique(np.round(vertices / SAME_m), axis=0, return_inverse=True)[1].reshape(-1)
    starts, ends = faces.T.ravel(), faces[:, [1, 2, 0]].T.ravel()
    own = np.tile(np.arange(len(faces)), 3)
    lengths = np.linalg.norm(vertices[ends] - vertices[starts], axis=1)
    longest = lengths.reshape(3, -1).max(axis=0)
    low, high = np.minimum(same[starts], same[ends]), np.maximum(same[starts], same[ends])
    up = same[starts] < same[ends]
    # Of the faces at an edge, those with the edge upwards come first; each is paired with one with the edge downwards
    order = np.lexsort((~up, high, low))
    order = order[low[order] != high[order]]
    rows = []
    for along in np.split(order, np.flatnonzero(np.diff(low[order]) | np.diff(high[order])) + 1):
        ups, downs = along[up[along]], along[~up[along]]
        paired = min(len(ups), len(downs))
        rows += [(one, own[other]) for one, other in zip(ups[:paired], downs[:paired], strict=True)]
        rows += [(one, -1) for one in (*ups[paired:], *downs[paired:])]
    first, right = (np.array(column, dtype=np.int64) for column in zip(*rows, strict=True))
    edges = np.column_stack([starts[first], ends[first], own[first], right]).astype(np.int32)
    return edges, lengths[first], longest
