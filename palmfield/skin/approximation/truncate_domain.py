"""Restrict a layer to the part that affects the requested points, or to a smaller one to estimate its reflection."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.hand.remesh import outward
from palmfield.hand.triangles import face_components, on_rim
from palmfield.skin.analytic.layer_oracle import centre_responses
from palmfield.skin.approximation.bands import bands, course_moves, resonance
from palmfield.skin.approximation.load_scales import load_centre, load_width
from palmfield.skin.materials.material import shear_wave
from palmfield.skin.problem import Body, Layer, Load, Spot
from palmfield.types import Float, Int, Patch

SHARE = 0.1
"""Largest share of the target accuracy for the error of the cut edge."""
FURTHEST = 20.0
"""Largest distance, in widths of the load, at which the decay is evaluated."""
FLATTEST = 0.5
"""Least |z component| of the mean outward direction of a patch under a spot, because a spot is defined in x and y."""


def truncate_domain(body: Body, load: Load, end_s: float, at: Float, accuracy: float) -> tuple[Body, Load, float]:
    """Return the part of a body around the load and the points, the load on it, and the relative error of truncation.

    end_s: last requested time [s]. at: requested points [m], shape (n, 2) or (n, 3). accuracy: target relative error.
    A layer of one sheet bonded to bone is cut where the edge changes the motion by SHARE of the accuracy. The estimate
    uses a flat infinite layer of the greatest depth (palmfield.skin.analytic.layer_oracle); see `reach`. Other bodies,
    layers almost without loss, and layers that need their whole patch are returned unchanged, with error 0.
    """
    if not isinstance(body, Layer) or len(body.sheets) != 1 or body.base != "bonded":
        return body, load, 0.0
    try:
        result = reach(body, load, end_s, accuracy)
    except SceneError:
        # Undamped waves reach the whole layer
        result = None
    if result is None:
        return body, load, 0.0
    distance, change = result
    patch = body.patch
    path = load.centres() if isinstance(load, Spot) else load.points[np.any(load.pressure_Pa != 0.0, axis=0), :2]
    requested = np.asarray(at, dtype=float)[:, :2]
    here = patch.vertices[:, :2]
    away = cKDTree(np.concatenate([path, requested])).query(here)[0]
    inside = away <= distance
    if len(path) == 0 or cKDTree(path).query(requested)[0].max() > distance:
        # Waves reach farther points on a straight path
        marks = np.concatenate([path, requested])
        inside = np.all((here >= marks.min(axis=0) - distance) & (here <= marks.max(axis=0) + distance), axis=1)
    kept = inside[patch.faces].any(axis=1)
    if kept.all() or not kept.any() or face_components(patch.faces[kept]).max() > 0:
        return body, load, 0.0
    if not isinstance(load, Spot):
        # Points without pressure at the boundary of the load stay
        near = cKDTree(path).query(load.points[:, :2])[0] <= distance
        load = replace(
            load, points=load.points[near], weights_m2=load.weights_m2[near], pressure_Pa=load.pressure_Pa[:, near]
        )
    return replace(body, patch=part_of(patch, kept)), load, change


def reach(body: Layer, load: Load, end_s: float, accuracy: float) -> tuple[float, float] | None:
    """Return the distance [m] at which an edge changes the motion by at most SHARE of the accuracy, and that change.

    The change follows from the ratio of the motion at a distance to the motion at the centre, in energies summed over
    bands. An edge reflects a wave with at most this ratio, and the wave decays by the same ratio on its way back. A
    guided wave, above c_s / 4h, focuses in the middle of a round edge, with sqrt(2 pi k R) times its amplitude at the
    edge. The largest ratio at this or a larger distance counts, because motion may pass through 0.
    Returns None if no distance up to FURTHEST widths is enough.
    """
    material, width = body.sheets[0].material, load_width(load)
    depth = float(body.patch.depth.max())
    distances = width * np.linspace(0.0, FURTHEST, 1 + round(4.0 * FURTHEST))
    guided = resonance(material, depth)
    if not course_moves(load, end_s):
        return None
    total = np.zeros(len(distances))
    frequencies, energies = bands(load, end_s, guided)
    responses = centre_responses(frequencies, material, depth, width, distances, "bonded", 1e-4)
    for frequency, energy, response in zip(frequencies, energies, responses, strict=True):
        seen = energy * np.abs(response) ** 2
        if frequency > guided:
            wavenumber = 2.0 * math.pi * frequency / shear_wave(material, frequency)[0]
            seen *= np.maximum(1.0, 2.0 * math.pi * wavenumber * distances)
        total += seen
    beyond = np.sqrt(np.maximum.accumulate(total[::-1])[::-1] / total[0])
    low = np.flatnonzero(beyond <= SHARE * accuracy)
    if len(low) == 0:
        return None
    return float(distances[low[0]]), float(beyond[low[0]])


def part_of(patch: Patch, kept: NDArray[np.bool_]) -> Patch:
    """Return the patch of the kept faces, (m,) bool; its rim consists of the edges that belong to only one face."""
    numbers, faces = np.unique(patch.faces[kept], return_inverse=True)
    corners: Int = faces.reshape(-1, 3).astype(np.int32)
    return replace(
        patch,
        vertices=patch.vertices[numbers],
        faces=corners,
        inward=patch.inward[numbers],
        depth=patch.depth[numbers],
        rim=on_rim(corners, len(numbers)),
        report={**patch.report, "faces_kept": float(kept.mean())},
    )


def refusal_of_spot(body: Body, load: Load) -> str | None:
    """Return the reason why a spot cannot act on this layer, in a sentence, or None."""
    if not isinstance(body, Layer) or not isinstance(load, Spot):
        return None
    if not body.patch.rim.any() or abs(outward(body.patch)[2]) < FLATTEST:
        return (
            "a Spot is defined in x and y, but the normal of this layer is not along z: rotate the patch, or give "
            "pressures at points (Traction)"
        )
    return None


def trim_absorbing_rim(body: Body, load: Load, points: Float, reach: float) -> Body:
    """Return a layer without a belt along its rim; other bodies are unchanged.

    The width of the belt is (1 - reach) of the distance from the middle of the load to the rim. It is at most half of
    the distance from load or requested points (n, 3) to the rim. A layer without room for a belt is unchanged."""
    if reach == 1.0 or not isinstance(body, Layer):
        return body
    patch = body.patch
    rim = cKDTree(patch.vertices[patch.rim, :2])
    pressed = load.centres() if isinstance(load, Spot) else load.points[np.any(load.pressure_Pa != 0.0, axis=0), :2]
    room = float(rim.query(np.concatenate([pressed, points[:, :2]]))[0].min())
    width = min((1.0 - reach) * float(rim.query(load_centre(load)[0])[0]), 0.5 * room)
    kept = rim.query(patch.vertices[patch.faces].mean(axis=1)[:, :2])[0] > width
    if kept.all() or not kept.any() or face_components(patch.faces[kept]).max() > 0:
        return body
    return replace(body, patch=part_of(patch, kept))
