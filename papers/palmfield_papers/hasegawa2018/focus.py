"""Rows H1, H13 to H15, H17 and H22: the focus at six depths, its force, and its steps."""

import math
from dataclasses import replace
from functools import cache

import numpy as np

from palmfield.acoustics import pressure64
from palmfield.acoustics.arp import arp
from palmfield.acoustics.nonlinear import beam_steepening, fundamental_left
from palmfield.drive.boards.autd2018 import BOARD, CARRIER_HZ, PACKET_RATE_HZ, TRANSDUCERS
from palmfield.drive.pulse_width import HASEGAWA_TICKS
from palmfield.instruments import Plate, plate_force
from palmfield.metrics import level_depth
from palmfield.types import Complex, Float
from palmfield_papers.answer import Answer, Cause, Compute, Setting
from palmfield_papers.hasegawa2018.units import (
    DEPTHS_M,
    EIGHTH_INCH_M,
    FORCE_DEPTH_M,
    LAYOUTS,
    ROOM,
    Units,
    array_of,
    drive_of,
    evaluator_of,
    focal_pressure,
    impedance_Pa,
    pressure_at,
    units_of,
    value_of,
    wavenumber,
)

JIG_M = 0.012
DRIFT_PPM, SKEW_S = 20.0, 1e-6
"""Largest frequency difference of free-running clocks (assumed), and delay of synchronised clocks (section 3.2)."""
GRID_M = 1e-3
THRESHOLD_DB = -34.0
PRINTED_JIG_N, PRINTED_ALL_N = 20e-3, 40.8e-3
STEPS_M = np.arange(0.0, 5.001e-3, 0.5e-3)
LINE_M = np.arange(-3e-3, 8.0001e-3, 0.1e-3)


# -- pressure over depth -------------------------------------------------------------------------------------------


def reference_m(setting: Setting, units: Units) -> float:
    """Return the depth of the reference pressure."""
    reading = value_of(setting, "hasegawa_reference")
    if reading.endswith(" mm"):
        return 1e-3 * float(reading.removesuffix(" mm"))
    return max(DEPTHS_M, key=lambda depth: focal_pressure(units, depth))


def ratio(units: Units, depth_m: float, reference: float, receiver: str = "microphone", faces: bool = False) -> float:
    return focal_pressure(units, depth_m, receiver, faces) / focal_pressure(units, reference, receiver, faces)


@cache
def far_field_error(count: int, depth_m: float, reference: float) -> float:
    """Return the relative error of a ratio due to the far field of pistons, by Rayleigh's integral."""
    units = Units(count, "piston")
    exact, ours = (ratio(units, depth_m, reference, "point", faces) for faces in (True, False))
    return abs(ours / exact - 1.0)


def pressure_ratio(count: int, depth_m: float) -> Compute:
    def compute(setting: Setting) -> Answer:
        units = units_of(setting, count)
        reference = reference_m(setting, units)
        value = ratio(units, depth_m, reference)
        return Answer(
            value,
            error=value * far_field_error(count, depth_m, reference),
            note=f"over {1e3 * reference:g} mm; error: of the pistons' far field, by Rayleigh's integral",
            shown={
                "mean over the microphone's face alone": ratio(units, depth_m, reference, "face"),
                "at a point": ratio(units, depth_m, reference, "point"),
            },
        )

    return compute


def lossy_ratio(count: int, depth_m: float, drive: float, far: bool) -> Compute:
    """Return the pressure ratio of the carrier, with losses to harmonics subtracted.

    The losses are those up to the reference or, if `far`, up to both depths.
    """

    def compute(setting: Setting) -> Answer:
        units = units_of(setting, count)
        depths = (depth_m, reference_m(setting, units))
        sigmas = (beam_steepening(array_of(units), drive_of(units, z), [0.0, 0.0, z], ROOM) for z in depths)
        there, near = (fundamental_left(drive * sigma) for sigma in sigmas)
        return Answer(ratio(units, *depths) * (there if far else 1.0) / near)

    return compute


