"""The outline of bodies as a point sees them: pieces of closed lines, for the sound that bends round them.

An edge of a closed mesh is on the outline where of its two faces one looks towards the point and the other away, and
nothing hides it. What lies below the skin round the point, or behind an array's board, is cut off by a plane, and the
cut closed by a cap: so the lines stay closed. A piece runs so that the body is to the left of who looks at it.
"""

import warp as wp

from warp_kernels.point_sound import GRAZING

wp.set_module_options({"enable_backward": False, "fast_math": True})

RUN = 64
"""Edges and faces that one thread looks at."""
LANES = 16
"""Threads that share out the pieces of a view."""


@wp.struct
class Mesh:
    """Bodies in the way.

    tree: of Warp; points: vertices [m]; planes: unit normal of each face and its height along it [m]
    corners: of each face; edges: two vertices, then the face to the left and the one to the right, -1 for none
    """

    tree: wp.uint64
    points: wp.array(dtype=wp.vec3)
    planes: wp.array(dtype=wp.vec4)
    corners: wp.array(dtype=wp.vec3i)
    edges: wp.array(dtype=wp.vec4i)


@wp.struct
class Views:
    """From where bodies are looked at, one for each group of points and each board.

    eyes: [m]; skins: plane over the group's skin; fronts: plane before the board; kept is what is above both
    """

    eyes: wp.array(dtype=wp.vec3)
    skins: wp.array(dtype=wp.vec4)
    fronts: wp.array(dtype=wp.vec4)


@wp.struct
class Pieces:
    """Pieces of outlines, in slots that have room for every run of edges and faces.

    middles: [m]; ways: from end to end [m]; both (views, slots); counts: how many in each run, (views, runs)
    starts: how many there are before each run, and of all, (views, runs + 1); listed: slots in use, (views, slots)
    """

    middles: wp.array2d(dtype=wp.vec3)
    ways: wp.array2d(dtype=wp.vec3)
    counts: wp.array2d(dtype=wp.int32)
    starts: wp.array2d(dtype=wp.int32)
    listed: wp.array2d(dtype=wp.int32)


@wp.struct
class Board:
    """Rectangles round each array's transducers. centres [m]; right, up: unit axes; sizes: half, along these [m]"""

    centres: wp.array(dtype=wp.vec3)
    right: wp.array(dtype=wp.vec3)
    up: wp.array(dtype=wp.vec3)
    sizes: wp.array(dtype=wp.vec2)


@wp.func
def above(point: wp.vec3, plane: wp.vec4):
    return point[0] * plane[0] + point[1] * plane[1] + point[2] * plane[2] - plane[3]


@wp.kernel
def place_views(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    numbers: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    boards: wp.array(dtype=wp.vec4),
    clearance_m: wp.float32,
    lift_m: wp.float32,
    views: Views,
    first: wp.int32,
):
    """Where groups of points look from; dim: (groups, boards), from group `first` on.

    numbers: of the points of all groups; starts: first of each group, and one past the last
    boards: mean direction and height of each [m]
    clearance_m: of the plane over the highest point of the skin; lift_m: of the eye
    """
    i, board = wp.tid()
    group = first + i
    boards_there = boards.shape[0]
    middle = wp.vec3()
    normal = wp.vec3()
    for j in range(starts[group], starts[group + 1]):
        middle += points[numbers[j]]
        normal += normals[numbers[j]]
    middle = middle / wp.float32(starts[group + 1] - starts[group])
    normal = wp.normalize(normal)
    highest = wp.dot(normal, middle)
    for j in range(starts[group], starts[group + 1]):
        highest = wp.max(highest, wp.dot(normal, points[numbers[j]]))
    view = group * boards_there + board
    views.eyes[view] = middle + (highest + lift_m - wp.dot(normal, middle)) * normal
    views.skins[view] = wp.vec4(normal[0], normal[1], normal[2], highest + clearance_m)
    facing = boards[board]
    views.fronts[view] = wp.vec4(facing[0], facing[1], facing[2], facing[3] + clearance_m)


