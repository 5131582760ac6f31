"""Where the focus is that some amplitudes make: the point to which their phases fit best."""

import numpy as np

from palmfield.types import Complex, Float

REACH_M = 0.6
NEAREST_M = 0.04
COARSE = (25, 25, 24)
ROUNDS = 30
CLOSE_M = 1e-8


def fitted_focus(
    positions: Float, amplitudes: Complex, wavenumber: float, near: Float | None = None, *, anywhere: bool = True
) -> tuple[Float, float]:
    """The focus [m], shape (3,), whose phases -k d fit best in the least-squares sense, and the rms of the rest [rad].

    positions: of the transducers [m], shape (n, 3), with the sound on the side of growing z; amplitudes: shape (n,),
    e^{-iwt}; those that are off don't count; near: where to begin, None to look everywhere within 0.6 m
    anywhere: whether to look everywhere too where nothing near fits, which takes some 0.1 s
    NaN where fewer than four transducers sound.
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
        begin = _coarse(places, phases, wavenumber) if start is None else start
        found = _refined(places, phases, wavenumber, begin)
        best = found if best is None or found[1] < best[1] else best
    assert best is not None
    return best


def _coarse(places: Float, phases: Float, wavenumber: float) -> Float:
    """The point of a grid, then of finer ones, where the sound of all transducers comes most in step."""
    low, high = places.min(axis=0) - 0.05, places.max(axis=0) + 0.05
    low[2], high[2] = places[:, 2].max() + NEAREST_M, places[:, 2].max() + REACH_M
    while True:
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, COARSE, strict=True)]
        best, best_sum = low, -1.0
        for z in axes[2]:
            x, y = np.meshgrid(axes[0], axes[1], indexing="ij")
            points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])
            distances = np.linalg.norm(points[:, None] - places, axis=2)
            sums = np.abs(np.exp(1j * (phases + wavenumber * distances)).sum(axis=1))
            if sums.max() > best_sum:
                best, best_sum = points[int(sums.argmax())], float(sums.max())
        spacing = np.array([axis[1] - axis[0] for axis in axes])
        if spacing.max() < 4e-3:
            return np.asarray(best)
        floor = places[:, 2].max() + NEAREST_M
        low, high = best - 2.0 * spacing, best + 2.0 * spacing
        low[2] = max(low[2], floor)


def _refined(places: Float, phases: Float, wavenumber: float, start: Float) -> tuple[Float, float]:
    """Gauss-Newton steps from a point that is nearer than about half a wavelength aside."""
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
