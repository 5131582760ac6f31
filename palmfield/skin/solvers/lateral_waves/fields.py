"""Whole fields of the face of a slab: the normal velocity on a grid at many times, under a spot that moves.

`solve` sums every wave at every point, which takes minutes for pictures of an infinite slab. Here the waves are those
of a periodic square, so that their sum on a grid is a Fourier transform; or those of a disc in a smooth wall, with a
transform round the disc. Modes in depth and steps in time are those of the solver.

from palmfield.skin.solvers.lateral_waves.fields import PeriodicSlab
plate = PeriodicSlab(Slab((Sheet(preset("gelatin_2"), 0.01),), base="free"), fwhm_m=0.006, period_m=0.6)
velocity = plate.normal_velocity(spot, times, half_m=0.125, cells=600)
"""

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.fft import ifft, irfft
from scipy.interpolate import CubicSpline
from scipy.special import jnp_zeros, jv

from palmfield.errors import SceneError
from palmfield.skin.problem import Slab, Spot, between, rising
from palmfield.skin.solvers.lateral_waves.march import Timeline, march, on_timeline, spot_transform, timeline
from palmfield.skin.solvers.lateral_waves.modes import FaceModes, depth_problem, face_modes
from palmfield.skin.solvers.lateral_waves.resolution import Resolution, resolution_for
from palmfield.skin.solvers.lateral_waves.waves import WaveSet, compute_modes, lattice
from palmfield.types import Complex, Float, Float32, Int

LEAST_SHARE = 1e-2
"""Least transform of the spot that divides the tolerance of the modes of short waves."""
MODES = 0.1
"""Tolerance of the modes in depth over that of the waves."""
CLEAR_WIDTHS = 1.6
"""Least distance of the centre of a spot from the wall, in widths; there the pressure is below 1e-3 of its peak."""
PHASE = 0.25
"""Largest phase of the shortest wave between two places of the spot [rad]; its load is linear between them."""
SAME_DIGITS = 7
"""Number of decimals to which equal wavenumbers agree [rad/m]."""
FINER_ANGLES = 2
"""Number of angles of the polar grid over the number for its waves, so that cubic interpolation is accurate."""
ROWS = 32
"""Number of moments that are summed together."""
WALL_STEP_m = 5e-4
"""Spacing of the radii of the tabulated waves of the disc [m]; the shortest waves are seven times as long."""


@dataclass(frozen=True)
class _Field:
    """Waves of a slab under spots of one width.

    slab: slab with the shape of the subclass. fwhm_m: width of the spot [m].
    tolerance: of the omitted short waves and of the modes; modes_tolerance replaces the latter.
    horizon_s: last requested time [s]. speed_m_s: largest speed of the spot [m/s]. threads: None for all cores.
    Raises SceneError for another shape, and for sizes that are not above 0.
    """

    slab: Slab
    fwhm_m: float
    _: KW_ONLY
    tolerance: float = 3e-3
    horizon_s: float = 0.05
    speed_m_s: float = 20.0
    threads: int | None = None
    modes_tolerance: float | None = None


