"""Spacing of particles for a target error, its cost, and the limits of particles."""

import itertools
import math

import numpy as np

from palmfield.errors import SceneError
from palmfield.hand.triangles import face_normals
from palmfield.skin.approximation.load_scales import mean_frequency, motion_width, passing_frequency
from palmfield.skin.base import NEEDS_AXIS, Foundation, Springs
from palmfield.skin.materials.material import shear_wave
from palmfield.skin.problem import ONLY_WEDGES, Body, Layer, Load, SkinProblem, Slab, depth_of
from palmfield.skin.solvers.particles.columns import FEWEST_CELLS

SECONDS_A_STEP = {"cpu": 0.9e-6, "cuda": 2.0e-9}
"""Seconds of a step per particle: measured on one core; on a GPU the time for its 1.5 kB at 0.75 TB/s."""
STIFFEST = 1e5
"""Instantaneous bulk over shear modulus above which the step is so small that the solver refuses (nu 0.499995)."""
BELOW = 0.6
"""Error by the square of the spacing in depth over the depth."""
FINEST = 2e-3
"""Least target error for which a spacing is chosen."""
STIFFER = 100.0
"""Stiffness of a sheet over that of one below it, above which the solver refuses. On a bed 1/100 as stiff, a sheet one
cell thick bends a third too little, on one of 1/1000 two fifths, and the stated error is smaller than that."""
COARSER = 1.5
"""Spacing of the run that estimates the error, over the requested spacing."""
COARSE_CELLS = 2
"""Its fewest cells through the depth: COARSER times as high as FEWEST_CELLS make them."""


def refusal_particles(body: Body, load: Load) -> str | None:
    """Return why particles refuse a problem, or None."""
    if isinstance(body, Slab) and body.shape == "infinite":
        return "particles need a finite body: give the slab a shape 'box' or 'disc'"
    if isinstance(body.base, Foundation):
        return ONLY_WEDGES
    if isinstance(body.base, Springs):
        return "particles do not support a spring base: use base 'bonded', 'free_slip' or 'free'"
    if body.side == "absorbing":
        return "particles do not support absorbing sides: use side 'fixed', 'free' or 'roller'"
    if isinstance(body, Layer) and body.side == "roller" and body.patch.axis is None:
        return NEEDS_AXIS
    for material in (sheet.material for sheet in body.sheets):
        if material.bulk_Pa > STIFFEST * material.shear_instant_Pa:
            return (
                f"particle steps resolve the pressure wave, and '{material.name}' has a bulk modulus of "
                f"{material.bulk_Pa / material.shear_instant_Pa:.3g} times its shear modulus; allowed: at most "
                f"{STIFFEST:g}: use solver 'wedges' or 'lateral_waves'"
            )
    for upper, lower in itertools.combinations([sheet.material for sheet in body.sheets], 2):
        ratio = upper.shear_instant_Pa / lower.shear_instant_Pa
        if ratio > STIFFER:
            return (
                f"'{upper.name}' is {ratio:.3g} times as stiff as '{lower.name}' below it; allowed: at most "
                f"{STIFFER:g}, because particles underestimate the bending of such a sheet: use solver 'wedges' or "
                "'lateral_waves'"
            )
    return None


def law_error(body: Body, load: Load, spacing_m: float) -> float:
    """Return the relative error of particles at this spacing [m], measured on discs against the exact layer
    (docs/bench/skin_particles.md).

    0.65 (h / L)^2 + 0.6 (h_z / H)^2 + 4.6 (h / wavelength)^2: L = min(w, sqrt(w H)) of the width w of the spot, or the
    length that a narrow body needs under a wide one (`motion_width`); H the depth, h_z the spacing in depth, wavelength
    that of shear at the mean frequency of the load in its slowest sheet.
    """
    depth = depth_of(body)
    below = min(spacing_m, depth / FEWEST_CELLS)
    return _along_face(body, load) * spacing_m**2 + BELOW * (below / depth) ** 2


def _along_face(body: Body, load: Load) -> float:
    """Return the error by the square of the spacing along the face [1/m^2]."""
    width = motion_width(body, load)
    length = min(width, math.sqrt(width * depth_of(body)))
    frequency = max(mean_frequency(load), passing_frequency(load, width))
    waves = 0.0
    if frequency > 0.0:
        wavelength = min(shear_wave(sheet.material, frequency)[0] for sheet in body.sheets) / frequency
        waves = 4.6 / wavelength**2
    return 0.65 / length**2 + waves


def choose_spacing(body: Body, load: Load, accuracy: float) -> float:
    """Return the spacing [m] at which law_error is `accuracy`; the spacing in depth may have to be finer than along the
    face.

    Below FINEST it is that of FINEST. Raises SceneError for an accuracy that is not above 0 and at most 1.
    """
    if not 0.0 < accuracy <= 1.0:
        raise SceneError(f"particles: accuracy is {accuracy}; give 0.002 to 1 (5 % is typical)")
    accuracy = max(accuracy, FINEST)
    # The error estimate is not valid with fewer than two particles per width in its coarser run.
    high = min(length_of(body) / 4.0, motion_width(body, load) / 3.0)
    depth, along = depth_of(body), _along_face(body, load)
    # With the fewest cells through the depth, or as many as along the face
    few = math.sqrt(max(accuracy - BELOW / FEWEST_CELLS**2, 0.0) / along)
    return min(high, few if few >= depth / FEWEST_CELLS else math.sqrt(accuracy / (along + BELOW / depth**2)))


def cost_particles(problem: SkinProblem) -> float:
    """Return the predicted seconds: particles x steps x seconds of one step of one particle."""
    spacing = choose_spacing(problem.body, problem.load, problem.accuracy)
    return sum(_run_seconds(problem, h) for h in (spacing, COARSER * spacing))


def _run_seconds(problem: SkinProblem, spacing: float) -> float:
    body, load = problem.body, problem.load
    depth = depth_of(body)
    below = min(spacing, depth / FEWEST_CELLS)
    total = sum(sheet.thickness_m for sheet in body.sheets)
    thicknesses = [depth * sheet.thickness_m / total for sheet in body.sheets]
    cells = [math.ceil(thickness / below - 1e-6) for thickness in thicknesses]
    lowest = min(thickness / count for thickness, count in zip(thicknesses, cells, strict=True))
    area = _area(body)
    along = spacing if isinstance(body, Slab) else math.sqrt(area / len(body.patch.vertices))
    count = area / along**2 * (sum(cells) + 1.0)
    fastest = max(
        math.sqrt((s.material.bulk_Pa + 4.0 / 3.0 * s.material.shear_instant_Pa) / s.material.density_kg_m3)
        for s in body.sheets
    )
    # 1.24 spacings at the speed of sound were measured on cubes.
    step = 1.24 * math.sqrt(3.0 / (2.0 / along**2 + 1.0 / lowest**2)) / fastest
    steps = max(0.0, float(problem.times[-1]) - float(load.times_s[0])) / step
    return 0.1 + count * steps * SECONDS_A_STEP["cuda" if problem.device.startswith("cuda") else "cpu"]


def length_of(body: Body) -> float:
    """Return the least length along the face [m]."""
    if isinstance(body, Layer):
        return float(np.ptp(body.patch.vertices, axis=0).max())
    return min(body.size_m) if body.size_m is not None else 2.0 * (body.radius_m or 0.0)


def _area(body: Body) -> float:
    if isinstance(body, Layer):
        return float(face_normals(body.patch.vertices, body.patch.faces)[1].sum())
    return math.prod(body.size_m) if body.size_m is not None else math.pi * (body.radius_m or 0.0) ** 2
