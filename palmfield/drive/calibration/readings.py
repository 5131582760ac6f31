"""Read measurements of a laboratory from CSV files, and add their results to the calibration (docs/calibration.md)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from palmfield.acoustics.arrays import LAYOUTS
from palmfield.acoustics.calibration_file import Calibration, calibrated
from palmfield.acoustics.focus import compensate, focus
from palmfield.drive.calibration.element_fit import fit_elements
from palmfield.drive.calibration.focus_scan import fit_pose
from palmfield.drive.calibration.frequency_sweep import fit_sweep
from palmfield.drive.calibration.level_ladder import fit_level, fit_warm_up
from palmfield.drive.calibration.plate_scale import fit_plate
from palmfield.errors import SceneError
from palmfield.tables import read_table
from palmfield.types import Air, Array, Complex, Estimate, Float

XYZ = ("x_m", "y_m", "z_m")
FOCUS_XYZ = ("focus_x_m", "focus_y_m", "focus_z_m")


@dataclass(frozen=True)
class Circumstances:
    """Data of a measurement other than its readings.

    source: person, date and equipment; microphone_error: 95 % limit of the relative error of the microphone calibration
    place_sd_m, temperature_sd_K: standard deviations of the places of the microphone, by axis, and of the temperature
    focus_m: commanded focus, array frame [m]; plate_m: sides of the plate [m]
    level: pressure of the array relative to full drive
    """

    source: str
    air: Air = field(default_factory=Air)
    microphone_error: float = 0.12
    place_sd_m: float = 1e-3
    temperature_sd_K: float = 1.0
    focus_m: tuple[float, float, float] | None = None
    plate_m: tuple[float, float] | None = None
    level: float = 1.0


@dataclass(frozen=True)
class Measured:
    """Result of readings. calibration: calibration with these results; report: the results, one per line"""

    calibration: Calibration
    report: tuple[str, ...]


@dataclass(frozen=True)
class Measurement:
    """A kind of measurement. about: procedure in the laboratory; columns, optional: required and optional columns of
    its CSV file; put: function that adds the results to a calibration"""

    about: str
    columns: tuple[str, ...]
    put: Callable[[Path, dict[str, Float], Calibration, Array, Circumstances], Measured]
    optional: tuple[str, ...] = ()

    @property
    def all_columns(self) -> tuple[str, ...]:
        return *self.columns, *self.optional


def put_elements(
    file: Path, columns: dict[str, Float], calibration: Calibration, array: Array, under: Circumstances
) -> Measured:
    """Evaluate readings of single transducers, see `fit_elements`."""
    element = _whole(file, columns, "element", len(array))
    _check_version(file, columns, array.name)
    at, place = np.unique(_places(columns), axis=0, return_inverse=True)
    readings = np.full((len(at), len(array)), np.nan, complex)
    readings[place, element] = _complex(columns)
    fit = fit_elements(
        array,
        under.air,
        at,
        readings,
        place_sd_m=under.place_sd_m,
        temperature_sd_K=under.temperature_sd_K,
    )
    elements = fit.elements
    phase_sd, gain_sd = elements.phase_sd_rad, elements.gain_sd
    assert phase_sd is not None and gain_sd is not None
    if calibration.elements is not None:
        names = ["position_m", "resonance_Hz", "quality"] + ["address"] * (elements.address is None)
        elements = elements.model_copy(update={name: getattr(calibration.elements, name) for name in names})
    spread = math.hypot(1.96 * fit.p0_sd_Pa_m / fit.p0_Pa_m, under.microphone_error)
    p0 = _estimate(fit.p0_Pa_m, spread, under.source)
    dead = np.flatnonzero(~np.array(elements.enabled)).tolist()
    notes: tuple[str, ...] = ()
    if fit.swapped:
        notes += (
            f"wires: transducers {_few(fit.swapped)} have exchanged signals; their addresses are stored, and the "
            "board is driven accordingly",
        )
    if fit.unfit:
        notes += (
            f"signals {_few(fit.unfit)} are loud but fit no position; they are switched off: check their readings "
            "and wires, and measure again",
        )
    turned = elements.polarity.count(-1)
    alive = np.array(elements.enabled)
    report = (
        f"transducers: {len(array) - len(dead)} of {len(array)} emit, {turned} with reversed polarity"
        + (f"; off: {_few(dead)}" if dead else ""),
        *notes,
        f"phases: {_degrees(np.std(np.array(elements.phase_rad)[alive]))} deg rms, standard error "
        f"{_degrees(np.median(np.array(phase_sd)[alive]))} deg each",
        f"gains: {100 * np.std(np.array(elements.gain)[alive]):.1f} % rms, standard error "
        f"{100 * np.median(np.array(gain_sd)[alive]):.1f} % each",
        f"p0 {p0.value:.3g} Pa m ({p0.low:.3g} to {p0.high:.3g})",
        f"microphone: {1e3 * float(np.sqrt((fit.moved_m**2).mean())):.2f} mm rms from the given positions; speed "
        f"of sound {fit.sound_speed_m_s:.1f} +- {1.96 * fit.sound_speed_sd_m_s:.1f} m/s; residual "
        f"{100 * fit.misfit:.1f} % (echoes, noise, directivity)",
    )
    return Measured(calibration.model_copy(update={"elements": elements, "p0": p0}), report)


def put_level(
    file: Path, columns: dict[str, Float], calibration: Calibration, array: Array, under: Circumstances
) -> Measured:
    """Evaluate rising levels, see `fit_level`. Forces are converted to their square roots."""
    has = [name for name in ("pressure_Pa", "force_N") if name in columns]
    if len(has) != 1:
        raise SceneError(f"{file}: columns are {', '.join(columns)}; give level and either pressure_Pa or force_N")
    readings = columns[has[0]]
    level = fit_level(columns["level"], np.sqrt(np.maximum(readings, 0.0)) if has[0] == "force_N" else readings)
    end = "to full drive" if level.linear_to == 1.0 else f"to level {level.linear_to:g}, and saturates above it"
    report = (
        f"pressure is proportional to the level to the power {level.exponent:.3f} +- "
        f"{1.96 * level.exponent_sd:.3f} {end}"
    )
    return Measured(calibration.model_copy(update={"level": level}), (report,))


def put_plate(
    file: Path, columns: dict[str, Float], calibration: Calibration, array: Array, under: Circumstances
) -> Measured:
    """Evaluate forces on a plate, see `fit_plate`."""
    if under.plate_m is None:
        raise SceneError(f"{file}: the side lengths of the plate are missing; give them (--plate 0.1 0.1, in metres)")
    real = calibrated(array, calibration)
    fit = fit_plate(
        real, under.air, _drive(real, under), under.plate_m, columns["distance_m"], columns["time_s"],
        columns["on"], columns["force_N"], under.level,
    )  # fmt: skip
    p0 = Estimate(fit.p0_Pa_m, fit.low_Pa_m, fit.high_Pa_m, "measured", under.source)
    report: tuple[str, ...] = (
        f"p0 {p0.value:.3g} Pa m ({p0.low:.3g} to {p0.high:.3g}; scatter of the readings "
        f"{100 * fit.p0_sd_Pa_m / fit.p0_Pa_m:.2g} %)",
        f"fringes: {100 * fit.fringe:.0f} % of the force, by sound between plate and array; drift of the scale: "
        f"{1e6 * fit.drift_N_s:.3g} uN/s",
    )
    if calibration.p0 is not None and not calibration.p0.low <= p0.value <= calibration.p0.high:
        before = calibration.p0
        report += (
            f"this value is outside the earlier measurement: {before.value:.3g} ({before.low:.3g} to "
            f"{before.high:.3g})",
        )
    return Measured(calibration.model_copy(update={"p0": p0}), report)


def put_focus(
    file: Path, columns: dict[str, Float], calibration: Calibration, array: Array, under: Circumstances
) -> Measured:
    """Evaluate pressures around foci, see `fit_pose`."""
    if any(name in columns for name in FOCUS_XYZ):
        commanded = np.column_stack([_column(file, columns, name) for name in FOCUS_XYZ])
    elif under.focus_m is None:
        raise SceneError(
            f"{file}: the focus is missing; give columns {', '.join(FOCUS_XYZ)}, or one focus (--focus X Y Z)"
        )
    else:
        commanded = np.tile(under.focus_m, (len(columns["x_m"]), 1))
    pose = fit_pose(
        calibrated(array, calibration.model_copy(update={"pose": type(calibration.pose)()})),
        under.air, commanded, _places(columns), columns["pressure_Pa"], under.temperature_sd_K,
    )  # fmt: skip
    offset = ", ".join(
        f"{1e3 * x:.2f} +- {1.96e3 * sd:.2f}" for x, sd in zip(pose.offset_m, pose.offset_sd_m, strict=True)
    )
    turn = ", ".join(
        f"{_degrees(x)} +- {_degrees(1.96 * sd)}" for x, sd in zip(pose.turn_rad, pose.turn_sd_rad, strict=True)
    )
    lines: tuple[str, ...] = (f"the board is displaced by {offset} mm along x, y, z",)
    lines += (f"and rotated by {turn} deg about these axes",) if any(pose.turn_sd_rad) else (
        "the rotation is not determined: scan three separate foci",
    )  # fmt: skip
    return Measured(calibration.model_copy(update={"pose": pose}), lines)


def put_sweep(
    file: Path, columns: dict[str, Float], calibration: Calibration, array: Array, under: Circumstances
) -> Measured:
    """Evaluate a sweep of the carrier, see `fit_sweep`."""
    at, place = np.unique(_places(columns), axis=0, return_inverse=True)
    f, which = np.unique(columns["frequency_Hz"], return_inverse=True)
    readings = np.full((len(at), len(f)), np.nan, complex)
    readings[place, which] = _complex(columns)
    if np.isnan(readings).any():
        m, q = np.argwhere(np.isnan(readings))[0]
        raise SceneError(
            f"{file}: no reading at {at[m].tolist()} m and {f[q]:g} Hz; give one for each position and frequency"
        )
    real = calibrated(array, calibration)
    fit = fit_sweep(real, under.air, _drive(real, under), at, f, readings)
    quality = _estimate(fit.quality, 1.96 * fit.quality_sd / fit.quality, under.source)
    resonance = _estimate(fit.resonance_Hz, 1.96 * fit.resonance_sd_Hz / fit.resonance_Hz, under.source)
    report = (
        f"resonance {resonance.value:.0f} Hz ({resonance.low:.0f} to {resonance.high:.0f}), Q {quality.value:.1f} "
        f"({quality.low:.1f} to {quality.high:.1f}), of all transducers together; residual {100 * fit.misfit:.1f} %",
    )
    return Measured(calibration.model_copy(update={"quality": quality, "resonance_Hz": resonance}), report)


def put_warm_up(
    file: Path, columns: dict[str, Float], calibration: Calibration, array: Array, under: Circumstances
) -> Measured:
    """Evaluate the level since the array was switched on, see `fit_warm_up`."""
    warm_up = fit_warm_up(columns["time_s"], columns["pressure_Pa"])
    within = warm_up.time_s * max(math.log(abs(warm_up.drop) / 0.01), 0.0)
    report = (
        f"the level starts {100 * warm_up.drop:+.1f} % (+- {196 * warm_up.drop_sd:.1f}) from its final value, and "
        f"is within 1 % after {within:.0f} s"
    )
    return Measured(calibration.model_copy(update={"warm_up": warm_up}), (report,))


MEASUREMENTS: dict[str, Measurement] = {
    "elements": Measurement(
        "one transducer at a time at full drive with phase 0, in front of a microphone at 3 or more positions "
        "(better 8)",
        ("element", *XYZ, "pressure_Pa", "phase_deg"), put_elements, ("layout_version",),
    ),
    "level": Measurement(
        "rising levels of the drive, in front of a microphone or a scale", ("level",), put_level,
        ("pressure_Pa", "force_N"),
    ),
    "plate": Measurement(
        "a plate on a scale, perpendicular to the axis, at 4 or more distances within half a wavelength, with the "
        "array on and off in turn",
        ("distance_m", "time_s", "on", "force_N"), put_plate,
    ),
    "focus": Measurement(
        "a microphone moved around one or more foci", (*XYZ, "pressure_Pa"), put_focus, FOCUS_XYZ
    ),
    "sweep": Measurement(
        "the carrier swept from 38 to 42 kHz, in front of a microphone at 8 or more positions",
        (*XYZ, "frequency_Hz", "pressure_Pa", "phase_deg"), put_sweep,
    ),
    "warm_up": Measurement(
        "the level from switching the array on until it is constant", ("time_s", "pressure_Pa"), put_warm_up
    ),
}  # fmt: skip
"""Kinds of measurements, in an order in which each uses the results of earlier ones."""


def measured(kind: str, path: str | Path, calibration: Calibration, array: Array, under: Circumstances) -> Measured:
    """Return the calibration with the results of a file of readings.

    kind: a key of MEASUREMENTS; array: array of the layout of the calibration
    Raises SceneError for a file that cannot be read or lacks columns, PalmfieldError for unusable readings.
    """
    file, measurement = Path(path), MEASUREMENTS[kind]
    columns, _ = read_table(file)
    for name in measurement.columns:
        _column(file, columns, name)
    unknown = [name for name in columns if name not in measurement.all_columns]
    if unknown:
        allowed = ", ".join(sorted(measurement.all_columns))
        raise SceneError(f"{file}: column '{unknown[0]}' is unknown; allowed: {allowed}")
    if not len(next(iter(columns.values()))):
        raise SceneError(f"{file}: no readings; give a line for each")
    return measurement.put(file, columns, calibration, array, under)


def _column(file: Path, columns: dict[str, Float], name: str) -> Float:
    if name not in columns:
        raise SceneError(f"{file}: column '{name}' is missing; columns are: {', '.join(columns)}")
    return columns[name]


def _places(columns: dict[str, Float]) -> Float:
    return np.column_stack([columns[name] for name in XYZ])


def _complex(columns: dict[str, Float]) -> Complex:
    return np.asarray(columns["pressure_Pa"] * np.exp(1j * np.radians(columns["phase_deg"])))


def _whole(file: Path, columns: dict[str, Float], name: str, count: int) -> np.ndarray:
    values = columns[name]
    bad = (values != np.rint(values)) | (values < 0) | (values >= count)
    if bad.any():
        raise SceneError(f"{file}: {name} {values[bad][0]:g} does not exist in the array; give 0 to {count - 1}")
    return values.astype(int)


def _check_version(file: Path, columns: dict[str, Float], name: str) -> None:
    """Raise SceneError if transducers may be numbered by another version of the layout."""
    now = LAYOUTS[name].version
    versions = columns.get("layout_version", np.array([1.0]))
    if (versions != now).any():
        old, earlier = versions[versions != now][0], LAYOUTS[name].earlier
        raise SceneError(
            f"{file}: the transducers are numbered as in version {old:g} of the layout (column layout_version, 1 "
            f"if absent); allowed: {now} for '{name}': measure again (`palmfield calibrate sound`)"
            + (f", or give --layout {earlier[-1]}" if earlier else "")
        )


def _few(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:16])) + (f" and {len(numbers) - 16} more" if len(numbers) > 16 else "")


def _drive(array: Array, under: Circumstances) -> Complex:
    if under.focus_m is None:
        raise SceneError("the commanded focus is missing; give it (--focus X Y Z, in metres)")
    return compensate(array, focus(array, under.air, under.focus_m))


def _estimate(value: float, relative: float, source: str) -> Estimate:
    return Estimate(value, value / (1.0 + relative), value * (1.0 + relative), "measured", source)


def _degrees(angle: float | np.floating) -> str:
    return f"{math.degrees(float(angle)):.2f}"
