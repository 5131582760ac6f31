"""Surfaces and layers round a cylinder, such as a finger, or a gel round a bone."""

import math

import numpy as np

from palmfield.errors import SceneError
from palmfield.types import Float, Int, Patch, Surface

FACETS = 120
"""Number of edges round the cylinder of a scene; the middle of an edge is 0.03 % of the radius inside the circle."""
FEWEST = 12
"""Least number of edges round a cylinder. With 48 edges, the middle of an edge is 0.2 % of the radius inside."""


def cylinder_patch(radius_m: float, length_m: float, thickness_m: float, edge_m: tuple[float, float]) -> Patch:
    """Return the whole lateral face of a cylinder, for a layer of this thickness on a rigid bone.

    The axis is x; the middle is the origin. Vertices lie on the cylinder; edges are straight. Quartered triangles stay
    in the same planes, so `edge_m` determines how round the body is.

    radius_m: radius of the face [m]; thickness_m: thickness of the layer [m], the bone has the rest of the radius.
    edge_m: edge length round the cylinder and along it [m]. Returns a Patch whose rim is both ends.
    Raises SceneError unless all lengths are above 0, the thickness is below the radius, and the edges are at most as
    long as the cylinder and a twelfth of its circumference.
    """
    _check(radius_m, length_m, edge_m)
    if not 0.0 < thickness_m < radius_m:
        raise SceneError(
            f"cylinder: a layer of {thickness_m} m with outer radius {radius_m} m leaves no room for bone; give a "
            "thickness above 0 and below the radius"
        )
    vertices, faces, around = _tube(radius_m, length_m, edge_m)
    count = len(vertices)
    outward = np.column_stack([np.zeros(count), vertices[:, 1:] / radius_m])
    return Patch(
        vertices=vertices,
        faces=faces,
        inward=-outward,
        depth=np.full(count, thickness_m),
        rim=np.isin(np.arange(count) // around, [0, count // around - 1]),
    )


def cylinder_surface(radius_m: float, length_m: float, edge_m: tuple[float, float]) -> Surface:
    """Return a closed cylinder with flat ends for the body of a scene; arguments as for `cylinder_patch`."""
    _check(radius_m, length_m, edge_m)
    vertices, faces, around = _tube(radius_m, length_m, edge_m)
    count = len(vertices)
    ends = np.array([[-0.5 * length_m, 0.0, 0.0], [0.5 * length_m, 0.0, 0.0]])
    here = np.arange(around)
    on = (here + 1) % around
    top = count - around
    low = np.column_stack([np.full(around, count), on, here])
    high = np.column_stack([np.full(around, count + 1), top + here, top + on])
    normals = np.concatenate([np.column_stack([np.zeros(count), vertices[:, 1:] / radius_m]), np.sign(ends)])
    return Surface(np.concatenate([vertices, ends]), np.concatenate([faces, low, high]).astype(np.int32), normals)


def round_body(radius_m: float, length_m: float) -> Surface:
    """Return the surface of a cylinder for a scene: FACETS facets round it, at most four times as long as wide."""
    around = 2.0 * math.pi * radius_m / FACETS
    return cylinder_surface(radius_m, length_m, (around, min(4.0 * around, length_m)))


def _tube(radius_m: float, length_m: float, edge_m: tuple[float, float]) -> tuple[Float, Int, int]:
    """Return vertices by ring from low x, faces (counter-clockwise from outside), and number of vertices per ring."""
    around = max(FEWEST, math.ceil(2.0 * math.pi * radius_m / edge_m[0]))
    rings = max(2, math.ceil(length_m / edge_m[1])) + 1
    # Every other ring is rotated by half an edge, so that the mesh has no preferred direction
    turn = np.arange(around) + 0.5 * (np.arange(rings) % 2)[:, None]
    angle = 2.0 * math.pi * turn / around
    along = np.broadcast_to(np.linspace(-0.5, 0.5, rings)[:, None] * length_m, angle.shape)
    vertices = np.stack([along, radius_m * np.cos(angle), radius_m * np.sin(angle)], axis=-1).reshape(-1, 3)
    here = np.arange(around)
    on = (here + 1) % around
    faces = []
    for ring in range(rings - 1):
        low, high = ring * around, (ring + 1) * around
        if ring % 2 == 0:
            faces += [np.column_stack([low + here, low + on, high + here])]
            faces += [np.column_stack([low + on, high + on, high + here])]
        else:
            faces += [np.column_stack([low + here, high + on, high + here])]
            faces += [np.column_stack([low + here, low + on, high + on])]
    return vertices, np.concatenate(faces).astype(np.int32), around


def _check(radius_m: float, length_m: float, edge_m: tuple[float, float]) -> None:
    girth = 2.0 * math.pi * radius_m
    good = all(math.isfinite(x) and x > 0.0 for x in (radius_m, length_m, *edge_m))
    if not good or edge_m[0] > girth / FEWEST or edge_m[1] > length_m:
        raise SceneError(
            f"cylinder of radius {radius_m} m and length {length_m} m with edges of {edge_m} m: give lengths above "
            f"0, and edges of at most 1/{FEWEST} of the circumference and at most the length"
        )
