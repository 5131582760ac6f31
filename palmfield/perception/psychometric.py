"""Psychometric functions: probability of detection at each level, fitted to answers by maximum likelihood.

p(x) = g + (1 - g - l) F(x), with g the rate of right guesses, l the rate of lapses, and F from 0 to 1, F = 1/2 at the
threshold. The definition of spread depends on F:

normal    F = Phi((x - threshold) / spread), where spread is the standard deviation
logistic  F = 1 / (1 + exp(-(x - threshold) / spread))
weibull   F = 1 - exp(-ln 2 (x / threshold)^(1 / spread)), x > 0, for levels that are ratios

from palmfield.perception.psychometric import fit
result = fit(levels, trials, right, guess=0.5)
print(result.threshold, result.threshold_interval)
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.special import expit, ndtr
from scipy.stats import chi2

from palmfield.errors import OutputError, refuse_unknown
from palmfield.types import Float

Shape = Literal["normal", "logistic", "weibull"]
MOST_LAPSES = 0.1
"""Largest fitted rate of lapses; with more lapses, answers contain little information on the level."""
SURE = 1e-9
"""Smallest distance of probabilities from 0 and 1, so that the likelihood of each answer is above 0."""
ROUNDS = 60
"""Largest number of scoring rounds."""
SETTLED = 1e-7
LEAST_SPREAD, MOST_SPREAD = 1e-3, 10.0
"""Limits of the fitted spread as shares of the range of levels."""
BEYOND = 1.0
"""Largest distance of a fitted threshold outside the levels, as a share of their range."""
ADAPTIVE_SHARE = 1.73
"""Factor of the limit of the deviance by chi squared, for adaptive levels. In simulated staircases (25 to 120 trials,
1 up 2 down, steps of 4 and 2 dB, spreads of 1 to 6 dB) 95 % of the deviances of the true threshold were below 4.5 to
7.5, not 3.84; we use 6.6."""
PROFILED, PROFILED_SPREADS = 601, 61
"""Thresholds and spreads at which a profile is evaluated."""


@dataclass(frozen=True)
class PsychometricFunction:
    """A psychometric function. threshold, spread: see the module; guess, lapse: rates, guess + lapse < 1"""

    shape: Shape
    threshold: float
    spread: float
    guess: float = 0.0
    lapse: float = 0.0

    def __post_init__(self) -> None:
        refuse_unknown(OutputError, "shape {} is unknown", self.shape, get_args(Shape))
        _check_rates(self.guess, self.lapse)
        if not (math.isfinite(self.threshold) and self.spread > 0.0):
            raise OutputError(f"threshold {self.threshold}, spread {self.spread}; allowed: finite, spread above 0")
        if self.shape == "weibull" and not self.threshold > 0.0:
            raise OutputError(f"threshold {self.threshold:g}; allowed with shape 'weibull': above 0")

    def __call__(self, x: ArrayLike) -> Float:
        """Return the probability of a right answer (or of yes) at levels x, in the shape of x."""
        levels = np.asarray(x, np.float64)
        share = FORMS[self.shape].share(_scaled(self.shape, levels), _scaled(self.shape, self.threshold), self.spread)
        return np.asarray(self.guess + (1.0 - self.guess - self.lapse) * share)


class _Form(NamedTuple):
    """F and its derivative by z = (x - threshold) / spread, for levels as returned by `_scaled`."""

    share: Callable[[Float, float | Float, float | Float], Float]
    slope: Callable[[Float], Float]


def _weibull(z: Float) -> Float:
    return np.asarray(-np.expm1(-math.log(2.0) * np.exp(np.minimum(z, 50.0))))


def _weibull_slope(z: Float) -> Float:
    power = math.log(2.0) * np.exp(np.minimum(z, 50.0))
    return np.asarray(power * np.exp(-power))


FORMS: dict[str, _Form] = {
    "normal": _Form(
        lambda x, m, s: np.asarray(ndtr((x - m) / s)),
        lambda z: np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi),
    ),
    "logistic": _Form(
        lambda x, m, s: np.asarray(expit((x - m) / s)),
        lambda z: np.asarray(expit(z) * expit(-z)),
    ),
    "weibull": _Form(
        lambda x, m, s: _weibull((x - m) / s),
        _weibull_slope,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Fit:
    """A fitted function and its uncertainty.

    threshold_interval, spread_interval: bootstrap percentiles of `confidence`, (low, high); with adaptive levels, the
        interval of the threshold is from the profile likelihood
    trials, right: totals over all levels
    deviance: twice the log likelihood of the observed shares minus that of the function
    deviance_share: share of the bootstrap samples with a larger deviance; below 0.05 the function does not fit
    settled: whether the threshold is between the levels and the spread inside its bounds
    """

    function: PsychometricFunction
    confidence: float
    threshold_interval: tuple[float, float]
    spread_interval: tuple[float, float]
    trials: int
    right: int
    deviance: float
    deviance_share: float
    settled: bool

    @property
    def threshold(self) -> float:
        """Threshold of the function."""
        return self.function.threshold

    @property
    def spread(self) -> float:
        """Spread of the function."""
        return self.function.spread


def fit(
    levels: ArrayLike,
    trials: ArrayLike,
    right: ArrayLike,
    *,
    guess: float,
    lapse: float | None = 0.02,
    spread: float | None = None,
    shape: Shape = "normal",
    adaptive: bool = False,
    samples: int = 1000,
    confidence: float = 0.95,
    seed: int = 0,
) -> Fit:
    """Fit a psychometric function to counts of answers, by maximum likelihood, with a parametric bootstrap.

    levels: k >= 2 different levels, shape (k,); trials, right: whole numbers at each level, shape (k,)
    guess: rate of right guesses, 1/n for n alternatives; lapse: fixed rate, or None to fit it, at most MOST_LAPSES
    spread: fixed spread, or None to fit it; fits to few trials or to a staircase underestimate it
    adaptive: whether the levels depended on the answers, as in a staircase. Then, with a fitted spread, the interval of
        the threshold is from the profile likelihood, with a limit raised by ADAPTIVE_SHARE.
    samples: number of bootstrap samples, each with new answers of the fitted function at the same levels. The bootstrap
        assumes levels chosen beforehand.
    Raises OutputError for other shapes and counts, repeated levels, and answers that are all right or all wrong.
    Source: F. A. Wichmann, N. J. Hill, Percept. Psychophys. 63, 1293 and 1314 (2001).
    """
    x, n, k = _counts(levels, trials, right, shape)
    refuse_unknown(OutputError, "shape {} is unknown", shape, get_args(Shape))
    _check_rates(guess, 0.0 if lapse is None else lapse)
    if not 0.0 < confidence < 1.0 or samples < 2:
        raise OutputError(f"confidence {confidence:g}, samples {samples}; allowed: between 0 and 1, and 2 or more")
    if spread is not None and not 0.0 < spread < math.inf:
        raise OutputError(f"spread {spread:g}; allowed: above 0, in the unit of the levels, or None to estimate it")
    if k.sum() in (0, n.sum()):
        raise OutputError(
            f"all {int(n.sum())} answers are {'right' if k.sum() else 'wrong'}, so the threshold is undetermined; "
            "give levels with both right and wrong answers"
        )
    place = _scaled(shape, x)
    bounds = _bounds(place, lapse, spread)
    best = _fit_one(FORMS[shape], place, n, k, guess, bounds)
    function = _function(shape, best, guess)
    drawn = np.random.default_rng(seed).binomial(n.astype(int), function(x), (samples, len(x))).astype(np.float64)
    fits = _fit_many(FORMS[shape], place, n, drawn, guess, bounds, best)
    tails = 50.0 * (1.0 - confidence)
    thresholds = np.exp(fits[:, 0]) if shape == "weibull" else fits[:, 0]
    low, high = np.percentile(thresholds, [tails, 100.0 - tails]).tolist()
    if adaptive and spread is None:
        low, high = _profiled(FORMS[shape], place, n, k, guess, bounds, best, confidence)
        low, high = (math.exp(low), math.exp(high)) if shape == "weibull" else (low, high)
    narrow, wide = np.percentile(np.exp(fits[:, 1]), [tails, 100.0 - tails]).tolist()
    deviance = float(_deviance(FORMS[shape], place, n, k[None], best[None], guess)[0])
    others = _deviance(FORMS[shape], place, n, drawn, fits, guess)
    bounded = spread is not None or bounds[1][0] + 1e-4 < best[1] < bounds[1][1] - 1e-4
    inside = bounded and bool(place.min() <= best[0] <= place.max())
    return Fit(
        function, confidence, (low, high), (narrow, wide), int(n.sum()), int(k.sum()), deviance,
        float(np.mean(others >= deviance - 1e-9)), inside,
    )  # fmt: skip


def _profiled(
    form: _Form, place: Float, n: Float, k: Float, guess: float,
    bounds: list[tuple[float, float]], best: Float, confidence: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the interval of the threshold from the profile likelihood, for adaptive levels."""
    limit = ADAPTIVE_SHARE * float(chi2.ppf(confidence, 1))
    thresholds = np.append(np.linspace(*bounds[0], PROFILED), best[0])
    spreads = np.append(np.linspace(*bounds[1], PROFILED_SPREADS), best[1])
    lapses = np.unique(np.append(np.linspace(*bounds[2], 5), best[2]))
    likely = np.full(len(thresholds), -math.inf)
    for lapse in lapses:
        values = np.stack(np.meshgrid(thresholds, spreads, [lapse], indexing="ij"), axis=-1).reshape(-1, 3)
        logarithms = _log_likelihood(form, place, n, k[None], values, guess).reshape(len(thresholds), -1)
        likely = np.maximum(likely, logarithms.max(axis=1))
    inside = thresholds[2.0 * (likely.max() - likely) <= limit]
    return float(inside.min()), float(inside.max())