def over_200(count: int, depth_m: float, directivity: str) -> Compute:
    """Return the answer function for the pressure relative to 200 mm, which is checked at a point."""

    def compute(setting: Setting) -> Answer:
        units = Units(count, directivity)
        value = ratio(units, depth_m, 0.2, "point")
        return Answer(
            value,
            error=value * far_field_error(count, depth_m, 0.2),
            note="at a point",
            shown={"through the microphone": ratio(units, depth_m, 0.2)},
        )

    return compute


def halved_depth(setting: Setting) -> Answer:
    """Return the depth at which the pressure is half of that at 200 mm, for one unit with the table [mm]."""

    def depth_mm(units: Units, step_m: float, receiver: str = "point") -> float:
        depths = np.arange(0.2, 1.2001, step_m)
        curve = np.array([focal_pressure(units, round(float(depth), 6), receiver) for depth in depths])
        return 1e3 * level_depth(depths, curve, 0.2)

    units = Units(1, "table")
    value = depth_mm(units, 0.02)
    return Answer(
        value,
        error=abs(depth_mm(units, 0.01) - value),
        note="at a point, with the T4010A1's table, over 200 mm",
        shown={
            "pistons [mm]": depth_mm(Units(1), 0.02),
            "four units, table [mm]": depth_mm(Units(4, "table"), 0.02),
            "four units, pistons [mm]": depth_mm(Units(4), 0.02),
        },
    )


# -- force ---------------------------------------------------------------------------------------------------------


@cache
def force(
    units: Units, edge_m: float, depth_m: float = FORCE_DEPTH_M, device: str = "cpu", focus_m: float | None = None
) -> tuple[float, float]:
    """Return [metrics.force] at full drive [N], and its value with twice the spacing.

    The law is alpha 2, incident field.

    focus_m: depth of the focus; None for that of the plate
    """
    drive = drive_of(units, depth_m if focus_m is None else focus_m)

    def arp_at(points: Float, normals: Float) -> Float:
        return np.abs(pressure_at(units, points, drive, device)) ** 2 / impedance_Pa()

    plate = Plate(width_m=edge_m, height_m=edge_m, centre_m=(0.0, 0.0, depth_m), spacing_m=GRID_M)
    found = plate_force(arp_at, plate)
    return found.force_N, found.coarser_N


@cache
def force_by_default_law(units: Units, edge_m: float) -> float:
    """Return the force by the Lagrangian law of the total field on a rigid wall [N]."""
    drive, evaluator = drive_of(units, FORCE_DEPTH_M), evaluator_of(units, "cpu")

    def arp_at(points: Float, normals: Float) -> Float:
        return arp(evaluator.pressure(points, drive, True), normals, ROOM, 40e3).astype(np.float64)

    plate = Plate(width_m=edge_m, height_m=edge_m, centre_m=(0.0, 0.0, FORCE_DEPTH_M), spacing_m=GRID_M)
    return plate_force(arp_at, plate).force_N


def share(units: Units, edge_m: float, device: str = "cpu") -> tuple[float, float]:
    """Return the force on the jig divided by that on the reflector, and the error of this ratio."""
    (jig, jig_coarse), (plate, plate_coarse) = (force(units, edge, FORCE_DEPTH_M, device) for edge in (JIG_M, edge_m))
    value = jig / plate
    error = (abs(jig - jig_coarse) / jig + abs(plate - plate_coarse) / plate) / 3.0
    return value, value * error


def edge_m(setting: Setting) -> float:
    return float(value_of(setting, "hasegawa_plate").removesuffix(" m"))


def force_ratio(setting: Setting) -> Answer:
    units, edge = units_of(setting), edge_m(setting)
    value, error = share(units, edge, setting.device)
    return Answer(
        value,
        error=error,
        note="error: of the grid; a jig of 1.4 waves is off by about 10 % by any local law",
        shown={
            "by the law of a rigid wall": force_by_default_law(units, JIG_M) / force_by_default_law(units, edge),
            "jig [mN]": 1e3 * force(units, JIG_M)[0],
            "reflector [mN]": 1e3 * force(units, edge)[0],
            "p0 [Pa m]": array_of(units).p0_Pa_m,
        },
    )


def force_ratio_on(edge: float) -> Compute:
    def compute(setting: Setting) -> Answer:
        value, error = share(Units(4), edge, setting.device)
        table, _ = share(Units(4, "table"), edge, setting.device)
        return Answer(value, error=error, note="pistons", shown={"table of the T4010A1": table})

    return compute


