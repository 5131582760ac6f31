"""Support below a meshed layer: springs and dashpots by area, or the rest of the depth as a foundation.

A foundation has its own unknowns under every node of the base: the displacement of its sheets at the Lobatto points
of one polynomial in depth for each sheet (finite elements of that degree; laterally they are those of the mesh). So its
impedance depends on frequency and wavenumber as that of the sheets, including resonances and relaxation. It is
passive, because its matrices are those of a solid that moves as its polynomials allow. The volume is projected as in
element.py: at degree 2 a sheet is a row of wedges. It is flat: the curvature of the base is left out below it.

Degree that fit_foundation takes (bonded, 50 to 400 Hz, spots of 5, 10 and 20 mm), and its misfit:

| layer | a quarter meshed | a third meshed |
|---|---|---|
| palm 8, 12, 20 mm | 3: 1.8 %, 3: 4.8 %, 5: 0.3 % | 3: 0.8 %, 3: 2.4 %, 4: 3.7 % |
| forearm 8, 12, 20 mm | 3: 0.7 %, 2: 4.0 %, 3: 1.7 % | 2: 2.3 %, 2: 1.9 %, 2: 3.4 % |
| Ecoflex 8, 12, 20 mm | 3: 0.9 %, 3: 1.4 %, 5: 1.5 % | 2: 2.8 %, 3: 0.7 %, 4: 4.7 % |

It saves geometry, not time: one level costs as much as half a row of wedges. A disc of 40 mm, palm 20 mm, under a
spot of 10.3 mm: three rows through the depth have 9450 unknowns, 0.57 s to factorise; two through a quarter of it, on
degree 5, 14175 and 1.8 s.
Springs, dashpots, masses and membranes by area, without their own unknowns, had errors of 10 to 50 % above 200 Hz
unless half the depth was meshed.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.special import j0

from palmfield.errors import SceneError
from palmfield.skin.base import BaseKind, Foundation, Springs
from palmfield.skin.fem.absorbing import match_speed, rim_edges, scatter
from palmfield.skin.fem.depth import condensed, impedance, line_matrices, on_impedance
from palmfield.skin.materials.material import Material, Sheet
from palmfield.skin.mesh.element import triangle_rule, triangle_shape, triangle_slopes
from palmfield.skin.mesh.wedges import WedgeMesh
from palmfield.skin.problem import spread
from palmfield.types import Float

FREQUENCIES_Hz = (50.0, 75.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0)
WIDTHS_M = (0.005, 0.01, 0.02)
MOST_DEGREE = 8
PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Distances from the centre of a spot at which the fit compares, in its widths."""