def _counts(levels: ArrayLike, trials: ArrayLike, right: ArrayLike, shape: str) -> tuple[Float, Float, Float]:
    x, n, k = (np.asarray(one, np.float64) for one in (levels, trials, right))
    if x.ndim != 1 or n.shape != x.shape or k.shape != x.shape or len(x) < 2:
        raise OutputError(
            f"levels, trials and right have shapes {x.shape}, {n.shape}, {k.shape}; allowed: (k,), k >= 2"
        )
    if not np.all(np.isfinite(x)) or len(np.unique(x)) < len(x) or (shape == "weibull" and x.min() <= 0.0):
        raise OutputError(f"levels {x.tolist()}; allowed: different finite levels, with shape 'weibull' above 0")
    bad = (n < 0) | (n != np.rint(n)) | (k < 0) | (k > n) | (k != np.rint(k))
    if bad.any():
        row = int(np.argmax(bad))
        raise OutputError(f"{k[row]:g} right of {n[row]:g} at level {x[row]:g}; allowed: whole, 0 to {n[row]:g}")
    return x, n, k


def counts(levels: ArrayLike, right: ArrayLike) -> tuple[Float, Float, Float]:
    """Count single trials, shapes (t,); return the levels and the numbers of trials and right answers at each."""
    x, answers = np.asarray(levels, np.float64), np.asarray(right, np.float64)
    values, which = np.unique(np.round(x, 12), return_inverse=True)
    return values, np.bincount(which).astype(np.float64), np.bincount(which, answers).astype(np.float64)


