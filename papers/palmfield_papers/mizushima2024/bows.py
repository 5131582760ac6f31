"""Compute the sound of the two bows of Mizushima & Sato 2024 under a reading, in the air of their room."""

from dataclasses import dataclass, replace

import numpy as np

from palmfield.acoustics import pressure64
from palmfield.acoustics.focus import focus
from palmfield.acoustics.layouts import bow_focus, two_bow
from palmfield.instruments import Microphone, microphone_scan
from palmfield.types import Air, Array, Complex, Float
from palmfield_papers.answer import Setting
from palmfield_papers.entries import book
from palmfield_papers.piston_faces import as_faces

ROOM = Air(temperature_C=23.0)
"""Air of section 4 of the paper: 23 degrees."""
SPEAKERS = 6
"""Number of speakers of a bow."""
QUARTER_INCH_M = 6.35e-3


@dataclass(frozen=True)
class Bows:
    """Driven speakers and receiver. Hashable, so that runs can be cached.

    focal_length_m: focal length of the parabola
    radius_m: radius of the face of a speaker
    coherent: whether the sounds of both bows are coherent
    receiver_m: diameter of the microphone, 0 for a point
    in_phase: whether all speakers have equal phase, instead of phases focused at the focus
    faces: whether speakers are sums of points on their faces (Rayleigh's integral) instead of far fields
    sounding: number of active speakers in the middle of a bow
    """

    focal_length_m: float = 50e-3
    radius_m: float = 6e-3
    coherent: bool = True
    receiver_m: float = QUARTER_INCH_M
    in_phase: bool = False
    faces: bool = False
    sounding: int = SPEAKERS


def value_of(setting: Setting, axis: str) -> str:
    """Return the reading of an axis. If the number does not depend on the axis, return its base value."""
    return dict(setting.readings).get(axis, book().axes[axis][0])


def bows_of(setting: Setting) -> Bows:
    """Return the configuration mizushima.field under the readings of a setting."""
    millimetres = {name: float(value_of(setting, name).removesuffix(" mm")) for name in LENGTHS}
    return Bows(
        focal_length_m=1e-3 * millimetres["mizushima_focal_length"],
        radius_m=1e-3 * millimetres["mizushima_radius"],
        coherent=value_of(setting, "mizushima_bows") == "coherent",
        receiver_m=0.0 if value_of(setting, "mizushima_receiver") == "point" else QUARTER_INCH_M,
    )


LENGTHS = ("mizushima_focal_length", "mizushima_radius")


def array_of(bows: Bows) -> Array:
    """Return speakers with 1 Pa m. The paper does not print their level, and half-widths do not depend on it."""
    return replace(two_bow("two_bow", bows.focal_length_m, bows.radius_m), p0_Pa_m=1.0)


def focus_of(bows: Bows) -> Float:
    """Return the common focus [m], shape (3,), array frame: x across the bows, y along them, z away from the sensor."""
    return np.array(bow_focus(array_of(bows)))


def drives_of(bows: Bows) -> list[Complex]:
    """Return one drive if pressures add, or one drive for each bow if squares add; shape (12,) each."""
    array = array_of(bows)
    drive = np.ones(len(array), complex) if bows.in_phase else focus(array, ROOM, focus_of(bows))
    place = np.arange(len(array)) % SPEAKERS
    drive = drive * (np.abs(2 * place - SPEAKERS + 1) < bows.sounding)
    if bows.coherent:
        return [drive]
    first = np.arange(len(array)) < SPEAKERS
    return [drive * first, drive * ~first]


def mean_square(bows: Bows, places_m: Float) -> Float:
    """Return the squared pressure amplitude of the microphone reading [Pa2], shape (n,).

    The radiation pressure, and its component at the modulation frequency, are proportional to this quantity.
    """
    array = array_of(bows)
    microphone = Microphone(diameter_m=bows.receiver_m)
    total = np.zeros(len(places_m))
    for drive in drives_of(bows):
        sources, emitted = as_faces(array, drive) if bows.faces else (array, drive)

        def sound(points: Float, sources: Array = sources, emitted: Complex = emitted) -> Complex:
            return pressure64(points, sources, emitted, ROOM)[0]

        total += np.abs(microphone_scan(sound, places_m, microphone).values) ** 2
    return total
