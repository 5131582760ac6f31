"""Rows C2, C5, C8 to C10: the array, the radiation pressure, and the level of 12 Pa."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from palmfield.acoustics import density, layout, pressure64, sound_speed
from palmfield.acoustics.arp import arp
from palmfield.acoustics.focus import focus
from palmfield.types import Air, Field, Float
from palmfield_papers.answer import Answer, Compute, Setting
from palmfield_papers.chilles2019.as_printed import incident_lagrangian_as_printed
from palmfield_papers.chilles2019.setup import LEVEL_PA

RHO, SPEED = 1.225, 343.0
"""Density and sound speed of air in section IV.A."""
FOCUS_M = (0.0, 0.0, 0.2)
REFERENCE_PA = 20e-6
HZ = 40e3
PROFILE_M = 0.03


class Focus(NamedTuple):
    """Sound of the UHEV1 in the plane of its focus. radii_m: along x; arp_Pa: for p0_Pa_m, the p0 of the layout"""

    radii_m: Float
    arp_Pa: Float
    peak_Pa: float
    p0_Pa_m: float


@cache
def focal_sound() -> Focus:
    """Return the radiation pressure along x through the focus: pistons in a baffle, full drive, default air."""
    array, air = layout("uhev1"), Air()
    radii = np.linspace(0.0, PROFILE_M, 301)
    points = np.column_stack([radii, np.zeros_like(radii), np.full_like(radii, FOCUS_M[2])])
    pressure, gradient = pressure64(points, array, focus(array, air, FOCUS_M), air, gradient=True)
    assert gradient is not None
    field = Field(pressure.astype(np.complex64), gradient.astype(np.complex64))
    normals = np.tile([0.0, 0.0, -1.0], (len(points), 1))
    push = arp(field, normals, air, HZ, device="cpu").astype(float)
    return Focus(radii, push, float(abs(pressure[0])), array.p0_Pa_m)


def fwhm_m() -> float:
    """Return the full width at half maximum of that radiation pressure [m]."""
    radii, push = focal_sound()[:2]
    half = 0.5 * push[0]
    first = int(np.argmax(push < half))
    return 2.0 * float(brentq(lambda r: np.interp(r, radii, push) - half, radii[first - 1], radii[first]))


def p0_for(level_Pa: float) -> float:
    """Return the p0 [Pa m] for a radiation pressure in the focus [Pa], which is proportional to its square."""
    found = focal_sound()
    return found.p0_Pa_m * math.sqrt(level_Pa / found.arp_Pa[0])


def plane(points: Float, there: complex, back: complex, air: Air) -> Field:
    """Return the field of a plane wave along z and a reflected one with these amplitudes [Pa]."""
    k = 2.0 * math.pi * HZ / sound_speed(air)
    ahead, behind = there * np.exp(1j * k * points), back * np.exp(-1j * k * points)
    slope = np.zeros((len(points), 3), np.complex64)
    slope[:, 2] = 1j * k * (ahead - behind)
    return Field((ahead + behind).astype(np.complex64), slope)


def travelling(setting: Setting) -> Answer:
    """Return the formula of the paper for a travelling plane wave, divided by its first term."""
    air = Air()
    unit = 1.0 / (4.0 * density(air) * sound_speed(air) ** 2)
    values = incident_lagrangian_as_printed(plane(np.linspace(0.0, 0.01, 50), 1.0, 0.0, air), air, HZ) / unit
    ours = float(np.abs(values).max())
    return Answer(ours, 1e-6, margin=0.01 - ours, note="largest along 10 mm; single precision")


def at_wall(setting: Setting) -> Answer:
    """Return the formula of the paper for the total field at a rigid wall, divided by <p_i^2>/(rho c^2)."""
    air = Air()
    unit = 1.0 / (2.0 * density(air) * sound_speed(air) ** 2)
    value = incident_lagrangian_as_printed(plane(np.zeros(1), 1.0, 1.0, air), air, HZ)[0] / unit
    return Answer(float(value), 1e-6, note="wave and echo of the same amplitude")


def total_over_incident(setting: Setting) -> Answer:
    air = Air()
    total = incident_lagrangian_as_printed(plane(np.zeros(1), 1.0, 1.0, air), air, HZ)[0]
    first_term = 1.0 / (4.0 * density(air) * sound_speed(air) ** 2)
    found = focal_sound()
    array = layout("uhev1")
    where = np.array([FOCUS_M])
    pressure, gradient = pressure64(where, array, focus(array, air, FOCUS_M), air, gradient=True)
    assert gradient is not None
    whole = incident_lagrangian_as_printed(Field(pressure.astype(np.complex64), gradient.astype(np.complex64)), air, HZ)
    value = float(total / first_term)
    return Answer(
        value, 1e-6, margin=min(value - 2.0, 4.0 - value),
        note="over <p_i^2>/(2 rho c^2); over <p_i^2>/(rho c^2), a wall that absorbs all sound, it is 2",
        shown={"incident field at this focus, over the right pressure": float(whole[0] / found.arp_Pa[0])},
    )  # fmt: skip


def level(setting: Setting) -> Answer:
    """Return the level of a plane wave with 12 Pa, 2 <p_i^2>/(rho c^2), on a rigid wall, in the air of the paper."""
    rms = math.sqrt(0.5 * LEVEL_PA * RHO * SPEED**2)
    found = focal_sound()
    at_focus = found.peak_Pa * math.sqrt(0.5 * LEVEL_PA / found.arp_Pa[0])
    shown = {"of the converging sound of the UHEV1": 20.0 * math.log10(at_focus / REFERENCE_PA)}
    return Answer(20.0 * math.log10(rms / REFERENCE_PA), 0.0, note="plane wave", shown=shown)


def source(setting: Setting) -> Answer:
    found = focal_sound()
    shown = {
        "p0 of the layout, Pa m": found.p0_Pa_m,
        "peak radiation pressure at that p0, Pa": float(found.arp_Pa[0]),
        "FWHM of the radiation pressure, mm": 1e3 * fwhm_m(),
    }
    note = "inferred from 12 Pa through the field of 256 pistons at 200 mm, so it confirms nothing"
    return Answer(p0_for(LEVEL_PA), 0.0, note=note, shown=shown)


def spot(setting: Setting) -> Answer:
    return Answer(1e3 * fwhm_m(), 0.05, note="along x through the focus of 256 pistons; along y it is the same")


def count(setting: Setting) -> Answer:
    return Answer(float(len(layout("uhev1").positions)), 0.0, note="layout uhev1")


def pitch(setting: Setting) -> Answer:
    steps = np.diff(np.unique(np.round(layout("uhev1").positions[:, 0], 6)))
    return Answer(1e3 * float(steps.mean()), 0.0, note="layout uhev1")


def carrier(setting: Setting) -> Answer:
    return Answer(1e-3 * layout("uhev1").frequency_Hz, 0.0, note="layout uhev1")


def flight(setting: Setting) -> Answer:
    return Answer(1e3 * FOCUS_M[2] / SPEED, 0.0, note="not part of the configuration: it moves the record by 0.3 %")


def velocity_term(setting: Setting) -> Answer:
    note = "words: u^2.u is a vector; the code, as printed or corrected, has u.u"
    return Answer(None, note=f"{note} (palmfield_papers.chilles2019.as_printed)")


ANSWERS: dict[str, Compute] = {
    "C0e": spot,
    "C2a": count,
    "C2c": carrier,
    "C2e": pitch,
    "C5e": flight,
    "C9c": velocity_term,
    "C9d": travelling,
    "C9e": at_wall,
    "C9f": total_over_incident,
    "C10b": level,
    "C10c": source,
}
