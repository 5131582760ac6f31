"""Which hand a mesh is, and where its palm looks, from its shape alone."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from palmfield.hand.holes import plane_axes
from palmfield.hand.triangles import unique_edges
from palmfield.types import Float, Int

# A tip is farther from the wrist than all skin within this share of the longest way; two tips are as far apart.
TIP_REACH_SHARE = 0.15
# Tips this share of the length out of the plane of the palm leave no doubt.
CLEAR_LIFT_SHARE = 0.06
LEAST_SURENESS = 0.03


@dataclass(frozen=True)
class Chirality:
    """side: "right", "left" or "unknown"; sureness: 0 to 1, how far the tips lie to the palm's side against
    CLEAR_LIFT_SHARE; palm: unit outward direction of the palm, shape (3,); tips: digit tips, thumb first, then from its
    neighbour on, shape (k, 3); reason: in words
    """

    side: str
    sureness: float
    palm: Float
    tips: Float
    reason: str


def chirality(vertices: Float, faces: Int) -> Chirality:
    """Side of a closed hand's mesh [m]; a right one has its thumb to the right, fingers up, seen on the palm.

    Tips are the farthest skin from the wrist along the surface; the thumb's is the one nearest to the wrist; digits
    bend to the palm's side. A flat, thin or closed hand leaves the side unknown.
    """
    middle = vertices.mean(axis=0)
    axes = plane_axes(vertices)
    links = _links(vertices, faces)
    wrist = _wrist(vertices, links, axes[0])
    way = _distance(links, wrist)
    tips = _tips(links, way)
    fingers = vertices[tips].mean(axis=0) - vertices[wrist].mean(axis=0)
    fingers /= np.linalg.norm(fingers)
    # The palm is what lies nearer to the wrist than all webs do.
    low = vertices[way < 0.5 * way.max()]
    flat = plane_axes(low - np.outer((low - middle) @ fingers, fingers))
    normal = np.cross(fingers, flat[0])
    normal /= np.linalg.norm(normal)
    if len(tips) != 5:
        reason = f"{len(tips)} digit tips were found, not 5"
        return Chirality("unknown", 0.0, normal, vertices[tips], reason)
    thumb = tips[int(np.argmin(way[tips]))]
    others = np.array([tip for tip in tips if tip != thumb])
    others = others[np.argsort(np.linalg.norm(vertices[others] - vertices[thumb], axis=1))]
    ordered = np.concatenate([[thumb], others])
    base = vertices[way < 0.35 * way.max()].mean(axis=0)
    lift = float(((vertices[ordered] - base) @ normal).mean())
    palm = normal if lift > 0.0 else -normal
    length = float(np.ptp((vertices - middle) @ fingers))
    sureness = min(1.0, abs(lift) / (CLEAR_LIFT_SHARE * length))
    if sureness < LEAST_SURENESS:
        reason = f"the digit tips lie in the plane of the palm, by {1e3 * abs(lift):.1f} mm"
        return Chirality("unknown", sureness, palm, vertices[ordered], reason)
    to_thumb = vertices[thumb] - vertices[others].mean(axis=0)
    side = "right" if to_thumb @ np.cross(fingers, palm) > 0.0 else "left"
    reason = f"thumb tip seen, digit tips {1e3 * abs(lift):.1f} mm to the palm's side"
    return Chirality(side, sureness, palm, vertices[ordered], reason)


def fingers_direction(vertices: Float, faces: Int) -> Float:
    """Unit direction from the wrist along the length, shape (3,), for meshes with holes as well."""
    along = plane_axes(vertices)[0]
    wrist = _wrist(vertices, _links(vertices, faces), along)
    return along if (vertices.mean(axis=0) - vertices[wrist].mean(axis=0)) @ along > 0.0 else -along


def _links(vertices: Float, faces: Int) -> sparse.csr_array:
    edges, _ = unique_edges(faces)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    half = sparse.coo_array((length, edges.T), shape=(len(vertices), len(vertices)))
    return sparse.csr_array(half + half.T)


def _distance(links: sparse.csr_array, sources: Int) -> Float:
    """Way along the edges to the nearest of `sources` [m], shape (n,)."""
    return sparse.csgraph.dijkstra(links, directed=False, indices=sources, min_only=True)


def _wrist(vertices: Float, links: sparse.csr_array, along: Float) -> Int:
    """Vertices of that end of the length that is one piece where the other is several, or else is thicker."""
    height = vertices @ along
    low, high = height.min(), height.max()
    depth = 0.04 * (high - low)
    ends = [np.flatnonzero(height < low + depth), np.flatnonzero(height > high - depth)]
    girth = [np.ptp(vertices[end] - np.outer(vertices[end] @ along, along), axis=0).max() for end in ends]
    pieces = []
    for sign, limit in ((1.0, low + 0.25 * (high - low)), (-1.0, -high + 0.25 * (high - low))):
        chosen = np.flatnonzero(sign * height < limit)
        pieces.append(sparse.csgraph.connected_components(links[chosen][:, chosen], directed=False)[0])
    if pieces[0] != pieces[1]:
        return ends[int(np.argmin(pieces))].astype(np.int32)
    return ends[int(np.argmax(girth))].astype(np.int32)


def _tips(links: sparse.csr_array, way: Float) -> Int:
    """Vertices that are farther from the wrist than all around them, the farthest first."""
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
