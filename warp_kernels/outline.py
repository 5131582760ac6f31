"""Outline of bodies as seen from a point, as pieces of closed lines, for diffracted sound.

An edge of a closed mesh is on the outline if one of its two faces faces the point and the other does not. Parts below
the skin round the point, behind the board of an array or far from the path of the sound are cut off by planes, and the
cut is closed by a cap. All lines are closed, and give the number of layers of bodies on the path. Sound is diffracted
only at visible lines, not at caps. A piece is oriented with the body to its left as seen by the viewer.
"""

import warp as wp

from warp_kernels import EXACT
from warp_kernels.point_sound import GRAZING

wp.set_module_options(EXACT | {"fast_math": True})

RUN = 64
"""Number of edges and faces that one thread processes."""
PLANES = wp.constant(6)
"""Number of planes that cut off irrelevant parts: over the skin, before the board, and on four sides of the path."""
AWAY = wp.constant(-0.3)
"""Cosine to the board beyond which sound does not reach a skin, so that no test is needed."""
NOWHERE = wp.constant(1.0e9)
LANES = 16
"""Number of threads per view, among which the pieces are divided."""


@wp.struct
class Mesh:
    """Obstacles.

    tree: id of Warp's mesh; points: vertices [m]; planes: unit normal of each face and its height along it [m]
    corners: vertices of each face; edges: two vertices, then left and right face, -1 for none
    listed: faces in the order of their runs; balls: centre and radius of each run of edges, then of faces [m]
    """

    tree: wp.uint64
    points: wp.array(dtype=wp.vec3)
    planes: wp.array(dtype=wp.vec4)
    corners: wp.array(dtype=wp.vec3i)
    edges: wp.array(dtype=wp.vec4i)
    listed: wp.array(dtype=wp.int32)
    balls: wp.array(dtype=wp.vec4)


@wp.struct
class Views:
    """Viewpoints, one for each group of points and each board.

    eyes: [m]; planes: unit normals and heights [m], (views, PLANES); parts above all planes are used
    """

    eyes: wp.array(dtype=wp.vec3)
    planes: wp.array2d(dtype=wp.vec4)


@wp.struct
class Pieces:
    """Pieces of outlines, in slots for every run of edges and faces.

    middles: [m], and 1 with diffraction, else 0; ways: vectors from end to end [m]; both (views, slots)
    counts: number of pieces in each run, (views, runs); totals: numbers of pieces with and without diffraction
    listed: used slots, those with diffraction from the beginning, the others from the end, (views, slots)
    """

    middles: wp.array2d(dtype=wp.vec4)
    ways: wp.array2d(dtype=wp.vec3)
    counts: wp.array2d(dtype=wp.int32)
    totals: wp.array(dtype=wp.vec2i)
    listed: wp.array2d(dtype=wp.int32)


@wp.struct
class Board:
    """Rectangles round the transducers of each array. centres: [m]; right, up: unit axes; sizes: half sizes [m]"""

    centres: wp.array(dtype=wp.vec3)
    right: wp.array(dtype=wp.vec3)
    up: wp.array(dtype=wp.vec3)
    sizes: wp.array(dtype=wp.vec2)


@wp.func
def above(point: wp.vec3, plane: wp.vec4):
    return point[0] * plane[0] + point[1] * plane[1] + point[2] * plane[2] - plane[3]


@wp.func
def plane_through(eye: wp.vec3, inner: wp.vec3, outer: wp.vec3, along: wp.vec3):
    """Return the plane through two points and along a direction, with the eye above it."""
    normal = wp.normalize(wp.cross(along, outer - inner))
    if wp.dot(normal, eye - inner) < 0.0:
        normal = -normal
    return wp.vec4(normal[0], normal[1], normal[2], wp.dot(normal, inner))


