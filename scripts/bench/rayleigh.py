"""Compute a baffled piston by its Rayleigh integral, exact at any distance, to test the far-field model.

It shares no code with palmfield.acoustics. `python scripts/bench/rayleigh.py` prints the tables of docs/bench/peers.md.
"""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.types import Air, Array, Complex, Float

DISTANCES = (1, 2, 5, 10, 20, 50)
"""Distances of the first table, in Rayleigh lengths k b^2/2."""

FOCI_M = (0.05, 0.1, 0.15, 0.2, 0.4)


def piston(points: ArrayLike, radius_m: float, k: float, p0_Pa_m: float, rings: int = 16, spokes: int = 32) -> Complex:
    """Return the lossless field of a piston at the origin in z = 0: p0/(pi b^2) times the integral of e^{ikR}/R.

    Gauss-Legendre along the radius, trapezoid around it (Rayleigh, Theory of Sound, sect. 278).

    points: [m], shape (n, 3); k: wavenumber [rad/m]; p0_Pa_m: peak pressure at 1 m on the axis, as in Array
    Returns complex peak pressure [Pa], shape (n,).
    """
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    s = radius_m * (nodes + 1.0) / 2.0
    angle = 2.0 * np.pi * np.arange(spokes) / spokes
    x, y = np.outer(s, np.cos(angle)).ravel(), np.outer(s, np.sin(angle)).ravel()
    area = np.repeat(weights * radius_m / 2.0 * s, spokes) * 2.0 * np.pi / spokes
    sources = np.column_stack([x, y, np.zeros_like(x)])
    distance = np.linalg.norm(np.asarray(points, dtype=float)[:, None] - sources, axis=2)
    return p0_Pa_m / (np.pi * radius_m**2) * (np.exp(1j * k * distance) / distance) @ area


def array_of_pistons(points: Float, array: Array, drive: Complex, k: float) -> Complex:
    """Return the sum of `piston` over a flat array facing z.

    Six rings and twelve spokes reach an error of 1e-9 beyond 30 mm.
    """
    total = np.zeros(len(points), complex)
    for position, amplitude in zip(array.positions, drive, strict=True):
        total += amplitude * piston(points - position, array.piston_radius_m, k, array.p0_Pa_m, 6, 12)
    return total


def hemisphere(distance_m: float, step_degrees: float = 5.0) -> Float:
    """Return points at one distance from the origin, from the axis to 85 degrees off it [m], shape (n, 3)."""
    t = np.radians(np.arange(0.0, 90.0, step_degrees))
    return distance_m * np.column_stack([np.sin(t), np.zeros_like(t), np.cos(t)])


def one_piston(radius_m: float = 4.5e-3) -> Array:
    return Array("one", np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), p0_Pa_m=1.0, piston_radius_m=radius_m)


def main() -> None:
    air, one = Air(), one_piston()
    k = 2.0 * np.pi * one.frequency_Hz / sound_speed(air)
    length = k * one.piston_radius_m**2 / 2.0
    print(f"| distance / {1e3 * length:.1f} mm | distance [mm] | largest amplitude error | largest phase error |")
    print("|---|---|---|---|")
    for n in DISTANCES:
        points = hemisphere(n * length)
        ratio = pressure64(points, one, [1.0], air, absorption_Np_m=0.0)[0]
        ratio = ratio / piston(points, one.piston_radius_m, k, 1.0)
        amplitude, phase = np.abs(np.abs(ratio) - 1.0).max(), np.degrees(np.abs(np.angle(ratio)).max())
        print(f"| {n} | {1e3 * n * length:.0f} | {100 * amplitude:.2g} % | {phase:.2g} deg |")
    array = layout("uhev1")
    print("\n| distance of the focus [mm] | error of the complex pressure | error without the common phase", end="")
    print(" | error of the magnitude |\n|---|---|---|---|")
    for z in FOCI_M:
        drive = focus(array, air, [0.0, 0.0, z])
        points = np.array([0.0, 0.0, z]) + np.random.default_rng(0).uniform(-0.02, 0.02, (200, 3))
        true = array_of_pistons(points, array, drive, k)
        model = pressure64(points, array, drive, air, absorption_Np_m=0.0)[0]
        overlap = np.vdot(model, true)
        errors = (model - true, model * overlap / abs(overlap) - true, np.abs(model) - np.abs(true))
        shares = (f"{100 * np.linalg.norm(error) / np.linalg.norm(true):.2g} %" for error in errors)
        print(f"| {1e3 * z:.0f} | {' | '.join(shares)} |")


if __name__ == "__main__":
    main()
