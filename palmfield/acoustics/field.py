"""Pressure and its gradient from an array of transducers, on the CPU or a GPU."""

import functools
import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import warp as wp
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import ArrayLike, NDArray

from palmfield.acoustics import check, polynomials
from palmfield.acoustics.air import absorption_Np_m as air_absorption
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.directivities import directivity_coefficients
from palmfield.acoustics.groups import groups
from palmfield.device import SharedBlock, filled, launching, recorded, replayed, resolve, whole_numbers
from palmfield.errors import PalmfieldError
from palmfield.threads import Calls, cores, share
from palmfield.types import Air, Array, Complex, Field, Float, Int
from warp_kernels import gradient as with_gradient
from warp_kernels import pressure as kernels

BLOCKS_PER_THREAD = 4
PAIRS_PER_THREAD = 100_000
"""Smallest number of pairs (point, transducer) per thread: 0.13 ms of work, and 0.02 ms to start a thread."""
SMALL_BLOCK_PAIRS = 250_000
"""Smallest block when threads are balanced [pairs of point and transducer]."""

MOST_POINTS = 2**17
"""Largest number of points in one pass; more points take several passes."""
SIZES_STORED = 8
THREADS_ENOUGH = 2**17
"""Number of threads that fills a GPU; for fewer points the transducers are divided as well."""
SHORTEST_RUN = 32
"""Smallest number of transducers per thread."""

WIDE = 1024
"""Number of points per block of a comparison; NumPy along rows of three takes 70 times as long."""

RANGE_STEP_M = 1.0 / 64.0
"""Grid of the ends of the range in which the decay of sound is fitted [m]. A fit is then valid for many poses. It
depends only on the present positions of the points, so runs repeat to the bit."""

CUBIC_REACH_Np = 0.4
"""Largest absorption times range of distances for a cubic in place of the exponential, with an error of 1e-5."""

QUADRATIC_REACH_Np = 0.08
"""Largest absorption times range of distances for a quadratic, with an error of 3e-6."""

SMOOTH = 1e-5
"""Largest error of a quartic for directivities; it has one power less than the quintic and saves 1/20 of the work."""

Mode = Literal["fast", "accurate"]
MODES: tuple[Mode, ...] = ("fast", "accurate")


@dataclass(frozen=True)
class Points:
    """Points on the device of a field. array: Warp array, shape (n,); low, high: corners of their box [m]."""

    array: Any
    low: Sequence[float] = (-check.FARTHEST_m,) * 3
    high: Sequence[float] = (check.FARTHEST_m,) * 3


