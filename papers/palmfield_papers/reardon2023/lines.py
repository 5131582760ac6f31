"""Rows R5 to R9 and R12: a focus on a straight path."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.ndimage import shift as moved

from palmfield.metrics import (
    average_residual_energy,
    focal_energy_ratio,
    mach_angle,
    ssim,
    strip,
    wake_area,
    wake_length,
)
from palmfield.skin.solvers.lateral_waves.modes import depth_problem, face_modes
from palmfield.types import Float
from palmfield_papers.answer import Answer, Setting
from palmfield_papers.reardon2023.configuration import (
    Course,
    Plate,
    RADIUS_m,
    SHEAR_SPEED_m_s,
    length_of,
    plate_of,
    threshold_of,
)
from palmfield_papers.reardon2023.resolution import answered, level_of
from palmfield_papers.reardon2023.runs import GRID_m, Straight, focus_at, run, straight

PATH_m = 0.16
LATERAL_m = 0.1
STRIP_m = 0.006
FAST = (5.0, 7.0, 10.0, 20.0)
"""Speeds at which the change of energies relative to a slow focus is computed [m/s]."""
AROUND_m = 0.1
"""Radius about the focus within which fields of control rates are compared [m]."""
FOCUS_AT_m = 0.12
RIDGE_deg = math.degrees(0.5 * GRID_m / 0.04)
"""Angle of half a grid step, seen in the middle of the fitted ridge, 20 to 60 mm behind the focus."""


def run_of(setting: Setting, level: int, speed: float, length: float | None = None, **changes: Any) -> Straight:
    """Return the straight run under a setting. length: of the path, if no reading defines it"""
    way = length_of(setting) if length is None else length
    return straight(plate_of(setting, **changes), speed, way, level, setting.device)


def wake_cm(one: Straight, threshold: float) -> float:
    """Return the wake of [metrics.wake_length] [cm]."""
    return 100.0 * wake_length(
        one.at_seven_eighths, one.places_m, one.places_m, focus_x_m=one.focus_x(0.875), threshold=threshold,
        lateral_m=LATERAL_m,
    )  # fmt: skip


def area_cm2(one: Straight, threshold: float) -> float:
    """Return the area of [metrics.wake_area] [cm^2]."""
    return 1e4 * wake_area(one.at_seven_eighths, one.places_m, one.places_m, threshold=threshold)


def angle_deg(one: Straight) -> float:
    """Return the half-angle of [metrics.mach_angle] [deg]."""
    return mach_angle(one.at_12_cm, one.places_m, one.places_m, focus_x_m=FOCUS_AT_m - 0.5 * one.length_m)


def _inside(one: Straight) -> Any:
    half = 0.5 * one.length_m
    return strip(one.places_m, one.places_m, [[-half, 0.0], [half, 0.0]], STRIP_m)


def ratio_of(one: Straight, over: Any = "outside") -> float:
    """Return the focal energy ratio: energy in the strip, relative to that outside or to the total."""
    return focal_energy_ratio(one.energy, one.places_m, one.places_m, _inside(one), over=over)


def residual(one: Straight) -> float:
    """Return the average residual energy over the square around the slab.

    It is that of the slab times the ratio of areas.
    """
    square = average_residual_energy(one.energy, one.places_m, one.places_m, _inside(one))
    return square * (2.0 * RADIUS_m) ** 2 / (math.pi * RADIUS_m**2)


# R5: wakes of a bonded slab by viscosity


def wake_by_viscosity(viscosity: float) -> Callable[[Setting], Answer]:
    """Return the answers of entries R5h to R5j: the wake for a viscosity."""

    def number(setting: Setting, level: int) -> float:
        return wake_cm(run_of(setting, level, 7.0, PATH_m, back="bonded", viscosity_Pa_s=viscosity), 0.1)

    return lambda setting: answered(number, setting, note="path of 16 cm: no wake is longer than 18.5 cm on the slab")


# R6, R7


def amplitudes(setting: Setting, level: int, **changes: Any) -> dict[float, float]:
    """Return the largest velocity in the second half of the path by speed [m/s]."""
    return {speed: run_of(setting, level, speed, PATH_m, **changes).largest for speed in (3.0, 5.0, 7.0, 10.0)}


def _largest_at_one(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        of = amplitudes(setting, level, **changes)
        return of[5.0] / max(of[3.0], of[7.0])

    def answer(setting: Setting) -> Answer:
        of = amplitudes(setting, level_of(setting), **changes)
        shown = {f"{speed:g} m/s over 5 m/s": of[speed] / of[5.0] for speed in (3.0, 7.0, 10.0)}
        return answered(number, setting, changes=changes, margin=lambda value: value - 1.0, shown=shown)

    return answer


def _smallest_when_slow(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        of = amplitudes(setting, level, **changes)
        return of[3.0] / min(of[5.0], of[7.0], of[10.0])

    def answer(setting: Setting) -> Answer:
        # Less than 1, because equality is not sufficient
        return answered(number, setting, changes=changes, margin=lambda value: 1.0 - value - 1e-9)

    return answer


def _angle(speed: float, **changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return angle_deg(run_of(setting, level, speed, PATH_m, **changes))

    def answer(setting: Setting) -> Answer:
        one = run_of(setting, level_of(setting), speed, PATH_m, **changes)
        slanted = mach_angle(
            one.at_12_cm, one.places_m, one.places_m, focus_x_m=FOCUS_AT_m - 0.5 * PATH_m, estimator="slant_stack"
        )
        by_ridge = answered(
            number, setting, changes=changes, shown={"by a slant stack [deg]": slanted}, resolution=RIDGE_deg
        )
        return replace(by_ridge, other_estimate=slanted)

    return answer


def strongest_mode(plate: Plate, wavenumber: float) -> float:
    """Return the angular frequency [rad/s] of the mode with the largest velocity after a pressure step."""
    modes = face_modes(depth_problem(plate.slab, wavenumber, (30,)), 0.05, 1e-4)
    moving = modes.poles.imag > 1.0
    part = np.abs(modes.normal[moving])
    # Pressure waves across the slab are excluded: they are over a hundred times as fast
    slow = modes.poles.imag[moving] < 4.0 * plate.shear_speed_m_s * max(wavenumber, math.pi / plate.thickness_m)
    return float(modes.poles.imag[moving][slow][part[slow].argmax()])


def own_curve_deg(one: Straight, plate: Plate, speed: float) -> tuple[float, float]:
    """Return the angle asin(c/v) of our dispersion curve [deg], and the wavenumber of the snapshot.

    The wavenumber is the power-weighted mean of the spectrum behind the focus. c is the phase speed of the mode that a
    pressure of this wavenumber excites most.
    """
    behind = one.at_12_cm[one.places_m < FOCUS_AT_m - 0.5 * one.length_m - 0.01]
    step = one.places_m[1] - one.places_m[0]
    power = np.abs(np.fft.rfft2(behind, (512, 512))) ** 2
    k = 2.0 * np.pi * np.hypot(np.fft.fftfreq(512, step)[:, None], np.fft.rfftfreq(512, step))
    mean = float((k * power).sum() / power.sum())
    phase = strongest_mode(plate, mean) / mean
    return math.degrees(math.asin(min(1.0, phase / speed))), mean


def _angle_at_seven(setting: Setting, level: int) -> float:
    return angle_deg(run_of(setting, level, 7.0, PATH_m))


def own_angle(setting: Setting) -> Answer:
    """Return the answer of entry R7c, which is compared with our dispersion curve."""
    one = run_of(setting, level_of(setting), 7.0, PATH_m)
    curve, k = own_curve_deg(one, plate_of(setting), 7.0)
    note = f"the phase speed of the strongest mode at {k:.0f} rad/m, the mean of the snapshot, gives {curve:.1f} deg"
    return replace(answered(_angle_at_seven, setting, note=note, resolution=RIDGE_deg), against=curve)


# R8, R9


def _wake_at_seven(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return wake_cm(run_of(setting, level, 7.0, **changes), threshold_of(setting))

    def answer(setting: Setting) -> Answer:
        one = run_of(setting, level_of(setting), 7.0, **changes)
        shown = {f"at {100 * share:g} % [cm]": wake_cm(one, share) for share in (0.01, 0.03, 0.1, 0.3)}
        shown |= {
            f"{speed:g} m/s [cm]": wake_cm(run_of(setting, level_of(setting), speed, **changes), threshold_of(setting))
            for speed in (3.0, 5.0, 10.0)
        }
        note = (
            f"path {100 * one.length_m:g} cm, {1e3 * 0.875 * one.end_s:.1f} ms after the start, rim "
            f"{plate_of(setting).rim}; up to the slab's rim there are {100 * (one.focus_x(0.875) + RADIUS_m):.1f} cm"
        )
        return answered(number, setting, changes=changes, margin=lambda value: value - 9.0, note=note, shown=shown)

    return answer


def areas(setting: Setting, level: int, **changes: Any) -> dict[float, float]:
    """Return areas by speed [cm^2]."""
    return {v: area_cm2(run_of(setting, level, v, **changes), threshold_of(setting)) for v in (5.0, 7.0, 10.0)}


def _outside(area: float) -> float:
    return min(area - 10.0, 50.0 - area)


def _area(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return min(areas(setting, level, **changes).values(), key=_outside)

    def answer(setting: Setting) -> Answer:
        shown = {f"{v:g} m/s [cm2]": area for v, area in areas(setting, level_of(setting), **changes).items()}
        return answered(
            number, setting, changes=changes, margin=_outside, note="the worst of 5, 7 and 10 m/s", shown=shown
        )

    return answer


def reference_m_s(setting: Setting) -> float:
    """Return the speed of the slow reference focus [m/s]."""
    return float(setting.reading("reardon_reference").split()[0])


def energy_changes(
    setting: Setting, level: int, what: Callable[[Straight], float], **changes: Any
) -> dict[float, float]:
    """Return the change from the reference speed to each fast speed [%]."""
    slow = what(run_of(setting, level, reference_m_s(setting), **changes))
    return {v: 100.0 * (what(run_of(setting, level, v, **changes)) / slow - 1.0) for v in FAST}


def _focal(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return min(energy_changes(setting, level, ratio_of, **changes).values())

    def answer(setting: Setting) -> Answer:
        level = level_of(setting)
        shown = {f"to {v:g} m/s [%]": one for v, one in energy_changes(setting, level, ratio_of, **changes).items()}
        total = energy_changes(setting, level, lambda one: ratio_of(one, "total"), **changes)
        shown |= {"of the ratio to the total, largest [%]": min(total.values())}
        return answered(number, setting, changes=changes, shown=shown)

    return answer


def _residual(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return max(energy_changes(setting, level, residual, **changes).values())

    def answer(setting: Setting) -> Answer:
        of = energy_changes(setting, level_of(setting), residual, **changes)
        return answered(number, setting, changes=changes, shown={f"to {v:g} m/s [%]": one for v, one in of.items()})

    return answer


# R12


@cache
def held_snapshot(plate: Plate, rate_Hz: float | None, delay_s: float, level: int, device: str) -> tuple[Float, Float]:
    """Return positions and velocity at 7 m/s after 12 cm of a path of 16 cm.

    rate_Hz: control rate; None for continuous motion, which is evaluated delay_s after this moment
    """
    course = Course(((-0.08, 0.0), (0.08, 0.0)), 7.0, 16, rate_Hz=rate_Hz)
    motion = run(plate, course, level, device, np.array([FOCUS_AT_m / 7.0 + delay_s]))
    return motion.places_m, motion.velocity[0].astype(float)


REFERENCE_Hz = 2e5


def _compared(places: Float, one: Float, other: Float) -> float:
    """Return [metrics.wave_field_difference]."""
    focus = focus_at(Course(((-0.08, 0.0), (0.08, 0.0)), 7.0, 16), FOCUS_AT_m / 7.0)
    x, y = np.meshgrid(places - focus[0], places - focus[1], indexing="ij")
    near = np.hypot(x, y) <= AROUND_m
    return float(np.sqrt(((one - other)[near] ** 2).sum() / (other[near] ** 2).sum()))


def rate_difference(plate: Plate, rate_Hz: float, level: int, device: str) -> float:
    """Return the difference between the fields at a control rate and at 200 kHz, at the same time.

    200 kHz is represented by continuous motion that is delayed by half a control step. The error is (k v / f)^2/24,
    which is 1e-4 at 1000 rad/m.
    """
    places, stepped = held_snapshot(plate, rate_Hz, 0.0, level, device)
    _, fine = held_snapshot(plate, None, -0.5 / REFERENCE_Hz, level, device)
    return _compared(places, stepped, fine)


def late_difference(plate: Plate, rate_Hz: float, level: int, device: str) -> tuple[float, float]:
    """Return the difference from a focus that moves continuously, delayed by half a control step; and the SSIM of both.

    This delay is the mean delay of the fixed focus. The continuous field is evaluated half a step earlier, without a
    shift.
    """
    places, stepped = held_snapshot(plate, rate_Hz, 0.0, level, device)
    _, late = held_snapshot(plate, None, -0.5 / rate_Hz, level, device)
    return _compared(places, stepped, late), ssim(stepped, late, data_range=2.0)


def _rate(rate_Hz: float, **changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return rate_difference(plate_of(setting, **changes), rate_Hz, level, setting.device)

    def answer(setting: Setting) -> Answer:
        late, like = late_difference(plate_of(setting, **changes), rate_Hz, level_of(setting), setting.device)
        shown = {"from a focus that is late by half a step": late, "SSIM with that": like}
        return answered(number, setting, changes=changes, margin=lambda value: 0.1 - value, shown=shown)

    return answer


def late_rate(rate_Hz: float) -> Callable[[Setting], Answer]:
    """Return the answer of `late_difference` at a control rate."""

    def answer(setting: Setting) -> Answer:
        late, _ = late_difference(plate_of(setting), rate_Hz, level_of(setting), setting.device)
        return Answer(late, margin=0.1 - late)

    return answer


def _order_of_rates(setting: Setting, level: int) -> float:
    plate = plate_of(setting)
    return rate_difference(plate, 700.0, level, setting.device) / rate_difference(plate, 1400.0, level, setting.device)


def spatial_step(rate_Hz: float) -> Callable[[Setting], Answer]:
    """Return the answers of entries R12f to R12i: the step v/f of the focus [mm]."""
    return lambda setting: Answer(1e3 * 7.0 / rate_Hz, 0.0, note="7 m/s over the control rate")


def likeness_of_nulls(setting: Setting) -> dict[str, tuple[float, float]]:
    """Return MSE and SSIM of energy densities that should be similar or should differ, for the notes."""
    from palmfield.metrics import mse

    level = level_of(setting)
    one, other = run_of(setting, level, 7.0, PATH_m).energy, run_of(setting, level, 5.0, PATH_m).energy
    step = 1e3 * 7.0 / 1400.0 / 2.0
    late = moved(one, (step, 0.0), order=1)
    return {
        "the same, moved by half a control step of 1.4 kHz (2.5 mm)": (mse(one, late), ssim(one, late)),
        "5 m/s for 7 m/s": (mse(one, other), ssim(one, other)),
    }


def viscosity_from_absorption(setting: Setting) -> Answer:
    """Return the answer of entry R5g: k-Wave's eta = 2 rho c^3 alpha for 3e5 dB/(MHz^2 cm)."""
    neper_m = 3e5 * 100.0 / (20.0 / math.log(10.0))
    alpha = neper_m / (2.0 * math.pi * 1e6) ** 2
    return Answer(
        2.0 * 923.5 * SHEAR_SPEED_m_s**3 * alpha, 0.0, note="eta = 2 rho c^3 alpha, alpha in Np/(m (rad/s)^2)"
    )