def amplitude_of_forces(directivity: str) -> Compute:
    """Return the p0 with which both printed forces differ by the same factor, in opposite directions [Pa m]."""

    def compute(setting: Setting) -> Answer:
        units = Units(4, directivity)
        p0 = array_of(units).p0_Pa_m
        by_jig, by_all = (
            p0 * math.sqrt(printed / force(units, edge, FORCE_DEPTH_M, setting.device)[0])
            for printed, edge in ((PRINTED_JIG_N, JIG_M), (PRINTED_ALL_N, 0.4))
        )
        jig, coarse = force(units, JIG_M, FORCE_DEPTH_M, setting.device)
        return Answer(
            math.sqrt(by_jig * by_all),
            error=by_jig * abs(jig - coarse) / jig / 6.0,
            note="geometric mean of those of both forces, on a plate of 0.4 m",
            shown={
                "by 20 mN on 12 x 12 mm [Pa m]": by_jig,
                "by 40.8 mN in all [Pa m]": by_all,
                "of both, by the law of a rigid wall [Pa m]": p0
                * math.sqrt(PRINTED_JIG_N * PRINTED_ALL_N) ** 0.5
                / (force_by_default_law(units, JIG_M) * force_by_default_law(units, 0.4)) ** 0.25,
                "sigma along the axis with it": math.sqrt(by_jig * by_all)
                / p0
                * beam_steepening(array_of(units), drive_of(units, FORCE_DEPTH_M), [0.0, 0.0, FORCE_DEPTH_M], ROOM),
            },
        )

    return compute


# -- steps and reach -----------------------------------------------------------------------------------------------


