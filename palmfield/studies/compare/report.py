"""Results of a comparison, with the guided modes: in words, as JSON, as a table of points."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmfield.errors import MeasurementError
from palmfield.files import write_text
from palmfield.instruments.agreement import Agreement
from palmfield.instruments.guided_mode import GuidedMode, Wave, guided_mode_fit, line_amplitudes
from palmfield.instruments.registration import Registration
from palmfield.instruments.scan import Scan
from palmfield.tables import write_table
from palmfield.types import Float

QUIET = 0.1
"""Fraction of the loudest measured rms. Points with a smaller rms are excluded from medians."""
FLAT = 0.02
"""Largest distance of the points of a scan from a plane, relative to the width of the scan."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of a measured scan with the skin of a run.

    measured, skin: their names; quantity: measured quantity; place: position of the scan on the skin
    near: which points are close enough to compare, shape (points,), bool
    computed: scan that palmfield computes at the near points
    numbers: numbers of the near points
    bare: whether no instrument was specified
    cut_s: part of the scan after the end of the run [s]
    most_delay_s: range in which the delay is searched [s]
    doubts: likely faults, in sentences
    modes: fits of the guided mode at mode_Hz, measured and computed, if requested
    """

    measured: str
    skin: str
    quantity: str
    place: Registration
    near: np.ndarray
    computed: Scan
    numbers: Agreement
    bare: bool
    cut_s: float
    most_delay_s: float
    doubts: tuple[str, ...] = ()
    mode_Hz: float | None = None
    modes: tuple[GuidedMode, GuidedMode] | None = None

    @property
    def loud(self) -> np.ndarray:
        """Return which compared points move enough to count in medians, shape (compared points,)."""
        return np.asarray(self.numbers.level >= QUIET)

    def median(self, name: str) -> tuple[float, float, float]:
        """Return median and quartiles of one of the numbers over the points that move enough."""
        low, middle, high = np.quantile(getattr(self.numbers, name)[self.loud], [0.25, 0.5, 0.75])
        return float(middle), float(low), float(high)

    def as_dict(self) -> dict[str, Any]:
        turn = Rotation.from_matrix(self.place.transform.rotation)
        return {
            "measured": self.measured,
            "skin": self.skin,
            "quantity": self.quantity,
            "points": len(self.near),
            "points_compared": int(self.near.sum()),
            "points_in_medians": int(self.loud.sum()),
            "position_m": self.place.transform.position.tolist(),
            "rotation_vector_deg": np.degrees(turn.as_rotvec()).tolist(),
            "residual_rms_m": self.place.rms_m,
            "residual_largest_m": float(self.place.residual_m.max()),
            "fiducials_m": self.place.fiducials_m.tolist(),
            "undetermined_directions": self.place.undetermined,
            "undetermined_turns": self.place.turns,
            "cut_off_s": self.cut_s,
            "instrument_told": not self.bare,
            **{
                name: dict(zip(("median", "low_quartile", "high_quartile"), self.median(name), strict=True))
                for name in ("gain", "delay_s", "l2", "l2_shape", "coherence")
            },
            **self._modes(),
            "doubts": list(self.doubts),
            "ambiguous_delays": int(self.numbers.ambiguous[self.loud].sum()),
        }

    def _modes(self) -> dict[str, Any]:
        if self.modes is None:
            return {}
        measured, computed = (as_dict(mode) for mode in self.modes)
        return {"guided_mode": {"frequency_Hz": self.mode_Hz, "measured": measured, "computed": computed}}

    def __str__(self) -> str:
        place, numbers = self.place, self.as_dict()
        excluded = len(self.near) - int(self.near.sum())
        rms, most = 1e3 * place.rms_m, 1e3 * place.residual_m.max()
        lines = [
            f"scan            {self.measured}: {self.quantity} at {len(self.near)} points"
            + (f", {excluded} of them excluded" if excluded else ""),
            f"registration    {rms:.2f} mm rms from skin '{self.skin}', {most:.2f} "
            f"at most; moved by {1e3 * np.linalg.norm(place.transform.position):.2f} mm and "
            f"{np.linalg.norm(numbers['rotation_vector_deg']):.2f} deg",
        ]
        if len(place.fiducials_m):
            lines.append(f"                fiducials {1e3 * np.sqrt(np.mean(place.fiducials_m**2)):.2f} mm rms apart")
        elif place.undetermined:
            shifts = place.undetermined - place.turns
            lines.append(
                f"                {place.undetermined} of 6 directions are not determined by the shape of the skin "
                f"and keep the values of the file ({shifts} {'shift' if shifts == 1 else 'shifts'}, {place.turns} "
                f"{'turn' if place.turns == 1 else 'turns'})"
            )
            lines.append("                an error in these is not visible in the residual, but affects all "
                         "numbers below: give --fiducials, three pairs or more")  # fmt: skip
        for name, unit, factor in (("gain", "", 1.0), ("delay_s", " ms", 1e3), ("l2", "", 1.0), ("l2_shape", "", 1.0),
                                   ("coherence", "", 1.0)):  # fmt: skip
            middle, low, high = (factor * value for value in self.median(name))
            lines.append(f"{LABELS[name]:16}{middle:.3f}{unit}, half of the points {low:.3f} to {high:.3f}")
        count = numbers["ambiguous_delays"]
        if count:
            lines.append(
                f"                {count} points fit nearly as well with another delay, because the motion is periodic"
            )
        lines.append(f"                medians of the {numbers['points_in_medians']} points that move more than "
                     f"{QUIET:g} of the loudest")  # fmt: skip
        if self.modes is not None and self.mode_Hz is not None:
            for name, mode in zip(("measured", "computed"), self.modes, strict=True):
                lines.append(f"{f'{self.mode_Hz:g} Hz wave':16}{name} {in_words(mode, self.mode_Hz)}")
        lines += [f"{'doubt':16}{text}" for text in self.doubts]
        if self.bare:
            lines.append("instrument      not given: computed motion along the mean normal of the skin, or along "
                         "the lines of sight of the scan, without filters")  # fmt: skip
        if self.cut_s > 0.0:
            lines.append(f"cut off         the last {self.cut_s:.4g} s of the scan, which the run does not cover")
        return "\n".join(lines)


LABELS = {"gain": "gain", "delay_s": "delay", "l2": "difference", "l2_shape": "of the shape", "coherence": "coherence"}


COLUMNS = ("point", "x_m", "y_m", "z_m", "skin_x_m", "skin_y_m", "skin_z_m", "residual_m", *Agreement._fields)


def write_report(done: Comparison, folder: Path) -> None:
    """Write compare.json and points.csv, a line for each compared point. Raises OutputError if that fails."""
    write_text(folder / "compare.json", json.dumps(done.as_dict(), indent=1) + "\n")
    number = np.flatnonzero(done.near)
    on_skin = done.computed.points
    measured: Float = done.place.transform.inverse_points(on_skin)
    columns = [number, measured, on_skin, done.place.residual_m[done.near], *done.numbers]
    write_table(folder / "points.csv", COLUMNS, np.column_stack([np.asarray(part, dtype=float) for part in columns]))


def guided_modes(
    measured: Scan, computed: Scan, frequency_Hz: float, source_m: Float | None, radius_m: float
) -> tuple[GuidedMode, GuidedMode]:
    """Fit the guided mode at one frequency to both scans, at the same points of the skin, along the computed beams.

    source_m: source on the skin [m], (3,); None: point of largest computed motion
    radius_m: radius about the source that is excluded
    Raises MeasurementError for skin that is not flat, and like `line_amplitudes` and `guided_mode_fit`.
    """
    assert computed.sights is not None
    points = computed.points
    centre = points.mean(axis=0)
    axes = np.linalg.svd(points - centre, full_matrices=False)[2]
    normal = axes[2] * np.sign((computed.sights @ axes[2]).sum())
    basis = np.stack([axes[0], np.cross(normal, axes[0]), normal])
    placed = (points - centre) @ basis.T
    width = float(np.ptp(placed[:, :2], axis=0).max())
    if np.abs(placed[:, 2]).max() > FLAT * width:
        raise MeasurementError(
            f"the skin deviates from a plane by {1e3 * np.abs(placed[:, 2]).max():.3g} mm over {1e3 * width:.3g} "
            "mm; a guided mode can only be fitted on flat skin"
        )
    amplitudes = [line_amplitudes(scan.times_s, scan.values, frequency_Hz) for scan in (measured, computed)]
    source = points[np.abs(amplitudes[1]).argmax()] if source_m is None else np.asarray(source_m, dtype=float)
    at = ((source - centre) @ basis.T)[:2]
    sights = computed.sights @ basis.T
    first, second = (guided_mode_fit(one, placed, at, radius_m, sights=sights) for one in amplitudes)
    return first, second


def in_words(mode: GuidedMode, frequency_Hz: float) -> str:
    """Report phase speed and 1/e length, or why there are none.

    Other waves with a large share of the motion are named.
    """
    words = [_wave_in_words(mode, frequency_Hz)]
    for other in mode.others:
        share = other.motion / mode.motion
        words.append(f"other waves {share:.2g} of its motion: {_wave_in_words(other, frequency_Hz)}")
    return "; ".join(words)


def _wave_in_words(wave: Wave, frequency_Hz: float) -> str:
    if wave.wavenumber_rad_m is None:
        return f"not resolved: {wave.reason}"
    k = wave.wavenumber_rad_m
    return (
        f"{2.0 * np.pi * frequency_Hz / k.real:.3g} m/s, 1/e length {1e3 / k.imag:.3g} mm (k {k.real:.4g} + "
        f"{k.imag:.3g}i rad/m, +-{100 * wave.error:.2g} %)"
    )


def as_dict(mode: GuidedMode) -> dict[str, Any]:
    others = [_wave_as_dict(other) for other in mode.others]
    return {**_wave_as_dict(mode), "misfit": mode.misfit, "waves_fitted": mode.rings, "other_waves": others}


def _wave_as_dict(wave: Wave) -> dict[str, Any]:
    k = wave.wavenumber_rad_m
    return {
        "resolved": k is not None, "reason": wave.reason, "wavenumber_real_rad_m": None if k is None else k.real,
        "wavenumber_imaginary_rad_m": None if k is None else k.imag, "error_relative": wave.error,
        "motion_relative": wave.motion, "waves_in_width": wave.waves, "points_a_wave": wave.points_a_wave,
    }  # fmt: skip
