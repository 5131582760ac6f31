"""Rows M8 to M15: displacement of a gel of 1 mm on a rigid bone under the focus."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.special import i0e

from palmfield.instruments import Analyser, analyser_reading
from palmfield.skin import CATALOGUE, Material, Sheet, Slab, Traction, preset, softest_and_stiffest, static
from palmfield.skin.analytic.layer_oracle import layer_compliance
from palmfield.skin.base import BaseKind
from palmfield.skin.materials.catalogue import GEL_STORAGE_PA
from palmfield.skin.materials.material import complex_bulk, complex_shear
from palmfield.types import Float
from palmfield_papers.answer import Answer, Cause, Compute, Setting
from palmfield_papers.entries import book
from palmfield_papers.mizushima2024.as_printed import (
    equivalent_modulus_as_printed,
    sls_modulus,
    uniaxial_displacement,
    vibration_modulus_as_printed,
)
from palmfield_papers.mizushima2024.bows import value_of

THICKNESS_M = 1e-3
LARGEST_PA = 4000.0
PRINTED_HZ = 10.0
ENDS = ("softest", "stiffest")


@dataclass(frozen=True)
class Gel:
    """Gel and load. Hashable, so that runs can be cached.

    hardness: "C0", "C7" or "C15"
    end: end of the range of the material, "softest" or "stiffest"; "" for its value
    base: see layer_compliance
    half_widths_m: distances along x and y at which the Gaussian pressure is half of its peak
    """

    hardness: str = "C0"
    base: BaseKind = "bonded"
    half_widths_m: tuple[float, float] = (0.010, 0.003)
    end: str = ""


def gel_of(setting: Setting) -> Gel:
    """Return the configuration mizushima.gel under the readings and the control of a setting."""
    base: BaseKind = "bonded" if value_of(setting, "mizushima_bond") == "bonded" else "free_slip"
    if setting.control == "gel_unbonded":
        base = "free_slip"
    wide = 0.008 if "x 8" in value_of(setting, "mizushima_load") else 0.010
    return Gel(value_of(setting, "mizushima_gel"), base, (wide, 0.003))


def material_of(gel: Gel) -> Material:
    entry = CATALOGUE[f"hitohada_{gel.hardness.lower()}"]
    if not gel.end:
        return entry.material
    ends = softest_and_stiffest(entry)
    assert ends is not None
    return ends[ENDS.index(gel.end)]


def frequencies() -> Float:
    """Return the frequencies of [metrics.gel_displacement]."""
    return np.array(book().metrics["gel_displacement"]["frequencies_hz"])


def compliance(gel: Gel, frequency_Hz: float, panels: int = 240) -> complex:
    """Return the displacement at the centre of the ellipse per peak pressure [m/Pa], positive into the gel.

    u = s_x s_y integral of k C(k) exp(-k^2 (s_x^2 + s_y^2)/4) I0(k^2 (s_x^2 - s_y^2)/4) dk. C is the compliance of the
    layer at the lateral wavenumber k, and s are the standard deviations of the Gaussian. The integral is computed by
    Gauss quadrature.
    """
    return _ellipse(material_of(gel), gel.base, gel.half_widths_m, frequency_Hz, panels)


@cache
def _ellipse(
    material: Material, base: BaseKind, half_widths_m: tuple[float, float], frequency_Hz: float, panels: int
) -> complex:
    x, y = (width / np.sqrt(2.0 * np.log(2.0)) for width in half_widths_m)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    edges = np.linspace(0.0, 9.0 / min(x, y), panels + 1)
    half = 0.5 * np.diff(edges)
    k = (edges[:-1, None] + half[:, None] * (1.0 + nodes)).ravel()
    # exp(-k^2 (x^2 + y^2)/4) I0(z) = exp(z - k^2 (x^2 + y^2)/4) i0e(z)
    z = 0.25 * k**2 * abs(x**2 - y**2)
    load = x * y * k * np.exp(z - 0.25 * k**2 * (x**2 + y**2)) * i0e(z)
    of_layer = layer_compliance(k, frequency_Hz, material, THICKNESS_M, base)
    return complex((half[:, None] * weights).ravel() @ (of_layer * load))


def young_Pa(material: Material, frequency_Hz: float) -> complex:
    """Return the complex modulus of a rod with free sides [Pa]."""
    shear, bulk = complex_shear(material, frequency_Hz), complex_bulk(material, frequency_Hz)
    return 9.0 * bulk * shear / (3.0 * bulk + shear)


def uniaxial_m(gel: Gel, frequency_Hz: float) -> float:
    """Return the displacement by eq 6 of the paper, with |E*| of the material [m]."""
    return uniaxial_displacement(LARGEST_PA, THICKNESS_M, young_Pa(material_of(gel), frequency_Hz))


def course_um(gel: Gel) -> Float:
    """Return the amplitude at 4000 Pa at the frequencies of the metric [um], shape (f,)."""
    return 1e6 * LARGEST_PA * np.array([abs(compliance(gel, float(f))) for f in frequencies()])


@cache
def off_at_rest(base: BaseKind, half_widths_m: tuple[float, float], quick: bool) -> float:
    """Return the relative difference of C0 at rest from `static`, an independent solution by elements in depth.

    Without losses it is equal for all moduli. It depends only on Poisson's ratio, which is the same for all gels.
    """
    gel = Gel("C0", base, half_widths_m)
    step = 1e-3 if quick else 0.5e-3
    x, y = (np.arange(-3.0 * width, 3.0 * width + 0.5 * step, step) for width in gel.half_widths_m)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    pressure = 2.0 ** -((places / np.array(gel.half_widths_m)) ** 2).sum(axis=1)
    points = np.column_stack([places, np.zeros(len(places))])
    load = Traction(points, np.full(len(points), step**2), np.zeros(1), pressure[None], "held")
    slab = Slab((Sheet(material_of(gel), THICKNESS_M),), base=gel.base)
    motion = static(slab, load, np.zeros((1, 2)), accuracy=0.02)
    return abs(-float(motion.displacement_m[0, 0, 2]) / compliance(gel, 0.0).real - 1.0)


def neo_hookean_m(gel: Gel, frequency_Hz: float) -> float:
    """Return the displacement of an incompressible neo-Hookean solid: P = G (1/s^2 - s), s = 1 - u/h, G = |E*|/3."""
    shear = abs(young_Pa(material_of(gel), frequency_Hz)) / 3.0
    left = brentq(lambda s: shear * (s**-2 - s) - LARGEST_PA, 1e-3, 1.0)
    return float(THICKNESS_M * (1.0 - left))


def largest(setting: Setting) -> Answer:
    gel = gel_of(setting)
    factor = 2.0 if value_of(setting, "mizushima_measure") == "peak to peak" else 1.0
    course = factor * course_um(gel)
    top = int(course.argmax())
    finer = factor * 1e6 * LARGEST_PA * abs(compliance(gel, float(frequencies()[top]), 480))
    off = off_at_rest(gel.base, gel.half_widths_m, setting.quick)
    band = [factor * course_um(replace(gel, end=end)).max() for end in ENDS]
    strain = course[top] / factor * 1e-6 / THICKNESS_M
    return Answer(
        float(course[top]),
        error=max(abs(finer - course[top]), off * course[top]),
        band=(float(min(band)), float(max(band))),
        note=f"linear; largest at {frequencies()[top]:g} Hz, {100 * strain:.0f} % of the thickness; error against "
        "the solver lateral_waves at rest; moduli at other frequencies are assumed",
        shown={
            "at 500 Hz [um]": float(course[-1]),
            "uniaxial formula, its largest [um]": 1e6 * factor * uniaxial_m(gel, float(frequencies()[0])),
            "uniaxial and neo-Hookean, its largest [um]": 1e6 * factor * neo_hookean_m(gel, float(frequencies()[0])),
            "uniaxial formula at 500 Hz [um]": 1e6 * factor * uniaxial_m(gel, float(frequencies()[-1])),
        },
    )


def with_change(change: Callable[[Gel], Gel], pressure_Pa: float = LARGEST_PA) -> Compute:
    def compute(setting: Setting) -> Answer:
        return Answer(float(course_um(change(gel_of(setting))).max()) * pressure_Pa / LARGEST_PA, error=None)

    return compute


def by_formula(setting: Setting) -> Answer:
    return Answer(1e6 * uniaxial_m(gel_of(setting), float(frequencies()[0])), error=0.0)


def order_of_bonds(setting: Setting) -> Answer:
    """Return the smallest of frictionless minus bonded and uniaxial minus frictionless over all frequencies [um]."""
    gel = gel_of(setting)
    bonded, free = course_um(replace(gel, base="bonded")), course_um(replace(gel, base="free_slip"))
    formula = np.array([1e6 * uniaxial_m(gel, float(f)) for f in frequencies()])
    at_10 = int(np.flatnonzero(frequencies() == PRINTED_HZ)[0])
    margin = float(min((free - bonded).min(), (formula - free).min()))
    return Answer(
        margin,
        error=1e-6 * float(formula.max()),
        margin=margin,
        note="of C0 over all frequencies",
        shown={
            "bonded at 10 Hz [um]": float(bonded[at_10]),
            "frictionless at 10 Hz [um]": float(free[at_10]),
            "uniaxial at 10 Hz [um]": float(formula[at_10]),
        },
    )


def storage(hardness: str) -> Compute:
    """Return E' of the preset at 10 Hz, in an analyser with frictionless plates."""

    def compute(setting: Setting) -> Answer:
        material = preset(f"hitohada_{hardness.lower()}")
        shown = analyser_reading(material, PRINTED_HZ, Analyser(radius_m=1e-3, height_m=1e-3, faces="frictionless"))
        bonded = analyser_reading(material, PRINTED_HZ, Analyser(radius_m=1e-3, height_m=1e-3, faces="bonded"))
        return Answer(
            float(shown.real),
            error=abs(float(shown.real) - GEL_STORAGE_PA[f"hitohada_{hardness.lower()}"]),
            note="disc of 2 mm, frictionless; error: distance of the fit from the printed modulus",
            shown={"if 1 mm high and bonded to the plates [Pa]": float(bonded.real)},
        )

    return compute


