"""What lies below a meshed layer: springs, dashpots and masses by area, and their fit to a deeper body.

Tangential displacement u_t and normal displacement u_n of a base carry four kinds of element (Form). Springs that
know only u_t or u_n (Winkler) can't do for a soft layer: what is pushed down must flow sideways, so u_n and div u_t
belong together, as u_t and grad u_n do in shear. At lateral wavenumber k, with u_t = i a, u_n = b, a form is
shear (a + shear_reach k b)^2 + slope (k b)^2 + volume (b + volume_reach k a)^2 + membrane (k a)^2: passive for all k.

Misfit as in fit_foundation, a spot of 10.3 mm, at 50, 100, 200, 300, 350 and 400 Hz [%]:

| layer | depth meshed | 50 | 100 | 200 | 300 | 350 | 400 |
|---|---|---|---|---|---|---|---|
| Ecoflex 12 mm | 4 mm | 0.9 | 2.2 | 12 | 16 | 13 | 12 |
| Ecoflex 12 mm | 6 mm | 0.8 | 1.2 | 3.7 | 8.2 | 8.6 | 10 |
| palm 12 mm | 6 mm | 2.3 | 2.3 | 3.1 | 4.0 | 12 | 19 |
| palm 20 mm | 5 mm | 6.9 | 12 | 10 | 21 | 29 | 55 |
| palm 20 mm | 7.5 mm | 7.3 | 9.9 | 9.2 | 13 | 14 | 39 |
| palm 20 mm | 10 mm | 3.8 | 4.8 | 12 | 8.2 | 7.7 | 5.8 |

So half the depth has to be meshed, and then 10 % is met but near single frequencies: what lies below has several
resonances of its own above 200 Hz, and one mass by area has one. Without the reaches (Winkler and Pasternak springs)
the misfits are 20 to 60 %.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse
from scipy.optimize import least_squares

from palmfield.errors import SceneError
from palmfield.skin.absorbing import scatter
from palmfield.skin.depth import condensed, surface_compliance
from palmfield.skin.element import triangle_rule, triangle_shape, triangle_slopes
from palmfield.skin.material import Material, complex_bulk, stiffening
from palmfield.skin.problem import BaseKind, Sheet, Springs, spread
from palmfield.skin.wedges import WedgeMesh
from palmfield.types import Complex, Float

FREQUENCIES_Hz = (50.0, 75.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0)
FITTING_STEPS = 60


@dataclass(frozen=True)
class Form:
    """Energy by area shear |u_t + shear_reach grad u_n|^2 + slope |grad u_n|^2 + volume (u_n - volume_reach div u_t)^2
    + membrane |grad u_t|^2, halved.

    shear, volume: by displacement^2, so [Pa/m] of stiffness, [Pa s/m] of damping, [kg/m^2] of mass; slope, membrane:
    m^2 times that; all >= 0; shear_reach_m, volume_reach_m [m]: of any sign
    Raises SceneError for other numbers.
    """

    shear: float = 0.0
    volume: float = 0.0
    slope: float = 0.0
    membrane: float = 0.0
    shear_reach_m: float = 0.0
    volume_reach_m: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value) or (value < 0.0 and not name.endswith("_reach_m")):
                raise SceneError(f"foundation: {name} is {value}; give a finite number, 0 or above")

    def at(self, k: Float) -> Float:
        """Matrix of (a, b) at wavenumbers k [rad/m], shape (n, 2, 2)."""
        one, zero = np.ones_like(k), np.zeros_like(k)
        rows = (
            (self.shear, one, self.shear_reach_m * k),
            (self.slope, zero, k),
            (self.volume, self.volume_reach_m * k, one),
            (self.membrane, k, zero),
        )
        return sum(size * np.einsum("in,jn->nij", *2 * [np.stack([a, b])]) for size, a, b in rows)

    @property
    def empty(self) -> bool:
        return self.shear == self.volume == self.slope == self.membrane == 0.0


@dataclass(frozen=True)
class Foundation:
    """Elastic springs, springs that relax as the shear modulus of `law`, dashpots and masses.

    frequencies_Hz, misfit: where it was fitted [Hz], and the relative error there, see fit_foundation; both (f,)
    Raises SceneError for relaxing springs without a law.
    """

    elastic: Form = field(default_factory=Form)
    relaxing: Form = field(default_factory=Form)
    damping: Form = field(default_factory=Form)
    mass: Form = field(default_factory=Form)
    law: Material | None = None
    frequencies_Hz: tuple[float, ...] = ()
    misfit: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.law is None and not self.relaxing.empty:
            raise SceneError("foundation: relaxing springs need a law, the material as which they relax")

    @property
    def holds(self) -> bool:
        """Whether springs hold both directions."""
        return (self.elastic.shear + self.relaxing.shear > 0.0) and (self.elastic.volume + self.relaxing.volume > 0.0)

    def impedance(self, k: Float, f_Hz: float) -> Complex:
        """Traction by displacement (a, b) at wavenumbers k [rad/m] under e^{-i w t} [Pa/m], shape (n, 2, 2)."""
        s = -2j * math.pi * f_Hz
        relaxed = 1.0 if self.law is None else stiffening(self.law, s)
        spring = self.elastic.at(k) + relaxed * self.relaxing.at(k)
        return spring + s * self.damping.at(k) + s**2 * self.mass.at(k)


def of_springs(base: Springs) -> Foundation:
    """The foundation that a base of springs and dashpots is."""
    return Foundation(
        elastic=Form(base.tangential_Pa_m, base.normal_Pa_m),
        damping=Form(base.tangential_Pa_s_m, base.normal_Pa_s_m),
    )


def base_matrix(mesh: WedgeMesh, form: Form) -> sparse.csr_matrix:
    """Matrix of a form on the base of a mesh over all nodal components, csr, shape (3 nodes, 3 nodes)."""
    triangles = mesh.surface_triangles6 + int(mesh.base[0])
    a, b, c = (mesh.nodes[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    twice = np.linalg.norm(area, axis=1)
    normal = area / twice[:, None]
    plane = np.eye(3) - np.einsum("ta,tb->tab", normal, normal)
    edges = np.stack([b - a, c - a], axis=2)
    dual = np.einsum("tci,tij->tcj", edges, np.linalg.inv(np.einsum("tci,tcj->tij", edges, edges)))
    points, rule = triangle_rule()
    shape = triangle_shape(points)
    gradient = np.einsum("tcj,qij->tqic", dual, triangle_slopes(points))
    tangential = np.einsum("qi,tab->tqaib", shape, plane)
    slope = np.einsum("tqia,tb->tqaib", gradient, normal)
    push = np.einsum("qi,tb->tqib", shape, normal)[:, :, None]
    stretch = np.einsum("tqia,tab->tqib", gradient, plane)
    turning = np.einsum("tqic,tab->tqcaib", gradient, plane).reshape(*gradient.shape[:2], 9, 6, 3)
    rows = (
        (form.shear, tangential + form.shear_reach_m * slope),
        (form.slope, slope),
        (form.volume, push - form.volume_reach_m * stretch[:, :, None]),
        (form.membrane, turning),
    )
    weights = np.outer(twice, rule)
    size = 3 * len(mesh.nodes)
    total = sparse.csr_matrix((size, size))
    for factor, row in rows:
        if factor > 0.0:
            total = total + scatter(triangles, factor * np.einsum("tq,tqaib,tqajc->tibjc", weights, row, row), size)
    return total


def fit_foundation(
    above: Sequence[Sheet],
    below: Sequence[Sheet],
    fwhm_m: float,
    base: BaseKind | Springs = "bonded",
    frequencies_Hz: Sequence[float] = FREQUENCIES_Hz,
) -> Foundation:
    """The foundation that replaces the sheets `below` under the sheets `above`, for a spot of a given width.

    base: below the lowest sheet; frequencies_Hz: where to fit [Hz], > 0
    The normal surface compliance C(k, f) of `above` on the foundation is fitted to that of all sheets. Its misfit is
    the relative L2 error of the surface's displacement under a Gaussian spot (Parseval):
    sqrt(int |C' - C|^2 w^2 k dk / int |C|^2 w^2 k dk) with w = exp(-k^2 s^2 / 2), s = fwhm / 2.355.
    The start of the fit is the sheets' own energy for displacements that fall linearly to the bottom.
    Raises SceneError for no sheets, or a width or frequency not above 0.
    """
    if not above or not below or not fwhm_m > 0.0 or not min(frequencies_Hz) > 0.0:
        raise SceneError(
            f"foundation: {len(above)} sheets above, {len(below)} below, spot {fwhm_m} m, frequencies "
            f"{list(frequencies_Hz)} Hz: give sheets on both sides, and numbers above 0"
        )
    width = spread(fwhm_m)
    nodes, rule = np.polynomial.legendre.leggauss(20)
    k = 2.0 / width * (1.0 + nodes)
    weight = np.sqrt(rule * k) * np.exp(-0.5 * (k * width) ** 2)
    exact = np.array([surface_compliance(k, f, [*above, *below], base) for f in frequencies_Hz])
    scale = np.linalg.norm(exact * weight, axis=1)
    upper = [condensed(k, f, above) for f in frequencies_Hz]
    law = below[0].material
    depth = sum(sheet.thickness_m for sheet in below)
    # All numbers in units of the sheet below: modulus, depth and time to cross it.
    modulus, density = law.shear_relaxed_Pa, law.density_kg_m3
    bulk = complex_bulk(law, 200.0).real / modulus
    time_s = depth * math.sqrt(density / modulus)

    def form(units: float, logs: Float, reaches: Float) -> Form:
        shear, volume, slope, membrane = units * np.exp(logs) / depth
        return Form(
            float(shear), float(volume), float(slope * depth**2), float(membrane * depth**2),
            float(reaches[0] * depth), float(reaches[1] * depth),
        )  # fmt: skip

    # Springs, masses, dashpots; then the elastic volume spring and the reaches.
    start = np.concatenate(
        [
            np.log([1.0, 2.0, 1 / 12, 2 / 3, 1 / 3, 1 / 3, 0.01, 0.01, 0.3, 0.3, 0.01, 0.01]),
            [np.log(bulk), -0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0],
        ]
    )

    def build(x: Float) -> Foundation:
        return Foundation(
            elastic=Form(volume=float(modulus / depth * np.exp(x[12])), volume_reach_m=float(x[13] * depth)),
            relaxing=form(modulus, x[:4], x[14:16]),
            mass=form(modulus * time_s**2, x[4:8], x[16:18]),
            damping=form(modulus * time_s, x[8:12], x[18:]),
            law=law,
        )

    def misfits(foundation: Foundation) -> Complex:
        rows = []
        for f, stiffness, wanted, size in zip(frequencies_Hz, upper, exact, scale, strict=True):
            rows.append((_on_foundation(stiffness, foundation, k, f) - wanted) * weight / size)
        return np.array(rows)

    def residual(x: Float) -> Float:
        rows = misfits(build(x)).ravel()
        return np.concatenate([rows.real, rows.imag])

    span = np.concatenate([np.full(13, math.log(1e4)), np.full(7, 3.0)])
    best = build(least_squares(residual, start, bounds=(start - span, start + span), max_nfev=FITTING_STEPS).x)
    misfit = tuple(float(x) for x in np.linalg.norm(misfits(best), axis=1))
    return replace(best, frequencies_Hz=tuple(frequencies_Hz), misfit=misfit)


def _on_foundation(stiffness: Complex, foundation: Foundation, k: Float, f_Hz: float) -> Complex:
    """Normal surface compliance of a sheet of condensed stiffness (n, 4, 4) on a foundation, shape (n,)."""
    total = stiffness.copy()
    total[:, 2:, 2:] += foundation.impedance(k, f_Hz)
    load = np.zeros((len(k), 4, 1), dtype=complex)
    load[:, 1, 0] = 1.0
    return np.linalg.solve(total, load)[:, 1, 0].astype(complex)
