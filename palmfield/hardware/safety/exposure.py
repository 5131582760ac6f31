"""Compute sound levels at a head and at a hand during a play, and check them against limits."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palmfield.acoustics.exposure import OCCUPATIONAL_DB, PUBLIC_DB, ball_points, dose_dB, level_dB
from palmfield.config import DriverConfig
from palmfield.errors import DeviceError, SceneError
from palmfield.types import Float

Sound = NDArray[np.complexfloating[Any, Any]]

SPACING_M = 10e-3
"""Spacing of the sample points in the sphere of a head [m]. The search is refined near the loudest points."""
CANDIDATES = 8
"""Number of points at which the search is refined. Interference patterns have many points of nearly equal level."""
CLOSER_M, CLOSER_SPACING_M, FINEST_SPACING_M = 12e-3, 2e-3, 0.5e-3


class SoundMoment(NamedTuple):
    """Sound at one moment.

    pressure: function from points [m], (n, 3), to the complex peak pressure [Pa], (n,)
    share: fraction of the play that this moment represents
    """

    pressure: Callable[[Float], Sound]
    share: float


@dataclass(frozen=True)
class Exposure:
    """Sound at the loudest point of a region, in a free field.

    place: the point [m], shape (3,)
    peak_Pa: largest peak pressure
    mean_square_Pa2: mean, over the play, of the squared rms pressure
    band_dB: level differences at the low and the high end of the range of p0
    """

    place: Float
    peak_Pa: float
    mean_square_Pa2: float
    band_dB: tuple[float, float] = (0.0, 0.0)

    @property
    def level_dB(self) -> float:
        """Sound pressure level at the loudest moment [dB]."""
        return level_dB(self.peak_Pa / math.sqrt(2.0))

    @property
    def mean_level_dB(self) -> float:
        """Energy-equivalent level over the play [dB]."""
        return level_dB(math.sqrt(self.mean_square_Pa2))

    def dose_dB(self, duration_s: float) -> float:
        """Return the energy-equivalent level over 8 h of one play with this duration [dB]."""
        return dose_dB(self.mean_square_Pa2, duration_s)

    @property
    def most_dB(self) -> float:
        """Value of `level_dB` if p0 is at the high end of its range."""
        return self.level_dB + self.band_dB[1]


def peaks_at(moments: Sequence[SoundMoment], points: Float) -> tuple[Float, NDArray[np.intp]]:
    """Return the largest peak pressure at each point [Pa], and the number of its moment.

    Both arrays have shape (n,).
    """
    peaks, which = np.zeros(len(points)), np.zeros(len(points), np.intp)
    for number, moment in enumerate(moments):
        magnitudes = np.abs(moment.pressure(points))
        louder = magnitudes > peaks
        peaks[louder], which[louder] = magnitudes[louder], number
    return peaks, which


def loudest_in(moments: Sequence[SoundMoment], points: Float) -> Exposure:
    """Return the sound at the loudest of the points, shape (n, 3)."""
    peaks, which = peaks_at(moments, points)
    best = int(peaks.argmax())
    if peaks[best] <= 0.0:
        return Exposure(points[0], 0.0, 0.0)
    return _at(moments, points[best], float(peaks[best]), int(which[best]))


def _separate(points: Float, peaks: Float) -> Float:
    """Return the loudest points that are at least CLOSER_M apart, shape (c, 3); at most CANDIDATES points."""
    result: list[Float] = []
    for number in np.argsort(-peaks):
        if all(np.linalg.norm(points[number] - other) > CLOSER_M for other in result):
            result.append(points[number])
        if len(result) == CANDIDATES:
            break
    return np.array(result)


def _at(moments: Sequence[SoundMoment], place: Float, peak_Pa: float, which: int) -> Exposure:
    squares = [
        0.5 * moment.share * float(np.abs(moment.pressure(place[None]))[0]) ** 2 for moment in moments
    ]  # fmt: skip
    return Exposure(place, max(peak_Pa, float(np.abs(moments[which].pressure(place[None]))[0])), sum(squares))


def at_head(moments: Sequence[SoundMoment], driver: DriverConfig, transducers: Float) -> Exposure:
    """Return the sound at the loudest point of the sphere defined by keys head_m and head_radius_m.

    transducers: their positions [m], shape (n, 3)
    Raises SceneError if the keys define no head, and if transducers are in the sphere.
    """
    if driver.head_m is None:
        raise SceneError(
            "the position of the head is not declared; give driver key head_m, the centre of the "
            "ball in which the head may be [m]"
        )
    middle = np.array(driver.head_m)
    nearest = float(np.linalg.norm(transducers - middle, axis=1).min())
    if nearest <= driver.head_radius_m:
        raise SceneError(
            f"driver key head_m has value {' '.join(f'{x:g}' for x in driver.head_m)}, which is {nearest:.3g} m "
            f"from a transducer; allowed: no transducer within head_radius_m ({driver.head_radius_m:g} m)"
        )

    def inside(points: Float) -> Float:
        away = points - middle
        distances = np.linalg.norm(away, axis=1, keepdims=True)
        return np.asarray(middle + away * np.minimum(1.0, driver.head_radius_m / np.maximum(distances, 1e-9)))

    coarse = ball_points(middle, driver.head_radius_m, SPACING_M)
    peaks, _ = peaks_at(moments, coarse)
    if not peaks.any():
        return Exposure(middle, 0.0, 0.0)
    near = [ball_points(place, CLOSER_M, CLOSER_SPACING_M) for place in _separate(coarse, peaks)]
    closer = loudest_in(moments, inside(np.concatenate(near)))
    return loudest_in(moments, inside(ball_points(closer.place, CLOSER_SPACING_M, FINEST_SPACING_M)))


def with_band(loudest: Exposure, factors: tuple[float, float] | None) -> Exposure:
    """Add the band of the level due to the range of p0.

    factors: factors of the squared pressure at the loudest point, at the ends of the range; None without a range
    """
    if factors is None or min(factors) <= 0.0:
        return loudest
    low, high = (10.0 * math.log10(factor) for factor in factors)
    return Exposure(loudest.place, loudest.peak_Pa, loudest.mean_square_Pa2, (low, high))


def check_head(loudest: Exposure, driver: DriverConfig) -> list[str]:
    """Return warnings for users about the head, in words.

    Raises DeviceError if the level at the upper end of the range of p0 is above key head_limit_dB.
    """
    if loudest.peak_Pa <= 0.0:
        return []
    where = "(" + ", ".join(f"{1e3 * x:.0f}" for x in loudest.place) + ") mm"
    level = f"{loudest.level_dB:.0f} dB SPL at {where} within head_radius_m of head_m"
    if loudest.band_dB[1] >= 0.5:
        level += f", up to {loudest.most_dB:.0f} dB within the range of p0"
    if driver.head_limit_dB is not None and loudest.most_dB > driver.head_limit_dB:
        raise DeviceError(
            f"the level would be {level}; driver key head_limit_dB allows {driver.head_limit_dB:g}: reduce "
            "drive_amplitude, keep the head farther away (head_m), or calibrate the array"
        )
    if loudest.most_dB > OCCUPATIONAL_DB:
        return [f"{level}: above {OCCUPATIONAL_DB:g} dB, an interim limit for people at work"]
    if loudest.most_dB > PUBLIC_DB:
        return [f"{level}: above {PUBLIC_DB:g} dB, an interim limit for the public"]
    return []
