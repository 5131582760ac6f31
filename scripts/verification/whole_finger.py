#!/usr/bin/env python3
"""Motion of a whole finger by the sound on its pulp, against the motion of the pulp's skin on its bone.

python scripts/verification/whole_finger.py

The index finger is a straight chain of rigid segments with springs at its joints. Stiffness of the knuckle: 0.033 to
0.047 N m/rad in four healthy adults (PubMed Central PMC7775510, table 2, H1 to H4). Lengths: Buryanov & Kotiuk 2010.
The other joints are rigid, or as soft as the knuckle. Damping is an assumption and matters only near a resonance.
"""

import math

import numpy as np
import scipy.linalg

from palmfield.estimate.numerics.base_band import responses
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet
from palmfield.types import Float

LENGTHS_M, RADII_M = np.array([0.0398, 0.0224, 0.0196]), np.array([0.0099, 0.0094, 0.0082])
"""Proximal, middle and distal segment with soft tip; radii of circles with the breadth and depth of `open_men_p50`."""
DENSITY_KG_M3, DAMPING = 1100.0, 0.3
STIFFNESS_NM = (0.033, 0.038, 0.047)
PULP_M, FWHM_M = 0.005, 0.0103
FREQUENCIES_HZ = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 400.0)
BONE_PA, BONE_RADIUS_M = 17e9, 0.004


def chain(springs_Nm: Float) -> tuple[Float, Float, Float]:
    """Return mass and stiffness for the angles of the joints, shapes (j, j), and the lever of the middle of the last
    segment, (j,); springs_Nm: of knuckle and further joints, infinite for a rigid joint."""
    ends = np.concatenate([[0.0], np.cumsum(LENGTHS_M)])
    masses = DENSITY_KG_M3 * math.pi * RADII_M**2 * LENGTHS_M
    joints = [i for i in range(3) if math.isfinite(springs_Nm[i])]
    # Displacement of a point at s by a rotation of joint i: s - ends[i] beyond it
    nodes, weights = np.polynomial.legendre.leggauss(8)
    mass = np.zeros((len(joints), len(joints)))
    for segment in range(3):
        places = ends[segment] + 0.5 * LENGTHS_M[segment] * (nodes + 1.0)
        moved = np.array([np.maximum(places - ends[i], 0.0) for i in joints])
        mass += (moved * (0.5 * masses[segment] * weights)) @ moved.T
        turned = np.array([segment >= i for i in joints], dtype=float)
        mass += 0.25 * masses[segment] * RADII_M[segment] ** 2 * np.outer(turned, turned)
    lever = np.array([ends[3] - 0.5 * LENGTHS_M[2] - ends[i] for i in joints])
    return mass, np.diag(springs_Nm[joints]), lever


def modes(mass: Float, stiffness: Float) -> tuple[Float, Float]:
    """Return the natural frequencies [Hz], (j,), and shapes of unit modal mass, (j, j)."""
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    return np.sqrt(squares) / (2.0 * math.pi), shapes


def moves(springs_Nm: Float, f_Hz: float) -> float:
    """Return the amplitude of the pulp's bone per force there [m/N]."""
    mass, stiffness, lever = chain(springs_Nm)
    own, shapes = modes(mass, stiffness)
    turn = 2.0 * math.pi
    parts = (lever @ shapes) ** 2 / (turn**2 * (own**2 - f_Hz**2 - 2j * DAMPING * own * f_Hz))
    return float(abs(parts.sum()))


def skin(f_Hz: float) -> float:
    """Return the amplitude of the skin of a pulp on bone per force of a Gaussian spot [m/N]."""
    area = 2.0 * math.pi * FWHM_M**2 / (8.0 * math.log(2.0))
    return float(responses([Sheet(preset("finger_pad"), PULP_M)], FWHM_M, f_Hz, ["bonded"])[0]) / area


def main() -> None:
    for name, others in (("other joints rigid", False), ("other joints as soft", True)):
        for knuckle in STIFFNESS_NM:
            own = modes(*chain(np.array([knuckle] + [knuckle if others else math.inf] * 2))[:2])[0]
            print(f"{name}, {knuckle:g} N m/rad: natural frequencies {', '.join(f'{f:.1f}' for f in own)} Hz")
    second = math.pi / 4.0 * BONE_RADIUS_M**4
    per_m = float((DENSITY_KG_M3 * math.pi * RADII_M**2).mean())
    first = 3.516 / (2.0 * math.pi * LENGTHS_M.sum() ** 2) * math.sqrt(BONE_PA * second / per_m)
    print(f"bones as a cantilever of {1e3 * BONE_RADIUS_M:g} mm radius: {first:.0f} Hz")
    print(f"{'f [Hz]':>8} {'finger [um/mN]':>20} {'skin [um/mN]':>14} {'finger/skin':>14}")
    for f in FREQUENCIES_HZ:
        ends = [moves(np.array([k, o, o]), f) for k in STIFFNESS_NM for o in (math.inf, k)]
        local = skin(f)
        low, high = 1e3 * min(ends), 1e3 * max(ends)
        ratios = f"{low / (1e3 * local):6.2g} to {high / (1e3 * local):.2g}"
        print(f"{f:8g} {low:9.3g} to {high:7.3g} {1e3 * local:14.3g} {ratios}")


if __name__ == "__main__":
    main()