class FieldSum(ABC):
    """Sum of the fields of one or several evaluators; thread-safe.

    Buffers are stored for the next call with the same number of points, so that only the result is allocated.

    device: as returned by `resolve`; count: number of drives; name: name for errors
    """

    device: str
    count: int
    name: str

    def __init__(self) -> None:
        # Free buffers, by number of points, gradient and normals
        self._calls: dict[tuple[int, bool, bool], list[_Call]] = {}

    @property
    @abstractmethod
    def parts(self) -> "Parts":
        """Return each evaluator with the indices of the drives of its transducers, in its order."""

    def pressure(self, points: Any, drive: ArrayLike, gradient: bool = False, normals: Any = None) -> Field:
        """Return the field at points; see function `pressure` for shapes, units and errors.

        points: NumPy array, or a Warp array on the device of wp.vec3 (wp.vec3d in mode accurate), shape (n,), or the
            result of `upload`. For Warp arrays the result is Warp arrays of (real, imaginary), wp.vec2: pressure, shape
            (n,), and gradient, shape (n, 3). On a GPU the call is asynchronous, and Warp coordinates are not checked.
        drive: complex amplitudes of all transducers, shape (count,).
        normals: unit outward normals of opaque surfaces at the points, shape (n, 3), a Warp array of wp.vec3 for Warp
            points. Sound from behind the surface is omitted (`warp_kernels.pressure.from_front`); implies gradient.
        """
        gradient = gradient or normals is not None
        on_device = isinstance(points, Points | wp.array)
        where: Any = self._on_device(points, normals) if on_device else check.positions(points)
        emitted = check.amplitudes(drive, self.count, self.name)
        total = len(where.array) if on_device else len(where)
        shapes: tuple[tuple[int, ...], ...] = ((total,), (total, 3)) if gradient else ((total,),)
        if on_device:
            results: list[Any] = [wp.zeros(shape, dtype=wp.vec2, device=self.device) for shape in shapes]
        else:
            results = [np.zeros(shape, np.complex64) for shape in shapes]
        for start in range(0, total if self.count > 0 else 0, MOST_POINTS):
            own = slice(start, min(start + MOST_POINTS, total))
            key = own.stop - own.start, gradient, normals is not None
            free = self._calls.get(key)
            if free is None:
                if len(self._calls) >= SIZES_STORED:
                    self._calls.clear()
                free = self._calls[key] = []
            try:
                call = free.pop()
            except IndexError:
                call = _Call(self.parts, *key)
            outward = None if normals is None else part(normals, own)
            targets = [part(result, own) for result in results]
            if on_device:
                call.run_on_device(self.parts, replace(where, array=part(where.array, own)), emitted, outward, targets)
            elif not call.run(self.parts, where[own], emitted, outward, targets):
                check.points(where, np.float64)  # raises an error with the invalid point
            free.append(call)
        return Field(*results)

    def upload(self, points: ArrayLike) -> Points:
        """Copy points [m], shape (n, 3), to the device for several calls of `pressure`; errors like `pressure`."""
        one = self.parts[0][0]
        where = check.points(points, one.real)
        array: Any = wp.array(where, dtype=one.vectors[0], device=self.device)
        return Points(array, *corners(where)) if len(where) > 0 else Points(array)

    def _on_device(self, points: Any, normals: Any) -> Points:
        """Return points as Warp arrays. Raises PalmfieldError for arrays of another type, shape or device."""
        one = self.parts[0][0]
        result = points if isinstance(points, Points) else Points(points)
        for name, array, dtype in (("points", result.array, one.vectors[0]), ("normals", normals, wp.vec3)):
            required = f"Warp array of {dtype.__name__}, shape {result.array.shape[:1]}, on {self.device}"
            actual = type(array).__name__
            if isinstance(array, wp.array):
                actual = f"Warp array of {array.dtype.__name__}, shape {array.shape}, on {array.device}"
            if array is not None and actual != required:
                raise PalmfieldError(f"{name} is a {actual}; allowed: a {required}, or NumPy points and normals")
        if self.device != "cpu" or result is points or len(result.array) == 0:
            return result
        return Points(result.array, *corners(check.points(result.array.numpy(), one.real)))


def part(values: Any, own: slice) -> Any:
    """Return a slice of the values; for all of them the values themselves, since Warp slices take 10 us."""
    return values if own.stop - own.start == len(values) else values[own]


