"""The complex wavenumber of the wave that leads away from a small source, fitted to a scan at one frequency.

Phasors go with e^{-i w t}, wavenumbers k = w/c + i/L. Outside the source each wave of a layer is a ring: H0(k r) in the
motion along the normal, H1(k r) in the motion along the surface, away from the source. A beam that is not normal sees
both. Waves with complex wavenumbers beside the guided one, which die near the source, are fitted with it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.special import hankel1

from palmfield.errors import MeasurementError
from palmfield.instruments.scan_grids import pitch
from palmfield.metrics.checks import above_zero, even_step, trace
from palmfield.types import Complex, Float

LEAST_WAVES = 2.0
LEAST_POINTS_A_WAVE = 3.0
MOST_RINGS = 3
"""Waves that are fitted at most."""
AGREE = 0.03
"""The wavenumber counts as resolved where a fit with one wave more, or fewer, changes it by less than this share, and
its standard deviation is below half of it."""
LEADS = 0.5
"""And where no other wave that travels carries more than this share of the motion that the guided one does."""
REACH_M = 4e-3
"""The source is sought within this of where it is said to be, each way."""
STARTS = 4
FEWEST = 24


class GuidedMode(NamedTuple):
    """The wave that carries most of the motion outside the source.

    wavenumber_rad_m: k, Re k = w/c, Im k = 1/L, or None where it is not resolved; reason: why it is not, else empty
    estimate_rad_m: the best fit's, whether resolved or not; deviation: its standard deviation, relative to |k|
    waves: wavelengths in the scan's width; points_a_wave: of the scan's pitch
    misfit: share of the motion that the fit leaves; rings: how many waves were fitted; source_m: where from, (2,)
    """

    wavenumber_rad_m: complex | None
    reason: str
    estimate_rad_m: complex
    deviation: float
    waves: float
    points_a_wave: float
    misfit: float
    rings: int
    source_m: Float


class _Fit(NamedTuple):
    k: Complex
    energies: Float
    deviation: Float
    misfit: float
    score: float
    x: Float

    def lead(self) -> int:
        """The travelling wave with the most motion; where none travels, the one with the most."""
        travels = self.k.real > self.k.imag
        return int(np.where(travels, self.energies, self.energies * 1e-9).argmax())

    def rival(self) -> float:
        """Motion of the next travelling wave over the leading one's."""
        others = np.delete(self.energies * (self.k.real > self.k.imag), self.lead())
        return float(others.max(initial=0.0) / self.energies[self.lead()])


