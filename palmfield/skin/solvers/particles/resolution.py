"""Spacing of particles for a target error, cost of a run, and limits of the solver."""

import itertools
import math

import numpy as np

from palmfield.errors import SceneError
from palmfield.hand.triangles import face_normals
from palmfield.skin.approximation.load_scales import mean_frequency, motion_width, passing_frequency
from palmfield.skin.base import NEEDS_AXIS, Foundation, Springs
from palmfield.skin.materials.material import shear_wave
from palmfield.skin.problem import ONLY_WEDGES, Body, Layer, Load, SkinProblem, Slab, depth_of
from palmfield.skin.solvers.particles.cloud import FEWEST_CELLS

SECONDS_A_STEP = {"cpu": 0.9e-6, "cuda": 2.0e-9}
"""Time of a step per particle [s]: measured on one CPU core; on a GPU, the time to read 1.5 kB at 0.75 TB/s."""
STIFFEST = 1e5
"""Largest allowed ratio of instantaneous bulk to shear modulus (nu 0.499995); above it the step is too small."""
BELOW = 0.6
"""Error over the square of (spacing in depth / depth)."""
FINEST = 2e-3
"""Least target error for the choice of a spacing."""
STIFFER = 100.0
"""Largest allowed stiffness of a sheet over that of a sheet below it. A sheet one cell thick bends a third too little
on a bed 1/100 as stiff, and two fifths on a bed 1/1000 as stiff; the error estimate is smaller than this."""
COARSER = 1.5
"""Spacing of the run for the error estimate over the requested spacing."""
COARSE_CELLS = 2
"""Least number of cells through the depth in this run: COARSER times as high as with FEWEST_CELLS."""


def refusal_particles(body: Body, load: Load) -> str | None:
    """Return the reason why particles cannot solve a problem, in a sentence, or None."""
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
    """Return the relative error of particles at this spacing [m], fitted to discs (docs/bench/skin_particles.md).

    It is 0.65 (h / L)^2 + 0.6 (h_z / H)^2 + 4.6 (h / wavelength)^2. L = min(w, sqrt(w H)) for spot width w, or
    `motion_width` for a narrow body under a wide spot; H: depth; h_z: spacing in depth; wavelength: of shear in the
    slowest sheet at the mean frequency of the load.
    """
    depth = depth_of(body)
    below = min(spacing_m, depth / FEWEST_CELLS)
    return _along_face(body, load) * spacing_m**2 + BELOW * (below / depth) ** 2


def _along_face(body: Body, load: Load) -> float:
    """Return the error over the square of the spacing along the face [1/m^2]."""
    width = motion_width(body, load)
    length = min(width, math.sqrt(width * depth_of(body)))
    frequency = max(mean_frequency(load), passing_frequency(load, width))
    waves = 0.0
    if frequency > 0.0:
        wavelength = min(shear_wave(sheet.material, frequency)[0] for sheet in body.sheets) / frequency
        waves = 4.6 / wavelength**2
    return 0.65 / length**2 + waves


def choose_spacing(body: Body, load: Load, accuracy: float) -> float:
    """Return the spacing [m] at which law_error is `accuracy`, but at least that for FINEST.

    The spacing in depth may be finer than along the face. Raises SceneError unless 0 < accuracy <= 1.
    """
    if not 0.0 < accuracy <= 1.0:
        raise SceneError(f"particles: accuracy is {accuracy}; give 0.002 to 1 (5 % is typical)")
    accuracy = max(accuracy, FINEST)
    # The error estimate is not valid if its coarser run has fewer than two particles per width
    high = min(length_of(body) / 4.0, motion_width(body, load) / 3.0)
    depth, along = depth_of(body), _along_face(body, load)
    # Two choices in depth: the least number of cells, or the same spacing as along the face
    few = math.sqrt(max(accuracy - BELOW / FEWEST_CELLS**2, 0.0) / along)
    return min(high, few if few >= depth / FEWEST_CELLS else math.sqrt(accuracy / (along + BELOW / depth**2)))


def cost_particles(problem: SkinProblem) -> float:
    """Return the predicted time [s]: particles x steps x time of one step of one particle."""
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
    # Measured stable step of cubes: time of a pressure wave over 1.24 spacings
    step = 1.24 * math.sqrt(3.0 / (2.0 / along**2 + 1.0 / lowest**2)) / fastest
    steps = max(0.0, float(problem.times[-1]) - float(load.times_s[0])) / step
    return 0.1 + count * steps * SECONDS_A_STEP["cuda" if problem.device.startswith("cuda") else "cpu"]


def length_of(body: Body) -> float:
    """Return the least length of a body along its face [m]."""
    if isinstance(body, Layer):
        return float(np.ptp(body.patch.vertices, axis=0).max())
    return min(body.size_m) if body.size_m is not None else 2.0 * (body.radius_m or 0.0)


def _area(body: Body) -> float:
    if isinstance(body, Layer):
        return float(face_normals(body.patch.vertices, body.patch.faces)[1].sum())
    return math.prod(body.size_m) if body.size_m is not None else math.pi * (body.radius_m or 0.0) ** 2
