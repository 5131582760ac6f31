"""Estimate polarity, phase and gain of each transducer from its own sound, at several places of a microphone.

The pressure of transducer n at place m is G_n D(angle) e^{b1 s + b2 s^2} e^{ikr - beta r}/r with s = sin^2(angle).
Gauss-Newton steps fit all unknowns together: the complex factors G_n, the true places of the microphone, the speed of
sound and its drift, and the deviation of the directivity from the layout (b1, b2). All unknowns except G have priors.
Delays other than polarity also have a prior of a few degrees, by sin(2 (arg G - common phase))/2, which does not depend
on polarity. Without this prior, a wrong speed of sound would give delays that grow towards the rim.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from palmfield.acoustics import check
from palmfield.acoustics.air import absorption_Np_m, sound_speed, sound_speed_sd
from palmfield.acoustics.calibration_file import Elements
from palmfield.acoustics.directivities import directivity_coefficients
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Complex, Float

DELAYS_RAD = math.radians(15.0)
"""Prior standard deviation of delays other than polarity: 5 to 15 degrees on boards of hobbyists."""
DIRECTIVITY = 0.3
"""Prior standard deviation of b1 and b2: pistons and measured tables differ by 0.2 of the amplitude at 30 degrees."""
DEAD = 0.25
"""Share of the median amplitude below which a transducer counts as dead."""
STEPS = 60
CONVERGED = 1e-7
ODD, ODD_TIMES = 0.1, 6.0
"""Least share of unexplained squared readings of a misplaced transducer, and its least ratio to the median."""
CHANCE = 0.05
LEAST_SHARE = 1e-3
"""Share of a step below which it is not halved further."""
SAME = 0.1
"""Negligible change of the sum of squares, in units of their standard deviation."""


@dataclass(frozen=True)
class ElementFit:
    """Result of the fit to the readings.

    elements: as in a calibration, by place, with addresses if signals are wired to other places than in the layout
    swapped: these places; unfit: columns of the readings that are loud but fit no place; their transducers are off
    p0_Pa_m: mean amplitude of the transducers that sound, and its standard error from the scatter only, without the
        error of the microphone
    moved_m: shift of the microphone from its nominal places, shape (m, 3); sound_speed_m_s: fitted speed of sound
    misfit: rms of the residual, relative to the rms reading
    """

    elements: Elements
    swapped: tuple[int, ...]
    unfit: tuple[int, ...]
    p0_Pa_m: float
    p0_sd_Pa_m: float
    moved_m: Float
    sound_speed_m_s: float
    sound_speed_sd_m_s: float
    misfit: float


def fit_elements(
    array: Array,
    air: Air,
    at: ArrayLike,
    readings: ArrayLike,
    *,
    place_sd_m: float = 1e-3,
    temperature_sd_K: float = 1.0,
) -> ElementFit:
    """Fit all transducers together.

    array: the layout; its p0 and gain are not used
    at: nominal places of the microphone, array frame [m], shape (m, 3), at least 3
    readings: complex peak pressure of each single transducer at full drive with phase 0 (a delay is +phase), shape
        (m, n); NaN if missing
    place_sd_m: standard deviation of the places, by axis. temperature_sd_K: standard deviation of the temperature of
        the air, for its mean and for its drift while all transducers sound in turn
    Raises PalmfieldError for shapes that do not fit, readings that are infinite, a transducer without readings, fewer
    than 3 places, places that are not in front of the array, and if most readings fit no sound from their places.
    """
    places = np.asarray(check.points(np.asarray(at, float), np.float64), float)
    y = np.asarray(readings, np.complex128)
    if y.shape != (len(places), len(array)):
        raise PalmfieldError(
            f"readings have shape {y.shape}: give ({len(places)}, {len(array)}), a row for each place and a column for "
            "each transducer"
        )
    if len(places) < 3:
        raise PalmfieldError(f"the microphone has {len(places)} positions; needed: at least 3, better 8")
    if not (place_sd_m > 0.0 and temperature_sd_K > 0.0):
        raise PalmfieldError(
            f"place_sd_m = {place_sd_m:g} and temperature_sd_K = {temperature_sd_K:g}: give standard deviations above 0"
        )
    present = ~np.isnan(y)
    if np.isinf(y).any() or not present.any(axis=0).all():
        n = int(np.argmax(np.isinf(y).any(axis=0) | ~present.any(axis=0)))
        raise PalmfieldError(f"transducer {n} has no finite reading: give at least one; 0 means silence")
    model = _Model(array, air, places, place_sd_m, temperature_sd_K)
    if not model.in_front():
        raise PalmfieldError("a position of the microphone is not in front of all transducers: give z > 0 [m]")
    y = np.where(present, y, 0.0)
    solution = _solved(model, y, present)
    odd = _odd(model, solution, y, present)
    if odd.mean() > 0.5:
        raise PalmfieldError(
            f"the readings of {odd.sum()} of {len(odd)} transducers do not fit sound from their positions: check "
            "the layout, the order of its transducers and the microphone positions (array frame, m)"
        )
    if not odd.any():
        return _result(model, solution)
    for _ in range(5):
        solution = _solved(model, np.where(odd, 0.0, y), present)
        more = odd | _odd(model, solution, y, present)
        if (more == odd).all():
            break
        odd = more
    place, fits = _matched(model, solution, y, present, np.flatnonzero(odd))
    signal = np.argsort(place)
    model.turn = model.turn[signal]
    present = present[:, signal]
    solution = _solved(model, np.where(fits, y, 0.0)[:, signal], present)
    own = np.arange(len(array)) if array.address is None else array.address
    swapped = tuple(np.flatnonzero((signal != np.arange(len(array))) & fits[signal]).tolist())
    result = _result(model, solution)
    elements = result.elements.model_copy(update={"address": tuple(own[signal].tolist()) if swapped else None})
    return replace(result, elements=elements, swapped=swapped, unfit=tuple(np.flatnonzero(~fits).tolist()))


class _Model:
    """Pressures of the model and their derivatives. Unknowns other than G_n, each over its standard deviation: moves by
    axis, drift of the sound speed at each place, common drift, sound speed, b1 and b2."""

    def __init__(self, array: Array, air: Air, places: Float, place_sd_m: float, temperature_sd_K: float):
        self.array, self.places, self.place_sd_m = array, places, place_sd_m
        self.speed = sound_speed(air)
        self.speed_sd = sound_speed_sd(air, temperature_sd_K)
        self.turns = 2.0 * math.pi * array.frequency_Hz
        self.absorption = absorption_Np_m(air, array.frequency_Hz)
        self.quintic = directivity_coefficients(array, self.turns / self.speed)[0]
        self.shape = len(places), len(array)
        # Relative position within a sweep over all transducers at one microphone position, in their order
        self.turn = np.arange(len(array)) / max(len(array) - 1, 1) - 0.5
        self.extra = 4 * len(places) + 4

    def in_front(self) -> bool:
        """Return whether each place is in front of every transducer."""
        way = self.places[:, None] - self.array.positions
        return bool((np.einsum("mnj,nj->mn", way, self.array.normals) > 0.0).all())

    def of(self, unknown: Float) -> tuple[Float, float, Float]:
        """Return moves [m], shape (m, 3), sound speed [m/s], and b1, b2."""
        moves = unknown[: 3 * len(self.places)].reshape(-1, 3) * self.place_sd_m
        return moves, self.speed + float(unknown[-3]) * self.speed_sd, unknown[-2:] * DIRECTIVITY

    def speeds(self, unknown: Float) -> Float:
        """Return the speed of sound at each reading [m/s], shape (m, n)."""
        drifts = (unknown[3 * len(self.places) : -4] + unknown[-4]) * self.speed_sd
        return self.of(unknown)[1] + drifts[:, None] * self.turn

    def pressures(self, unknown: Float) -> tuple[Complex, list[tuple[slice, Complex]]]:
        """Return the pressure of a unit G_n, shape (m, n), and for each unknown its rows and relative derivative."""
        moves, _, bend = self.of(unknown)
        speed = self.speeds(unknown)
        way = (self.places + moves)[:, None] - self.array.positions
        r = np.linalg.norm(way, axis=2)
        along = way / r[..., None]
        square = 1.0 - np.clip(np.einsum("mnj,nj->mn", along, self.array.normals), 0.0, 1.0) ** 2
        k = self.turns / speed
        wave = np.exp((1j * k - self.absorption) * r + bend[0] * square + bend[1] * square**2) / r
        pressure = wave * polyval(square, self.quintic)
        slopes: list[tuple[slice, Complex]] = []
        for m in range(len(self.places)):
            by_place = (1j * k[m] - self.absorption - 1.0 / r[m]) * self.place_sd_m
            slopes += [(slice(m, m + 1), (by_place * along[m, :, axis])[None]) for axis in range(3)]
        by_speed = -1j * k * r / speed * self.speed_sd
        slopes += [(slice(m, m + 1), (by_speed[m] * self.turn)[None]) for m in range(len(self.places))]
        slopes += [(slice(None), by_speed * self.turn), (slice(None), by_speed)]
        slopes.append((slice(None), DIRECTIVITY * square + 0j))
        slopes.append((slice(None), DIRECTIVITY * square**2 + 0j))
        return pressure, slopes


@dataclass(frozen=True)
class _Found:
    """Converged state of the fit, its covariance and residual, relative to the rms reading."""

    factor: Complex
    unknown: Float
    common: float
    covariance: Float
    misfit: float


def _unexplained(pressure: Complex, y: Complex) -> Float:
    """Return the share of the squared readings that no factor explains, 0 to 1, (columns of y, columns of pressure)."""
    size = np.outer((np.abs(y) ** 2).sum(axis=0), (np.abs(pressure) ** 2).sum(axis=0))
    return np.asarray(1.0 - np.abs(y.conj().T @ pressure) ** 2 / np.maximum(size, 1e-300))


def _odd(model: _Model, solution: _Found, y: Complex, present: np.ndarray) -> np.ndarray:
    """Return which columns are loud and do not fit their places, shape (n,)."""
    pressure = model.pressures(solution.unknown)[0] * present
    residual = np.array([_unexplained(pressure[:, [n]], y[:, [n]])[0, 0] for n in range(y.shape[1])])
    loud = np.sqrt((np.abs(y) ** 2).sum(axis=0) / np.maximum((np.abs(pressure) ** 2).sum(axis=0), 1e-300))
    usual = np.median(residual[loud > 0.0])
    return np.asarray((loud > DEAD * np.median(loud)) & (residual > max(ODD, min(ODD_TIMES * usual, 0.5))))


def _matched(
    model: _Model, solution: _Found, y: Complex, present: np.ndarray, odd: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of the signals of all columns, a permutation, and which columns fit their place, shapes (n,).

    odd: columns that may be exchanged among themselves or moved to places of silent transducers
    """
    place, fits = np.arange(y.shape[1]), np.ones(y.shape[1], bool)
    pressure = model.pressures(solution.unknown)[0]
    free = np.union1d(odd, np.flatnonzero(~_alive(solution.factor)))
    residual = np.array([_unexplained((pressure * present[:, [n]])[:, free], y[:, [n]])[0] for n in odd])
    row, column = linear_sum_assignment(residual)
    best = residual[row, column]
    # Probability that one of the free positions fits noise of m readings equally well
    chance = len(free) * best ** (present[:, odd].sum(axis=0) - 1)
    good = (best < ODD) & (chance < CHANCE)
    fits[odd] = good
    matched = free[column[good]]
    place[odd[good]] = matched
    # A column without a match keeps its own position if it is free
    idle, vacant = np.setdiff1d(free, odd[good]), np.setdiff1d(free, matched)
    moved = np.setdiff1d(idle, vacant)
    place[moved] = np.setdiff1d(vacant, idle)
    return place, fits


