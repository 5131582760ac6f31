"""Complex wavenumber of the wave from a small source, with its error, from a scan at one frequency.

Phasors are e^{-i w t}, wavenumbers k = w/c + i/L. All waves of a layer are fitted together as rings: the guided wave,
evanescent waves near the source, and other travelling waves. Outside the source each wave of a layer is a ring: H0(k r)
in the normal motion, H1(k r) in the radial motion along the surface. An oblique beam measures both.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.special import hankel1

from palmfield.errors import MeasurementError
from palmfield.instruments.scan import pitch
from palmfield.metrics.checks import above_zero, even_step, trace
from palmfield.types import Complex, Float

MOST_RINGS = 6
"""Largest number of fitted waves."""
REACH_M = 4e-3
"""Largest distance of the fitted source from its nominal position along each axis."""
STARTS, SPLITS = 3, 2
WIDEST = 1.5
"""Largest real and imaginary part of fitted wavenumbers, as shares of pi over the pitch of the points."""
LEAST_LOSS = 2e-3
FLOOR = 2e-3
"""Smallest assumed noise, as a share of the rms of the motion, so that simulated scans are not treated as exact."""
APART = 0.25
"""Spacing of the start points of a further ring, as a share of the wavenumber."""
HIDDEN_SPAN, HIDDEN_APART = (0.35, 2.2), 0.2
NEAREST_M = 1e-4
"""Smallest distance from the source, where rings are infinite."""
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


class Scanned(NamedTuple):
    """Data of a fit.

    values: amplitudes over their rms, shape (n,); flat: points relative to the nominal source [m], shape (n, 2)
    along: tangential over normal components of the beams, shape (n, 2), or None for normal beams
    top: pi over the pitch [rad/m], the unit of wavenumbers within the fit
    """

    values: Complex
    flat: Float
    along: Float | None
    top: float


class Rings(NamedTuple):
    """Result of a fit.

    k: wavenumbers [rad/m], shape (rings,); motion: rms of each ring at the points over that of the scan, shape (rings,)
    deviation: standard deviation of each wavenumber by noise, relative to |k|, shape (rings,)
    misfit: rms of the residual over that of the scan; residual: shape (n,)
    score: Bayesian information criterion, smaller is better; source: position [m], shape (2,); x: vector of unknowns
    """

    k: Complex
    motion: Float
    deviation: Float
    misfit: float
    residual: Complex
    score: float
    source: Float
    x: Float


class _Field(NamedTuple):
    """Rings at the points. columns: rings of unit amplitude, shape (n, rings, 1 or 2), the second of tangential motion

    h0, h1: Hankel functions at k r, shape (n, rings); ways, r: vectors and distances from the source; towards: along .
    ways / r
    """

    columns: Complex
    h0: Complex
    h1: Complex
    kr: Complex
    ways: Float
    r: Float
    towards: Float | None


def ring_fits(scanned: Scanned) -> list[Rings]:
    """Return fits of 1, 2, ... rings, until two further rings do not lower the score, or up to MOST_RINGS.

    Each fit starts from the rings of the previous fit. Either a further ring is added, at the STARTS wavenumbers of
    smallest residual, or one ring is split in two. (A single ring fits between two similar waves.)
    """
    fits: list[Rings] = []
    x = np.zeros(2)
    for rings in range(1, MOST_RINGS + 1):
        if len(scanned.values) <= 4 * rings + 8:
            break
        if rings > 3 and min(one.score for one in fits[:-2]) < min(one.score for one in fits[-2:]):
            break
        begins = [_with(x, [one]) for one in _beginnings(scanned, x)] + _split(scanned, x)
        runs = [_descend(scanned, begin) for begin in begins]
        x = min(runs, key=lambda run: run[0])[1]
        fits.append(_result(scanned, x))
    return fits


def hidden_change(scanned: Scanned, fit: Rings, number: int) -> float:
    """Return the largest change of the wavenumber of a ring by a wave hidden in the noise, relative to |k|.

    A further ring of normal motion, with the losses of the ring, is added at wavenumbers around it. They are at least
    HIDDEN_APART from all rings of the fit. To first order this shifts the wavenumber and changes its standard
    deviation. The result is the largest root of the sum of squares of both.
    """
    k, source = _unpacked(scanned, fit.x)
    field = _field(scanned, k, source)
    basis, parts, residual = _projected(field, scanned.values)
    by_x = -_residual(scanned, fit.x)[1]
    free = 2 * len(residual) - len(fit.x) - 2 * parts.size
    power = max(float(np.linalg.norm(residual) ** 2), FLOOR**2 * len(residual)) / max(free, 1)
    own, worst, unit = complex(k[number]), 0.0, scanned.top / abs(complex(k[number]))
    for real in np.geomspace(*HIDDEN_SPAN, 14) * own.real:
        for loss in (0.7, 1.3):
            hidden = complex(real, own.imag * loss)
            if np.any(np.abs(hidden - k) < HIDDEN_APART * np.abs(k)) or real > WIDEST * scanned.top:
                continue
            column = _field(scanned, np.array([hidden]), source).columns[:, 0, :1]
            column = column - basis @ (basis.conj().T @ column)
            slopes = _real(np.concatenate([by_x, column, 1j * column], axis=1))
            sizes = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
            covariance = np.linalg.pinv((slopes / sizes).T @ (slopes / sizes), rcond=1e-12, hermitian=True)
            shift = covariance @ ((slopes / sizes).T @ _real(residual)) / sizes
            spread = np.sqrt(np.maximum(np.diag(covariance), 0.0) * power) / sizes
            both = [number, len(k) + number]
            worst = max(worst, unit * float(np.sqrt((shift[both] ** 2 + spread[both] ** 2).sum())))
    return worst


def _with(x: Float, more: list[complex], but: int | None = None) -> Float:
    """Return the unknowns of a fit with more rings, and without ring `but`."""
    real, imaginary, source = np.split(x, [(len(x) - 2) // 2, len(x) - 2])
    if but is not None:
        real, imaginary = np.delete(real, but), np.delete(imaginary, but)
    added = np.array(more)
    return np.concatenate([real, added.real, imaginary, added.imag, source])


def _split(scanned: Scanned, x: Float) -> list[Float]:
    """Split each ring into two at smaller and larger wavenumbers; return the SPLITS fits of smallest residual."""
    begins = []
    for number in range((len(x) - 2) // 2):
        k = complex(x[number], x[(len(x) - 2) // 2 + number])
        begins.append(_with(x, [k * (1.0 - APART / 2.0), k * (1.0 + APART / 2.0)], number))
    norms = [float(np.linalg.norm(_residual(scanned, begin)[0])) for begin in begins]
    return [begins[number] for number in np.argsort(norms)[:SPLITS]]


def _unpacked(scanned: Scanned, x: Float) -> tuple[Complex, Float]:
    rings = (len(x) - 2) // 2
    return np.asarray((x[:rings] + 1j * x[rings:-2]) * scanned.top, complex), x[-2:] * REACH_M


def _field(scanned: Scanned, k: Complex, source: Float) -> _Field:
    ways = scanned.flat - source
    r = np.maximum(np.linalg.norm(ways, axis=1), NEAREST_M)
    kr = np.outer(r, k)
    # Rings have size 1 at the mean distance of the scan, so that all columns have similar sizes
    size = np.abs(hankel1(0, k * float(np.median(r))))
    h0, h1 = hankel1(0, kr) / size, hankel1(1, kr) / size
    if scanned.along is None:
        return _Field(h0[:, :, None], h0, h1, kr, ways, r, None)
    towards = np.einsum("ni,ni->n", scanned.along, ways) / r
    return _Field(np.stack([h0, h1 * towards[:, None]], axis=2), h0, h1, kr, ways, r, towards)


def _projected(field: _Field, values: Complex) -> tuple[Complex, Complex, Complex]:
    """Return an orthonormal basis of the columns of the rings, their least-squares amplitudes, and the residual."""
    flat = field.columns.reshape(len(values), -1)
    basis, sizes, right = np.linalg.svd(flat, full_matrices=False)
    kept = sizes > 1e-9 * sizes[0]
    basis = basis[:, kept]
    inside = basis.conj().T @ values
    parts = right[kept].conj().T @ (inside / sizes[kept])
    return basis, parts.reshape(field.columns.shape[1:]), values - basis @ inside


def _residual(scanned: Scanned, x: Float) -> tuple[Complex, Complex]:
    """Return the residual of the best amplitudes, shape (n,), and its derivatives, shape (n, len(x)).

    Variable projection (Golub & Pereyra 1973) with Kaufman's derivative; amplitudes are not unknowns.
    """
    k, source = _unpacked(scanned, x)
    field = _field(scanned, k, source)
    basis, parts, residual = _projected(field, scanned.values)
    by_k, by_r = -field.h1 * field.r[:, None] * parts[:, 0], -field.h1 * k * parts[:, 0]
    slope = field.h0 - field.h1 / field.kr
    if field.towards is not None:
        by_k = by_k + slope * (field.r * field.towards)[:, None] * parts[:, 1]
        by_r = by_r + slope * k * field.towards[:, None] * parts[:, 1]
    columns = [by_k * scanned.top, 1j * by_k * scanned.top]
    for axis in range(2):
        moved = -field.ways[:, axis] / field.r * by_r.sum(axis=1)
        if field.towards is not None and scanned.along is not None:
            turned = field.towards * field.ways[:, axis] / field.r**2 - scanned.along[:, axis] / field.r
            moved = moved + turned * (field.h1 @ parts[:, 1])
        columns.append(REACH_M * moved[:, None])
    by_x = np.concatenate(columns, axis=1)
    return residual, basis @ (basis.conj().T @ by_x) - by_x


def _real(values: Complex) -> Float:
    return np.concatenate([values.real, values.imag])


def _descend(scanned: Scanned, x: Float) -> tuple[float, Float]:
    """Minimise half the sum of squared residuals; return the minimum and the unknowns."""
    rings = (len(x) - 2) // 2
    low = np.concatenate([np.full(rings, -WIDEST), np.full(rings, LEAST_LOSS), [-1.0, -1.0]])
    high = np.concatenate([np.full(2 * rings, WIDEST), [1.0, 1.0]])
    last: list[tuple[Float, Complex, Complex]] = []

    def at(x: Float) -> tuple[Complex, Complex]:
        if not last or not np.array_equal(last[0][0], x):
            last[:] = [(x.copy(), *_residual(scanned, x))]
        return last[0][1:]

    minimum = least_squares(
        lambda x: _real(at(x)[0]), np.clip(x, low + 1e-6, high - 1e-6), jac=lambda x: _real(at(x)[1]),
        bounds=(low, high), xtol=1e-8, ftol=1e-8, max_nfev=60,
    )  # fmt: skip
    return float(minimum.cost), np.asarray(minimum.x)


def _beginnings(scanned: Scanned, x: Float) -> list[complex]:
    """Return the wavenumbers, over scanned.top, of a further ring that would reduce the residual most."""
    grid = [complex(real, real * loss) for real in np.geomspace(0.03, 1.2, 18) for loss in (0.08, 0.25, 0.6, 1.2)]
    grid += [complex(-real, max(real, 0.15) * loss) for real in (0.07, 0.2, 0.4) for loss in (0.54, 0.8, 1.1)]
    k, source = _unpacked(scanned, x)
    tried: Complex = np.array(grid, dtype=np.complex128)
    columns = _field(scanned, tried * scanned.top, source).columns
    residual = scanned.values
    if len(k):
        basis, _, residual = _projected(_field(scanned, k, source), scanned.values)
        inside = np.einsum("nb,ngm->bgm", basis.conj(), columns)
        columns = columns - np.einsum("nb,bgm->ngm", basis, inside)
    products = np.einsum("ngm,ngl->gml", columns.conj(), columns)
    ridge = 1e-9 * np.einsum("gmm->g", products).real
    products += ridge[:, None, None] * np.eye(products.shape[1])
    projected = np.einsum("ngm,n->gm", columns.conj(), residual)
    gain = np.einsum("gm,gm->g", projected.conj(), np.linalg.solve(products, projected[:, :, None])[:, :, 0]).real
    chosen: list[complex] = []
    for number in np.argsort(-gain):
        one = grid[int(number)]
        if all(abs(one - other) > APART * abs(other) for other in chosen):
            chosen.append(one)
        if len(chosen) == STARTS:
            break
    return chosen


def _result(scanned: Scanned, x: Float) -> Rings:
    k, source = _unpacked(scanned, x)
    field = _field(scanned, k, source)
    _, parts, _ = _projected(field, scanned.values)
    residual, by_x = _residual(scanned, x)
    motion = np.sqrt(np.mean(np.abs(np.einsum("nrm,rm->nr", field.columns, parts)) ** 2, axis=0))
    count, free = 2 * len(residual), len(x) + 2 * parts.size
    power = max(float(np.linalg.norm(residual) ** 2), FLOOR**2 * len(residual))
    jacobian = _real(by_x)
    spread = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-13)) * power / max(count - free, 1))
    deviation = np.hypot(spread[: len(k)], spread[len(k) : -2]) * scanned.top / np.abs(k)
    score = count * math.log(power / count) + free * math.log(count)
    misfit = float(np.linalg.norm(residual)) / math.sqrt(len(residual))
    return Rings(k, motion, deviation, misfit, residual, score, source, x)


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