@wp.kernel
def place_views(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    numbers: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    boards: wp.array(dtype=wp.vec4),
    board: Board,
    clearance_m: wp.float32,
    lift_m: wp.float32,
    margin_m: wp.float32,
    views: Views,
    first: wp.int32,
):
    """Compute the viewpoints of groups of points; dim: (groups, boards), from group `first` on.

    numbers: point numbers of all groups; starts: first point of each group, and one past the last
    boards: mean direction and height of each board [m]
    clearance_m: height of the cutting plane over the highest point of the skin; lift_m: height of the eye
    margin_m: distance from the points and the board within which bodies are processed
    """
    i, number = wp.tid()
    group = first + i
    middle = wp.vec3()
    normal = wp.vec3()
    for j in range(starts[group], starts[group + 1]):
        middle += points[numbers[j]]
        normal += normals[numbers[j]]
    middle = middle / wp.float32(starts[group + 1] - starts[group])
    normal = wp.normalize(normal)
    highest = wp.dot(normal, middle)
    radius = wp.float32(0.0)
    for j in range(starts[group], starts[group + 1]):
        highest = wp.max(highest, wp.dot(normal, points[numbers[j]]))
        radius = wp.max(radius, wp.length(points[numbers[j]] - middle))
    view = group * boards.shape[0] + number
    eye = middle + (highest + lift_m - wp.dot(normal, middle)) * normal
    views.eyes[view] = eye
    views.planes[view, 0] = wp.vec4(normal[0], normal[1], normal[2], highest + clearance_m)
    towards = board.centres[number] - middle
    if wp.dot(normal, towards) < AWAY * wp.length(towards):
        views.planes[view, 0] = wp.vec4(normal[0], normal[1], normal[2], NOWHERE)
    facing = boards[number]
    views.planes[view, 1] = wp.vec4(facing[0], facing[1], facing[2], facing[3] + clearance_m)
    right = board.right[number]
    up = board.up[number]
    wide = (board.sizes[number][0] + margin_m) * right
    high = (board.sizes[number][1] + margin_m) * up
    centre = board.centres[number]
    reach = radius + margin_m
    views.planes[view, 2] = plane_through(eye, eye + reach * right, centre + wide, up)
    views.planes[view, 3] = plane_through(eye, eye - reach * right, centre - wide, up)
    views.planes[view, 4] = plane_through(eye, eye + reach * up, centre + high, right)
    views.planes[view, 5] = plane_through(eye, eye - reach * up, centre - high, right)


@wp.kernel
def face_planes(mesh: Mesh, first: wp.int32):
    """Compute the planes of the faces of the mesh in its present pose; dim: faces, from number `first` on."""
    face = first + wp.tid()
    corners = mesh.corners[face]
    a = mesh.points[corners[0]]
    normal = wp.normalize(wp.cross(mesh.points[corners[1]] - a, mesh.points[corners[2]] - a))
    mesh.planes[face] = wp.vec4(normal[0], normal[1], normal[2], wp.dot(normal, a))


@wp.kernel
def run_balls(mesh: Mesh):
    """Compute the bounding sphere of each run, for the present vertices; dim: runs."""
    run = wp.tid()
    edges = mesh.edges.shape[0]
    runs_of_edges = (edges + RUN - 1) // RUN
    low = wp.vec3(1.0e9, 1.0e9, 1.0e9)
    high = -low
    if run < runs_of_edges:
        for j in range(run * RUN, wp.min((run + 1) * RUN, edges)):
            for k in range(2):
                point = mesh.points[mesh.edges[j][k]]
                low = wp.min(low, point)
                high = wp.max(high, point)
    else:
        start = (run - runs_of_edges) * RUN
        for j in range(start, wp.min(start + RUN, mesh.listed.shape[0])):
            for k in range(3):
                point = mesh.points[mesh.corners[mesh.listed[j]][k]]
                low = wp.min(low, point)
                high = wp.max(high, point)
    middle = 0.5 * (low + high)
    mesh.balls[run] = wp.vec4(middle[0], middle[1], middle[2], 0.5 * wp.length(high - low))


@wp.func
def kept(a: wp.vec3, b: wp.vec3, plane: wp.vec4, span: wp.vec2):
    """Clip a span of the segment from a to b to the part above a plane; an empty span is (1, 0)."""
    first = above(a, plane)
    last = above(b, plane)
    result = span
    if first <= 0.0 and last <= 0.0:
        result = wp.vec2(1.0, 0.0)
    elif first <= 0.0:
        result = wp.vec2(wp.max(span[0], first / (first - last)), span[1])
    elif last <= 0.0:
        result = wp.vec2(span[0], wp.min(span[1], first / (first - last)))
    return result