def _solved(model: _Model, y: Complex, present: np.ndarray) -> _Found:
    count = y.shape[1]
    unknown = np.zeros(model.extra)
    pressure, slopes = model.pressures(unknown)
    pressure = pressure * present
    factor = _best_factors(pressure, y)
    # Twice the angle is the same for both polarities
    common = 0.5 * float(np.angle((factor**2).sum()))
    freedom = max(2 * int(present.sum()) - 2 * count - model.extra, 1)
    loudness = math.sqrt(float((np.abs(y) ** 2).sum()) / int(present.sum()))
    if loudness == 0.0:
        raise PalmfieldError("all readings are 0: check that the array emits and that the microphone records")
    sigma = 0.1 * loudness
    for _ in range(STEPS):
        normal, right = _normal_equations(model, y, present, pressure, slopes, factor, unknown, common, sigma)
        step = np.linalg.solve(normal, right)
        before = _cost(y - pressure * factor, factor, unknown, common, sigma)
        share = 1.0
        while True:
            further, late = unknown + share * step[2 * count : -1], common + share * float(step[-1])
            pressure, slopes = model.pressures(further)
            pressure = pressure * present
            moved = _best_factors(pressure, y)
            if share < LEAST_SHARE or _cost(y - pressure * moved, moved, further, late, sigma) < before + SAME:
                break
            share *= 0.5
        factor, unknown, common = moved, further, late
        residual = float((np.abs(y - pressure * factor) ** 2).sum())
        sigma = max(math.sqrt(residual / freedom), 1e-9 * loudness)
        if np.abs(step[2 * count :]).max() < CONVERGED:
            break
    else:
        raise PalmfieldError(
            f"the fit of the transducers does not converge in {STEPS} steps: check the layout, the order of its "
            "transducers, the microphone positions (array frame, m), and that a delay is a positive phase"
        )
    normal, right = _normal_equations(model, y, present, pressure, slopes, factor, unknown, common, sigma)
    step = np.linalg.solve(normal, right)
    factor = factor + step[:count] + 1j * step[count : 2 * count]
    covariance = np.asarray(np.linalg.inv(normal), float)
    return _Found(factor, unknown, common, covariance, math.sqrt(residual / int(present.sum())) / loudness)