ANSWERS = {
    "R5g": viscosity_from_absorption,
    "R5h": wake_by_viscosity(0.02),
    "R5i": wake_by_viscosity(1.0),
    "R5j": wake_by_viscosity(3.0),
    "R6b": _largest_at_one(),
    "R6c": _smallest_when_slow(),
    "R7a": _angle(7.0),
    "R7b": _angle(10.0),
    "R7c": own_angle,
    "R8-R9a": _wake_at_seven(),
    "R8-R9b": _area(),
    "R8-R9c": _focal(),
    "R8-R9d": _residual(),
    "R12f": spatial_step(700.0),
    "R12g": spatial_step(1400.0),
    "R12h": spatial_step(4200.0),
    "R12i": spatial_step(2e5),
    "R12j": _rate(1400.0),
    "R12k": _rate(4200.0),
    "R12l": lambda setting: answered(_order_of_rates, setting, margin=lambda value: value - 1.0),
}
VARIED = {
    "R6b": _largest_at_one,
    "R6c": _smallest_when_slow,
    "R7a": lambda **changes: _angle(7.0, **changes),
    "R7b": lambda **changes: _angle(10.0, **changes),
    "R8-R9a": _wake_at_seven,
    "R8-R9b": _area,
    "R8-R9c": _focal,
    "R8-R9d": _residual,
    "R12j": lambda **changes: _rate(1400.0, **changes),
    "R12k": lambda **changes: _rate(4200.0, **changes),
}
"""Answers for slabs with changed fields, to find causes."""