def loss_tangent(setting: Setting) -> Answer:
    """Return the smallest ratio of largest to smallest tan delta over 100 to 1000 Hz, of all standard linear solids.

    Their tan delta has one peak, 2/(f/f_p + f_p/f). It varies least over the decade if f_p is in the middle of the
    decade.
    """
    rates = np.geomspace(100.0, 1000.0, 201)

    def change(peak: float) -> float:
        # E2 = E1 puts the peak of tan delta at f = E2/(2 pi eta sqrt 2)
        viscosity = 1.0 / (2.0 * np.pi * 10.0**peak * np.sqrt(2.0))
        modulus = np.array([sls_modulus(float(f), 1.0, 1.0, viscosity) for f in rates])
        tangent = -modulus.imag / modulus.real
        return float(tangent.max() / tangent.min())

    found = minimize_scalar(change, bounds=(2.0, 3.0), method="bounded", options={"xatol": 1e-6})
    least = float(found.fun) - 1.0
    return Answer(least, error=1e-4, margin=least - 0.25, note="largest over least, less 1, of the flattest such solid")


def as_printed_and_corrected(setting: Setting) -> Answer:
    """Return eq 4 and |E*| of eqs 1 and 2 at 200 Hz, for a solid with E1 = E2 and its transition at 200 Hz."""
    e1 = e2 = 1.0
    viscosity = e2 / (2.0 * np.pi * 200.0)
    right = abs(sls_modulus(200.0, e1, e2, viscosity))
    return Answer(
        equivalent_modulus_as_printed(200.0, e1, e2, viscosity) / right,
        error=0.0,
        note="as printed over corrected, of E1 = E2 at the transition",
        shown={"corrected over E1": right},
    )


def stress_law(setting: Setting) -> Answer:
    e1 = e2 = 1.0
    viscosity = e2 / (2.0 * np.pi * 200.0)
    right = abs(sls_modulus(200.0, e1, e2, viscosity))
    return Answer(
        vibration_modulus_as_printed(200.0, e1, e2, viscosity) / right,
        error=0.0,
        note="as printed over corrected, of E1 = E2 at the transition",
        shown={"corrected over E1": right},
    )


ANSWERS: dict[str, Compute] = {
    "M8e": storage("C0"),
    "M8f": storage("C7"),
    "M8g": storage("C15"),
    "M9e": loss_tangent,
    "M10-M12b": as_printed_and_corrected,
    "M10-M12c": stress_law,
    "M13a": largest,
    "M13d": order_of_bonds,
}
CAUSES = {
    "M13a": (
        Cause("the paper's uniaxial formula, in which the gel may widen freely", by_formula),
        Cause(
            "500 Pa, if the doubling at a microphone and peak read as rms turned it into 4000 Pa",
            with_change(lambda gel: gel, 500.0),
        ),
        Cause("gel C15 that slides", with_change(lambda gel: replace(gel, hardness="C15", base="free_slip"))),
    )
}
