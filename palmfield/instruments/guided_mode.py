"""Complex wavenumber of the wave from a small source, with its error, from a scan at one frequency.

Phasors are e^{-i w t}, wavenumbers k = w/c + i/L. All waves of a layer are fitted together as rings
(`palmfield.instruments.ring_fit`): the guided wave, evanescent waves near the source, and other travelling waves.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from palmfield.errors import MeasurementError
from palmfield.instruments.ring_fit import MOST_RINGS, REACH_M, Rings, Scanned, hidden_change, ring_fits
from palmfield.instruments.scan_grids import pitch
from palmfield.metrics.checks import above_zero, even_step, trace
from palmfield.types import Complex, Float

LEAST_WAVES = 2.0
LEAST_POINTS_A_WAVE = 3.0
SURE = 0.013
"""Largest error of a resolved wavenumber."""
TIED, NEXT = 10.0, 25.0
"""Largest score difference from the best fit of other fits, and of a fit with one more ring, that are considered. A
ring that fits only noise raises the score by 22 to 30."""
MOST_LOSS = 0.5
"""Largest Im k / Re k; beyond it a wave loses 96 % per wavelength, too much to distinguish waves."""
LASTING, LEAST_SHARE = 0.25, 0.05
"""Limits that show several similar waves: a ring has more than LEAST_SHARE of the motion, and its Im k is below LASTING
times that of the strongest ring. The fit cannot separate such waves; the losses of one material differ less."""
HIDES = 0.03
"""Largest worst-case change of a resolved wavenumber by a wave hidden in the noise, to first order."""
COUNTS = 0.2
"""Other waves with at least this share of the motion of the strongest wave are reported."""
ALIKE, LEAST_RESIDUAL = 0.35, 0.05
"""The residual is not noise above this correlation of neighbours and above this share of the motion."""
FEWEST = 24


@dataclass(frozen=True)
class Wave:
    """One wave of a scan.

    wavenumber_rad_m: k, Re k = w/c, Im k = 1/L, or None if it is not resolved; reason: why not, or ""
    estimate_rad_m: k of the best fit, also if it is not resolved
    error: standard deviation by noise, and change with another number of waves, relative to |k|
    motion: rms of this wave over that of the scan; waves: number of wavelengths in the width of the scan
    points_a_wave: number of points of the scan per wavelength
    """

    wavenumber_rad_m: complex | None
    reason: str
    estimate_rad_m: complex
    error: float
    motion: float
    waves: float
    points_a_wave: float


@dataclass(frozen=True)
class GuidedMode(Wave):
    """The travelling wave with most of the motion outside the source.

    others: other travelling waves with at least COUNTS of its motion, strongest first, each with its error; if one of
        them is nearly as strong, the guided mode is not unique
    misfit: share of the motion in the residual; rings: number of fitted waves; source_m: fitted source, (2,)
    """

    others: tuple[Wave, ...]
    misfit: float
    rings: int
    source_m: Float


def line_amplitudes(times_s: ArrayLike, values: ArrayLike, frequency_Hz: float, periods: int | None = None) -> Complex:
    """Return the complex amplitudes of records (t, n) at one frequency, e^{-i w t}, (n,), over the last whole periods.

    The fit is by least squares with a constant, a slope and the line. Raises MeasurementError without a whole period.
    """
    times, signal = trace(times_s, values, 8)
    above_zero("frequency_Hz", frequency_Hz)
    step = even_step(times)
    most = math.floor((times[-1] - times[0] + step) * frequency_Hz * (1.0 + 1e-9))
    count = most if periods is None else periods
    if not 1 <= count <= most or frequency_Hz * step >= 0.5:
        raise MeasurementError(
            f"{count} periods of {frequency_Hz:g} Hz are requested, but the record holds {most} and lines below "
            f"{0.5 / step:g} Hz"
        )
    chosen = times > times[-1] - count / frequency_Hz + 0.5 * step
    angle = 2.0 * np.pi * frequency_Hz * times[chosen]
    design = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(angle)), times[chosen] - times[-1]])
    cosine, sine = np.linalg.lstsq(design, signal[chosen], rcond=None)[0][:2]
    return np.asarray(cosine + 1j * sine)


def guided_mode_fit(
    amplitudes: ArrayLike, points_m: ArrayLike, source_m: ArrayLike, source_radius_m: float, *,
    sights: ArrayLike | None = None,
) -> GuidedMode:  # fmt: skip
    """Fit rings to complex amplitudes at points along a flat surface.

    amplitudes: shape (n,), e^{-i w t}; points_m: [m], shape (n, 2) or (n, 3), of which only x and y are used
    source_m: expected position of the source [m], (2,), which is fitted within `ring_fit.REACH_M`
    source_radius_m: points nearer to the source are not used [m]; the pressure of a spot is below 0.2 % of its peak
        beyond 1.5 times its full width at half maximum
    sights: lines of sight, shape (n, 3), z along the normal; None: only the normal motion is measured
    The number of rings has the smallest Bayesian information criterion.
    Raises MeasurementError for other shapes, fewer than FEWEST points outside the source, and silence.
    """
    values, flat, along = _checked(amplitudes, points_m, source_m, source_radius_m, sights)
    width = float(np.ptp(np.asarray(points_m, dtype=float)[:, :2], axis=0).max())
    spacing = pitch(np.asarray(points_m, dtype=float))
    scanned = Scanned(values, flat, along, math.pi / spacing)
    fits = ring_fits(scanned)
    best = min(range(len(fits)), key=lambda n: fits[n].score)
    fit = fits[best]
    worse = [one.score - fit.score for one in fits]
    close = [one for n, one in enumerate(fits) if n != best and worse[n] < (NEXT if n == best + 1 else TIED)]
    order = sorted(range(len(fit.k)), key=lambda n: (fit.k[n].real <= fit.k[n].imag, -fit.motion[n]))
    whole = _why_unresolved(fit, order[0], flat, best + 1 == len(fits))
    waves = [_wave(scanned, fit, n, close, width, spacing, whole) for n in order]
    strongest = waves[0]
    others = tuple(
        one for one in waves[1:]
        if one.estimate_rad_m.real > one.estimate_rad_m.imag and one.motion >= COUNTS * strongest.motion
    )  # fmt: skip
    source = np.asarray(source_m, dtype=float) + fit.source
    return GuidedMode(**vars(strongest), others=others, misfit=fit.misfit, rings=len(fit.k), source_m=source)


def _wave(
    scanned: Scanned, fit: Rings, number: int, close: list[Rings], width: float, spacing: float, whole: str
) -> Wave:
    """Convert one ring to a wave. whole: reason why no wave is resolved, or ""."""
    k = complex(fit.k[number])
    moved = max((float(np.abs(other.k - k).min()) / abs(k) for other in close), default=0.0)
    error = math.hypot(float(fit.deviation[number]), moved)
    waves, points = width * k.real / (2.0 * np.pi), 2.0 * np.pi / (max(k.real, 1e-9) * spacing)
    reason = whole
    if reason:
        pass
    elif k.real <= k.imag:
        reason = f"the wave does not propagate: Re k is {k.real:.3g}, Im k {k.imag:.3g} rad/m"
    elif waves < LEAST_WAVES:
        reason = f"the scan of {1e3 * width:.3g} mm holds {waves:.2g} wavelengths; needed: {LEAST_WAVES:g}"
    elif points < LEAST_POINTS_A_WAVE:
        reason = f"{points:.2g} points per wavelength; needed: {LEAST_POINTS_A_WAVE:g}"
    elif k.imag > MOST_LOSS * k.real:
        lost = 100 * (1.0 - math.exp(-2.0 * math.pi * k.imag / k.real))
        reason = f"the wave decays by {lost:.3g} % per wavelength, so it cannot be separated from other waves"
    elif error > SURE:
        beyond = len(fit.k) - 1
        neighbours = "" if beyond == 0 else f" next to {beyond} other wave{'s' if beyond > 1 else ''}"
        reason = (
            f"noise ({100 * fit.misfit:.2g} % of the motion) gives an uncertainty of +-{100 * error:.2g} "
            f"%{neighbours}; allowed: {100 * SURE:.2g} %"
        )
    if not reason:
        hidden = hidden_change(scanned, fit, number)
        if hidden > HIDES:
            reason = f"another wave below the noise could change it by {100 * hidden:.2g} %"
    return Wave(None if reason else k, reason, k, error, float(fit.motion[number]), waves, points)


def _why_unresolved(fit: Rings, lead: int, flat: Float, last: bool) -> str:
    """Return why a fit resolves no wave, or ""; lead: strongest travelling ring; last: if no fit has more rings."""
    if np.abs(fit.x[-2:]).max() > 0.98:
        return f"the fitted source is {1e3 * REACH_M:g} mm or more from source_m"
    nearest = cKDTree(flat).query(flat, k=2)[1][:, 1]
    power = float(np.linalg.norm(fit.residual) ** 2)
    alike = float((fit.residual.conj() * fit.residual[nearest]).sum().real) / max(power, 1e-300)
    if fit.misfit > LEAST_RESIDUAL and alike > ALIKE:
        return (
            f"{len(fit.k)} waves from one source leave {100 * fit.misfit:.2g} % of the motion, which is more than "
            "noise: there are other sources, or the surface is not uniform"
        )
    lasting = (fit.motion > LEAST_SHARE) & (fit.k.imag < LASTING * fit.k[lead].imag)
    if lasting.any():
        one = fit.k[int(lasting.argmax())]
        return (
            f"one of {len(fit.k)} fitted waves, {one.real:.3g} + {one.imag:.2g}i rad/m, decays much less than the "
            f"strongest, {fit.k[lead].imag:.2g}i: several similar waves replace one"
        )
    if last and len(fit.k) == MOST_RINGS:
        return f"the fit needs more than {MOST_RINGS - 1} waves"
    return ""


def _checked(
    amplitudes: ArrayLike, points_m: ArrayLike, source_m: ArrayLike, radius: float, sights: ArrayLike | None
) -> tuple[Complex, Float, Float | None]:
    """Return amplitudes over their rms, points relative to the source [m] and tangential parts of beams, outside it."""
    values, points = np.asarray(amplitudes, dtype=complex), np.asarray(points_m, dtype=float)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or values.shape != (len(points),):
        raise MeasurementError(
            f"amplitudes have shape {values.shape}, points {points.shape}; give (n,) and (n, 2 or 3)"
        )
    if not (np.isfinite(values).all() and np.isfinite(points).all()):
        raise MeasurementError("amplitudes and points must be finite")
    above_zero("source_radius_m", radius)
    if np.shape(source_m) != (2,):
        raise MeasurementError(f"source_m has shape {np.shape(source_m)}; give its x and y, (2,)")
    beams = None if sights is None else np.asarray(sights, dtype=float)
    if beams is not None and (beams.shape != (len(points), 3) or np.abs(beams[:, 2]).min() < 1e-3):
        raise MeasurementError(f"sights have shape {beams.shape}; give ({len(points)}, 3), none along the surface")
    flat = points[:, :2] - np.asarray(source_m, dtype=float)
    outside = np.linalg.norm(flat, axis=1) > radius
    if outside.sum() < FEWEST:
        raise MeasurementError(
            f"{outside.sum()} points lie outside the radius of {radius:g} m around the source; needed: {FEWEST}"
        )
    size = float(np.sqrt(np.mean(np.abs(values[outside]) ** 2)))
    if size == 0.0:
        raise MeasurementError("the scan is silent at this frequency")
    oblique = beams is not None and np.abs(beams[:, :2] / beams[:, 2:]).max() > 1e-3
    along = beams[outside, :2] / beams[outside, 2:] if beams is not None and oblique else None
    return values[outside] / size, flat[outside], along