def _check_rates(guess: float, lapse: float) -> None:
    if guess < 0.0 or lapse < 0.0 or not guess + lapse < 1.0:
        raise OutputError(f"guess {guess:g}, lapse {lapse:g}; allowed: 0 or more, together below 1")


def _scaled(shape: str, x: float | Float) -> Float:
    """Return the levels, or for a Weibull function their logarithms."""
    levels = np.asarray(x, np.float64)
    if shape != "weibull":
        return levels
    return np.log(np.maximum(levels, 1e-300))


def _bounds(place: Float, lapse: float | None, spread: float | None) -> list[tuple[float, float]]:
    """Return the bounds of threshold, log spread and lapse; lower and upper bounds of a fixed value are equal."""
    low, high = float(place.min()), float(place.max())
    wide = high - low
    rates = (0.0, MOST_LAPSES) if lapse is None else (lapse, lapse)
    spreads = math.log(LEAST_SPREAD * wide), math.log(MOST_SPREAD * wide)
    if spread is not None:
        spreads = math.log(spread), math.log(spread)
    return [(low - BEYOND * wide, high + BEYOND * wide), spreads, rates]


def _function(shape: Shape, values: Float, guess: float) -> PsychometricFunction:
    threshold = math.exp(values[0]) if shape == "weibull" else float(values[0])
    return PsychometricFunction(shape, threshold, math.exp(values[1]), guess, float(values[2]))


