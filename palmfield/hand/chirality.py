"""Determine the side of a hand and the direction of its palm from its shape alone."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from palmfield.hand.holes import plane_axes
from palmfield.hand.triangles import edge_lengths, vertex_areas
from palmfield.types import Float, Int

# Radius about a tip without farther skin, and smallest distance of two tips, as a share of the longest distance.
TIP_REACH_SHARE = 0.15
# Shares of the finger length beyond the webs. CLEAR_LIFT: distance from the middle plane of the palm at which a thumb
# is certain; straight fingers are within STRAIGHT of this plane, bent fingers CLEAR_LIFT farther out. CLEAR_WEB,
# CLEAR_TIP: how much nearer to the wrist the web and the tip of a thumb are than those of the next digit.
CLEAR_LIFT, STRAIGHT, CLEAR_WEB, CLEAR_TIP = 0.15, 0.08, 0.3, 0.15
LEAST_SURENESS = 0.5
# Share of the length, from the end, in which fingers are separate: for a forearm with its hand, and for a hand.
PIECE_SHARES = (0.1, 0.25)


@dataclass(frozen=True)
class Chirality:
    """Side of a hand. side: "right", "left" or "unknown"; sureness: 0 to 1; palm: unit outward direction, shape (3,),
    an estimate if the side is unknown; tips: digit tips, shape (k, 3), from the thumb on; middle: centre of the skin
    between wrist and webs, shape (3,); reason: reason in words
    """

    side: str
    sureness: float
    palm: Float
    tips: Float
    middle: Float
    reason: str


def chirality(vertices: Float, faces: Int, named: str = "unknown") -> Chirality:
    """Return the side of a closed hand's mesh, in any unit and position; unknown if the sureness is below 0.5.

    vertices: shape (n, 3); faces: shape (m, 3); named: side by the file, for instance by joint names, which is used if
    the shape determines the thumb but not the palm

    The distance from the wrist along the skin hardly depends on the pose. The five maxima of this distance are the
    tips, and the saddles between them are the webs. The thumb is the digit whose web and tip are nearest to the wrist.
    The thumb and the tips of bent fingers are on the palmar side of the middle plane of the skin between wrist and
    webs. Sureness is reduced if thumb and fingers are on different sides of this plane. Seen on the palm with the
    fingers up, a right hand has its thumb to the right.
    """
    links = _links(vertices, faces)
    wrist = _wrist(vertices, links, plane_axes(vertices)[0])
    way = _distance(links, wrist)
    tips = _tips(links, way)
    if len(tips) != 5:
        up = vertices[way > np.median(way)].mean(axis=0) - vertices[wrist].mean(axis=0)
        near = way < 0.5 * way.max()
        normal = _frame(vertices, near, np.ones(len(vertices)), up)[1]
        middle = vertices[near].mean(axis=0)
        return Chirality("unknown", 0.0, normal, vertices[tips], middle, f"found {len(tips)} digit tips, expected 5")
    level, passes = _webs(links, way, tips)
    web = level.max(axis=1)
    thumb, fingers = int(np.argmin(web)), np.argsort(web)[1:]
    between = level[np.ix_(fingers, fingers)]
    low = float(between[between >= 0.0].min())
    length = float(way[tips[fingers]].mean()) - low
    digits = [_beyond(links, way, tip, reach) for tip, reach in zip(tips, web, strict=True)]
    on_palm = (way > low - length) & (way < low)
    on_palm[digits[thumb]] = False
    weight = vertex_areas(vertices, faces)  # so that the weight does not depend on the mesh density
    middle = np.average(vertices[on_palm], axis=0, weights=weight[on_palm])
    across, normal = _frame(
        vertices, on_palm, weight, vertices[passes[np.ix_(fingers, fingers)]].mean(axis=(0, 1)) - middle
    )
    if (vertices[passes[thumb, fingers]].mean(axis=0) - middle) @ across < 0.0:
        across, normal = -across, -normal
    # `normal` points out of the palm of a right hand and out of the back of a left one.
    of_thumb = float((vertices[digits[thumb]].mean(axis=0) - middle) @ normal) / length
    of_tips = float(((vertices[tips[fingers]] - middle) @ normal).mean()) / length
    bent = np.sign(of_tips) * max(0.0, abs(of_tips) - STRAIGHT)
    evidence = float(np.clip(of_thumb / CLEAR_LIFT, -1.0, 1.0) + np.clip(bent / CLEAR_LIFT, -1.0, 1.0))
    web_offset = float(web[fingers].min() - web[thumb]) / length
    nearer = float(way[tips[fingers]].min() - way[tips[thumb]]) / length
    # Web and tip alone are weak evidence of the thumb (mitten, bent thumb); together they are strong evidence
    of_web, nearest = np.clip([web_offset / CLEAR_WEB, nearer / CLEAR_TIP], -1.0, 1.0)
    thumb_sureness = float(np.clip(of_web + nearest, 0.0, 1.0))
    sureness = min(1.0, abs(evidence)) * thumb_sureness
    by_name = sureness < LEAST_SURENESS <= thumb_sureness and named != "unknown"
    right = named == "right" if by_name else evidence > 0.0
    palm = normal if right else -normal
    from_thumb = fingers[np.argsort([-(vertices[digits[i]].mean(axis=0) @ across) for i in fingers])]
    ordered = vertices[tips[[thumb, *from_thumb]]]
    sign = 1.0 if right else -1.0
    reason = (
        f"relative to the length of the fingers, the thumb branches off {web_offset:.2f} and ends {nearer:.2f} closer "
        f"to the wrist than the other digits; the thumb is {sign * of_thumb:+.2f} and the fingertips are "
        f"{sign * of_tips:+.2f} towards the palm"
    )
    if by_name:
        return Chirality(named, thumb_sureness, palm, ordered, middle, f"from the joint names; {reason}")
    if sureness < LEAST_SURENESS:
        return Chirality("unknown", sureness, palm, ordered, middle, f"not sure: {reason}")
    return Chirality("right" if right else "left", sureness, palm, ordered, middle, reason)


def way_from_wrist(vertices: Float, faces: Int) -> Float:
    """Return the distance of each vertex along the edges from the wrist, in the unit of the mesh, shape (n,)."""
    links = _links(vertices, faces)
    return _distance(links, _wrist(vertices, links, plane_axes(vertices)[0]))


def fingertips(vertices: Float, faces: Int) -> Float:
    """Return the digit tips of a mesh, which may have holes, shape (k, 3); a hand has five.

    Of several bodies, the body with the most vertices is used.
    """
    links = _links(vertices, faces)
    label = sparse.csgraph.connected_components(links, directed=False)[1]
    largest = np.flatnonzero(label == np.argmax(np.bincount(label)))
    links, points = sparse.csr_array(links[largest][:, largest]), vertices[largest]
    way = _distance(links, _wrist(points, links, plane_axes(points)[0]))
    return points[_tips(links, way)]


def fingers_direction(vertices: Float, faces: Int) -> Float:
    """Return the unit direction from the wrist along the length, shape (3,); the mesh may have holes."""
    along = plane_axes(vertices)[0]
    wrist = _wrist(vertices, _links(vertices, faces), along)
    return along if (vertices.mean(axis=0) - vertices[wrist].mean(axis=0)) @ along > 0.0 else -along


def _frame(vertices: Float, chosen: np.ndarray, weight: Float, up: Float) -> tuple[Float, Float]:
    """Return unit vectors across the chosen skin (sign unknown) and normal to it (across x up)."""
    up = up / np.linalg.norm(up)
    points = vertices[chosen] - np.average(vertices[chosen], axis=0, weights=weight[chosen])
    points = points - np.outer(points @ up, up)
    across = np.linalg.svd(points * np.sqrt(weight[chosen])[:, None], full_matrices=False)[2][0]
    return across, np.cross(across, up)


def _webs(links: sparse.csr_array, way: Float, tips: Int) -> tuple[Float, Int]:
    """Return distance and vertex of the highest saddle between each two tips, shape (k, k); -1 on the diagonal."""
    pairs = links.tocoo()
    depth = way.max() - np.minimum(way[pairs.row], way[pairs.col])
    # On a minimum spanning tree by depth the only path between two tips is the one with the highest minimum.
    tiny = 1e-9 * float(way.max())
    tree = sparse.csgraph.minimum_spanning_tree(
        sparse.csr_array((depth + tiny, (pairs.row, pairs.col)), shape=links.shape)
    )
    passes = np.tile(tips, (len(tips), 1))
    for i, start in enumerate(tips):
        before = sparse.csgraph.breadth_first_order(tree, start, directed=False)[1]
        for j, here in enumerate(tips):
            while here != start:
                if way[here] < way[passes[i, j]]:
                    passes[i, j] = here
                here = before[here]
    level: Float = np.asarray(way[passes], dtype=np.float64)
    np.fill_diagonal(level, -1.0)
    return level, passes


def _beyond(links: sparse.csr_array, way: Float, tip: int, level: float) -> Int:
    """Return the vertices farther from the wrist than `level` that are connected to a tip."""
    far = np.flatnonzero(way > level)
    label = sparse.csgraph.connected_components(links[far][:, far], directed=False)[1]
    return far[label == label[np.searchsorted(far, tip)]]


def _links(vertices: Float, faces: Int) -> sparse.csr_array:
    edges, length = edge_lengths(vertices, faces)
    half = sparse.coo_array((length, edges.T), shape=(len(vertices), len(vertices)))
    return sparse.csr_array(half + half.T)


def _distance(links: sparse.csr_array, sources: Int) -> Float:
    """Return the distance along the edges to the nearest of `sources` [m], shape (n,)."""
    return sparse.csgraph.dijkstra(links, directed=False, indices=sources, min_only=True)


def _wrist(vertices: Float, links: sparse.csr_array, along: Float) -> Int:
    """Return the vertices of the wrist: the end of the length that is one piece, or the thicker end."""
    height = vertices @ along
    low, high = height.min(), height.max()
    depth = 0.04 * (high - low)
    ends = [np.flatnonzero(height < low + depth), np.flatnonzero(height > high - depth)]
    girth = [np.ptp(vertices[end] - np.outer(vertices[end] @ along, along), axis=0).max() for end in ends]
    pieces = [1, 1]
    for share in PIECE_SHARES:
        reach = share * (high - low)
        for i, chosen in enumerate((np.flatnonzero(height < low + reach), np.flatnonzero(height > high - reach))):
            number = sparse.csgraph.connected_components(links[chosen][:, chosen], directed=False)[0]
            pieces[i] = max(pieces[i], number)
    if pieces[0] != pieces[1]:
        return ends[int(np.argmin(pieces))].astype(np.int32)
    return ends[int(np.argmax(girth))].astype(np.int32)


def _tips(links: sparse.csr_array, way: Float) -> Int:
    """Return the local maxima of the distance from the wrist, the farthest first."""
    reach = TIP_REACH_SHARE * float(way.max())
    neighbours = links.indices
    highest = np.maximum.reduceat(way[neighbours], links.indptr[:-1])
    tips: list[int] = []
    for peak in np.argsort(-way):
        if way[peak] < highest[peak] or way[peak] < 0.4 * way.max():
            continue
        near = sparse.csgraph.dijkstra(links, directed=False, indices=peak, limit=reach)
        if way[np.isfinite(near)].max() <= way[peak]:
            tips.append(int(peak))
    return np.array(tips, dtype=np.int64)
