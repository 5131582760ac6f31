"""Rows M1 to M7: the bows, requirements for 4000 Pa, and the size of the focus."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from palmfield.acoustics import density, sound_speed
from palmfield.acoustics.layouts import bow
from palmfield.errors import MeasurementError
from palmfield.instruments import Microphone, Plate, plate_force
from palmfield.instruments.microphone import face_factor
from palmfield.metrics import half_width
from palmfield.types import Air, Float
from palmfield_papers.answer import Answer, Cause, Compute, Setting
from palmfield_papers.mizushima2024.bows import (
    QUARTER_INCH_M,
    ROOM,
    SPEAKERS,
    Bows,
    array_of,
    bows_of,
    focus_of,
    mean_square,
    value_of,
)
from palmfield_papers.piston_axis import on_axis, rayleigh_length_m

PRINTED_AIR_C_m_s = 343.0
CARRIER_HZ = 40e3
STEP_M = 0.25e-3
REACH_M = {"x": (-45e-3, 45e-3), "y": (-45e-3, 45e-3), "z": (-38e-3, 80e-3)}
"""Ranges of the scans about the focus. At their ends, less than half of the maximum remains."""
CLEAR_M = 5e-3
"""Smallest distance of the microphone from the foremost speaker [m]."""
LARGEST_PA = 4000.0


@cache
def scan(bows: Bows, axis: str, step_m: float = STEP_M) -> tuple[Float, Float]:
    """Return positions along an axis from the focus [m], and the mean square relative to its maximum, shapes (n,)."""
    number = "xyz".index(axis)
    low, high = REACH_M[axis]
    focus = focus_of(bows)
    if axis == "z":
        low = max(low, float(array_of(bows).positions[:, 2].max() - focus[2]) + CLEAR_M)
    at = step_m * np.arange(np.ceil(low / step_m), np.floor(high / step_m) + 0.5)
    square = mean_square(bows, focus + at[:, None] * np.eye(3)[number])
    return at, square / square.max()


def width_mm(bows: Bows, axis: str, step_m: float = STEP_M) -> float:
    """Return [metrics.half_width]: distance from the maximum to the outermost half level, mean of both sides [mm]."""
    return 1e3 * half_width(*scan(bows, axis, step_m))


def numerical_error_mm(bows: Bows, axis: str, width: float) -> float:
    """Return the error of the step (from half the step) and of the far field (from Rayleigh's integral).

    It is computed for a point receiver.
    """
    finer = abs(width_mm(bows, axis, STEP_M / 2) - width)
    bare = replace(bows, receiver_m=0.0)
    return max(finer, abs(width_mm(replace(bare, faces=True), axis) - width_mm(bare, axis)))


PRINTED_MM = {"section 4: x 10, z 8": {"x": 10.0, "z": 8.0}, "conclusion: x 8, z 10": {"x": 8.0, "z": 10.0}}


def width_along(axis: str) -> Compute:
    def compute(setting: Setting) -> Answer:
        bows = bows_of(setting)
        printed = PRINTED_MM[value_of(setting, "mizushima_axes")].get(axis) if axis != "y" else None
        try:
            width = width_mm(bows, axis)
        except MeasurementError as error:
            return Answer(None, note=f"no half level within the scan: {error}")
        at, square = scan(bows, axis)
        shown = {
            "central lobe [mm]": 1e3 * half_width(at, square, of="central"),
            "place of the largest value from the focus [mm]": 1e3 * float(at[square.argmax()]),
        }
        return Answer(
            width,
            error=numerical_error_mm(bows, axis, width),
            note="error: of the step, and of the far field by Rayleigh's integral",
            shown=shown,
            against=printed,
        )

    return compute


def width_with(axis: str, change: Callable[[Bows], Bows], power: float = 1.0) -> Compute:
    """Return the half-width with one change; power: exponent of the mean square."""

    def compute(setting: Setting) -> Answer:
        at, square = scan(change(bows_of(setting)), axis)
        return Answer(1e3 * half_width(at, square**power), error=None)

    return compute


def _speakers_in_phase(bows: Bows) -> Bows:
    return replace(bows, in_phase=True)


def _short_focus(bows: Bows) -> Bows:
    return replace(bows, focal_length_m=30e-3, radius_m=5e-3)


def _as_it_is(bows: Bows) -> Bows:
    return bows


def causes(axis: str) -> tuple[Cause, ...]:
    return (
        Cause(
            "one generator drives all speakers equally: on a parabola their sound does not arrive in phase",
            width_with(axis, _speakers_in_phase),
        ),
        Cause("half of the sound pressure is meant, not of the radiation pressure", width_with(axis, _as_it_is, 0.5)),
        Cause(
            "focal length 30 mm and radius 5 mm together, which fit the printed angles and Rayleigh length",
            width_with(axis, _short_focus),
        ),
    )


# -- inputs of the paper --------------------------------------------------------------------------------------


def speaker_angle(number: int) -> Compute:
    """Return the angle between the axis of a bow and the line from a speaker to the focus [deg].

    number: 0 for the outermost
    """

    def angle(focal_length_m: float) -> float:
        positions, _ = bow(focal_length_m)
        _, y, z = positions[number]
        return float(np.degrees(np.arctan2(abs(y), -z)))

    def compute(setting: Setting) -> Answer:
        return Answer(
            angle(50e-3),
            error=0.0,
            note="for speakers 10 mm apart along the parabola of 50 mm",
            shown={"for a focal length of 30 mm [deg]": angle(30e-3)},
        )

    return compute


def count_of_bows(setting: Setting) -> Answer:
    return Answer(len(array_of(bows_of(setting))) / SPEAKERS, error=0.0)


def count_of_speakers(setting: Setting) -> Answer:
    return Answer(float(len(bow(50e-3)[0])), error=0.0)


def spacing(setting: Setting) -> Answer:
    positions, _ = bow(50e-3)
    return Answer(1e3 * float(np.linalg.norm(np.diff(positions, axis=0), axis=1).max()), error=0.0)


def rayleigh_length(radius_mm: float) -> Compute:
    def compute(setting: Setting) -> Answer:
        wavenumber = 2.0 * np.pi * CARRIER_HZ / PRINTED_AIR_C_m_s
        length = rayleigh_length_m(1e-3 * radius_mm, wavenumber)
        left = abs(on_axis(length, 1e-3 * radius_mm, wavenumber)) * length
        return Answer(1e3 * length, error=0.0, shown={"pressure there over that of the far field": float(left)})

    return compute


def printed_rayleigh_length(setting: Setting) -> Answer:
    radius = float(value_of(setting, "mizushima_radius").removesuffix(" mm"))
    return rayleigh_length(radius)(setting)


# -- requirements for 4000 Pa ---------------------------------------------------------------------------------------


def impedance_Pa(air: Air) -> float:
    return density(air) * sound_speed(air) ** 2


def needed_pressure_Pa(arp_Pa: float) -> float:
    """Return the rms sound pressure for a radiation pressure, by alpha p^2/(rho c^2) with alpha 2."""
    return float(np.sqrt(0.5 * arp_Pa * impedance_Pa(ROOM)))


def needed_pressure(setting: Setting) -> Answer:
    return Answer(1e-3 * needed_pressure_Pa(LARGEST_PA), error=0.0)


def needed_level(setting: Setting) -> Answer:
    return Answer(20.0 * float(np.log10(needed_pressure_Pa(LARGEST_PA) / 20e-6)), error=0.0)


@cache
def force_at(bows: Bows, peak_Pa: float, spacing_m: float) -> tuple[float, float]:
    """Return the force on a plate of 30 x 30 mm in the focus [N], also with a coarser spacing.

    peak_Pa: largest radiation pressure
    """
    focus = focus_of(bows)
    free = replace(bows, receiver_m=0.0)
    largest = float(mean_square(free, focus[None])[0])

    def arp_at(points: Float, normals: Float) -> Float:
        return peak_Pa / largest * mean_square(free, points)

    force = plate_force(
        arp_at,
        Plate(width_m=0.03, height_m=0.03, centre_m=(0.0, 0.0, float(focus[2])), spacing_m=spacing_m),
    )
    return force.force_N, force.coarser_N


def needed_force(setting: Setting) -> Answer:
    spacing_m = 1e-3 if setting.quick else 0.5e-3
    force, coarser = force_at(bows_of(setting), LARGEST_PA, spacing_m)
    corrected, _ = force_at(Bows(30e-3, 5e-3), LARGEST_PA, 1e-3)
    area = np.pi * 10e-3 * 3e-3 / np.log(2.0)
    return Answer(
        force,
        error=abs(force - coarser) / 3.0,
        note="on 30 x 30 mm about the focus of both bows in step, with 4000 Pa in its middle",
        shown={
            "focal length 30 mm, radius 5 mm [N]": corrected,
            "Gaussian ellipse of the printed half-widths 10 and 3 mm [N]": LARGEST_PA * area,
            "source amplitude of a speaker that it takes [Pa m]": needed_p0_Pa_m(bows_of(setting)),
            "radiation pressure at 2.53 Pa m [Pa]": LARGEST_PA * (2.53 / needed_p0_Pa_m(bows_of(setting))) ** 2,
        },
    )


def needed_p0_Pa_m(bows: Bows) -> float:
    """Return the source amplitude of each speaker [Pa m] for 4000 Pa in the focus."""
    free = replace(bows, receiver_m=0.0)
    per_p0 = np.sqrt(mean_square(free, focus_of(bows)[None])[0] / 2.0)
    return float(needed_pressure_Pa(LARGEST_PA) / per_p0)


def face_doubling(setting: Setting) -> Answer:
    factor = face_factor(Microphone(diameter_m=QUARTER_INCH_M, face="doubling"))
    return Answer(factor**2, error=0.0, note="a rigid wall doubles the pressure")


def peak_for_rms(setting: Setting) -> Answer:
    phases = 2.0 * np.pi * np.arange(64) / 64
    return Answer(float(np.max(np.sin(phases) ** 2) / np.mean(np.sin(phases) ** 2)), error=0.0, note="of a sine")


def true_pressure(setting: Setting) -> Answer:
    factors = (face_doubling(setting).value or 1.0) * (peak_for_rms(setting).value or 1.0)
    return Answer(LARGEST_PA / factors, error=0.0)


# -- checks of the fringes ------------------------------------------------------------------------------


def fringe_spacing(setting: Setting) -> Answer:
    """Return half the distance of the two maxima next to the central one [mm]."""
    at, square = scan(replace(bows_of(setting), receiver_m=0.0), "x")
    inside = np.flatnonzero((square[1:-1] > square[:-2]) & (square[1:-1] > square[2:])) + 1
    places = []
    for i in inside:
        left, middle, right = square[i - 1 : i + 2]
        places.append(at[i] + 0.5 * STEP_M * (left - right) / (left - 2.0 * middle + right))
    ordered = sorted(places, key=abs)
    spacing_mm = 0.5e3 * (abs(ordered[1]) + abs(ordered[2]))
    plane = 1e3 * sound_speed(ROOM) / CARRIER_HZ / (2.0 * np.sin(np.radians(30.0)))
    return Answer(spacing_mm, error=1e3 * STEP_M / 10.0, shown={"of two plane waves at +-30 degrees [mm]": plane})


def check_of(axis: str, change: Callable[[Bows], Bows], of: str = "outermost") -> Compute:
    def compute(setting: Setting) -> Answer:
        bows = change(bows_of(setting))
        short = change(Bows(30e-3, 5e-3))

        def width(one: Bows) -> float:
            at, square = scan(one, axis)
            return 1e3 * half_width(at, square, of="central" if of == "central" else "outermost")

        return Answer(
            width(bows),
            error=numerical_error_mm(bows, axis, width_mm(bows, axis)),
            note="focal length 50 mm, radius 6 mm, as the base of the readings",
            shown={"focal length 30 mm, radius 5 mm [mm]": width(short)},
        )

    return compute


def _bare(bows: Bows) -> Bows:
    return replace(bows, receiver_m=0.0)


def _bare_incoherent(bows: Bows) -> Bows:
    return replace(bows, receiver_m=0.0, coherent=False)


def _quarter_inch(bows: Bows) -> Bows:
    return replace(bows, receiver_m=QUARTER_INCH_M)


ANSWERS: dict[str, Compute] = {
    "M1a": count_of_bows,
    "M1b": count_of_speakers,
    "M1c": spacing,
    "M1g": speaker_angle(0),
    "M1h": speaker_angle(1),
    "M1i": speaker_angle(2),
    "M2-M3f": printed_rayleigh_length,
    "M2-M3g": rayleigh_length(6.0),
    "M2-M3h": rayleigh_length(5.0),
    "M2-M3i": rayleigh_length(3.0),
    "M4-M5c": needed_pressure,
    "M4-M5d": needed_level,
    "M4-M5e": needed_force,
    "M4-M5f": face_doubling,
    "M4-M5g": peak_for_rms,
    "M4-M5h": true_pressure,
    "M7a": width_along("y"),
    "M7b": width_along("x"),
    "M7c": width_along("z"),
    "M7f": fringe_spacing,
    "M7g": check_of("x", _bare, "central"),
    "M7h": check_of("x", _bare),
    "M7i": check_of("x", _bare_incoherent),
    "M7j": check_of("y", _quarter_inch),
    "M7k": check_of("z", _quarter_inch),
}
CAUSES = {"M7a": causes("y"), "M7b": causes("x"), "M7c": causes("z")}
LATER = {
    "M7a": (
        Cause(
            "two speakers of a bow in place of six: a third of the aperture",
            width_with("y", lambda bows: replace(bows, sounding=2)),
        ),
    )
}
