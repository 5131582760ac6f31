"""Find the focus of given amplitudes: the point whose phases fit best."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.types import Complex, Float

REACH_M = 0.6
NEAREST_M = 0.04
COARSE, FINER = (25, 25, 24), (9, 9, 9)
FINE_M = 4e-3
MOST_ROUGH, FEWEST_ROUGH = 256, 32
"""Largest and least number of transducers in the coarse search, which finds the place to millimetres."""
ROUNDS = 30
CLOSE_M = 1e-8


def fitted_focus(
    positions: Float, amplitudes: Complex, wavenumber: float, near: Float | None = None, *, anywhere: bool = True
) -> tuple[Float, float]:
    """Return the focus [m], shape (3,), whose phases -k d fit best by least squares, and the rms residual [rad].

    positions: of the transducers [m], shape (n, 3), with the sound on the side of positive z
    amplitudes: shape (n,), e^{-iwt}; amplitudes of 0 do not count; near: start point, None: search within 0.6 m
    anywhere: whether to search everywhere if no point nearby fits, which takes about 20 ms
    Returns NaN if fewer than four transducers sound.
    """
    on = np.abs(amplitudes) > 1e-9
    if on.sum() < 4:
        return np.full(3, np.nan), np.nan
    places, phases = positions[on], np.angle(amplitudes[on])
    starts = [near] if near is not None else []
    best: tuple[Float, float] | None = None
    for start in [*starts, None] if anywhere or near is None else starts:
        if best is not None and best[1] < 1.0:
            break
        begin = _coarse(positions, np.where(on, amplitudes, 0.0), wavenumber) if start is None else start
        fit = _refined(places, phases, wavenumber, begin)
        best = fit if best is None or fit[1] < best[1] else best
    assert best is not None
    return best


def _coarse(places: Float, amplitudes: Complex, wavenumber: float) -> Float:
    """Return the point of a grid, then of finer grids, with the largest coherent sum of all transducers."""
    sounding = np.flatnonzero(amplitudes)
    # The grid of a constant input is cached
    some = _spread(np.arange(len(places)))
    some = some if np.count_nonzero(amplitudes[some]) >= min(len(sounding), FEWEST_ROUGH) else _spread(sounding)
    places, wave = places[some], np.exp(1j * np.angle(amplitudes[some])) * (amplitudes[some] != 0.0)
    low, high = _region(places)
    points, steering = _steering(places.tobytes(), wavenumber)
    best = points[int(np.abs(steering @ wave.astype(np.complex64)).argmax())]
    spacing = (high - low) / (np.array(COARSE) - 1)
    while spacing.max() >= FINE_M:
        points = _grid(np.maximum(best - 2.0 * spacing, [-np.inf, -np.inf, low[2]]), best + 2.0 * spacing, FINER)
        sums = np.exp(1j * wavenumber * np.linalg.norm(points[:, None] - places, axis=2)) @ wave
        best, spacing = points[int(np.abs(sums).argmax())], 0.5 * spacing
    return best


def _spread(numbers: NDArray[np.signedinteger[Any]]) -> NDArray[np.signedinteger[Any]]:
    """Return at most MOST_ROUGH of some numbers, evenly spaced."""
    return numbers[np.unique(np.linspace(0, len(numbers) - 1, min(len(numbers), MOST_ROUGH)).astype(int))]


def _region(places: Float) -> tuple[Float, Float]:
    """Return the corners of the search box for a focus [m]."""
    low, high = places.min(axis=0) - 0.05, places.max(axis=0) + 0.05
    low[2], high[2] = places[:, 2].max() + NEAREST_M, places[:, 2].max() + REACH_M
    return low, high


def _grid(low: Float, high: Float, counts: tuple[int, int, int]) -> Float:
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


@lru_cache(maxsize=2)
def _steering(places: bytes, wavenumber: float) -> tuple[Float, NDArray[np.complex64]]:
    """Return the first grid, (n, 3), and the phase factor of the sound from each transducer to its points, (n, m)."""
    whence = np.frombuffer(places).reshape(-1, 3)
    points = _grid(*_region(whence), COARSE)
    turns = np.empty((len(points), len(whence)), np.complex64)
    for row in range(0, len(points), COARSE[2]):
        distance = np.linalg.norm(points[row : row + COARSE[2], None] - whence, axis=2)
        turns[row : row + COARSE[2]] = np.exp(1j * wavenumber * distance)
    return points, turns


def _refined(places: Float, phases: Float, wavenumber: float, start: Float) -> tuple[Float, float]:
    """Return a point refined by Gauss-Newton steps from a start within half a wavelength, and rms residual [rad]."""
    point = np.array(start, float)
    rest = np.zeros(len(places))
    for _ in range(ROUNDS):
        rays = point - places
        distances = np.linalg.norm(rays, axis=1)
        wave = np.exp(1j * (phases + wavenumber * distances))
        rest = np.angle(wave * np.conj(wave.sum()))
        slope = np.column_stack([wavenumber * rays / distances[:, None], np.ones(len(places))])
        step = np.linalg.lstsq(slope, -rest, rcond=None)[0][:3]
        length = float(np.linalg.norm(step))
        point += step * min(1.0, 0.02 / max(length, 1e-12))
        if length < CLOSE_M:
            break
    return point, float(np.sqrt(np.mean(rest**2)))