@wp.kernel
def face_planes(mesh: Mesh, first: wp.int32):
    """Planes of the mesh's faces as it stands now; dim: faces, from number `first` on."""
    face = first + wp.tid()
    corners = mesh.corners[face]
    a = mesh.points[corners[0]]
    normal = wp.normalize(wp.cross(mesh.points[corners[1]] - a, mesh.points[corners[2]] - a))
    mesh.planes[face] = wp.vec4(normal[0], normal[1], normal[2], wp.dot(normal, a))


@wp.func
def kept(a: wp.vec3, b: wp.vec3, plane: wp.vec4, span: wp.vec2):
    """Of a span of the way from a to b what is above a plane; an empty span is (1, 0)."""
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
    longest_m: wp.float32,
    beside_m: wp.float32,
    farthest_m: wp.float32,
    pieces: Pieces,
    slot: wp.int32,
    stop: wp.int32,
):
    """Write the way from a to b in pieces from `slot` on; returns the slot after the last.

    A piece counts where nothing that is kept hides what is `beside_m` beside it.
    """
    eye = views.eyes[view]
    front = views.fronts[view]
    skin = views.skins[view]
    parts = wp.int32(wp.ceil(wp.length(b - a) / longest_m))
    way = (b - a) / wp.float32(wp.max(parts, 1))
    next_slot = slot
    for j in range(parts):
        middle = a + (wp.float32(j) + 0.5) * way
        towards = middle - eye
        outward = wp.normalize(wp.cross(towards, way))
        ray = wp.normalize(towards + beside_m * outward)
        nearing = -(ray[0] * front[0] + ray[1] * front[1] + ray[2] * front[2])
        rising = ray[0] * skin[0] + ray[1] * skin[1] + ray[2] * skin[2]
        hidden = wp.bool(False)
        if rising > GRAZING:
            begin = wp.max(-above(eye, skin), 0.0) / rising
            reach = farthest_m
            if nearing > GRAZING:
                reach = wp.min(above(eye, front) / nearing, farthest_m)
            if begin < reach:
                hidden = wp.mesh_query_ray_anyhit(mesh.tree, eye + begin * ray, ray, reach - begin)
        if not hidden and next_slot < stop:
            pieces.middles[view, next_slot] = middle
            pieces.ways[view, next_slot] = way
            next_slot += 1
    return next_slot