def _best_factors(pressure: Complex, y: Complex) -> Complex:
    return np.asarray((pressure.conj() * y).sum(axis=0) / np.maximum((np.abs(pressure) ** 2).sum(axis=0), 1e-300))


def _cost(residual: Complex, factor: Complex, unknown: Float, common: float, sigma: float) -> float:
    """Return the cost that a step must reduce: unexplained readings, and deviations from the priors."""
    delays = np.where(_alive(factor), 0.5 * np.sin(2.0 * (np.angle(factor) - common)) / DELAYS_RAD, 0.0)
    return float((np.abs(residual) ** 2).sum()) / sigma**2 + float((unknown**2).sum() + (delays**2).sum())


def _alive(factor: Complex) -> np.ndarray:
    return np.asarray(np.abs(factor) > DEAD * np.median(np.abs(factor)))


def _normal_equations(
    model: _Model,
    y: Complex,
    present: np.ndarray,
    pressure: Complex,
    slopes: list[tuple[slice, Complex]],
    factor: Complex,
    unknown: Float,
    common: float,
    sigma: float,
) -> tuple[Float, Float]:
    """Return J'J and J'r over real parts of G, imaginary parts of G, the unknowns of the model and the common phase."""
    count = len(factor)
    size = 2 * count + model.extra + 1
    normal, right = np.zeros((size, size)), np.zeros(size)
    sound = pressure * factor / sigma
    residual = (y - pressure * factor) * present / sigma
    unit = pressure / sigma
    power = (np.abs(unit) ** 2).sum(axis=0)
    real, imaginary = np.arange(count), np.arange(count, 2 * count)
    normal[real, real] = normal[imaginary, imaginary] = power
    toward = (unit.conj() * residual).sum(axis=0)
    right[:count], right[count : 2 * count] = toward.real, toward.imag
    columns = np.zeros((model.extra, *y.shape), complex)
    for row, (rows, slope) in enumerate(slopes):
        columns[row, rows] = sound[rows] * slope
    flat = columns.reshape(model.extra, -1)
    low, high = 2 * count, 2 * count + model.extra
    normal[low:high, low:high] = (flat.conj() @ flat.T).real
    right[low:high] = (flat.conj() @ residual.ravel()).real
    cross = (unit.conj() * columns).sum(axis=1)
    normal[low:high, :count], normal[low:high, count:low] = cross.real, cross.imag
    normal[:low, low:high] = normal[low:high, :low].T
    diagonal = np.arange(low, high)
    normal[diagonal, diagonal] += 1.0
    right[low:high] -= unknown
    _add_prior_of_delays(normal, right, factor, common)
    return normal, right


