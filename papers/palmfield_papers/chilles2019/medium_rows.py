"""Rows C0, C1, C3, C7, C11, C12, C13 and C22: the silicone, its waves, and arithmetic on printed values."""

import math

from palmfield.skin import CATALOGUE, shear_wave
from palmfield.skin.materials.dispersion import elastic_root
from palmfield.skin.materials.material import complex_shear
from palmfield_papers.answer import Answer, Compute, Setting
from palmfield_papers.chilles2019.ecoflex import ecoflex_rate_law_as_printed, ecoflex_rate_law_mixed
from palmfield_papers.chilles2019.setup import (
    CIRCLE_HZ,
    CIRCLE_RADIUS_M,
    SILICONE,
    case_of,
    material_of,
    slab_of,
)
from palmfield_papers.entries import book

STEP_S = 0.2e-3
"""Time step of the paper, section IV.C."""
PRESET = f"preset {SILICONE}"


def input_of(value: float, note: str = PRESET) -> Compute:
    """Return the answer for an input that a preset, slab or load of the library confirms."""
    return lambda _setting: Answer(value, 0.0, note=note)


def poisson(setting: Setting) -> Answer:
    material = material_of("given")
    bulk, shear, at_once = material.bulk_Pa, material.shear_relaxed_Pa, material.shear_instant_Pa
    nu = (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))
    shown = {"at once": (3.0 * bulk - 2.0 * at_once) / (2.0 * (3.0 * bulk + at_once))}
    return Answer(nu, 0.0, note=f"{PRESET}: relaxed, as printed; with the bulk elastic it falls at once", shown=shown)


def diameter(setting: Setting) -> Answer:
    radius = slab_of(case_of(setting)).radius_m
    return Answer(
        None if radius is None else 2e3 * radius, 0.0, note="an endless slab has none" if radius is None else ""
    )


def thickness(setting: Setting) -> Answer:
    return Answer(1e3 * slab_of(case_of(setting)).thickness_m, 0.0)


def modulus(f_Hz: float, loss: bool) -> Compute:
    def compute(setting: Setting) -> Answer:
        shear = complex_shear(material_of("given"), f_Hz)
        return Answer(-shear.imag if loss else shear.real, 0.0, note="closed form")

    return compute


def wave(f_Hz: float, length: bool) -> Compute:
    def compute(setting: Setting) -> Answer:
        speed, fall = shear_wave(material_of("given"), f_Hz)
        return Answer(1e3 * fall if length else speed, 0.0, note="closed form")

    return compute


def time_constant(setting: Setting) -> Answer:
    branch = material_of("given").branches[0]
    printed = material_of("tau_printed")
    shown = {
        "as printed": 1e6 * printed.branches[0].time_s,
        "loss tangent at 200 Hz, as corrected": _loss_tangent(complex_shear(material_of("given"), 200.0)),
        "loss tangent at 200 Hz, as printed": _loss_tangent(complex_shear(printed, 200.0)),
    }
    return Answer(
        1e6 * branch.time_s, 0.0, note="eta/G_m; corrected is the default, as printed is a control", shown=shown
    )


def _loss_tangent(shear: complex) -> float:
    return -shear.imag / shear.real


def rate_law(setting: Setting) -> Answer:
    right, mixed = complex_shear(material_of("given"), 200.0), ecoflex_rate_law_mixed(200.0)
    shown = {
        "modulus at 200 Hz as corrected, Pa": abs(right),
        "as printed, taken in SI numbers, Pa": ecoflex_rate_law_as_printed(),
        "with the last dot taken as a slip, Pa": abs(mixed),
    }
    return Answer(None, note="words; the values of each law at 200 Hz are among those shown", shown=shown)


def rayleigh_ratio(setting: Setting) -> Answer:
    """Return |u_t/u_n| at the surface of a half-space (Achenbach 1973, ch. 5), with x = (c_R/c_s)^2."""

    def at(nu: float) -> float:
        squares = (1.0 - 2.0 * nu) / (2.0 - 2.0 * nu)
        x = elastic_root(squares)
        shear, pressure = math.sqrt(1.0 - x), math.sqrt(1.0 - squares * x)
        along = 1.0 - 2.0 * pressure * shear / (2.0 - x)
        across = pressure * (1.0 - 2.0 / (2.0 - x))
        return abs(along / across)

    return Answer(at(0.5), 0.0, note="closed form", shown={"nu 0.495": at(0.495)})


def misfits() -> dict[str, float]:
    """Return the ratios of FEM value to measured value, for the six pairs in Tables I and II."""
    values = {entry.id: entry.value for entry in book().entries}
    pairs = {
        "steady": ("C15a", "C14a"), "step peak": ("C15c", "C14c"), "AM p-p": ("C19b", "C19a"),
        "AM rms": ("C19d", "C19c"), "STM p-p": ("C20b", "C20a"), "STM rms": ("C20d", "C20c"),
    }  # fmt: skip
    return {name: float(str(values[fem])) / float(str(values[measured])) for name, (fem, measured) in pairs.items()}


def misfit_range(setting: Setting) -> Answer:
    found = misfits()
    note = f"arithmetic on Tables I and II: {min(found.values()):.2g} to {max(found.values()):.2g}"
    return Answer(max(found.values()), 0.0, note=note, shown=found)


def misfit(name: str) -> Compute:
    return lambda _setting: Answer(misfits()[name], 0.0, note="arithmetic on the tables")


def step_over_time(setting: Setting) -> Answer:
    value = STEP_S / material_of("given").branches[0].time_s
    return Answer(value, 0.0, margin=value - 1.0, note="their step does not resolve the relaxation")


def spread(setting: Setting) -> Answer:
    range_ = CATALOGUE[SILICONE].ranges[0]
    return Answer(50.0 * (range_.high - range_.low), 0.0, note="of the bands on this page; the bulk modulus stays")


_MATERIAL = material_of("given")
_BRANCH = _MATERIAL.branches[0]

ANSWERS: dict[str, Compute] = {
    "C0a": lambda setting: Answer(1e3 * (slab_of(case_of(setting)).radius_m or 0.0), 0.0),
    "C0b": thickness,
    "C0c": input_of(_MATERIAL.density_kg_m3),
    "C0d": poisson,
    "C1a": diameter,
    "C1b": thickness,
    "C1c": input_of(_MATERIAL.density_kg_m3),
    "C1d": poisson,
    "C3b": rayleigh_ratio,
    "C7d": input_of(2.0 * math.pi * CIRCLE_HZ * CIRCLE_RADIUS_M, "circumference times repetition"),
    "C11a": input_of(1e-3 * _MATERIAL.shear_relaxed_Pa),
    "C11b": input_of(1e-3 * _BRANCH.shear_Pa),
    "C11c": input_of(_BRANCH.shear_Pa * _BRANCH.time_s),
    "C11d": time_constant,
    "C11e": rate_law,
    **{
        name: compute
        for f_Hz, names in ((70.0, "fghi"), (200.0, "jklm"), (400.0, "nopq"))
        for name, compute in zip(
            (f"C11{letter}" for letter in names),
            (modulus(f_Hz, False), modulus(f_Hz, True), wave(f_Hz, False), wave(f_Hz, True)),
            strict=True,
        )
    },
    **{
        f"C12{letter}": misfit(name)
        for letter, name in zip(
            "abcdef", ("steady", "step peak", "AM p-p", "AM rms", "STM p-p", "STM rms"), strict=True
        )
    },
    "C12g": misfit_range,
    "C13h": step_over_time,
    "C22a": spread,
}