@wp.func
def ends_on(f: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Where f, given at the corners, is 0 on a triangle: two ends in rows, f > 0 to the left as seen from outside."""
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
    beside_m: wp.float32,
    farthest_m: wp.float32,
    pieces: Pieces,
    first: wp.int32,
):
    """Pieces of each view's outline, in runs of edges, then of faces; dim: (views, runs), from view `first` on.

    slots: where each run's pieces begin, and one past the last
    longest_m: of a piece; beside_m: how far beside a piece nothing may be in the way; farthest_m: of what is looked for
    """
    i, run = wp.tid()
    view = first + i
    eye = views.eyes[view]
    skin = views.skins[view]
    front = views.fronts[view]
    slot = slots[run]
    stop = slots[run + 1]
    edges = mesh.edges.shape[0]
    runs_of_edges = (edges + RUN - 1) // RUN
    if run < runs_of_edges:
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
                span = kept(a, b, front, kept(a, b, skin, wp.vec2(0.0, 1.0)))
                if span[1] > span[0]:
                    slot = put(
                        mesh,
                        views,
                        view,
                        a + span[0] * (b - a),
                        a + span[1] * (b - a),
                        longest_m,
                        beside_m,
                        farthest_m,
                        pieces,
                        slot,
                        stop,
                    )
    else:
        start = (run - runs_of_edges) * RUN
        for face in range(start, wp.min(start + RUN, mesh.corners.shape[0])):
            corners = mesh.corners[face]
            a = mesh.points[corners[0]]
            b = mesh.points[corners[1]]
            c = mesh.points[corners[2]]
            on_skin = wp.vec3(above(a, skin), above(b, skin), above(c, skin))
            on_board = wp.vec3(above(a, front), above(b, front), above(c, front))
            if wp.max(on_skin) > 0.0 and wp.max(on_board) > 0.0:
                # The cap over the skin looks at the eye, so that it ends where a face looks away; that at the board
                # looks away, and what is seen ends where a face looks at the eye
                towards = above(eye, mesh.planes[face]) > 0.0
                if wp.min(on_skin) <= 0.0 and not towards:
                    ends = ends_on(on_skin, a, b, c)
                    last = wp.vec3(ends[0, 0], ends[0, 1], ends[0, 2])
                    begin = wp.vec3(ends[1, 0], ends[1, 1], ends[1, 2])
                    span = kept(begin, last, front, wp.vec2(0.0, 1.0))
                    if span[1] > span[0]:
                        slot = put(
                            mesh,
                            views,
                            view,
                            begin + span[0] * (last - begin),
                            begin + span[1] * (last - begin),
                            longest_m,
                            beside_m,
                            farthest_m,
                            pieces,
                            slot,
                            stop,
                        )
                if wp.min(on_board) <= 0.0 and towards:
                    ends = ends_on(on_board, a, b, c)
                    begin = wp.vec3(ends[0, 0], ends[0, 1], ends[0, 2])
                    last = wp.vec3(ends[1, 0], ends[1, 1], ends[1, 2])
                    span = kept(begin, last, skin, wp.vec2(0.0, 1.0))
                    if span[1] > span[0]:
                        slot = put(
                            mesh,
                            views,
                            view,
                            begin + span[0] * (last - begin),
                            begin + span[1] * (last - begin),
                            longest_m,
                            beside_m,
                            farthest_m,
                            pieces,
                            slot,
                            stop,
                        )
    pieces.counts[view, run] = slot - slots[run]


@wp.kernel
def count_pieces(pieces: Pieces, first: wp.int32):
    """How many pieces there are before each run; dim: views, from `first` on."""
    view = first + wp.tid()
    total = wp.int32(0)
    for run in range(pieces.counts.shape[1]):
        pieces.starts[view, run] = total
        total += pieces.counts[view, run]
    pieces.starts[view, pieces.counts.shape[1]] = total


@wp.kernel
def list_pieces(pieces: Pieces, slots: wp.array(dtype=wp.int32), first: wp.int32):
    """The slots that are in use, in order; dim: (views, runs), from view `first` on. slots: as `find_pieces`"""
    i, run = wp.tid()
    view = first + i
    for j in range(pieces.counts[view, run]):
        pieces.listed[view, pieces.starts[view, run] + j] = slots[run] + j


@wp.func
def count_of(pieces: Pieces, view: wp.int32):
    return pieces.starts[view, pieces.starts.shape[1] - 1]


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
    """Whether pieces are in or beside the way to the board, and if not how often they go round it.

    dim: (nodes, boards, LANES), from node `first` on; numbers: which points are nodes; groups: of each the view's
    widest: clearance up to which a piece counts, in Fresnel's v
    result: shape (nodes boards, LANES): more than 0 if there is such a piece; the share in going round the middle
    """
    i, number, lane = wp.tid()
    node = first + i
    boards = board.centres.shape[0]
    view = groups[node] * boards + number
    point = points[numbers[node]]
    front = views.fronts[view]
    height = above(point, front)
    near = wp.float32(0.0)
    around = wp.float32(0.0)
    axis = wp.normalize(board.centres[number] - point)
    for j in range(lane, count_of(pieces, view), LANES):
        slot = pieces.listed[view, j]
        middle = pieces.middles[view, slot]
        towards = middle - point
        falls = height - above(middle, front)
        if falls > 0.01 * height:
            near_side = wp.length(towards)
            # Nearly all the way for what lies on the board, where the scale would be 0
            share = wp.min(falls / height, 0.99)
            onward = near_side / share - near_side
            on_board = point + towards / share - board.centres[number]
            x = wp.max(wp.abs(wp.dot(on_board, board.right[number])) - board.sizes[number][0], 0.0)
            y = wp.max(wp.abs(wp.dot(on_board, board.up[number])) - board.sizes[number][1], 0.0)
            scale = wp.sqrt(0.5 * wavelength_m * onward * (onward + near_side) / near_side)
            if wp.sqrt(x * x + y * y) < widest * scale:
                near = 1.0
        along = wp.dot(towards, axis)
        square = wp.max(wp.dot(towards, towards) - along * along, 1.0e-9)
        around += wp.dot(axis, wp.cross(pieces.ways[view, slot], towards)) / square
    result[node * boards + number, lane] = wp.vec2(near, around / (2.0 * wp.pi))