@wp.func
def put(
    mesh: Mesh,
    views: Views,
    view: wp.int32,
    a: wp.vec3,
    b: wp.vec3,
    but: wp.int32,
    bends: wp.bool,
    longest_m: wp.float32,
    nearby_m: wp.float32,
    farthest_m: wp.float32,
    pieces: Pieces,
    slot: wp.int32,
    stop: wp.int32,
):
    """Write the clipped segment from a to b as pieces from `slot` on; return the slot after the last.

    Sound is diffracted at a piece of an edge if no body hides the point at a distance of `nearby_m` from it.
    but: plane that contains the segment, -1 for none; bends: whether it is an edge, not a cap
    """
    next_slot = slot
    span = wp.vec2(0.0, 1.0)
    for k in range(PLANES):
        if k != but:
            span = kept(a, b, views.planes[view, k], span)
    if span[1] > span[0]:
        eye = views.eyes[view]
        parts = wp.int32(wp.ceil((span[1] - span[0]) * wp.length(b - a) / longest_m))
        way = (span[1] - span[0]) * (b - a) / wp.float32(wp.max(parts, 1))
        for j in range(parts):
            start = a + span[0] * (b - a) + wp.float32(j) * way
            middle = start + 0.5 * way
            hidden = wp.bool(True)
            if bends:
                towards = middle - eye
                ray = wp.normalize(towards + nearby_m * wp.normalize(wp.cross(towards, way)))
                reach = farthest_m
                for k in range(PLANES):
                    plane = views.planes[view, k]
                    rising = ray[0] * plane[0] + ray[1] * plane[1] + ray[2] * plane[2]
                    if rising < -GRAZING:
                        reach = wp.min(reach, above(eye, plane) / -rising)
                hidden = wp.mesh_query_ray_anyhit(mesh.tree, eye, ray, reach)
            if next_slot < stop:
                pieces.middles[view, next_slot] = wp.vec4(
                    middle[0], middle[1], middle[2], wp.where(hidden, wp.float32(0.0), wp.float32(1.0))
                )
                pieces.ways[view, next_slot] = way
                next_slot += 1
    return next_slot