class FieldEvaluator(FieldSum):
    """Field of one array in one air. Both are stored on the device, so that a call transfers only points and drive.

    mode: "fast" computes in float32, whose phase error grows with distance: 1.2e-5 of the field at 0.05 to 0.4 m and
        4e-5 at 0.4 to 1.2 m (on a GPU 2e-5 and 6e-5); "accurate" computes distance and phase in float64.
    threads: number of threads on the CPU, 1 or more; None is all cores of this process.
    absorption_Np_m: replaces the absorption of the air, for example 0 for lossless air.
    """

    def __init__(
        self,
        array: Array,
        air: Air,
        device: str = "auto",
        *,
        threads: int | None = None,
        absorption_Np_m: float | None = None,
        mode: Mode = "fast",
    ):
        super().__init__()
        check.array(array)
        if mode not in MODES:
            raise PalmfieldError(f"mode '{mode}' is unknown: use one of {', '.join(MODES)}")
        if threads is not None and threads < 1:
            raise PalmfieldError(f"threads = {threads}; allowed: 1 or more, or None for all cores")
        self.array, self.air = array, air
        self.device, self.count, self.name = resolve(device), len(array), f"array '{array.name}'"
        self.threads = cores() if threads is None else threads
        self.mode = mode
        self.absorption_Np_m = check.absorption(
            air_absorption(air, array.frequency_Hz) if absorption_Np_m is None else absorption_Np_m
        )
        self._gpu = self.device != "cpu"
        self._accurate = mode == "accurate"
        self.real: type[np.floating] = np.float64 if self._accurate else np.float32
        wavenumber = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
        directivity, slope, self._smooth = off_axis(array, wavenumber)
        sine, cosine = polynomials.sine_cosine()
        polynomial = {
            "directivity": kernels.vec6(*directivity),
            "sine": kernels.vec6(*sine),
            "cosine": kernels.vec6(*cosine),
        }

        def sound(unit_m: float) -> Any:
            """Return the constants of the kernels for lengths in this unit."""
            return filled(
                kernels.Sound(),
                turns_per_m=unit_m * wavenumber / (2.0 * np.pi),
                turns32_per_m=unit_m * wavenumber / (2.0 * np.pi),
                wavenumber_rad_m=unit_m * wavenumber,
                absorption_Np_m=unit_m * self.absorption_Np_m,
                slope=kernels.vec6(*slope / (unit_m * wavenumber)),
                **polynomial,
            )

        self.sound, self._radians = sound(1.0), sound(1.0 / wavenumber)
        self._wavenumber = wavenumber
        self._shapes = self._upload(np.array([directivity, slope], np.float32), kernels.vec6)
        self._groups = groups(array)
        vec3, _, mat33 = self.vectors
        self._origins = self._upload(self._groups.origins.astype(self.real), vec3)
        self._turns = self._upload(self._groups.turns.astype(self.real), mat33)
        self._turns_radians = self._upload((wavenumber * self._groups.turns).astype(self.real), mat33)
        self._box = corners(array.positions) if len(array) > 0 else ([0.0] * 3, [0.0] * 3)

    @property
    def parts(self) -> "Parts":
        return ((self, self.order),)

    def _form(self, fall: str, shaded: bool = False, faced: bool = False) -> kernels.Form:
        smooth = self._smooth and not self._accurate
        return kernels.Form(self._gpu, self._accurate, fall, smooth, self._groups.flat, shaded, faced)

    def kernel(self, fall: str, gradient: bool, shaded: bool = False, faced: bool = False) -> Any:
        """Return the kernel for a method of decay, see `falling`; shaded, faced: see `Form`."""
        form = self._form(fall, shaded, faced)
        return with_gradient.gradient(form) if gradient else kernels.pressure(form)

    @property
    def vectors(self) -> tuple[Any, Any, Any]:
        """Warp types of a position, of four numbers and of a rotation."""
        return self._form("cubic").vectors

    @property
    def points_per_thread(self) -> int:
        """Number of points per thread of a kernel."""
        return kernels.WIDTH["gpu" if self._gpu else "cpu"]

    @property
    def ranges(self) -> Int:
        """First transducer of each group and one past the last, in the numbering of `order`, shape (g, 2)."""
        return self._groups.ranges

    def ranges_of(self, drives: int) -> Int:
        """Return `ranges` with the first drive and one past the last, for kernels with gradient, shape (g, 4)."""
        return np.insert(self.ranges, 2, [[0], [drives]], axis=1)

    def inputs(self, elements: Any, strengths: Any, gradient: bool, ranges: Any) -> list[Any]:
        """Return the arguments of a kernel between points and results, on the device.

        elements, strengths: see `elements`; ranges: as returned by `ranges_of`, or without gradient the first
        transducer of each group and one past the last, wp.vec2i, shape (parts, g)
        """
        if gradient:
            turns, sound, shapes = self._turns_radians, self._radians, [self._shapes]
        else:
            turns, sound, shapes = self._turns, self.sound, []
        return [self._origins, turns, ranges, elements, strengths, sound, *shapes]

    def fall(self, low: Sequence[float], high: Sequence[float], gradient: bool) -> tuple[str, Float]:
        """Return the method of decay to a box with these corners [m], see `falling`, and p0 times its coefficients.

        The coefficients, shape (4,), are for lengths in m, or with gradient in units of 1/k.
        """
        # The same as `distances` of two boxes, without a call, because every evaluation needs it
        gap, reach = 0.0, 0.0
        for first, last, least, most in zip(low, high, *self._box, strict=True):
            gap += max(least - last, first - most, 0.0) ** 2
            reach += (max(last, most) - min(first, least)) ** 2
        steps = int(math.sqrt(gap) / RANGE_STEP_M), int(math.sqrt(reach) / RANGE_STEP_M) + 1
        return _fall(self.absorption_Np_m, self.array.p0_Pa_m, 1.0 / self._wavenumber if gradient else 1.0, *steps)

    def elements(self, gradient: bool) -> NDArray[Any]:
        """Return x, y, phase (0) and z of each transducer in the order of its groups, shape (n, 4).

        Kernels also take strengths, shape (n, 4): p0 times amplitude times the coefficients of the decay. Kernels with
        gradient take drives instead and lengths in units of 1/k.
        """
        elements = np.zeros((len(self.order), 4), self.real)
        elements[:, [0, 1, 3]] = (self._wavenumber if gradient else 1.0) * self._groups.places
        return elements

    @property
    def order(self) -> Int:
        """Numbers of the transducers in the order of the kernels, shape (n,)."""
        return self._groups.order

    @property
    def phase_unit(self) -> float:
        """Unit of phase in the kernels [rad]: a turn or a radian."""
        return 1.0 if self._gpu and not self._accurate else 2.0 * np.pi

    def _upload(self, values: NDArray[Any], dtype: Any) -> Any:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)