def _probability(form: _Form, place: Float, values: Float, guess: float) -> Float:
    """Return probabilities of right answers, shape (m, k); values: m sets of threshold, log spread, lapse, (m, 3)."""
    share = form.share(place, values[:, :1], np.exp(values[:, 1:2]))
    return np.clip(guess + (1.0 - guess - values[:, 2:]) * share, SURE, 1.0 - SURE)


def _log_likelihood(form: _Form, place: Float, n: Float, right: Float, values: Float, guess: float) -> Float:
    p = _probability(form, place, values, guess)
    return np.add.reduce(right * np.log(p) + (n - right) * np.log1p(-p), axis=1)


def _deviance(form: _Form, place: Float, n: Float, right: Float, values: Float, guess: float) -> Float:
    shares = np.clip(right / np.maximum(n, 1.0), SURE, 1.0 - SURE)
    saturated = np.add.reduce(right * np.log(shares) + (n - right) * np.log1p(-shares), axis=1)
    return np.asarray(2.0 * (saturated - _log_likelihood(form, place, n, right, values, guess)))


def _fit_one(form: _Form, place: Float, n: Float, k: Float, guess: float, bounds: list[tuple[float, float]]) -> Float:
    """Return the most likely threshold, log spread and lapse, shape (3,), from the two best of several start points."""
    wide = float(np.ptp(place))
    low, high = np.array(bounds).T
    middles, spreads = np.meshgrid(
        place.min() + wide * np.linspace(0.05, 0.95, 10), wide * np.array([0.03, 0.1, 0.3, 1.0])
    )
    firsts = np.stack([middles.ravel(), np.log(spreads.ravel()), np.full(middles.size, 0.02)], axis=1)
    firsts = np.clip(firsts, low, high)
    likely = _log_likelihood(form, place, n, k[None], firsts, guess)
    best, least = firsts[0], math.inf
    for first in firsts[np.argsort(-likely)[:2]]:
        minimum = minimize(
            lambda v: -float(_log_likelihood(form, place, n, k[None], v[None], guess)[0]),
            first, method="L-BFGS-B", bounds=bounds,
        )  # fmt: skip
        if minimum.fun < least - 1e-9:
            best, least = np.asarray(minimum.x, np.float64), float(minimum.fun)
    return best


def _fit_many(
    form: _Form, place: Float, n: Float, right: Float, guess: float,
    bounds: list[tuple[float, float]], first: Float,
) -> Float:  # fmt: skip
    """Fit many samples, right: shape (m, k), like `_fit_one`, but by damped Fisher scoring; returns shape (m, 3)."""
    low, high = np.array(bounds).T
    free = np.flatnonzero(low < high)
    values = np.tile(first, (len(right), 1))
    damping = np.full(len(right), 1e-3)
    best = _log_likelihood(form, place, n, right, values, guess)
    for _ in range(ROUNDS):
        p = _probability(form, place, values, guess)
        z = (place - values[:, :1]) / np.exp(values[:, 1:2])
        slope, range_ = form.slope(z), 1.0 - guess - values[:, 2:]
        by = np.stack([-range_ * slope / np.exp(values[:, 1:2]), -range_ * slope * z, -(p - guess) / range_], axis=2)
        weights = n / (p * (1.0 - p))
        gradient = np.einsum("mk,mkj->mj", (right - n * p) / (p * (1.0 - p)), by)
        at_bound = ((values <= low) & (gradient < 0.0)) | ((values >= high) & (gradient > 0.0))
        by = np.where(at_bound[:, None, :], 0.0, by)[:, :, free]
        gradient = np.where(at_bound, 0.0, gradient)[:, free]
        information = np.einsum("mk,mki,mkj->mij", weights, by, by)
        diagonal = np.einsum("mii->mi", information)
        scale = diagonal * damping[:, None] + 1e-9
        step = np.linalg.solve(information + scale[:, :, None] * np.eye(len(free)), gradient[:, :, None])[:, :, 0]
        trial = values.copy()
        trial[:, free] = np.clip(values[:, free] + step, low[free], high[free])
        likely = _log_likelihood(form, place, n, right, trial, guess)
        better = likely >= best
        moved = np.abs(trial - values).max(axis=1)
        values[better], best[better] = trial[better], likely[better]
        damping = np.where(better, np.maximum(0.2 * damping, 1e-9), np.minimum(10.0 * damping + 1e-6, 1e12))
        if np.all(moved < SETTLED):
            break
    return values
