"""Matrices of a layered disc for one angular harmonic: spectral elements on a grid of rectangles in r and z.

Harmonic m of the motion is u_r = Re U e^{i m theta}, u_theta = Re(-i V e^{i m theta}), u_z = Re W e^{i m theta} with
functions U, V, W of (r, z). The strains of a real (U, V, W), times cosine or sine of m theta, are

    rr: U_r    tt: (U + m V) / r    zz: W_z    rt: V_r - V / r - m U / r    rz: U_z + W_r    tz: V_z - m W / r

(the last three are engineering shear strains). The basis functions are products of Lagrange polynomials of degree p in
r and in z, at Gauss-Lobatto points (Karniadakis & Sherwin 2005, ch. 2). All rectangles are aligned, so each integral is
a product of integrals over r and z. No strain is projected: from p = 4 on, nothing locks up to nu = 0.4999 and beyond.

On the axis a smooth field has U = V = 0 (m = 0), U = -V and W = 0 (m = 1), or all 0 (m >= 2). So the terms with 1 / r
are 0 there, and integrals at interior points are exact.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from scipy import sparse

from palmfield.skin.base import Springs
from palmfield.skin.fem.linear_body import Matrices, Part
from palmfield.skin.materials.material import Material
from palmfield.skin.problem import Slab
from palmfield.types import Float, Int

U, V, W = 0, 1, 2


@dataclass(frozen=True)
class Line:
    """Continuous piecewise polynomials on an interval.

    breaks: ends of the elements [m], ascending, (e + 1,); degree: p >= 1; count: e p + 1 basis functions
    """

    breaks: Float
    degree: int

    @property
    def elements(self) -> int:
        return len(self.breaks) - 1

    @property
    def count(self) -> int:
        return self.elements * self.degree + 1

    @cached_property
    def _to_legendre(self) -> Float:
        inner = legendre.Legendre.basis(self.degree).deriv().roots()
        points = np.concatenate([[-1.0], np.sort(inner.real), [1.0]])
        return np.linalg.inv(legendre.legvander(points, self.degree))

    def rule(self, points: int) -> tuple[Float, Float, Int]:
        """Return the Gauss points [m], their weights [m] and their elements, each (e * points,)."""
        nodes, weights = legendre.leggauss(points)
        half = 0.5 * np.diff(self.breaks)
        places = (self.breaks[:-1] + half)[:, None] + half[:, None] * nodes
        return places.ravel(), (half[:, None] * weights).ravel(), np.repeat(np.arange(self.elements), points)

    def values(self, x: Float, derivative: int = 0) -> Float:
        """Return the basis functions, or their slopes [1/m], at x (q,) in the interval, shape (q, count)."""
        element = np.clip(np.searchsorted(self.breaks, x, side="right") - 1, 0, self.elements - 1)
        half = 0.5 * np.diff(self.breaks)[element]
        local = (x - self.breaks[element]) / half - 1.0
        table = legendre.legvander(local, self.degree)
        if derivative:
            slopes = [legendre.legval(local, legendre.legder(row)) for row in np.eye(self.degree + 1)]
            table = np.stack(slopes, axis=1) / half[:, None]
        result = np.zeros((len(x), self.count))
        columns = element[:, None] * self.degree + np.arange(self.degree + 1)
        np.put_along_axis(result, columns, table @ self._to_legendre, axis=1)
        return result


@dataclass(frozen=True)
class DiscSystem(Matrices):
    """M u'' + C u' + E u + sum over parts K_p (u + branches) = F for one harmonic, over n free unknowns.

    Matrices and force are without the integral over the angle. spread: matrix from free unknowns to all unknowns
    (radial node, depth node, component), csr (all, n)
    """

    spread: sparse.csr_matrix


class DiscGrid:
    """Elements of a disc and the integrals that all harmonics share.

    radial: r from 0 to the rim. depth: z from the base, -thickness, to the face, 0.
    sheet: number of the sheet of each element in depth.
    """

    def __init__(self, body: Slab, radial: Line, depth: Line, sheet: Int) -> None:
        self.body, self.radial, self.depth = body, radial, depth
        r, weight, _ = radial.rule(radial.degree + 2)
        self._weight = weight * r
        self._shape = {"N": radial.values(r), "D": radial.values(r, 1), "T": radial.values(r) / r[:, None]}
        z, across, element = depth.rule(depth.degree + 1)
        shapes = depth.values(z), depth.values(z, 1)
        self._depths: dict[Material, Any] = {}
        for number, layer in enumerate(body.sheets):
            mine = np.where(sheet[element] == number, across, 0.0)[:, None]
            pairs = np.array([[a.T @ (mine * b) for b in shapes] for a in shapes])
            self._depths[layer.material] = self._depths.get(layer.material, 0.0) + pairs
        whole = [self._assemble(m) for m in (0, 1, 2)]
        # Each matrix is a quadratic polynomial of m.
        second = [0.5 * (c - 2.0 * b + a) for a, b, c in zip(*whole, strict=True)]
        first = [b - a - d for (a, b, _), d in zip(zip(*whole, strict=True), second, strict=True)]
        self._powers = [whole[0], first, second]
        # Sorted here: SciPy would sort indices at first use, whose time depends on the order of parallel harmonics
        for matrix in (one for power in self._powers for one in power):
            matrix.sum_duplicates()

    def _strains(self, m: int) -> list[tuple[float, list[tuple[int, Float, int]]]]:
        """Return for each strain the weight in 2 e:e - 2/3 div^2 and its terms: component, radial factor, z order."""
        value, slope, hoop = self._shape["N"], self._shape["D"], self._shape["T"]
        return [
            (2.0, [(U, slope, 0)]),
            (2.0, [(U, hoop, 0), (V, m * hoop, 0)]),
            (2.0, [(W, value, 1)]),
            (1.0, [(V, slope - hoop, 0), (U, -m * hoop, 0)]),
            (1.0, [(U, value, 1), (W, slope, 0)]),
            (1.0, [(V, value, 1), (W, -m * hoop, 0)]),
            (-2.0 / 3.0, self._divergence(m)),
        ]

    def _divergence(self, m: int) -> list[tuple[int, Float, int]]:
        value, slope, hoop = self._shape["N"], self._shape["D"], self._shape["T"]
        return [(U, slope + hoop, 0), (V, m * hoop, 0), (W, value, 1)]

    def _integrate(self, strains: list[tuple[float, list[tuple[int, Float, int]]]], pairs: Float) -> Any:
        """Return the sum of weight * integral of squared strain as a matrix over all unknowns."""
        radial: dict[tuple[int, int, int, int], Float] = {}
        for weight, terms in strains:
            for row, left, down in terms:
                for column, right, over in terms:
                    key = row, column, down, over
                    radial[key] = radial.get(key, 0.0) + left.T @ ((weight * self._weight)[:, None] * right)
        total = 0.0
        for (row, column, down, over), matrix in radial.items():
            total = total + _place(matrix, pairs[down, over], row, column)
        return total

    def _assemble(self, m: int) -> list[Any]:
        """Return mass, damping and elastic matrices and the stiffness of each part, over all unknowns."""
        value = self._shape["N"]
        plane = value.T @ (self._weight[:, None] * value)
        mass = damping = elastic = 0.0 * _place(plane, self._depths[self.body.sheets[0].material][0, 0], U, U)
        parts = []
        for material, pairs in self._depths.items():
            for component in (U, V, W):
                mass = mass + material.density_kg_m3 * _place(plane, pairs[0, 0], component, component)
            shear = material.shear_relaxed_Pa * self._integrate(self._strains(m), pairs)
            bulk = material.bulk_Pa * self._integrate([(1.0, self._divergence(m))], pairs)
            if material.bulk_relaxes:
                shear = shear + bulk
            else:
                elastic = elastic + bulk
            parts.append(shear)
        if isinstance(self.body.base, Springs):
            bottom = np.zeros((self.depth.count, self.depth.count))
            bottom[0, 0] = 1.0
            base = self.body.base
            for component in (U, V, W):
                here = _place(plane, bottom, component, component)
                elastic = elastic + (base.normal_Pa_m if component == W else base.tangential_Pa_m) * here
                damping = damping + (base.normal_Pa_s_m if component == W else base.tangential_Pa_s_m) * here
        return [mass, damping, elastic, *parts]

    def system(self, m: int) -> DiscSystem:
        """Return the matrices of harmonic m >= 0 over its free unknowns."""
        spread = self._spread(m)
        back = spread.T.tocsr()
        zeroth, first, second = self._powers
        mass, damping, elastic, *stiffness = [
            (back @ (a + m * b + m**2 * c) @ spread).tocsr() for a, b, c in zip(zeroth, first, second, strict=True)
        ]
        parts = tuple(Part(k, material) for k, material in zip(stiffness, self._depths, strict=True))
        return DiscSystem(mass, damping, elastic, parts, spread)

    def _spread(self, m: int) -> sparse.csr_matrix:
        free = np.ones((self.radial.count, self.depth.count, 3), dtype=bool)
        if m == 0:
            # An axisymmetric pressure has no torque.
            free[:, :, V] = False
        free[0] = [[False, False, True], [True, True, False], [False, False, False]][min(m, 2)]
        if self.body.base == "bonded":
            free[:, 0] = False
        elif self.body.base == "free_slip":
            free[:, 0, W] = False
        if self.body.side == "fixed":
            free[-1] = False
        elif self.body.side == "roller":
            free[-1, :, U] = False
        numbers = np.arange(free.size).reshape(free.shape)
        tied = np.flatnonzero(free[0, :, U] & free[0, :, V])
        free[0, tied, V] = False
        kept = numbers[free]
        rows = np.concatenate([kept, numbers[0, tied, V]])
        columns = np.concatenate([np.arange(len(kept)), np.searchsorted(kept, numbers[0, tied, U])])
        values = np.concatenate([np.ones(len(kept)), -np.ones(len(tied))])
        return sparse.csr_matrix((values, (rows, columns)), shape=(free.size, len(kept)))

    def pressure_force(self, pressure: Any) -> Float:
        """Return the force of a radial pressure, pressure(r (q,)) -> (q, j) [Pa], over all unknowns, shape (all, j)."""
        r, weight, _ = self.radial.rule(2 * self.radial.degree + 4)
        push = -self.radial.values(r).T @ ((weight * r)[:, None] * pressure(r))
        force = np.zeros((self.radial.count, self.depth.count, 3, push.shape[1]))
        force[:, -1, W] = push
        return force.reshape(-1, push.shape[1])

    def face_reader(self, r: Float) -> sparse.csr_matrix:
        """Return U, V, W on the face at distances r (n,) [m] = reader @ all unknowns, csr (3 n, all)."""
        top = np.zeros((1, self.depth.count))
        top[0, -1] = 1.0
        return sparse.csr_matrix(sparse.kron(sparse.kron(self.radial.values(r), top), np.eye(3)))


def _place(radial: Float, depth: Float, row: int, column: int) -> Any:
    """Return the Kronecker product of integrals over r and z, for one pair of components."""
    unit = sparse.csr_matrix(([1.0], ([row], [column])), shape=(3, 3))
    return sparse.kron(sparse.kron(sparse.csr_matrix(radial), sparse.csr_matrix(depth)), unit, format="csr")


def graded(length: float, size: Any) -> Float:
    """Return the ends of elements on 0..length with lengths about size(x); the number of elements is rounded up."""
    x = np.linspace(0.0, length, 4001)
    rate = 1.0 / size(x)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(x))])
    count = max(1, int(np.ceil(total[-1] - 1e-9)))
    ends = np.interp(np.linspace(0.0, total[-1], count + 1), total, x)
    ends[-1] = length
    return ends
