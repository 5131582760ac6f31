"""Compute the motion of the palm under the focus of four units: amplitude in the centre per newton, by frequency.

Only the angular mean of the radiation pressure moves the centre of a flat infinite layer. So an integral over
wavenumbers is exact: u = integral of C(k) P(k) k dk. P is the Hankel transform of the angular mean, and C is the
compliance of the layer (`palmfield.skin.analytic.layer_oracle`).
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.special import j0

from palmfield.acoustics import FieldEvaluator, layout
from palmfield.acoustics.arp import arp
from palmfield.acoustics.focus import focus
from palmfield.instruments import Plate, plate_force
from palmfield.skin import CATALOGUE, Material, softest_and_stiffest
from palmfield.skin.analytic.layer_oracle import layer_compliance
from palmfield.types import Air, Array, Float

DEPTH_M = 0.2
JIG_M = 0.012
"""Edge of the square on which the paper measured 20 mN [m]."""
REACH_M = 0.05
"""Radius up to which the radiation pressure is included [m], about half the width of a palm.

The finer run doubles it.
"""
SHORTEST_rad_m = 1300.0
"""Largest wavenumber. The wavenumbers of the ARP end at 2 k sin(42 degrees) = 980 rad/m."""
SPACINGS = 400
"""Number of points along the edge of a plate. On the largest plate they are 1 mm apart."""
MATERIALS = ("preset", "softest", "stiffest")


def four_units() -> Array:
    """Return the four units of the paper with pistons of 4.5 mm, the base reading of `hasegawa_directivity`."""
    return replace(layout("autd2018_2x2"), directivity_table=None)


def palm(which: str) -> Material:
    """Return the material of the palm (MATERIALS), or at an end of its range."""
    ends = softest_and_stiffest(CATALOGUE["palm"])
    assert ends is not None
    return {"preset": CATALOGUE["palm"].material, "softest": ends[0], "stiffest": ends[1]}[which]


def _arp_at(points: Float, normals: Float) -> Float:
    array, air = four_units(), Air()
    drive = focus(array, air, [0.0, 0.0, DEPTH_M])
    field = FieldEvaluator(array, air, device="cpu").pressure(points, drive, gradient=True)
    return arp(field, normals, air, array.frequency_Hz, device="cpu").astype(np.float64)


@cache
def force_N(edge_m: float) -> float:
    """Return the force on a square around the focus at full drive [N]."""
    return plate_force(_arp_at, Plate(width_m=edge_m, height_m=edge_m, spacing_m=edge_m / SPACINGS)).force_N


@cache
def ring_mean(reach_m: float, rings: int) -> tuple[Float, Float, Float]:
    """Return radii [m], quadrature weights [m], and the angular mean of the ARP per newton on the jig [Pa/N].

    Each has shape (rings,).
    """
    nodes, shares = np.polynomial.legendre.leggauss(rings)
    radii = 0.5 * reach_m * (1.0 + nodes)
    count = 4 * math.ceil(SHORTEST_rad_m * reach_m / 4.0) + 16
    angles = 2.0 * math.pi * np.arange(count) / count
    points = np.stack(
        [np.outer(radii, np.cos(angles)), np.outer(radii, np.sin(angles)), np.full((rings, count), DEPTH_M)], axis=2
    )
    flat = points.reshape(-1, 3)
    pressure = _arp_at(flat, np.tile([0.0, 0.0, -1.0], (len(flat), 1)))
    return radii, 0.5 * reach_m * shares, pressure.reshape(rings, count).mean(axis=1) / force_N(JIG_M)


def motion_m_per_N(
    frequencies_Hz: tuple[float, ...], thickness_m: float, material: str = "preset", *, fine: bool = False
) -> Float:
    """Return the peak displacement of the centre per newton of sinusoidal force on the jig [m/N], shape (n,).

    material: of MATERIALS; fine: twice the reach and twice the wavenumbers, for the error
    """
    return np.array([_motion(f, thickness_m, material, fine) for f in frequencies_Hz])


@cache
def _motion(frequency_Hz: float, thickness_m: float, material: str, fine: bool) -> float:
    k, weights, spectrum = _spectrum(fine)
    compliance = layer_compliance(k, frequency_Hz, palm(material), thickness_m)
    return float(abs((compliance * spectrum * k) @ weights))


@cache
def moved_area_m2(frequency_Hz: float, thickness_m: float) -> float:
    """Return the area in which motion exceeds half of that at the centre [m2], for the angular mean of the focus."""
    k, weights, spectrum = _spectrum(False)
    radii = np.linspace(0.0, REACH_M, 501)
    amplitude = np.abs(j0(np.outer(radii, k)) @ (layer_compliance(k, frequency_Hz, palm("preset"), thickness_m)
                                                   * spectrum * k * weights))  # fmt: skip
    inside = amplitude > 0.5 * amplitude[0]
    return float(2.0 * math.pi * (radii * inside).sum() * radii[1])


@cache
def _spectrum(fine: bool) -> tuple[Float, Float, Float]:
    """Return wavenumbers, quadrature weights over them, and the Hankel transform of `ring_mean` [m2 Pa/N]."""
    times = 2 if fine else 1
    radii, shares, pressure = ring_mean(times * REACH_M, times * 96)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    edges = np.linspace(0.0, SHORTEST_rad_m, times * 100 + 1)
    half = 0.5 * (edges[1] - edges[0])
    k = (edges[:-1, None] + half * (1.0 + nodes)).ravel()
    return k, np.tile(weights * half, times * 100), j0(np.outer(k, radii)) @ (shares * radii * pressure)