@wp.func
def ends_on(f: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Return the ends of the zero line of f, given at the corners of a triangle; f > 0 is to its left from outside."""
    leaves = wp.vec3()
    enters = wp.vec3()
    if f[0] > 0.0 and f[1] <= 0.0:
        leaves = a + (b - a) * (f[0] / (f[0] - f[1]))
    if f[1] > 0.0 and f[2] <= 0.0:
        leaves = b + (c - b) * (f[1] / (f[1] - f[2]))
    if f[2] > 0.0 and f[0] <= 0.0:
        leaves = c + (a - c) * (f[2] / (f[2] - f[0]))
    if f[0] <= 0.0 and f[1] > 0.0:
        enters = a + (b - a) * (f[0] / (f[0] - f[1]))
    if f[1] <= 0.0 and f[2] > 0.0:
        enters = b + (c - b) * (f[1] / (f[1] - f[2]))
    if f[2] <= 0.0 and f[0] > 0.0:
        enters = c + (a - c) * (f[2] / (f[2] - f[0]))
    return wp.matrix_from_rows(leaves, enters)


@wp.kernel
def find_pieces(
    mesh: Mesh,
    views: Views,
    slots: wp.array(dtype=wp.int32),
    longest_m: wp.float32,
    nearby_m: wp.float32,
    farthest_m: wp.float32,
    pieces: Pieces,
    first: wp.int32,
):
    """Find the pieces of the outline of each view, in runs of edges, then of faces; dim: (views, runs) from `first`.

    slots: first slot of each run, and one past the last
    longest_m: longest piece; nearby_m: distance from a piece that must be free; farthest_m: range of the search
    """
    i, run = wp.tid()
    view = first + i
    eye = views.eyes[view]
    slot = slots[run]
    stop = slots[run + 1]
    ball = mesh.balls[run]
    middle = wp.vec3(ball[0], ball[1], ball[2])
    lowest = wp.float32(1.0e9)
    for k in range(PLANES):
        lowest = wp.min(lowest, above(middle, views.planes[view, k]))
    edges = mesh.edges.shape[0]
    runs_of_edges = (edges + RUN - 1) // RUN
    if lowest > -ball[3] and run < runs_of_edges:
        for j in range(run * RUN, wp.min((run + 1) * RUN, edges)):
            edge = mesh.edges[j]
            towards = above(eye, mesh.planes[edge[2]]) > 0.0
            other = not towards
            if edge[3] >= 0:
                other = above(eye, mesh.planes[edge[3]]) > 0.0
            if towards != other:
                a = mesh.points[edge[0]]
                b = mesh.points[edge[1]]
                if not towards:
                    a = mesh.points[edge[1]]
                    b = mesh.points[edge[0]]
                slot = put(mesh, views, view, a, b, -1, True, longest_m, nearby_m, farthest_m, pieces, slot, stop)
    # Parts above all planes are not cut
    if lowest > -ball[3] and lowest < ball[3] and run >= runs_of_edges:
        start = (run - runs_of_edges) * RUN
        for j in range(start, wp.min(start + RUN, mesh.listed.shape[0])):
            face = mesh.listed[j]
            corners = mesh.corners[face]
            a = mesh.points[corners[0]]
            b = mesh.points[corners[1]]
            c = mesh.points[corners[2]]
            towards = above(eye, mesh.planes[face]) > 0.0
            for k in range(PLANES):
                plane = views.planes[view, k]
                heights = wp.vec3(above(a, plane), above(b, plane), above(c, plane))
                # Seen from between the planes, caps face away; the visible part ends at faces that face the eye
                if towards and wp.max(heights) > 0.0 and wp.min(heights) <= 0.0:
                    ends = ends_on(heights, a, b, c)
                    begin = wp.vec3(ends[0, 0], ends[0, 1], ends[0, 2])
                    end = wp.vec3(ends[1, 0], ends[1, 1], ends[1, 2])
                    slot = put(
                        mesh, views, view, begin, end, k, False, longest_m, nearby_m, farthest_m, pieces, slot, stop
                    )
    pieces.counts[view, run] = slot - slots[run]


@wp.kernel
def list_pieces(pieces: Pieces, slots: wp.array(dtype=wp.int32), first: wp.int32):
    """List the used slots in order: those with diffraction from the beginning, the others from the end.

    dim: views, from view `first` on; slots: as for `find_pieces`
    """
    view = first + wp.tid()
    bending = wp.int32(0)
    others = wp.int32(0)
    last = pieces.listed.shape[1] - 1
    for run in range(pieces.counts.shape[1]):
        for j in range(pieces.counts[view, run]):
            slot = slots[run] + j
            if pieces.middles[view, slot][3] > 0.0:
                pieces.listed[view, bending] = slot
                bending += 1
            else:
                pieces.listed[view, last - others] = slot
                others += 1
    pieces.totals[view] = wp.vec2i(bending, others)


@wp.kernel
def look_across(
    points: wp.array(dtype=wp.vec3),
    numbers: wp.array(dtype=wp.int32),
    groups: wp.array(dtype=wp.int32),
    views: Views,
    pieces: Pieces,
    board: Board,
    wavelength_m: wp.float32,
    widest: wp.float32,
    result: wp.array2d(dtype=wp.vec2),
    first: wp.int32,
):
    """Compute whether pieces are in or near the path to the board, and otherwise how often they enclose it.

    dim: (nodes, boards, LANES), from node `first` on; numbers: point numbers of nodes; groups: view group of each
    widest: largest clearance of a piece near the path, as Fresnel's v
    result: shape (nodes boards, LANES): above 0 if there is such a piece; and the share in enclosing the centre
    """
    i, number, lane = wp.tid()
    node = first + i
    boards = board.centres.shape[0]
    view = groups[node] * boards + number
    point = points[numbers[node]]
    near = wp.float32(0.0)
    around = wp.float32(0.0)
    centre = board.centres[number]
    axis = wp.normalize(centre - point)
    totals = pieces.totals[view]
    for j in range(lane, totals[0] + totals[1], LANES):
        slot = pieces.listed[view, wp.where(j < totals[0], j, pieces.listed.shape[1] - 1 + totals[0] - j)]
        piece = pieces.middles[view, slot]
        middle = wp.vec3(piece[0], piece[1], piece[2])
        towards = middle - point
        if piece[3] > 0.0:
            # The transducer whose path is nearest, approximately: where its extension meets the board, or the rim
            share = wp.max(above(middle, views.planes[view, 1]) / above(point, views.planes[view, 1]), 0.0)
            on_board = towards / wp.max(1.0 - share, 0.02) + point - centre
            x = wp.dot(on_board, board.right[number])
            y = wp.dot(on_board, board.up[number])
            size = board.sizes[number]
            nearest = wp.clamp(x, -size[0], size[0]) * board.right[number]
            nearest += wp.clamp(y, -size[1], size[1]) * board.up[number] + centre
            detour = wp.length(towards) + wp.length(nearest - middle) - wp.length(nearest - point)
            if 4.0 * detour < widest * widest * wavelength_m:
                near = 1.0
        along = wp.dot(towards, axis)
        square = wp.max(wp.dot(towards, towards) - along * along, 1.0e-9)
        around += wp.dot(axis, wp.cross(pieces.ways[view, slot], towards)) / square
    result[node * boards + number, lane] = wp.vec2(near, around / (2.0 * wp.pi))
