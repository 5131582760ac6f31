"""Plane waves in a viscoelastic half space, under e^{ikx - i w t}: impedance of its face, reflection, Rayleigh wave.

u_x = i a e^{ikx}, u_z = b e^{ikx}, z up. Downgoing waves fall with depth d as e^{-alpha d} (P: a, b = k, alpha) and
e^{-beta d} (S: beta, k); upgoing ones have -alpha, -beta (Achenbach 1973, ch. 5).
"""

import math

import numpy as np

from palmfield.skin.materials.material import complex_bulk, complex_shear


def waves(k, f_Hz, material):
    """Displacement and traction (a, b) of the P and the S wave, of the downgoing, then the upgoing pair: (n, 2, 2)."""
    shear, bulk = complex_shear(material, f_Hz) * (1.0 - 1e-9j), complex_bulk(material, f_Hz) * (1.0 - 1e-9j)
    stiff = bulk + 4.0 / 3.0 * shear
    inertia = material.density_kg_m3 * (2.0 * math.pi * f_Hz) ** 2
    alpha, beta = np.sqrt(k**2 - inertia / stiff), np.sqrt(k**2 - inertia / shear)

    def pair(alpha, beta):
        moved = np.array([[k + 0j, beta], [alpha, k + 0j]])
        normal = (stiff - 2.0 * shear) * (alpha**2 - k**2) + 2.0 * shear * alpha**2
        pulled = np.array([[2 * shear * alpha * k, shear * (beta**2 + k**2)], [normal, 2 * shear * k * beta]])
        return np.moveaxis(moved, 2, 0), np.moveaxis(pulled, 2, 0)

    return pair(alpha, beta), pair(-alpha, -beta)


def impedance(k, f_Hz, material):
    """Traction by displacement on the face [Pa/m], shape (n, 2, 2); f_Hz > 0."""
    (moved, pulled), _ = waves(k, f_Hz, material)
    return pulled @ np.linalg.inv(moved)


def reflection(k, f_Hz, material, base):
    """Amplitude of displacement of the upgoing waves by that of the downgoing ones, P first, from a base of impedance
    (n, 2, 2) below the material; shape (n, 2, 2)."""
    (down, pulled), (up, pulled_up) = waves(k, f_Hz, material)
    ratio = np.linalg.solve(base @ up - pulled_up, pulled - base @ down)
    size = np.linalg.norm(down, axis=1)
    return ratio * size[:, :, None] / size[:, None, :]


def angle_wavenumbers(f_Hz, material, angles_deg):
    """Lateral wavenumbers of P and of S waves at these angles from the normal [rad/m], shape (2, n)."""
    shear, bulk = complex_shear(material, f_Hz), complex_bulk(material, f_Hz)
    slowness = np.sqrt(material.density_kg_m3 / np.array([bulk + 4.0 / 3.0 * shear, shear])).real
    return 2.0 * math.pi * f_Hz * np.outer(slowness, np.sin(np.radians(angles_deg)))


def surface_stiffness(k, f_Hz, material, depth_m, base):
    """Normal pressure by inward displacement of the face of a layer on a base of impedance (n, 2, 2), without shear."""
    (down, pulled), (up, pulled_up) = waves(k, f_Hz, material)
    shear, bulk = complex_shear(material, f_Hz), complex_bulk(material, f_Hz)
    inertia = material.density_kg_m3 * (2.0 * math.pi * f_Hz) ** 2
    falls = np.stack([np.sqrt(k**2 - inertia / modulus + 0j) for modulus in (bulk + 4.0 / 3.0 * shear, shear)], axis=1)
    fade = np.exp(-falls * depth_m)
    ratio = np.linalg.solve(base @ up - pulled_up, (pulled - base @ down) * fade[:, None, :])
    returned = fade[:, :, None] * ratio
    total = (pulled + pulled_up @ returned) @ np.linalg.inv(down + up @ returned)
    return 1.0 / np.linalg.inv(total)[:, 1, 1]


def midpoint_sheets(k, f_Hz, material, heights_m, springs):
    """Impedance (n, 2, 2) of linear sheets with strain and motion at their middles, on springs and dashpots."""
    shear, bulk = complex_shear(material, f_Hz), complex_bulk(material, f_Hz)
    s, one = -2j * math.pi * f_Hz, np.ones_like(k, dtype=complex)
    rates = (springs.tangential_Pa_m + springs.tangential_Pa_s_m * s, springs.normal_Pa_m + springs.normal_Pa_s_m * s)
    total = np.einsum("n,ij->nij", one, np.diag(rates))
    for h in reversed(heights_m):
        zero = 0.0 * one
        a, b = np.stack([0.5 * one, zero, 0.5 * one, zero], 1), np.stack([zero, 0.5 * one, zero, 0.5 * one], 1)
        slope_a, slope_b = np.array([1.0, 0.0, -1.0, 0.0]) / h + 0.0 * a, np.array([0.0, 1.0, 0.0, -1.0]) / h + 0.0 * a
        wave = k[:, None]
        terms = [
            (bulk - 2.0 / 3.0 * shear, slope_b - wave * a), (2.0 * shear, wave * a), (2.0 * shear, slope_b),
            (shear, slope_a + wave * b), (material.density_kg_m3 * s**2, a), (material.density_kg_m3 * s**2, b),
        ]  # fmt: skip
        sheet = h * sum(factor * np.einsum("ni,nj->nij", row, row) for factor, row in terms)
        sheet[:, 2:, 2:] += total
        total = sheet[:, :2, :2] - sheet[:, :2, 2:] @ np.linalg.solve(sheet[:, 2:, 2:], sheet[:, 2:, :2])
    return total
