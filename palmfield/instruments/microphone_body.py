"""Effect of the body of a microphone on the sound at its face: rigid cylinder in a plane wave, boundary elements."""

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np

from palmfield.acoustics.scattering import scatter
from palmfield.errors import MeasurementError
from palmfield.types import Float, Int

LENGTH_RADII = 6.0
"""Length of the cylinder over its radius; other lengths change the pressure at the face by 0.2 dB (diffraction)."""
EDGES_A_RADIUS = 5
EDGES_A_WAVE = 8.0
MOST_KA = 6.0


def face_rise(diameter_m: float, wavenumber: float, cosine: float = 1.0) -> complex:
    """Return the mean pressure on the face of a rigid cylinder in a plane wave, over that of the wave at its centre.

    It is 1 for wavelengths much larger than the face; 1.57 (3.9 dB) from the front at k a = 1.16, 1/8 inch at 40 kHz;
    2.15 from k a = 2 on, with edge diffraction and doubling. With e^{-i w t} a delay is +phase. The error is 0.3 dB:
    0.1 dB by the mesh (change with half the edge length), 0.2 dB by the length. The first call takes over a second.

    diameter_m: diameter of face and body; wavenumber: [rad/m]; cosine: cosine of the angle between the outward normal
    of the face and the direction to the source
    Raises MeasurementError for cosines beyond -1 and 1, and for k a that is not above 0 or above MOST_KA.
    """
    ka = 0.5 * diameter_m * wavenumber
    if not 0.0 < ka <= MOST_KA:
        raise MeasurementError(
            f"microphone: diameter_m is {diameter_m:g} and the wavenumber {wavenumber:g} rad/m, so that k a is {ka:g}; "
            f"allowed: above 0, up to {MOST_KA:g}"
        )
    if not -1.0 <= cosine <= 1.0:
        raise MeasurementError(f"microphone: cosine of the source's direction is {cosine:g}; allowed: -1 to 1")
    return _face_rise(round(ka, 6), round(cosine, 6))


@lru_cache(maxsize=256)
def _face_rise(ka: float, cosine: float) -> complex:
    vertices, faces = cylinder(max(EDGES_A_RADIUS, math.ceil(EDGES_A_WAVE * ka / (2.0 * math.pi))))
    sine = math.sqrt(1.0 - cosine**2)
    solution = scatter(
        vertices, faces, lambda points: np.exp(-1j * ka * (cosine * points[:, 2] + sine * points[:, 0])), ka,
        device="cpu",
    )  # fmt: skip
    on_face = np.abs(solution.centroids[:, 2]) < 1e-9
    areas = solution.areas[on_face]
    return complex((solution.pressure[on_face] * areas).sum() / areas.sum())


def cylinder(edges: int) -> tuple[Float, Int]:
    """Return vertices and outward faces of a cylinder of radius 1 whose face is at z = 0 and points along +z.

    edges: number of triangle edges from the centre of the face to its rim
    """
    step = 1.0 / edges
    along = max(2, round(LENGTH_RADII / step))
    radii = np.arange(1, edges + 1) * step
    profile = [(float(r), 0.0) for r in radii]
    profile += [(1.0, -LENGTH_RADII * n / along) for n in range(1, along + 1)]
    profile += [(float(r), -LENGTH_RADII) for r in radii[-2::-1]]
    vertices, rings = [np.zeros(3)], []
    for radius, z in profile:
        count = max(6, round(2.0 * math.pi * radius / step))
        rings.append((len(vertices), count))
        angles = 2.0 * math.pi * np.arange(count) / count
        vertices += list(np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, z)]))
    vertices.append(np.array([0.0, 0.0, -LENGTH_RADII]))
    first, count = rings[0]
    faces = [(0, first + n, first + (n + 1) % count) for n in range(count)]
    for (one, many), (other, more) in pairwise(rings):
        n = m = 0
        while n < many or m < more:
            # Advance the ring whose next vertex comes first
            if m == more or (n < many and (n + 1) * more <= (m + 1) * many):
                faces.append((one + n % many, other + m % more, one + (n + 1) % many))
                n += 1
            else:
                faces.append((one + n % many, other + m % more, other + (m + 1) % more))
                m += 1
    last, count = rings[-1]
    faces += [(len(vertices) - 1, last + (n + 1) % count, last + n) for n in range(count)]
    return np.array(vertices), np.array(faces)