def line_amplitudes(times_s: ArrayLike, values: ArrayLike, frequency_Hz: float, periods: int | None = None) -> Complex:
    """Complex amplitudes of records (t, n) at one frequency, e^{-i w t}, shape (n,), over their last whole periods.

    Least squares with a constant and a slope beside the line. Raises MeasurementError for a record without a period.
    """
    times, signal = trace(times_s, values, 8)
    above_zero("frequency_Hz", frequency_Hz)
    step = even_step(times)
    most = math.floor((times[-1] - times[0] + step) * frequency_Hz * (1.0 + 1e-9))
    count = most if periods is None else periods
    if not 1 <= count <= most or frequency_Hz * step >= 0.5:
        raise MeasurementError(
            f"{count} periods of {frequency_Hz:g} Hz are asked of a record that holds {most} and lines below "
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

    amplitudes: shape (n,), e^{-i w t}; points_m: [m], shape (n, 2) or (n, 3), of which x and y count
    source_m: where the source is thought to be [m], (2,); it is fitted within REACH_M
    source_radius_m: points nearer than this are left out; 1.5 times the spot's full width at half maximum leaves 0.2 %
        of its pressure outside
    sights: lines of sight, shape (n, 3), z along the normal; None: only the normal motion is seen
    The number of rings, up to MOST_RINGS, is the one with the least Bayesian information criterion.
    Raises MeasurementError for other shapes, fewer than FEWEST points outside the source, and silence.
    """
    values, flat, along = _checked(amplitudes, points_m, source_m, source_radius_m, sights)
    width = float(np.ptp(np.asarray(points_m, dtype=float)[:, :2], axis=0).max())
    spacing = pitch(np.asarray(points_m, dtype=float))
    ends = (0.5 * 2.0 * np.pi / width, np.pi / spacing)
    fits: list[_Fit] = []
    for rings in range(1, MOST_RINGS + 1):
        if len(values) > 4 * rings + 8:
            fits.append(_fitted(values, flat, along, ends, rings, fits[-1].x if fits else None, source_radius_m))
    best = min(range(len(fits)), key=lambda n: fits[n].score)
    fit = fits[best]
    lead = fit.lead()
    k = complex(fit.k[lead])
    waves, points = width * k.real / (2.0 * np.pi), 2.0 * np.pi / (max(k.real, 1e-9) * spacing)
    neighbour = fits[best + 1] if best + 1 < len(fits) else fits[best - 1] if best > 0 else fit
    moved = float(np.abs(neighbour.k - k).min() / abs(k))
    deviation = float(fit.deviation[lead])
    reason = ""
    if k.real <= k.imag:
        reason = f"no wave travels: Re k is {k.real:.3g}, Im k {k.imag:.3g} rad/m"
    elif waves < LEAST_WAVES:
        reason = f"{waves:.2g} waves fit the scan's {1e3 * width:.3g} mm, {LEAST_WAVES:g} are needed"
    elif points < LEAST_POINTS_A_WAVE:
        reason = f"{points:.2g} points stand for a wave, {LEAST_POINTS_A_WAVE:g} are needed"
    elif fit.rival() > LEADS:
        reason = f"another wave carries {fit.rival():.2g} of the motion that the strongest does"
    elif moved > AGREE:
        reason = f"fits with other numbers of waves differ by {100 * moved:.2g} %"
    elif deviation > 0.5 * AGREE:
        reason = f"noise leaves {100 * deviation:.2g} %"
    source = np.asarray(source_m, dtype=float) + fit.x[-2:] * REACH_M
    return GuidedMode(
        None if reason else k, reason, k, deviation, waves, points, fit.misfit, len(fit.k), source
    )  # fmt: skip


def _checked(
    amplitudes: ArrayLike, points_m: ArrayLike, source_m: ArrayLike, radius: float, sights: ArrayLike | None
) -> tuple[Complex, Float, Float | None]:
    """Amplitudes over their rms, places about the source [m] and the beams' parts along the surface, outside of it."""
    values, points = np.asarray(amplitudes, dtype=complex), np.asarray(points_m, dtype=float)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or values.shape != (len(points),):
        raise MeasurementError(
            f"amplitudes have shape {values.shape}, points {points.shape}; give (n,) and (n, 2 or 3)"
        )
    if not (np.isfinite(values).all() and np.isfinite(points).all()):
        raise MeasurementError("amplitudes and points must be finite")
    above_zero("source_radius_m", radius)
    beams = None if sights is None else np.asarray(sights, dtype=float)
    if beams is not None and (beams.shape != (len(points), 3) or np.abs(beams[:, 2]).min() < 1e-3):
        raise MeasurementError(f"sights have shape {beams.shape}; give ({len(points)}, 3), none along the surface")
    flat = points[:, :2] - np.asarray(source_m, dtype=float)
    outside = np.linalg.norm(flat, axis=1) > radius
    if outside.sum() < FEWEST:
        raise MeasurementError(f"{outside.sum()} points lie outside the source's {radius:g} m; {FEWEST} are needed")
    size = float(np.sqrt(np.mean(np.abs(values[outside]) ** 2)))
    if size == 0.0:
        raise MeasurementError("the scan is silent at this frequency")
    oblique = beams is not None and np.abs(beams[:, :2] / beams[:, 2:]).max() > 1e-3
    along = beams[outside, :2] / beams[outside, 2:] if beams is not None and oblique else None
    return values[outside] / size, flat[outside], along


def _columns(k: Complex, flat: Float, along: Float | None, source: Float, near: float) -> Complex:
    """What rings of unit size at `near` look like at the points, two columns a ring where the beam is oblique."""
    ways = flat - source
    r = np.linalg.norm(ways, axis=1)
    parts = []
    for one in k:
        parts.append(hankel1(0, one * r) / abs(hankel1(0, one * near)))
        if along is not None:
            towards = np.einsum("ni,ni->n", along, ways) / r
            parts.append(hankel1(1, one * r) * towards / abs(hankel1(1, one * near)))
    return np.stack(parts, axis=1)


def _unpacked(x: Float, rings: int, ends: tuple[float, float]) -> tuple[Complex, Float]:
    return np.asarray((x[:rings] + 1j * x[rings : 2 * rings]) * ends[1], complex), x[2 * rings :] * REACH_M


def _fitted(
    values: Complex, flat: Float, along: Float | None, ends: tuple[float, float], rings: int, fewer: Float | None,
    near: float,
) -> _Fit:  # fmt: skip
    """Variable projection: amplitudes of rings by linear least squares, wavenumbers and source by descent."""

    def solved(x: Float) -> tuple[Complex, Complex, Complex]:
        k, source = _unpacked(x, rings, ends)
        columns = _columns(k, flat, along, source, near)
        parts = np.asarray(np.linalg.lstsq(columns, values, rcond=1e-10)[0], complex)
        return columns, parts, columns @ parts - values

    def rest(x: Float) -> Float:
        left = solved(x)[2]
        return np.concatenate([left.real, left.imag])

    low = np.concatenate([np.full(rings, -1.0), np.full(rings, 2e-3), [-1.0, -1.0]])
    high = np.concatenate([np.full(rings, 1.0), np.full(rings, 1.0), [1.0, 1.0]])
    begins: list[tuple[float, int, Float]] = []
    for real in (*np.geomspace(ends[0] / ends[1], 0.95, 14), -0.15):
        for loss in (0.1, 0.35) if real > 0.0 else (0.7,):
            imaginary = abs(real) * loss
            if fewer is None:
                x = np.array([real, imaginary, 0.0, 0.0])
            else:
                m = rings - 1
                x = np.concatenate([fewer[:m], [real], fewer[m : 2 * m], [imaginary], fewer[2 * m :]])
            x = np.clip(x, low + 1e-6, high - 1e-6)
            begins.append((float(np.linalg.norm(rest(x))), len(begins), x))
    runs = [
        least_squares(rest, x, bounds=(low, high), xtol=1e-9, ftol=1e-9, max_nfev=80)
        for *_, x in sorted(begins)[:STARTS]
    ]
    found = min(runs, key=lambda run: run.cost)
    k, _ = _unpacked(found.x, rings, ends)
    columns, parts, left = solved(found.x)
    each = columns.shape[1] // rings
    energies = [
        np.linalg.norm(columns[:, each * n : each * (n + 1)] @ parts[each * n : each * (n + 1)]) for n in range(rings)
    ]
    count, free = 2 * len(values), 2 * rings + 2 + 2 * columns.shape[1]
    power = float(np.linalg.norm(left) ** 2)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * power / max(count - free, 1)
    spread = np.sqrt(np.diag(covariance))
    deviation = np.hypot(spread[:rings], spread[rings : 2 * rings]) * ends[1] / np.abs(k)
    score = count * math.log(max(power, 1e-30) / count) + free * math.log(count)
    return _Fit(k, np.array(energies), deviation, math.sqrt(power / len(values)), score, found.x)
