"""Predict the numbers of a scan from its setting alone. The bands cover base, depth and moduli of the skin."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from palmfield.errors import MeasurementError, refuse_unknown
from palmfield.skin import CATALOGUE, Material, softest_and_stiffest
from palmfield.skin.materials.dispersion import describe
from palmfield.types import Float
from palmfield_papers.reardon2023.configuration import Back, Course, Plate
from palmfield_papers.reardon2023.figures import zigzag_corners
from palmfield_papers.reardon2023.resolution import QUICK_LEAST
from palmfield_papers.reardon2023.runs import COARSE, FULL, QUICK, GRID_m, run
from palmfield_papers.reardon2023.scan_numbers import Pass, SILENCE_s, STEP_s, band_passed, numbers

BASES: tuple[Back, ...] = ("bonded", "free", "deep")
"""Bases of the skin; the last, tissue without end, is none of a plate."""
MODULI = ("mid", "low", "high")
DEPTHS_m = {"hand": (0.0045, 0.0075, 0.012), "plate": (0.009, 0.01, 0.011)}
"""Depths of the skin [m]: pulp, pads, and palm of the hand presets (docs/data/hand_depths.csv)."""
MATERIALS = {"hand": "palm", "plate": "gelatin_2"}
FAST_Hz = 500.0
"""Frequency whose shear speed sets the period of the lattice."""
REST = 100
"""Number of samples at rest before the start of the stimulus."""
ALL = "all"


@dataclass(frozen=True)
class Tissue(Plate):
    """A slab with a material preset. moduli: low or high end of the ranges of its numbers, or mid"""

    preset: str = "palm"
    moduli: str = "mid"

    @property
    def material(self) -> Material:
        entry = CATALOGUE[self.preset]
        low, high = softest_and_stiffest(entry) or (entry.material, entry.material)
        return {"low": low, "mid": entry.material, "high": high}[self.moduli]

    @property
    def name(self) -> str:
        return f"{self.back}, {1e3 * self.thickness_m:g} mm, moduli {self.moduli}"


def skins(preset: str, depths_m: Sequence[float], fwhm_m: float, quick: bool) -> list[Tissue]:
    """Return the skins of the band, a middle one first. quick: whether only one quantity is varied at a time"""
    refuse_unknown(MeasurementError, "setting: material is {}", preset, CATALOGUE)
    middle = depths_m[len(depths_m) // 2]
    found, bases = [], BASES[:-1] if preset == MATERIALS["plate"] else BASES
    for base, depth, moduli in product(bases, sorted(depths_m, key=lambda one: one != middle), MODULI):
        if depth == middle or moduli == "mid" or not quick:
            material = Tissue(preset=preset, moduli=moduli).material
            speed = describe(material, FAST_Hz).shear_speed_m_s
            found.append(Tissue(back=base, viscosity_Pa_s=material.viscosity_Pa_s, shear_speed_m_s=speed,
                                thickness_m=depth, fwhm_m=fwhm_m, preset=preset, moduli=moduli))  # fmt: skip
    return found


def velocity(tissue: Tissue, passes: Sequence[Pass], level: int, device: str) -> list[Float]:
    """Return the band-passed velocity at the places of passes, shapes (t, n).

    The passes may differ only in their places.
    """
    one = passes[0]
    if one.width_m > 0.0:
        corners = zigzag_corners(one.length_m, one.width_m, one.along_m_s, one.across_m_s)
        speed = math.hypot(one.along_m_s, one.across_m_s)
    else:
        corners, speed = ((-0.5 * one.length_m, 0.0), (0.5 * one.length_m, 0.0)), one.along_m_s
    course = Course(corners, speed, max(1, round(one.end_s / STEP_s)), still_after_s=SILENCE_s)
    motion = run(tissue, course, level, device, one.times_s)
    found = []
    for places in (other.places_m for other in passes):
        at = (places - motion.places_m[0]).T / GRID_m
        values = np.array([map_coordinates(frame, at, order=1) for frame in motion.velocity], dtype=float)
        found.append(band_passed(np.pad(values, ((REST, 0), (0, 0))), STEP_s)[REST:])
    return found


def predicted(passes: Mapping[str, Pass], tissue: Tissue, level: int, device: str) -> dict[str, dict[str, float]]:
    """Return the numbers of each file on one skin. Passes in both directions share a run."""
    alike: dict[tuple[float, ...], list[str]] = {}
    for name, one in passes.items():
        alike.setdefault((one.along_m_s, one.length_m), []).append(name)
    found = {}
    for names in alike.values():
        for name, values in zip(names, velocity(tissue, [passes[n] for n in names], level, device), strict=True):
            found[name] = numbers(passes[name], values)
    return {name: found[name] for name in passes}


def bands(passes: Mapping[str, Pass], of: Sequence[Tissue], quick: bool, device: str) -> dict[str, Any]:
    """Return all numbers by skin, and their bands.

    The bands are by file and number: middle value, its numerical error, and low and high value for each base.
    numerical_error: difference from another resolution on the first skin, at least that of quick runs
    """
    level, other = (QUICK, COARSE) if quick else (FULL, QUICK)
    rows = {one.name: predicted(passes, one, level, device) for one in of}
    check = predicted(passes, of[0], other, device)
    found: dict[str, dict[str, Any]] = {}
    for file, first in rows[of[0].name].items():
        found[file] = {}
        for what, value in first.items():
            ends: dict[str, list[float]] = {}
            for base in (ALL, *BASES):
                named = [rows[one.name][file] for one in of if base in (ALL, one.back)]
                values = [numbers[what] for numbers in named if what in numbers]
                ends |= {base: [min(values), max(values)]} if values else {}
            error = max(abs(value - check[file].get(what, value)), QUICK_LEAST * abs(value))
            found[file][what] = {"middle": value, "numerical_error": error, "bands": ends}
    return {"skins": rows, "bands": found}