Parts = Sequence[tuple[FieldEvaluator, Int]]


class _Call:
    """Buffers and recorded launches for `count` points, for one call at a time.

    On a GPU the launches are a graph of the upload of the inputs, the kernels, and the download of the result.
    """

    def __init__(self, parts: Parts, count: int, gradient: bool, faced: bool):
        one = parts[0][0]
        self._device, self._gradient, self._faced = one.device, gradient, faced
        self._gpu = one.device != "cpu"
        self._guard: AbstractContextManager[object] = launching if self._gpu else nullcontext()
        # Event after which the last upload has left the buffers
        self._sent = wp.Event(one.device) if self._gpu else None
        accurate = one.mode == "accurate"
        vec3, vec4, _ = one.vectors
        # Points are last: if they are already on the device, only the data before them is uploaded
        self._inputs = SharedBlock(
            {
                "drive": ((1, sum(len(chosen) for _, chosen in parts)), wp.vec2 if gradient else wp.vec2d),
                "falls": ((len(parts),), wp.vec4 if gradient else wp.vec4d),
                "points": ((count,), vec3),
                "normals": ((count if faced else 0,), wp.vec3),
            },
            one.device,
        )
        shapes: dict[str, tuple[tuple[int, ...], Any]] = {"pressure": ((1, count), wp.vec2)}
        if gradient:
            shapes["gradient"] = ((1, count, 3), wp.vec2)
        self._results = SharedBlock(shapes, one.device)
        self._drive = self._inputs.hosts["drive"].view(np.complex64 if gradient else np.complex128)[0, :, 0]
        self._views = [host.view(np.complex64)[0, ..., 0] for host in self._results.hosts.values()]
        self._chosen = np.concatenate([chosen for _, chosen in parts])
        gains = [1.0 if part.array.gain is None else part.array.gain[part.order] for part, _ in parts]
        self._gain = np.concatenate([gain * np.ones(part.count) for gain, (part, _) in zip(gains, parts, strict=True)])
        drives, falls = self._inputs.arrays["drive"], self._inputs.arrays["falls"]
        self._one = whole_numbers([1], one.device)
        self._emitted: list[Callable[[], object]] = []
        self._rows: list[tuple[Any, Any, Any]] = []
        start = 0
        for i, (evaluator, chosen) in enumerate(parts):
            size = len(chosen)
            elements: Any = wp.array(evaluator.elements(gradient), dtype=vec4, device=one.device)
            strengths: Any = drives[:, start : start + size]
            start += size
            if not gradient:
                inputs = [strengths[0], falls[i : i + 1], 1.0 / evaluator.phase_unit, elements]
                strengths = wp.empty(size, dtype=wp.vec4, device=one.device)
                self._emitted.append(recorded(kernels.emitted(accurate), size, [*inputs, strengths], one.device))
            ranges = evaluator.ranges_of(1) if gradient else split(evaluator.ranges, splits(evaluator, count))
            kind = wp.vec4i if gradient else wp.vec2i
            on_device: Any = wp.array(np.ascontiguousarray(ranges), dtype=kind, device=one.device)
            self._rows.append((elements, strengths, on_device))
        rows = 1 if gradient else sum(ranges.shape[0] for *_, ranges in self._rows)
        self._pressures = self._results.arrays["pressure"]
        if rows > 1:
            self._pressures = wp.zeros((rows, count), dtype=wp.vec2, device=one.device)
        self._threads, self._blocks = shared_out(one, count, len(self._chosen), one.threads)
        self._launches: dict[tuple[tuple[str, ...], bool], Callable[[], object]] = {}

    def run(self, parts: Parts, points: NDArray[Any], drive: Complex, normals: Any, results: list[Any]) -> bool:
        """Fill `results` (pressure, and gradient); return False for points that are not finite or too far away."""
        here = self._inputs.hosts["points"]
        with np.errstate(over="ignore"):
            here[...] = points
        low, high = corners(here)
        if not math.isfinite(sum(low) + sum(high)) or min(low) < -check.FARTHEST_m or max(high) > check.FARTHEST_m:
            return False
        if normals is not None:
            self._inputs.hosts["normals"][...] = normals
        launch = self._prepared(parts, low, high, drive, True)
        with self._guard:
            launch()
            if self._gpu:
                wp.synchronize_stream(self._device)
        for result, view in zip(results, self._views, strict=True):
            result[...] = view
        return True

    def run_on_device(self, parts: Parts, points: Points, drive: Complex, normals: Any, results: list[Any]) -> None:
        """Fill Warp arrays from Warp arrays like `run`, but asynchronously."""
        launch = self._prepared(parts, points.low, points.high, drive, False)
        arrays = self._inputs.arrays
        with self._guard:
            self._inputs.upload("points")
            if self._sent is not None:
                wp.get_stream(self._device).record_event(self._sent)
            wp.copy(arrays["points"], points.array)
            if normals is not None:
                wp.copy(arrays["normals"], normals)
            launch()
            for result, array in zip(results, self._results.arrays.values(), strict=True):
                wp.copy(result, array[0])

    def _prepared(
        self, parts: Parts, low: Sequence[float], high: Sequence[float], drive: Complex, copied: bool
    ) -> Callable[[], object]:
        """Store the drive; return launches for points in a box, with copies from and to the host if `copied`."""
        falls = [one.fall(low, high, self._gradient) for one, _ in parts]
        key = tuple(kind for kind, _ in falls), copied
        launch = self._launches.get(key)
        if launch is None:
            calls = self._record(parts, key[0])
            if copied:
                calls = [self._inputs.upload, *calls, self._results.download]
            launch = replayed(calls, self._device) if self._gpu else functools.partial(share, [calls], 1)
            self._launches[key] = launch
        if self._sent is not None:
            with self._guard:
                wp.synchronize_event(self._sent)
        np.multiply(drive[self._chosen], self._gain, out=self._drive)
        self._inputs.hosts["falls"][...] = [fall for _, fall in falls]
        return launch

    def _record(self, parts: Parts, falls: tuple[str, ...]) -> list[Callable[[], object]]:
        arrays, results = self._inputs.arrays, self._results.arrays
        blocks: list[Calls] = []
        for own in self._blocks:
            calls, row, count = [], 0, own.stop - own.start
            room = scratch(self._device)
            for i, ((one, _), fall, of_part) in enumerate(zip(parts, falls, self._rows, strict=True)):
                inputs = [arrays["points"][own], *one.inputs(*of_part[:2], self._gradient, of_part[2])]
                dim = 1, -(-count // one.points_per_thread)
                if self._gradient:
                    normals = arrays["normals"][own] if self._faced else None
                    slices = (result[:, own] for result in results.values())
                    inputs += [arrays["falls"][i : i + 1], self._one, i > 0, *slices, None, None, normals, room]
                else:
                    dim = of_part[2].shape[0], dim[1]
                    inputs.append(self._pressures[row : row + dim[0], own])
                    row += dim[0]
                kernel = one.kernel(fall, self._gradient, faced=self._faced)
                calls.append(recorded(kernel, dim, inputs, self._device))
            if row > 1:
                inputs = [self._pressures[:, own], results["pressure"][0, own]]
                calls.append(recorded(kernels.sum_of_parts, count, inputs, self._device))
            blocks.append(calls)
        return [*self._emitted, functools.partial(share, blocks, self._threads)]


def scratch(device: str) -> Any:
    """Return the work arrays of the kernels with gradient, which each uses while it runs."""
    return wp.empty(with_gradient.SCRATCH if device == "cpu" else 0, dtype=wp.float32, device=device)


def shared_out(one: FieldEvaluator, count: int, transducers: int, threads: int) -> tuple[int, list[slice]]:
    """Return the number of useful threads for these points, and the blocks of points for the threads."""
    pairs = count * transducers
    if one.device != "cpu" or pairs == 0:
        return 1, [slice(0, count)]
    threads = max(1, min(threads, pairs // PAIRS_PER_THREAD))
    blocks = threads if threads == 1 else max(threads, min(BLOCKS_PER_THREAD * threads, pairs // SMALL_BLOCK_PAIRS))
    width = one.points_per_thread
    size = -(-count // (blocks * width)) * width
    return threads, [slice(start, min(start + size, count)) for start in range(0, count, size)]


def splits(one: FieldEvaluator, count: int) -> int:
    """Return the number of parts into which transducers are divided, so that there are enough threads."""
    threads = -(-count // one.points_per_thread)
    return 1 if one.device == "cpu" else max(1, min(len(one.array) // SHORTEST_RUN, THREADS_ENOUGH // threads))


def split(ranges: Int, parts: int) -> Int:
    """Return ranges (g, 2) in parts of equal length, shape (parts, g, 2)."""
    first, stop = ranges[:, 0], ranges[:, 1]
    ends = first + (stop - first) * np.arange(parts + 1)[:, None] // parts
    return np.stack([ends[:-1], ends[1:]], axis=2).astype(np.int32)


ENDS: tuple[Any, Any] = (np.minimum.reduce, np.maximum.reduce)


def corners(points: NDArray[Any]) -> tuple[list[float], list[float]]:
    """Return smallest and largest x, y, z of contiguous points, shape (n, 3), n > 0; NaN if a coordinate is NaN."""
    whole = len(points) // WIDE * WIDE
    if whole > 2 * WIDE:
        wide = points[:whole].reshape(-1, 3 * WIDE)
        points = np.concatenate([*(reduce(wide, axis=0).reshape(WIDE, 3) for reduce in ENDS), points[whole:]])
    columns = np.ascontiguousarray(points.T)
    return ENDS[0](columns, axis=1).tolist(), ENDS[1](columns, axis=1).tolist()


def distances(points: NDArray[Any], positions: Float) -> tuple[float, float]:
    """Return bounds of the distances between points and positions [m], from their boxes."""
    gap, reach = 0.0, 0.0
    for first, last, least, most in zip(*corners(np.ascontiguousarray(points)), *corners(positions), strict=True):
        gap += max(least - last, first - most, 0.0) ** 2
        reach += (max(last, most) - min(first, least)) ** 2
    return math.sqrt(gap), math.sqrt(reach)


@functools.lru_cache(maxsize=256)
def _fall(absorption_Np_m: float, p0_Pa_m: float, unit_m: float, near: int, far: int) -> tuple[str, Float]:
    """Return `FieldEvaluator.fall` between two distances in RANGE_STEP_M."""
    kind, fall = falling(absorption_Np_m, near * RANGE_STEP_M, far * RANGE_STEP_M)
    # Coefficients are for distances in this unit, so that amplitudes over distance stay in Pa
    scaled: Float = p0_Pa_m * fall * unit_m ** np.array([-1.0, 0.0, 1.0, 2.0])
    scaled.setflags(write=False)
    return kind, scaled


def falling(absorption_Np_m: float, low: float, high: float) -> tuple[str, Float]:
    """Return the kernels' method for exp(-absorption d), d from low to high [m], and its coefficients, shape (4,)."""
    reach = absorption_Np_m * (high - low)
    if reach > CUBIC_REACH_Np:
        return "exponential", np.array([1.0, 0.0, 0.0, 0.0])
    if reach > QUADRATIC_REACH_Np:
        return "cubic", polynomial_fall(absorption_Np_m, low, high, 3)
    return "quadratic", polynomial_fall(absorption_Np_m, low, high, 2)


@functools.cache
def _chebyshev(power: int) -> tuple[Float, Float]:
    """Return nodes in -1 to 1, shape (power + 1,), and the matrix from values there to polynomial coefficients."""
    points = np.cos(np.pi * (np.arange(power + 1.0) + 0.5) / (power + 1))
    return points, np.linalg.inv(np.vander(points, increasing=True))


def polynomial_fall(absorption_Np_m: float, low: float, high: float, power: int = 3) -> Float:
    """Return coefficients, lowest power first, shape (4,), of exp(-absorption d) for d from low to high [m].

    The exponential is interpolated at Chebyshev nodes. NumPy's interpolation takes 190 Python calls, too many between
    the steps of a simulation.
    """
    fall = np.zeros(4)
    if absorption_Np_m == 0.0 or high <= low:
        fall[0] = math.exp(-absorption_Np_m * low)
        return fall
    points, coefficients = _chebyshev(power)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    # From powers of (d - middle) / half to those of d, by Horner's rule
    for coefficient in (coefficients @ np.exp(-absorption_Np_m * (middle + half * points)))[::-1]:
        lower = fall * (-middle / half)
        lower[1:] += fall[:-1] / half
        lower[0] += coefficient
        fall = lower
    return fall


def off_axis(array: Array, wavenumber: float) -> tuple[Float, Float, bool]:
    """Return the directivity in q = cos^2 of the angle off the axis, and twice its derivative in q, shapes (6,), (6,).

    The third value is whether they are a quartic and a cubic (padded with zeros), see SMOOTH.
    """
    in_sine, _ = directivity_coefficients(array, wavenumber)
    return _in_cosine(tuple(in_sine.tolist()))


@functools.lru_cache(maxsize=64)
def _in_cosine(in_sine: tuple[float, ...]) -> tuple[Float, Float, bool]:
    """Return `off_axis` from a polynomial in sin^2; cached, since moving arrays get new evaluators in each step."""
    quintic: Any = Polynomial(in_sine)(Polynomial([1.0, -1.0]))
    slope: Any = 2.0 * quintic.deriv()
    quartic = Chebyshev.interpolate(quintic, 4, domain=[0.0, 1.0])
    q = np.linspace(0.0, 1.0, 201)
    smooth = bool(np.abs(quartic(q) - quintic(q)).max() <= SMOOTH)
    if smooth:
        quintic, slope = quartic, Chebyshev.interpolate(slope, 3, domain=[0.0, 1.0])
    tables = padded(quintic, 6), padded(slope, 6)
    for values in tables:
        values.setflags(write=False)
    return *tables, smooth


def padded(function: Polynomial | Chebyshev, count: int) -> Float:
    """Return coefficients, lowest power first, with zeros up to `count`."""
    coefficients = np.asarray(function.convert(kind=Polynomial).coef, dtype=float)
    return np.pad(coefficients, (0, count - len(coefficients)))


def pressure(
    points: ArrayLike,
    array: Array,
    drive: ArrayLike,
    air: Air,
    *,
    gradient: bool = False,
    device: str = "auto",
    mode: Mode = "fast",
    warn: bool = True,
) -> Field:
    """Return the incident field of an array: p = p0/d A g D(angle) exp(ikd - beta d) summed over its transducers.

    D is 1 for a point, 2 J1(kb sin)/(kb sin) for a baffled piston, or a measured table; A is the drive, g the gain of
    the transducer, beta the ISO 9613-1 absorption. A transducer emits no sound in or behind its own plane. The far
    field of a transducer is not valid within a few k b^2/2 (7 mm for b = 4.5 mm at 40 kHz).
    For many calls with one array use FieldEvaluator, which stores the array on the device and can set the absorption.

    points: [m], array frame, shape (n, 3).
    drive: complex amplitudes, 1 is full drive, shape (len(array),).
    gradient: whether to compute the gradient. mode: see FieldEvaluator.
    warn: whether to give a PalmfieldWarning if sound is too loud for a linear field or a point is too near for the far
        field of the transducers; see `palmfield.acoustics.validity.warnings`. FieldEvaluator gives no warnings.
    Returns Field: complex peak pressure [Pa], shape (n,), and gradient [Pa/m], shape (n, 3), or None.
    Raises PalmfieldError for NaN, infinity or a wrong shape in points or drive, SceneError for a bad array or air.
    """
    field = FieldEvaluator(array, air, device, mode=mode).pressure(points, drive, gradient)
    if warn:
        from palmfield.acoustics import validity

        messages = validity.warnings(array, points, field.pressure, air)
        if messages:
            warnings.warn("; ".join(messages), validity.PalmfieldWarning, stacklevel=2)
    return field