class BaseFace:
    """Integrals over the base of a mesh, of products of lateral functions; matrices over its nodal components.

    A matrix is csr of shape (3 S, 3 S), S the nodes of a level. Names of functions of the displacement: "along", "out"
    (its tangential part; its part along the outward normal). "slope" is the gradient of the latter. "strain", "stretch"
    are the symmetric surface gradient of the former and its trace. "out_linear" is "out" projected on the linear
    functions of each triangle, which include "stretch".
    """

    def __init__(self, mesh: WedgeMesh) -> None:
        self.triangles = mesh.surface_triangles6
        self.size = 3 * mesh.surface_nodes
        corners = mesh.nodes[self.triangles[:, :3] + int(mesh.base[0])]
        edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        area = np.cross(edges[..., 0], edges[..., 1])
        twice = np.linalg.norm(area, axis=1)
        normal = area / twice[:, None]
        plane = np.eye(3) - np.einsum("ta,tb->tab", normal, normal)
        dual = np.einsum("tci,tij->tcj", edges, np.linalg.inv(np.einsum("tci,tcj->tij", edges, edges)))
        points, rule = triangle_rule()
        shape = triangle_shape(points)
        linear = np.column_stack([1.0 - points.sum(axis=1), points])
        projection = linear @ np.linalg.solve(linear.T @ (rule[:, None] * linear), linear.T * rule)
        gradient = np.einsum("tcj,qij->tqic", dual, triangle_slopes(points))
        turning = np.einsum("tqic,tab->tqcaib", gradient, plane)
        strain = 0.5 * (turning + np.swapaxes(turning, 2, 3))
        self.weights = np.outer(twice, rule)
        self.functions = {
            "along": np.einsum("qi,tab->tqaib", shape, plane),
            "out": np.einsum("qi,tb->tqib", shape, normal)[:, :, None],
            "out_linear": np.einsum("qi,tb->tqib", projection @ shape, normal)[:, :, None],
            "slope": np.einsum("tqia,tb->tqaib", gradient, normal),
            "stretch": np.einsum("tqia,tab->tqib", gradient, plane)[:, :, None],
            "strain": strain.reshape(*strain.shape[:2], 9, 6, 3),
        }

    def product(self, first: str, second: str, by_triangle: Float | None = None) -> sparse.csr_matrix:
        """int first second dA, the share of each triangle times `by_triangle`, shape (triangles,), where given."""
        weights = self.weights if by_triangle is None else by_triangle[:, None] * self.weights
        a, b = self.functions[first], self.functions[second]
        return scatter(self.triangles, np.einsum("tq,tqaib,tqajc->tibjc", weights, a, b, optimize=True), self.size)