@cache
def peaks_mm(units: Units, rounded: bool, step_m: float = 0.1e-3, delays: int | None = None) -> tuple[float, ...]:
    """Return the position of the largest pressure along x for each command of STEPS_M [mm].

    rounded: whether to round to ticks and packets of the board
    delays: number of delays per period if not rounded
    """
    board = BOARD.sized(len(array_of(units)))
    line = np.arange(LINE_M[0], LINE_M[-1] + 0.5 * step_m, step_m)
    points = np.column_stack([line, np.zeros(len(line)), np.full(len(line), FORCE_DEPTH_M)])
    found = []
    for x in STEPS_M:
        if rounded:
            placed = np.rint(np.array([x, 0.0, FORCE_DEPTH_M]) / board.packet_lsb_m) * board.packet_lsb_m
            drive = board.focused(placed, HASEGAWA_TICKS // 2)
        else:
            drive = drive_of(units, FORCE_DEPTH_M, float(x))
            if delays is not None:
                step = 2.0 * math.pi / delays
                drive = np.exp(1j * step * np.rint(np.angle(drive) / step))
        # float64, because in single precision a flat maximum may shift by a grid step
        found.append(1e3 * _parabola(line, np.abs(_exactly(units, points, drive))))
    return tuple(found)


def _exactly(units: Units, points: Float, drive: Complex) -> Complex:
    return pressure64(points, array_of(units), drive, ROOM)[0]


def _parabola(at: Float, values: Float) -> float:
    i = int(values.argmax())
    left, middle, right = values[i - 1 : i + 2]
    return float(at[i] + 0.5 * (at[1] - at[0]) * (left - right) / (left - 2.0 * middle + right))


def largest_step(setting: Setting) -> Answer:
    units = units_of(setting)
    steps = np.diff(peaks_mm(units, True))
    finer = np.diff(peaks_mm(units, True, 0.2e-3))
    smooth = np.diff(peaks_mm(units, False))
    return Answer(
        float(steps.max()),
        error=float(np.abs(finer - steps).max()),
        margin=float(min(1.0 - steps.max(), steps.min())),
        note="with delays in 640 ticks a period and places in packets of 0.025 mm",
        shown={"least step [mm]": float(steps.min()), "largest step, delays not rounded [mm]": float(smooth.max())},
    )


def step_with_delays(delays: int) -> Compute:
    """Return the largest step with delays rounded to `delays` values per period."""

    def compute(setting: Setting) -> Answer:
        steps = np.diff(peaks_mm(units_of(setting), False, delays=delays))
        return Answer(float(steps.max()), margin=float(min(1.0 - steps.max(), steps.min())))

    return compute


def reach_without_focusing(setting: Setting) -> Answer:
    """Return `reach` with the focus constant at 200 mm."""
    units = units_of(setting)
    near, far = (force(units, JIG_M, depth, setting.device, FORCE_DEPTH_M)[0] for depth in (FORCE_DEPTH_M, 1.0))
    level = 20.0 * math.log10(far / near)
    return Answer(level - THRESHOLD_DB, margin=level - THRESHOLD_DB)


def reach(setting: Setting) -> Answer:
    units = units_of(setting)
    (near, near_coarse), (far, far_coarse) = (
        force(units, JIG_M, depth, setting.device) for depth in (FORCE_DEPTH_M, 1.0)
    )
    level = 20.0 * math.log10(far / near)
    error = 20.0 / math.log(10.0) * (abs(near - near_coarse) / near + abs(far - far_coarse) / far) / 3.0
    peak = 40.0 * math.log10(ratio(units, 1.0, 0.2, "point"))
    return Answer(
        level - THRESHOLD_DB,
        error=error,
        margin=level - THRESHOLD_DB,
        note="force on 12 x 12 mm in 20 log10, threshold -34 dB",
        shown={
            "level of the force at 1000 mm [dB]": level,
            "of the pressure squared in its middle [dB]": peak,
            "of the force on 0.1 x 0.1 m [dB]": 20.0
            * math.log10(
                force(units, 0.1, 1.0, setting.device)[0] / force(units, 0.1, FORCE_DEPTH_M, setting.device)[0]
            ),
        },
    )


@cache
def _of_units(units: Units) -> Complex:
    """Return the pressure of each unit at the common focus [Pa]."""
    array, drive = array_of(units), drive_of(units, FORCE_DEPTH_M)
    mine = np.arange(len(array)) // TRANSDUCERS == np.arange(units.count)[:, None]
    return np.array([pressure64(np.array([[0.0, 0.0, FORCE_DEPTH_M]]), array, drive * one, ROOM)[0][0] for one in mine])


def level_of_units(units: Units, since_sync_s: Float) -> Float:
    """Return the pressure at the focus relative to that of synchronised units.

    since_sync_s: time since synchronisation [s]
    """
    board = replace(BOARD.sized(units.count * TRANSDUCERS), clock_drift_ppm=DRIFT_PPM, skew_s=SKEW_S)
    late = np.array([board.unit_delays(float(one)) for one in since_sync_s])
    parts = _of_units(units)
    return np.asarray(np.abs(np.exp(2j * np.pi * CARRIER_HZ * late) @ parts) / abs(parts.sum()))


def synchronised(setting: Setting) -> Answer:
    """Return the answer of entry H6d, on synchronised units."""
    units = units_of(setting)
    times = np.linspace(0.0, 1.0, 4001)
    set_often = float(level_of_units(units, times % (1.0 / PACKET_RATE_HZ)).mean())
    free, coarser = (float(level_of_units(units, times[::every]).mean()) for every in (1, 2))
    ratio_of_means = set_often / free
    return Answer(
        ratio_of_means, ratio_of_means * abs(coarser / free - 1.0), margin=ratio_of_means - 1.0 - 1e-9,
        note="error: of the sampling of 1 s", shown={"set every 500 us, over units in step": set_often, "free": free},
    )  # fmt: skip


# -- counts --------------------------------------------------------------------------------------------------------


def extent(count: int) -> Compute:
    """Return the width over the outer rims of transducers [mm]. The height is only shown."""

    def compute(setting: Setting) -> Answer:
        positions = array_of(Units(count)).positions
        width, height, _ = 1e3 * (np.ptp(positions, axis=0) + 10e-3)
        return Answer(float(width), error=0.0, note=f"layout {LAYOUTS[count]}", shown={"height [mm]": float(height)})

    return compute


def ratio_of(change: str | Units, count: int, depth_m: float) -> Compute:
    """Return the ratio with one change: other transducers, or another receiver."""

    def compute(setting: Setting) -> Answer:
        units = units_of(setting, count)
        if isinstance(change, Units):
            return Answer(ratio(change, depth_m, reference_m(setting, units)))
        return Answer(ratio(units, depth_m, reference_m(setting, units), change))

    return compute


def ratio_at_200(count: int, depth_m: float) -> Compute:
    """Return the largest pressure near the focus divided by that at 200 mm, as in a scan along the axis."""

    def compute(setting: Setting) -> Answer:
        units = units_of(setting, count)

        def largest(depth: float) -> float:
            along = np.linspace(0.5 * depth, 1.1 * depth, 241)
            points = np.column_stack([np.zeros((len(along), 2)), along])
            return float(np.abs(pressure_at(units, points, drive_of(units, depth))).max())

        return Answer(largest(depth_m) / largest(0.2))

    return compute


def causes(count: int, depth_m: float) -> tuple[Cause, ...]:
    return (
        Cause("the T4010A1's table in place of the piston", ratio_of(Units(count, "table"), count, depth_m)),
        Cause("a microphone that is a point", ratio_of("point", count, depth_m)),
        Cause("transducers that radiate equally in all directions", ratio_of(Units(count, "point"), count, depth_m)),
        Cause(
            "the largest pressure along the axis, which lies nearer, in place of that at the focus",
            ratio_at_200(count, depth_m),
        ),
    )


def force_by(units: Units, edge: float) -> Compute:
    def compute(setting: Setting) -> Answer:
        return Answer(force_by_default_law(units, JIG_M) / force_by_default_law(units, edge))

    return compute


RATIOS = {"H13-H14b": (1, 0.4), "H13-H14c": (4, 0.8), "H13-H14d": (4, 1.0)}
"""Units and depth [m] of each ratio of pressures."""
ANSWERS: dict[str, Compute] = {
    "H1a": lambda setting: Answer(float(len(array_of(Units(1)))), error=0.0),
    "H1c": extent(1),
    "H1e": extent(4),
    **{name: pressure_ratio(*at) for name, at in RATIOS.items()},
    "H13-H14e": over_200(4, 0.8, "piston"),
    "H13-H14f": over_200(4, 1.0, "piston"),
    "H13-H14g": over_200(4, 0.8, "table"),
    "H13-H14h": over_200(4, 1.0, "table"),
    "H13-H14i": halved_depth,
    "H13-H14j": lambda setting: Answer(0.5 * EIGHTH_INCH_M * wavenumber(), error=0.0),
    "H15c": force_ratio,
    "H15d": force_ratio_on(0.4),
    "H15e": force_ratio_on(0.2),
    "H15f": amplitude_of_forces("piston"),
    "H15g": amplitude_of_forces("table"),
    "H17a": largest_step,
    "H6d": synchronised,
    "H22a": reach,
    "H22b": lambda setting: Answer(20.0 * math.log10(0.4**2), error=0.0),
    "H22c": lambda setting: Answer(20.0 * math.log10(0.4**1.5), error=0.0, note="0.4 to the power 1.5 of the drive"),
}
CAUSES = {
    **{name: causes(*at) for name, at in RATIOS.items()},
    "H15c": (
        Cause("the law of a rigid wall on a plate of 0.4 m, instead of alpha p^2/(rho c^2)", force_by(Units(4), 0.4)),
        Cause("the table of the T4010A1 on a plate of 0.3 m", force_by(Units(4, "table"), 0.3)),
    ),
}
FOUND_LATER = {
    name: tuple(
        Cause(f"sound lost to harmonics {way}, {drive} drive, p0 of the layout", lossy_ratio(*at, level, far))
        for way, far in (("on the way to either depth", True), ("at the reference alone", False))
        for drive, level in (("full", 1.0), ("half", 0.5))
    )
    for name, at in RATIOS.items()
}
LATER = {
    "H13-H14b": (
        Cause(
            "pistons of 9 mm, twice as wide, which radiate less to the side", ratio_of(Units(1, "piston", 9e-3), 1, 0.4)
        ),
    ),
    "H17a": (Cause("delays rounded to a quarter of a period instead of a 640th", step_with_delays(4)),),
    "H22a": (Cause("the focus stays at 200 mm, so that sound at 1000 mm is spread wide", reach_without_focusing),),
}