@dataclass(frozen=True, kw_only=True)
class PeriodicSlab(_Field):
    """An infinite slab with a load that is periodic in both directions; period_m: period [m].

    The motion of the face is right until waves of the repeated loads arrive: about (period - distance to the load) over
    the fastest group speed. This is twice the shear speed on a free slab, and below the shear speed on a bonded slab.
    """

    period_m: float

    def __post_init__(self) -> None:
        _check(self.slab, "infinite", fwhm_m=self.fwhm_m, period_m=self.period_m)

    @cached_property
    def waves(self) -> WaveSet:
        """Waves, one of each pair k, -k; the weights include the transform of the spot."""
        half = 0.5 * self.period_m
        resolution = resolution_for(self.tolerance, 0.0, self.speed_m_s)
        vectors, weights, k, group = lattice((half, half), resolution.cut(self.fwhm_m))
        modes = _modes(self, k)
        return WaveSet(modes, group, weights * spot_transform(self.fwhm_m, np.linalg.norm(vectors, axis=1)), vectors)

    def normal_velocity(self, spot: Spot, times_s: Float, *, half_m: float, cells: int, device: str = "cpu") -> Float32:
        """Return the outward normal velocity [m/s] at times [s] on the square of +- half_m, shape (t, n, n), float32.

        cells: number of grid places in a period; their spacing is period_m / cells, see `places`
        Raises SceneError for a spot of another width, a grid too coarse for the waves, and times that do not ascend.
        """
        times = _checked_times(spot, times_s, self.fwhm_m)
        numbers, shown = self._grid(half_m, cells)
        return _maps(self._amplitudes(spot, times, device), numbers, cells, shown)

    def line_and_maps(
        self, spot: Spot, times_s: Float, maps: Int, *, half_m: float, cells: int, device: str = "cpu"
    ) -> tuple[Float32, Float32]:
        """Return the normal velocity on the line y = 0 at all times, (t, n), and on the square at some, (m, n, n).

        maps: numbers of the times for the square, shape (m,); other arguments as for `normal_velocity`
        """
        times = _checked_times(spot, times_s, self.fwhm_m)
        numbers, shown = self._grid(half_m, cells)
        amplitude = self._amplitudes(spot, times, device)
        most = int(numbers[:, 0].max())
        of_column = sparse.csr_array(
            (np.ones(len(numbers)), (np.arange(len(numbers)), numbers[:, 0])), shape=(len(numbers), most + 1)
        )
        sums = (of_column.T @ amplitude.T).T
        # On the line m = 0 both a wave and its mirror are needed
        sums[:, 0] = 2.0 * sums[:, 0].real
        spectrum = np.zeros((len(times), cells // 2 + 1), dtype=complex)
        spectrum[:, : most + 1] = sums
        line = irfft(spectrum, cells, axis=1, norm="forward", overwrite_x=True)[:, shown]
        return line.astype(np.float32), _maps(amplitude[maps], numbers, cells, shown)

    def _grid(self, half_m: float, cells: int) -> tuple[Int, Int]:
        """Return the number of periods of each wave along x and y, shape (n, 2), and the numbers of the shown cells."""
        numbers = np.round(self.waves.vectors / (2.0 * math.pi / self.period_m)).astype(np.int32)
        most = int(np.abs(numbers).max())
        if cells < 2 * most + 1:
            raise SceneError(f"cells is {cells}; spots of {self.fwhm_m:g} m need at least {2 * most + 1}")
        return numbers, self._shown(half_m, cells)

    def _amplitudes(self, spot: Spot, times: Float, device: str) -> Complex:
        """Return the normal velocity of each wave times its weight, at the times, shape (t, n)."""
        line = timeline(spot, times)
        if line is None:
            return np.zeros((len(times), len(self.waves)), dtype=complex)
        return _amplitudes(spot, line, self.waves, len(times), device, self.threads)

    def places(self, half_m: float, cells: int) -> Float:
        """Return the coordinates of the grid of `normal_velocity` along x and along y [m], ascending, shape (n,)."""
        shown = self._shown(half_m, cells)
        return np.asarray(np.where(shown > cells // 2, shown - cells, shown) * self.period_m / cells)

    def _shown(self, half_m: float, cells: int) -> Int:
        if not 0.0 < half_m <= 0.5 * self.period_m:
            raise SceneError(
                f"half_m is {half_m:g} m; allowed: above 0, up to half the period, {0.5 * self.period_m:g}"
            )
        reach = math.floor(half_m * cells / self.period_m * (1.0 + 1e-9))
        return np.asarray(np.arange(-reach, reach + 1) % cells)


def _maps(amplitude: Complex, numbers: Int, cells: int, shown: Int) -> Float32:
    """Return the sums of plane waves on the visible cells of a period, shape (t, n, n).

    amplitude: shape (t, w); numbers: number of periods of each wave along x and y, shape (w, 2)
    """
    most = int(np.abs(numbers).max())
    result = np.zeros((len(amplitude), len(shown), len(shown)), dtype=np.float32)
    sums = np.empty((2 * most + 1, most + 1), dtype=complex)
    along = np.zeros((len(shown), cells // 2 + 1), dtype=complex)
    # Half planes of e^{i(mx + ny)} with m >= 0: a complex transform along y, then a real transform along x
    for row, values in enumerate(amplitude):
        sums[...] = 0.0
        sums[numbers[:, 1], numbers[:, 0]] = values
        # On the line m = 0 both a wave and its mirror are needed; the weight of k = 0 is halved
        sums[:, 0] += np.roll(sums[::-1, 0], 1).conj()
        padded = np.zeros((cells, most + 1), dtype=complex)
        padded[: most + 1], padded[cells - most :] = sums[: most + 1], sums[most + 1 :]
        along[:, : most + 1] = ifft(padded, axis=0, norm="forward", overwrite_x=True)[shown]
        result[row] = irfft(along, cells, axis=1, norm="forward")[:, shown].T
    return result


@dataclass(frozen=True)
class WalledDisc(_Field):
    """A disc in a smooth wall, which reflects all waves: no radial motion at the wall, free motion along z.

    The slab is a disc with rollers. Its lateral waves are J_m(k r) e^{i m phi} with J_m'(k R) = 0. The curvature of the
    wall is neglected. So a shear traction along the wall is left, about 2 m / (k R)^2 of that of the wave: 1 % for
    12 mm waves on 25 cm. A free slab moves as a whole, because it has no support.
    """

    def __post_init__(self) -> None:
        _check(self.slab, "disc", fwhm_m=self.fwhm_m)
        if self.slab.side != "roller":
            raise SceneError(f"slab: side is '{self.slab.side}'; allowed: 'roller' (a smooth wall)")

    @property
    def radius_m(self) -> float:
        """Radius of the disc [m]."""
        assert self.slab.radius_m is not None
        return self.slab.radius_m

    @cached_property
    def waves(self) -> tuple[WaveSet, Int]:
        """Waves with vectors (k, m), and the orders m; weights include transform and norm, 1 / integral of J_m^2."""
        resolution = resolution_for(self.tolerance, 0.0, self.speed_m_s)
        orders, k = wall_wavenumbers(self.radius_m, resolution.cut(self.fwhm_m))
        different, group = np.unique(k, return_inverse=True)
        modes = _modes(self, different)
        x = k * self.radius_m
        share = np.where(x > 0.0, 1.0 - (orders / np.where(x > 0.0, x, 1.0)) ** 2, 1.0)
        norm = math.pi * self.radius_m**2 * share * jv(orders, x) ** 2
        weights = spot_transform(self.fwhm_m, k) / norm
        vectors = np.stack([k, orders.astype(float)], axis=1)
        return WaveSet(modes, group.astype(np.int32), weights, vectors), orders

    @cached_property
    def _radii(self) -> Float:
        return np.linspace(0.0, self.radius_m, math.ceil(self.radius_m / WALL_STEP_m) + 1)

    @cached_property
    def _table(self) -> Float:
        """J_m(k r) of each wave at `_radii`, shape (n, r)."""
        waves, orders = self.waves
        return np.asarray(jv(orders[:, None], np.outer(waves.vectors[:, 0], self._radii)))

    def normal_velocity(
        self, spot: Spot, times_s: Float, *, places_m: Float | None = None, spacing_m: float = 1e-3, device: str = "cpu"
    ) -> Float32:
        """Return the outward normal velocity [m/s] at times [s] on a square round the disc, (t, n, n); 0 off the disc.

        places_m: coordinates along x and along y [m], shape (n,); default: spacing `spacing_m`, symmetric
        Raises SceneError for a spot of another width or nearer to the wall than 1.6 widths, and for times like `solve`.
        """
        times = _checked_times(spot, times_s, self.fwhm_m)
        places = self.places(spacing_m) if places_m is None else np.asarray(places_m, dtype=float)
        amplitude, orders = self._amplitudes(spot, times, device)
        count = FINER_ANGLES * 2 ** math.ceil(math.log2(2 * int(orders.max()) + 2))
        inside, to_square = self._to_square(tuple(places.tolist()), count)
        by_order = [np.flatnonzero(orders == m) for m in range(int(orders.max()) + 1)]
        tables = [self._table[chosen] for chosen in by_order]
        result = np.zeros((len(times), *inside.shape), dtype=np.float32)
        for start in range(0, len(times), ROWS):
            rows = amplitude[start : start + ROWS]
            spectrum = np.zeros((count // 2 + 1, len(self._radii), len(rows)), dtype=complex)
            for m, (chosen, table) in enumerate(zip(by_order, tables, strict=True)):
                spectrum[m].real = table.T @ rows[:, chosen].real.T
                spectrum[m].imag = table.T @ rows[:, chosen].imag.T
            polar = irfft(spectrum, count, axis=0, norm="forward", overwrite_x=True)
            flat = np.ascontiguousarray(polar.transpose(1, 0, 2)).reshape(-1, len(rows))
            result[start : start + ROWS][:, inside] = (to_square @ flat).T
        return result

    @lru_cache(maxsize=2)  # noqa: B019 (of a frozen object that lives as long as its waves)
    def _to_square(self, places: tuple[float, ...], count: int) -> tuple[NDArray[np.bool_], sparse.csr_array]:
        """Return which places of the square lie on the disc, (n, n), and the matrix from polar values to these places:
        cubic interpolation in radius and angle."""
        x, y = np.meshgrid(places, places, indexing="ij")
        inside = np.hypot(x, y) <= self.radius_m * (1.0 + 1e-9)
        radius = np.hypot(x, y)[inside] / self._radii[1]
        angle = np.mod(np.arctan2(y, x)[inside], 2.0 * np.pi) / (2.0 * np.pi) * count
        last = len(self._radii) - 1
        first = np.clip(np.floor(radius).astype(int) - 1, 0, last - 3)
        begin = np.floor(angle).astype(int) - 1
        parts = []
        for i, across in enumerate(_cubic(radius - first)):
            for j, along in enumerate(_cubic(angle - begin)):
                column = (first + i) * count + (begin + j) % count
                parts.append((across * along, column))
        rows = np.tile(np.arange(len(radius)), len(parts))
        values, columns = (np.concatenate(part) for part in zip(*parts, strict=True))
        shape = (len(radius), (last + 1) * count)
        return inside, sparse.csr_array((values, (rows, columns)), shape=shape)

    def places(self, spacing_m: float) -> Float:
        """Return the coordinates of the default grid along x and along y [m], shape (n,)."""
        reach = math.floor(self.radius_m / spacing_m * (1.0 + 1e-9))
        return np.asarray(spacing_m * np.arange(-reach, reach + 1), dtype=float)

    def _amplitudes(self, spot: Spot, times: Float, device: str) -> tuple[Complex, Int]:
        """Return the normal velocity of each wave times its weight, at the requested times, (t, n), and the orders."""
        waves, orders = self.waves
        fine = self._linear(spot)
        line = timeline(fine, times)
        if line is None:
            return np.zeros((len(times), len(waves)), dtype=complex), orders
        centres = fine.centres()
        radius, angle = np.hypot(*centres.T), np.arctan2(centres[:, 1], centres[:, 0])
        if radius.max() > self.radius_m - CLEAR_WIDTHS * self.fwhm_m:
            raise SceneError(
                f"the spot comes to {radius.max():g} m from the centre; on a disc of {self.radius_m:g} m it must "
                f"stay {CLEAR_WIDTHS * self.fwhm_m:g} m from the wall"
            )
        turns = np.exp(-1j * np.outer(np.arange(int(orders.max()) + 1), angle))

        def force(part: slice) -> Float:
            values = CubicSpline(self._radii, self._table[part], axis=1)(radius)
            return on_timeline(fine.law, fine.times_s, values * turns[orders[part]] * fine.peak_Pa, line)

        return _amplitudes(fine, line, waves, len(times), device, self.threads, force), orders

    def _linear(self, spot: Spot) -> Spot:
        """Return the spot with more places, so that the phase of the shortest wave changes by less than PHASE."""
        if spot.law == "held":
            return spot
        short = resolution_for(self.tolerance, 0.0, self.speed_m_s).cut(self.fwhm_m)
        step = PHASE / short
        times, centres = [spot.times_s[:1]], spot.centres()
        for n in range(len(spot.times_s) - 1):
            way = float(np.linalg.norm(centres[n + 1] - centres[n]))
            times.append(np.linspace(spot.times_s[n], spot.times_s[n + 1], max(1, math.ceil(way / step)) + 1)[1:])
        fine = np.concatenate(times)
        return Spot(spot.fwhm_m, fine, between(spot, spot.peak_Pa, fine), between(spot, centres, fine), "linear")


def _cubic(x: Float) -> tuple[Float, ...]:
    """Return the weights of values at 0, 1, 2, 3 for the cubic polynomial through them, at x."""
    return (
        (1.0 - x) * (2.0 - x) * (3.0 - x) / 6.0,
        x * (2.0 - x) * (3.0 - x) / 2.0,
        -x * (1.0 - x) * (3.0 - x) / 2.0,
        x * (1.0 - x) * (2.0 - x) / 6.0,
    )


def wall_wavenumbers(radius_m: float, k_end: float) -> tuple[Int, Float]:
    """Return the orders m and wavenumbers k [rad/m] up to k_end with J_m'(k R) = 0, with k = 0 of order 0."""
    end = k_end * radius_m
    orders, k = [np.zeros(1, dtype=int)], [np.zeros(1)]
    for m in range(math.floor(end) + 1):
        # Number of zeros below `end` from the phase of J_m, with an error below one
        ahead = (math.sqrt(end**2 - m**2) - m * math.acos(m / end)) / math.pi
        zeros = jnp_zeros(m, math.ceil(ahead) + 2)
        zeros = zeros[zeros <= end]
        orders.append(np.full(len(zeros), m))
        k.append(zeros / radius_m)
    return np.concatenate(orders), np.concatenate(k)


def _amplitudes(
    spot: Spot,
    line: Timeline,
    waves: WaveSet,
    rows: int,
    device: str,
    threads: int | None,
    force_on: Callable[[slice], Float] | None = None,
) -> Complex:
    """Return the normal velocity of each wave times its weight, at the requested times, shape (rows, n)."""
    result = np.zeros((rows, len(waves)), dtype=complex)

    def keep(part: slice, amplitude: Complex) -> Float:
        result[:, part] = amplitude[:, :, 2] * waves.weights[part]
        return np.zeros(1)

    march(spot, line, waves, rows, keep, device, threads, force_on)
    return result


@lru_cache(maxsize=8)
def _stored_modes(slab: Slab, fwhm_m: float, resolution: Resolution, horizon_s: float) -> dict[float, FaceModes]:
    """Return a cache of modes by rounded wavenumber, shared by lattices of half a period; discs use that of a slab."""
    return {}


def _modes(of: _Field, k: Float) -> tuple[FaceModes, ...]:
    slab, fwhm_m, horizon_s = of.slab, of.fwhm_m, of.horizon_s
    resolution = resolution_for(of.modes_tolerance or of.tolerance, 0.0, of.speed_m_s)
    whole = float(spot_transform(fwhm_m, np.zeros(1))[0])

    def modes_at(number: float) -> FaceModes:
        share = float(spot_transform(fwhm_m, np.array([number]))[0]) / whole
        tolerance = MODES * resolution.tolerance / max(share, LEAST_SHARE)
        return face_modes(
            depth_problem(slab, number, resolution.degrees(slab, number)), horizon_s, min(tolerance, 0.03)
        )

    stored = _stored_modes(slab, fwhm_m, resolution, horizon_s)
    keys = np.round(k, SAME_DIGITS).tolist()
    missing = [n for n, key in enumerate(keys) if key not in stored]
    new = compute_modes(modes_at, k[missing], of.threads)
    stored.update((keys[n], modes) for n, modes in zip(missing, new, strict=True))
    return tuple(stored[key] for key in keys)


def _check(slab: Slab, shape: str, **sizes: float) -> None:
    if slab.shape != shape:
        raise SceneError(f"slab: shape is '{slab.shape}'; here it must be '{shape}'")
    for name, value in sizes.items():
        if not (math.isfinite(value) and value > 0.0):
            raise SceneError(f"{name} is {value}; give metres above 0")


def _checked_times(spot: Spot, times_s: Float, fwhm_m: float) -> Float:
    if spot.fwhm_m != fwhm_m:
        raise SceneError(
            f"spot: fwhm_m is {spot.fwhm_m:g}; the waves were built for a spot of {fwhm_m:g} m; use that width"
        )
    return rising("times", times_s)