def _add_prior_of_delays(normal: Float, right: Float, factor: Complex, common: float) -> None:
    count, alive = len(factor), _alive(factor)
    angle = np.angle(factor) - common
    value = np.where(alive, 0.5 * np.sin(2.0 * angle) / DELAYS_RAD, 0.0)
    slope = np.where(alive, np.cos(2.0 * angle) / DELAYS_RAD, 0.0)
    square = np.maximum(np.abs(factor) ** 2, 1e-300)
    by = np.stack([-slope * factor.imag / square, slope * factor.real / square, -slope])
    at = np.stack([np.arange(count), np.arange(count, 2 * count), np.full(count, len(right) - 1)])
    for i in range(3):
        np.add.at(right, at[i], -by[i] * value)
        for j in range(3):
            np.add.at(normal, (at[i], at[j]), by[i] * by[j])


def _result(model: _Model, solution: _Found) -> ElementFit:
    factor, unknown, common, covariance = solution.factor, solution.unknown, solution.common, solution.covariance
    count, alive = len(factor), _alive(factor)
    size = np.abs(factor)
    p0 = float(size[alive].mean())
    angle = np.angle(factor * np.exp(-1j * common))
    polarity = np.where(np.abs(angle) < 0.5 * math.pi, 1, -1)
    phase = np.angle(polarity * np.exp(1j * angle))
    late = float(phase[alive].mean())
    # Only phase differences are determined; the common phase depends on the trigger of the recorder
    square = np.maximum(size**2, 1e-300)
    both = np.hstack([np.diag(-factor.imag / square), np.diag(factor.real / square)])
    louder = np.hstack([np.diag(factor.real / np.sqrt(square)), np.diag(factor.imag / np.sqrt(square))])
    mean = alive / alive.sum()
    of_factors = covariance[: 2 * count, : 2 * count]
    gain = size / p0
    phases, sizes = both - mean @ both, louder / p0 - np.outer(gain, mean @ louder) / p0
    phase_sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", phases, of_factors, phases), 0.0))
    gain_sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", sizes, of_factors, sizes), 0.0))
    p0_slope = mean @ louder
    moves, speed, _ = model.of(unknown)
    return ElementFit(
        Elements(
            enabled=tuple(alive.tolist()),
            polarity=tuple(np.where(alive, polarity, 1).tolist()),
            phase_rad=tuple(np.where(alive, phase - late, 0.0).tolist()),
            phase_sd_rad=tuple(np.where(alive, phase_sd, 0.0).tolist()),
            gain=tuple(np.where(alive, gain, 0.0).tolist()),
            gain_sd=tuple(gain_sd.tolist()),
        ),
        (),
        (),
        p0,
        float(np.sqrt(p0_slope @ of_factors @ p0_slope)),
        moves,
        speed,
        float(np.sqrt(covariance[-4, -4])) * model.speed_sd,
        solution.misfit,
    )
