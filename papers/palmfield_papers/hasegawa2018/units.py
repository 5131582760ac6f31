"""Compute the sound of the units of Hasegawa & Shinoda 2018, and the reading of a 1/8-inch microphone."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from palmfield.acoustics import FieldEvaluator, density, layout, pressure64, sound_speed
from palmfield.acoustics.focus import focus
from palmfield.instruments import Microphone, microphone_scan
from palmfield.instruments.microphone import angle_response
from palmfield.types import Air, Array, Complex, Float
from palmfield_papers.answer import Setting
from palmfield_papers.entries import book
from palmfield_papers.piston_faces import as_faces

ROOM = Air()
EIGHTH_INCH_M = 3.175e-3
PISTON_M = 4.5e-3
LAYOUTS = {1: "autd2018", 4: "autd2018_2x2"}
DEPTHS_M = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
FORCE_DEPTH_M = 0.2
TABLE = "measured table of the T4010A1"


@dataclass(frozen=True)
class Units:
    """Active units. Hashable, so that runs can be cached.

    count: 1 or 4
    directivity: "piston" (of radius_m), "table" or "point"
    """

    count: int = 4
    directivity: str = "piston"
    radius_m: float = PISTON_M


def value_of(setting: Setting, axis: str) -> str:
    """Return the reading of an axis. If the number does not depend on the axis, return its base value."""
    return dict(setting.readings).get(axis, book().axes[axis][0])


def units_of(setting: Setting, count: int = 4) -> Units:
    """Return the configuration hasegawa.field under the readings and the control of a setting."""
    directivity = "table" if value_of(setting, "hasegawa_directivity") == TABLE else "piston"
    return Units(count, "point" if setting.control == "directivity_point" else directivity)


@cache
def array_of(units: Units) -> Array:
    """Return the array with the p0 of the layout. Only the forces depend on p0."""
    array = layout(LAYOUTS[units.count])
    if units.directivity == "table":
        return array
    radius = units.radius_m if units.directivity == "piston" else 0.0
    return replace(array, directivity_table=None, piston_radius_m=radius)


@cache
def evaluator_of(units: Units, device: str) -> FieldEvaluator:
    return FieldEvaluator(array_of(units), ROOM, device)


def drive_of(units: Units, depth_m: float, x_m: float = 0.0) -> Complex:
    """Return the full drive for a focus at x_m from the axis of the aperture, shape (n,)."""
    return focus(array_of(units), ROOM, [x_m, 0.0, depth_m])


def pressure_at(units: Units, points: Float, drive: Complex, device: str = "cpu") -> Complex:
    """Return the complex peak pressure [Pa], shape (n,), in single precision: for maps."""
    return np.asarray(evaluator_of(units, device).pressure(points, drive).pressure, dtype=np.complex128)


def wavenumber() -> float:
    return 2.0 * np.pi * 40e3 / sound_speed(ROOM)


def head_on(units: Units, point: Float) -> Complex:
    """Return the factor of each transducer's sound by its angle of incidence on a microphone that faces the units."""
    rays = array_of(units).positions - point
    cosine = -rays[:, 2] / np.linalg.norm(rays, axis=1)
    return angle_response(cosine, EIGHTH_INCH_M, wavenumber())


@cache
def focal_pressure(units: Units, depth_m: float, receiver: str = "microphone", faces: bool = False) -> float:
    """Return [metrics.focal_pressure]: rms pressure at the commanded focus [Pa].

    receiver: "microphone": mean over its face, with the angular response of its body; "face": only the mean; "point"
    faces: whether pistons are sums of points on their faces instead of far fields
    """
    array, point = array_of(units), np.array([0.0, 0.0, depth_m])
    drive = drive_of(units, depth_m)
    if receiver == "microphone":
        drive = drive * head_on(units, point)
    sources, emitted = as_faces(array, drive, rings=3, spokes=8) if faces else (array, drive)
    microphone = Microphone(diameter_m=0.0 if receiver == "point" else EIGHTH_INCH_M)

    def sound(points: Float) -> Complex:
        return pressure64(points, sources, emitted, ROOM)[0]

    return float(np.abs(microphone_scan(sound, point[None], microphone).values[0]) / np.sqrt(2.0))


def impedance_Pa() -> float:
    return density(ROOM) * sound_speed(ROOM) ** 2
