"""Waves of a layer on a rigid base by elements through its depth: true wavenumbers of its modes, motion under a spot.

The semi-analytical finite elements of guided waves (Bartoli et al. 2006, J. Sound Vib. 295, 685): polynomials in depth,
plane waves along the layer. Shares no code with palmfield. e^{-i w t}, moduli G' - iG''.
"""

import numpy as np
from scipy.linalg import eig
from scipy.special import hankel1, j0, j1


def fractional(f_Hz, stiff_Pa=8e3, pot_Pa=6e3, reference_Hz=100.0, power=0.3):
    """Shear modulus of a spring beside a spring-pot [Pa]."""
    return stiff_Pa + pot_Pa * (-1j * f_Hz / reference_Hz) ** power


class GuidedLayer:
    """A layer bonded to a rigid base at one frequency. order: of the polynomials in depth."""

    def __init__(self, f_Hz, shear_Pa, thickness_m, density=1030.0, bulk_ratio=200.0, order=24, base="bonded"):
        if order > 10:
            self.coarse = GuidedLayer(f_Hz, shear_Pa, thickness_m, density, bulk_ratio, 10, base)
        lame = (bulk_ratio - 2.0 / 3.0) * shear_Pa
        modulus = lame + 2.0 * shear_Pa
        nodes, weights = np.polynomial.legendre.leggauss(order + 4)
        dz = 0.5 * thickness_m
        legendre = np.polynomial.legendre
        value = legendre.legvander(nodes, order)
        slope = np.stack([legendre.legval(nodes, legendre.legder(row)) for row in np.eye(order + 1)], axis=1) / dz
        at_ends = legendre.legvander(np.array([-1.0, 1.0]), order)
        # Integrated products of shapes and slopes: f'f', f'f, ff
        vv, sv, ss = (np.einsum("q,qi,qj->ij", weights * dz, a, b) for a, b in
                      ((value, value), (slope, value), (slope, slope)))  # fmt: skip
        n = order + 1
        zero = np.zeros((n, n))
        self.a2 = np.block([[modulus * vv, zero], [zero, shear_Pa * vv]])
        # -lame k (w u' + u' w) + shear k (w' u + u w')
        cross = -lame * sv.T + shear_Pa * sv
        self.a1 = np.block([[zero, cross], [cross.T, zero]])
        self.a0 = np.block([[shear_Pa * ss, zero], [zero, modulus * ss]])
        self.mass = density * np.block([[vv, zero], [zero, vv]])
        self.omega = 2.0 * np.pi * f_Hz
        held = np.zeros((2 if base == "bonded" else 1, 2 * n))
        held[-1, n:] = at_ends[1]
        if base == "bonded":
            held[0, :n] = at_ends[1]
        free = np.linalg.svd(held)[2][len(held) :].T
        self.a2, self.a1, self.a0, self.mass = (free.T @ m @ free for m in (self.a2, self.a1, self.a0, self.mass))
        self.along = np.concatenate([at_ends[0], np.zeros(n)]) @ free
        self.down = np.concatenate([np.zeros(n), at_ends[0]]) @ free

    def stiffness(self, k):
        return k**2 * self.a2 + k * self.a1 + self.a0 - self.omega**2 * self.mass

    def modes(self, spot_m=None, furthest=250.0):
        """Wavenumbers of modes with Im k below furthest [rad/m], and their parts far from 1 N: part * H0(k r)."""
        spread = 0.0 if spot_m is None else spot_m / np.sqrt(8.0 * np.log(2.0))
        found, parts = [], []
        for begin in self.coarse._eigenvalues():
            k, shape = self._newton(begin)
            if k is None or not 0.0 < k.imag < furthest or any(abs(k - one) < 1e-6 * abs(k) for one in found):
                continue
            norm = shape @ ((2.0 * k * self.a2 + self.a1) @ shape)
            found.append(k)
            parts.append(0.5j * k * (self.down @ shape) ** 2 / norm * np.exp(-0.5 * (k * spread) ** 2))
        order = np.argsort(np.imag(found))
        return np.array(found)[order], np.array(parts)[order]

    def seen(self, spot_m, ways, tilt=0.0, furthest=600.0):
        """Wavenumbers of modes, and what a beam in the x-z plane sees of each under 1 N, over the cosine of its angle.

        ways: from the source, shape (n, 2); tilt: tangent of the beam's angle. Returns shapes (modes,), (modes, n).
        """
        r = np.linalg.norm(ways, axis=1)
        spread = spot_m / np.sqrt(8.0 * np.log(2.0))
        k, parts = self.modes(spot_m, furthest)
        fields = []
        for one, part in zip(k, parts, strict=True):
            shape = self._newton(one)[1]
            norm = shape @ ((2.0 * one * self.a2 + self.a1) @ shape)
            out = -0.5j * one * (self.down @ shape) * (self.along @ shape) / norm
            out *= np.exp(-0.5 * (one * spread) ** 2)
            fields.append(-part * hankel1(0, one * r) + tilt * out * hankel1(1, one * r) * ways[:, 0] / r)
        return k, np.array(fields)

    def _eigenvalues(self):
        n = len(self.a0)
        unit = np.eye(n)
        left = np.block([[np.zeros((n, n)), unit], [-self.stiffness(0.0), -self.a1]])
        right = np.block([[unit, np.zeros((n, n))], [np.zeros((n, n)), self.a2]])
        values = eig(left, right, right=False)
        return values[np.isfinite(values) & (values.imag > 0.0) & (values.imag < 1e3)]

    def _newton(self, k):
        """A mode from near it, by inverse iteration: the linear eigenproblem of high orders has too few digits."""
        shape = np.linalg.solve(self.stiffness(k), self.down.astype(complex))
        for _ in range(30):
            shape /= np.linalg.norm(shape)
            ahead = np.linalg.solve(self.stiffness(k), (2.0 * k * self.a2 + self.a1) @ shape)
            step = (shape.conj() @ shape) / (shape.conj() @ ahead)
            k, shape = k - step, ahead
            if abs(step) < 1e-11 * abs(k):
                return k, shape
        return None, shape

    def under_spot(self, r, spot_m, count=1500):
        """Motion downwards and outwards at distances r from a spot of 1 N, shapes of r, by an integral over k."""
        spread = spot_m / np.sqrt(8.0 * np.log(2.0))
        end = 8.0 / spread
        nodes, weights = np.polynomial.legendre.leggauss(count)
        k, weights = 0.5 * end * (nodes + 1.0), 0.5 * end * weights
        down, along = np.empty(count, complex), np.empty(count, complex)
        for n, one in enumerate(k):
            motion = np.linalg.solve(self.stiffness(one), self.down)
            down[n], along[n] = self.down @ motion, self.along @ motion
        load = weights * k * np.exp(-0.5 * (k * spread) ** 2) / (2.0 * np.pi)
        return (down * load) @ j0(np.outer(k, r)), -(along * load) @ j1(np.outer(k, r))