def sheet_stiffness(face: BaseFace, height_m: float, degree: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Deviatoric and volumetric stiffness [m] of a sheet below the base for unit moduli, by level from the top down.

    Both of shape ((degree + 1) 3 S, (degree + 1) 3 S); strain energy as in element.py: G (2 e:e - 2/3 tr^2), K tr^2.
    """
    mass, slope, mixed, projected = line_matrices(degree, height_m)
    # The normal points up and nodes are numbered downwards, so a derivative along it is minus that by depth.
    up = -mixed
    cross = sparse.kron(up.T, face.product("along", "slope"))
    trace = sparse.kron(up, face.product("stretch", "out"))
    deviatoric = (
        sparse.kron(slope, face.product("along", "along") + 4.0 / 3.0 * face.product("out", "out"))
        + sparse.kron(
            mass,
            face.product("slope", "slope")
            + 2.0 * face.product("strain", "strain")
            - 2.0 / 3.0 * face.product("stretch", "stretch"),
        )
        + (cross + cross.T)
        - 2.0 / 3.0 * (trace + trace.T)
    )
    trace = sparse.kron(up, face.product("stretch", "out_linear"))
    volumetric = (
        sparse.kron(projected, face.product("stretch", "stretch"))
        + sparse.kron(slope, face.product("out_linear", "out_linear"))
        + (trace + trace.T)
    )
    return deviatoric.tocsr(), volumetric.tocsr()


def sheet_mass(face: BaseFace, height_m: float, degree: int, by_triangle: Float | None = None) -> sparse.csr_matrix:
    """Mass [m^3] of a sheet for unit density, by level as sheet_stiffness; `by_triangle` as for BaseFace.product."""
    lateral = face.product("along", "along", by_triangle) + face.product("out", "out", by_triangle)
    return sparse.kron(line_matrices(degree, height_m)[0], lateral, format="csr")


def rim_dashpots(mesh: WedgeMesh, material: Material, height_m: float, degree: int, f_Hz: float) -> sparse.csr_matrix:
    """Damping [N s/m] of the side faces of a sheet by level, as sheet_stiffness; f_Hz: see absorbing.side_dashpots."""
    edges = rim_edges(mesh)
    ends = mesh.nodes[edges + int(mesh.base[0])]
    length = np.linalg.norm(ends[:, 2] - ends[:, 0], axis=1)
    # Integrals of N_i N_j over a unit length, for quadratic functions on a line with the middle node in place 1.
    line = np.array([[4.0, 2.0, -1.0], [2.0, 16.0, 2.0], [-1.0, 2.0, 4.0]]) / 30.0
    blocks = material.density_kg_m3 * match_speed(material, f_Hz) * np.einsum("e,ij->eij", length, line)
    lateral = scatter(edges, np.einsum("eij,ab->eiajb", blocks, np.eye(3)), 3 * mesh.surface_nodes)
    return sparse.kron(line_matrices(degree, height_m)[0], lateral, format="csr")


def fit_foundation(
    above: Sequence[Sheet],
    below: Sequence[Sheet],
    fwhm_m: float | Sequence[float] = WIDTHS_M,
    base: BaseKind | Springs = "bonded",
    frequencies_Hz: Sequence[float] = FREQUENCIES_Hz,
    target: float = 0.05,
) -> Foundation:
    """Return the foundation of lowest degree that replaces the sheets `below` under the meshed sheets `above`.

    fwhm_m: full widths of the Gaussian spots for which it must hold [m]; base: below the lowest sheet.
    frequencies_Hz: where it must hold [Hz], > 0; target: largest misfit allowed.
    The misfit at a frequency is the relative error of the complex normal displacement of the surface; it is the largest
    error over the widths and over PLACES from the centre of a spot. The reference is the same sheets by polynomials of
    degree 12. Elements above it add their own error.
    Raises SceneError for no sheets, a width or frequency not above 0, and where MOST_DEGREE misses.
    """
    widths = np.atleast_1d(np.asarray(fwhm_m, dtype=float))
    numbers = np.array([*widths, *frequencies_Hz])
    if not above or not below or not (np.isfinite(numbers).all() and (numbers > 0.0).all()):
        raise SceneError(
            f"foundation: {len(above)} sheets above, {len(below)} below, spots of {widths.tolist()} m, frequencies "
            f"{list(frequencies_Hz)} Hz: needed: sheets on both sides, and numbers above 0"
        )
    cases = [_Case(above, below, base, float(width), f) for f in frequencies_Hz for width in widths]
    misfit = np.zeros(len(frequencies_Hz))
    for degree in range(1, MOST_DEGREE + 1):
        result = Foundation(tuple(below), base, degree)
        misfit = np.array([case.misfit(result) for case in cases]).reshape(len(frequencies_Hz), -1).max(axis=1)
        if misfit.max() <= target:
            return replace(result, frequencies_Hz=tuple(frequencies_Hz), misfit=tuple(float(x) for x in misfit))
    worst = int(np.argmax(misfit))
    raise SceneError(
        f"foundation: at degree {MOST_DEGREE} the error is still {100 * misfit[worst]:.3g} % at "
        f"{frequencies_Hz[worst]:g} Hz; target {100 * target:g} %: mesh more of the depth, or split the part below "
        "into several sheets"
    )


class _Case:
    """A spot on the whole depth at one frequency: its motion, and the motion with a foundation."""

    def __init__(
        self, above: Sequence[Sheet], below: Sequence[Sheet], base: BaseKind | Springs, fwhm_m: float, f_Hz: float
    ) -> None:
        width = spread(fwhm_m)
        nodes, rule = np.polynomial.legendre.leggauss(120)
        self.f_Hz = f_Hz
        # The transform of a Gaussian is e^{-12.5} at k = 5 / width.
        self.k = 2.5 / width * (1.0 + nodes)
        weights = 2.5 / width * rule * self.k * np.exp(-0.5 * (self.k * width) ** 2)
        self.transform = j0(np.outer(fwhm_m * np.array(PLACES), self.k)) * weights
        self.upper = condensed(self.k, f_Hz, above)
        self.exact = self.transform @ on_impedance(self.upper, impedance(self.k, f_Hz, below, base))

    def misfit(self, foundation: Foundation) -> float:
        result = self.transform @ on_impedance(
            self.upper, impedance(self.k, self.f_Hz, foundation.sheets, foundation.base, foundation.degree)
        )
        return float((np.abs(result - self.exact) / np.abs(self.exact)).max())
