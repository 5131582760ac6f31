"""Compare the guided mode of a measured and of a computed scan."""

from typing import Any

import numpy as np

from palmfield.errors import MeasurementError
from palmfield.instruments.guided_mode import GuidedMode, Wave, guided_mode_fit, line_amplitudes
from palmfield.instruments.scan import Scan
from palmfield.types import Float

FLAT = 0.02
"""Largest distance of the points of a scan from a plane, as a share of its width."""


def guided_modes(
    measured: Scan, computed: Scan, frequency_Hz: float, source_m: Float | None, radius_m: float
) -> tuple[GuidedMode, GuidedMode]:
    """Fit the mode at one frequency to both scans, at the same points of the skin, along the computed beams.

    source_m: point on the skin [m], (3,); None: place of largest computed motion; radius_m: excluded radius about it
    Raises MeasurementError for skin that is not flat, and as `line_amplitudes` and `guided_mode_fit`.
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
    """Report speed and 1/e length, or why there are none, with other waves that have a large share of the motion."""
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
