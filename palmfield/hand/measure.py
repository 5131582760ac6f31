"""Lengths and circumferences of a hand mesh, as measured with a tape."""

import numpy as np
import trimesh
from scipy import sparse
from scipy.spatial import ConvexHull

from palmfield.errors import SceneError
from palmfield.hand.meshquery import exit_distances
from palmfield.hand.surface import HandSurface
from palmfield.types import Float

SAME_m = 1e-7
"""Ends of pieces of a section that are closer than this are joined."""


def measures(hand: HandSurface) -> dict[str, float]:
    """Return lengths [m] by name, defined as in ANSUR II (Gordon et al. 2014).

    length: wrist crease to the tip of the middle finger; breadth: across the hand at the metacarpal heads of index and
    little finger; hand_circumference: around these heads without the thumb; wrist_circumference: around the wrist
    Raises SceneError if a section is not closed.
    """
    vertices, faces, marks = hand.surface.vertices, hand.surface.faces, hand.landmarks
    index, little = marks["index_knuckle"], marks["little_knuckle"]
    across = little - index
    out = np.array([np.sign(across[0]), 0.0, 0.0])
    ends = exit_distances(vertices, faces, np.stack([index, little]), np.stack([-out, out]), 0.3)
    along = np.array([-across[1], across[0], 0.0])
    return {
        "length": float(vertices[:, 1].max() - marks["wrist"][1]),
        "breadth": float(ends.sum() + abs(across[0])),
        "hand_circumference": tape(hand, 0.5 * (index + little), along / np.linalg.norm(along)),
        "wrist_circumference": tape(hand, marks["wrist"], np.array([0.0, 1.0, 0.0])),
    }


def tape(hand: HandSurface, point: Float, normal: Float) -> float:
    """Return the length of a tight tape [m] in a plane around the part of the hand at the point; it bridges hollows."""
    mesh = trimesh.Trimesh(hand.surface.vertices, hand.surface.faces, process=False)
    cut = trimesh.intersections.mesh_plane(mesh, normal, point)
    helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
    right = np.cross(normal, helper)
    axes = np.stack([right, np.cross(normal, right)]).T / np.linalg.norm(right)
    ends = (cut.reshape(-1, 3) - point) @ axes
    _, number = np.unique(np.round(ends / SAME_m), axis=0, return_inverse=True)
    links = number.reshape(-1, 2)
    count = int(links.max(initial=-1)) + 1
    graph = sparse.coo_array((np.ones(len(links)), links.T), shape=(count, count))
    label = sparse.csgraph.connected_components(graph, directed=False)[1][links[:, 0]]
    hulls = [ConvexHull(ends.reshape(-1, 2, 2)[label == part].reshape(-1, 2)) for part in np.unique(label)]
    # The point is inside a hull if the offsets of all sides are below 0
    around = [hull for hull in hulls if hull.equations[:, 2].max() < 0.0]
    if not around:
        place = ", ".join(f"{1e3 * c:.1f}" for c in point)
        raise SceneError(
            f"hand: the section around ({place}) mm with normal {normal.round(2).tolist()} is not "
            "closed; close the mesh there"
        )
    # The "area" of a hull in the plane is its perimeter
    return float(min(hull.area for hull in around))
