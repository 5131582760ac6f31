"""Pressure and its gradient from an array of transducers, on the CPU or a GPU."""

import functools
import math
import warnings
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import warp as wp
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import ArrayLike, NDArray

from palmfield.acoustics import check, polynomials, validity
from palmfield.acoustics.air import absorption_Np_m as air_absorption
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.directivities import directivity_coefficients
from palmfield.acoustics.groups import groups
from palmfield.device import SharedArray, filled, load_kernels, recorded, resolve
from palmfield.errors import PalmfieldError
from palmfield.threads import Calls, cores, pool, share
from palmfield.types import Air, Array, Field, Float, Int
from warp_kernels import gradient as with_gradient
from warp_kernels import pressure as kernels

BLOCKS_PER_THREAD = 4
PAIRS_PER_THREAD = 1_000_000
"""Fewest pairs of point and transducer worth a thread of its own: about 1 ms of work against 0.1 ms to hand it over."""

SMALL_PAIRS = 4_000_000
"""Up to so many pairs, 3 ms of work, buffers and launches are kept for the next call with as many points."""
SMALL_PAIRS_PER_THREAD = 100_000
"""PAIRS_PER_THREAD for these: what is recorded is handed over in 0.02 ms."""
SIZES_KEPT = 8

CUBIC_REACH_Np = 0.4
"""Absorption times range of distances up to which a cubic follows the exponential, with an error of 1e-5."""

QUADRATIC_REACH_Np = 0.08
"""The same for a quadratic, with an error of 3e-6."""

SMOOTH = 1e-5
"""Directivities that a quartic follows as well as this take one power less, which is a twentieth of the work."""

UNSHADED = (None, None)
"""In place of weights, for kernels with the gradient; normals, or None, come after them."""

Mode = Literal["fast", "accurate"]
MODES: tuple[Mode, ...] = ("fast", "accurate")


class FieldEvaluator:
    """The field of one array in one air; it holds the array on the device, so that a call moves only points and drive.

    Safe to call from several threads at once. On the CPU large sets of points are shared among `threads` threads.

    mode: "fast" computes in float32, whose phase error grows with distance: 1.2e-5 of the field at 0.05 to 0.4 m and
        4e-5 at 0.4 to 1.2 m (on a GPU 2e-5 and 6e-5); "accurate" takes distance and phase in float64
    threads: 1 or more; None is all cores that this process may use
    absorption_Np_m: instead of that of the air, for example 0 for lossless air
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
        check.array(array)
        if mode not in MODES:
            raise PalmfieldError(f"mode '{mode}' is unknown: use one of {', '.join(MODES)}")
        if threads is not None and threads < 1:
            raise PalmfieldError(f"threads = {threads} can't compute: give 1 or more, or None for all cores")
        self.array, self.air = array, air
        self.device = resolve(device)
        self.threads = cores() if threads is None else threads
        self.mode = mode
        self.absorption_Np_m = check.absorption(
            air_absorption(air, array.frequency_Hz) if absorption_Np_m is None else absorption_Np_m
        )
        self._gpu = self.device != "cpu"
        self._accurate = mode == "accurate"
        self.real: Any = np.float64 if self._accurate else np.float32
        wavenumber = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
        directivity, slope, self._smooth = off_axis(array, wavenumber)
        sine, cosine = polynomials.sine_cosine()
        polynomial = {
            "directivity": kernels.vec6(*directivity),
            "sine": kernels.vec6(*sine),
            "cosine": kernels.vec6(*cosine),
        }

        def sound(unit_m: float) -> Any:
            """The kernels' numbers where lengths are in this unit."""
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
        self._vec3, _, mat33 = self._form("cubic").vectors
        self._origins = self._upload(self._groups.origins.astype(self.real), self._vec3)
        self._turns = self._upload(self._groups.turns.astype(self.real), mat33)
        self._turns_radians = self._upload((wavenumber * self._groups.turns).astype(self.real), mat33)
        self._ranges = self._upload(self._groups.ranges, wp.vec2i)
        self._box = array.positions.min(axis=0), array.positions.max(axis=0)
        # Those that no call is using just now, by number of points, fall and gradient
        self._small: dict[tuple[int, str, bool, bool], list[_SmallCall]] = {}

    def pressure(
        self, points: ArrayLike, drive: ArrayLike, gradient: bool = False, normals: NDArray[np.float32] | None = None
    ) -> Field:
        """Field at points; see `pressure` below for shapes, units and errors.

        normals: unit outward, shape (n, 3), of opaque surfaces at the points: what transducers send from behind them is
            left out (`warp_kernels.pressure.from_front`). The gradient comes with it.
        """
        gradient = gradient or normals is not None
        where = check.points(points, self.real)
        amplitude = check.drive(drive, self.array)
        count = len(where)
        pressure = np.zeros(count, np.complex64)
        slope = np.zeros((count, 3), np.complex64) if gradient else None
        if count == 0 or len(self.array) == 0:
            return Field(pressure, slope)
        bounds = box_distances(where, self._box)
        if self._gpu:
            outward = None if normals is None else self._upload(normals, wp.vec3)
            outputs = self._launch(self._upload(where, self._vec3), bounds, amplitude, gradient, outward)
            for target, output in zip((pressure, slope), outputs, strict=False):
                assert target is not None
                target[:] = output.numpy().view(np.complex64)[..., 0]
        elif count * len(self.array) <= SMALL_PAIRS:
            self._small_on_cpu(where, bounds, amplitude, pressure, slope, normals)
        else:
            self._on_cpu(where, bounds, amplitude, pressure, slope, normals)
        return Field(pressure, slope)

    def upload(self, points: ArrayLike) -> "Points":
        """Points, [m], shape (n, 3), on the evaluator's GPU for `pressure_on_gpu`. Errors as `pressure`."""
        where = check.points(points, self.real)
        bounds = distances(where, self.array.positions) if len(where) else (0.0, 0.0)
        return Points(self._upload(where, self._vec3), bounds)

    def pressure_on_gpu(self, points: "Points", drive: ArrayLike, gradient: bool = False) -> tuple[Any, ...]:
        """As `pressure`, with the results left on the GPU, and not waited for.

        Returns Warp arrays of (real, imaginary): pressure [Pa], shape (n,), and if asked its gradient [Pa/m], shape
        (n, 3). Raises PalmfieldError for an evaluator on the CPU.
        """
        if not self._gpu:
            raise PalmfieldError(f"pressure_on_gpu on device '{self.device}': make the evaluator with device cuda:0")
        return self._launch(points.array, points.distances_m, check.drive(drive, self.array), gradient)

    def _form(self, fall: str, shaded: bool = False, faced: bool = False) -> kernels.Form:
        smooth = self._smooth and not self._accurate
        return kernels.Form(self._gpu, self._accurate, fall, smooth, self._groups.flat, shaded, faced)

    def kernel(self, fall: str, gradient: bool, shaded: bool = False, faced: bool = False) -> Any:
        """The kernel for how sound falls off, see `falling`; shaded, faced: see `Form`."""
        form = self._form(fall, shaded, faced)
        return with_gradient.gradient(form) if gradient else kernels.pressure(form)

    @property
    def points_per_thread(self) -> int:
        """How many points each thread of a kernel takes."""
        return kernels.WIDTH["gpu" if self._gpu else "cpu"]

    @property
    def ranges(self) -> Int:
        """First transducer of each group, and one past the last, counted in `order`, shape (g, 2)."""
        return self._groups.ranges

    def inputs(self, elements: Any, strengths: Any, gradient: bool, ranges: Any = None) -> list[Any]:
        """What a kernel takes between points and results.

        elements, strengths: see `elements`, on the device; ranges: others than all transducers of each group
        """
        if gradient:
            turns, sound, shapes = self._turns_radians, self._radians, [self._shapes]
        else:
            turns, sound, shapes = self._turns, self.sound, []
        ranges = self._ranges if ranges is None else ranges
        return [self._origins, turns, ranges, elements, strengths, sound, *shapes]

    def elements(self, gradient: bool) -> NDArray[Any]:
        """x, y, phase and z of each transducer in the order of its groups, shape (n, 4), the phase still 0.

        The kernels take them with strengths, shape (n, 4): p0 times amplitude times the coefficients of the fall.
        For the gradient lengths are in units of 1/k.
        """
        elements = np.zeros((len(self.order), 4), self.real)
        elements[:, [0, 1, 3]] = (self._wavenumber if gradient else 1.0) * self._groups.places
        return elements

    @property
    def order(self) -> Int:
        """The array's transducers in the order in which kernels take them, shape (n,)."""
        return self._groups.order

    @property
    def phase_unit(self) -> float:
        """The angle [rad] in which the kernels count phases: a turn, or a radian."""
        return 1.0 if self._gpu and not self._accurate else 2.0 * np.pi

    def unit_m(self, gradient: bool) -> float:
        """The length [m] in which the kernels count."""
        return float(1.0 / self._wavenumber) if gradient else 1.0

    def _inputs(
        self, bounds: tuple[float, float], drive: NDArray[np.complex128], gradient: bool, faced: bool
    ) -> tuple[Any, int, list[Any]]:
        """Kernel for points within these distances [m], points a thread, and what it takes between them and results."""
        kind, fall = falling(self.absorption_Np_m, *bounds)
        elements = self.elements(gradient)
        strengths = np.empty((len(elements), 4), np.float32)
        self._put_drive(drive, fall, gradient, elements, strengths)
        _, vec4, _ = self._form(kind).vectors
        inputs = self.inputs(self._upload(elements, vec4), self._upload(strengths, wp.vec4), gradient)
        return self.kernel(kind, gradient, faced=faced), self.points_per_thread, inputs

    def _put_drive(
        self,
        drive: NDArray[np.complex128],
        fall: Float,
        gradient: bool,
        elements: NDArray[Any],
        strengths: NDArray[np.float32],
    ) -> None:
        """Write phases into `elements` and amplitudes times the coefficients of the fall into `strengths`."""
        emitted = drive if self.array.gain is None else drive * self.array.gain
        emitted = emitted[self.order]
        strengths[:] = self.array.p0_Pa_m * np.abs(emitted)[:, None] * in_unit(fall, self.unit_m(gradient))
        elements[:, 2] = np.angle(emitted) / self.phase_unit

    def _small_on_cpu(
        self,
        points: NDArray[Any],
        bounds: tuple[float, float],
        drive: NDArray[np.complex128],
        pressure: NDArray[np.complex64],
        slope: NDArray[np.complex64] | None,
        normals: NDArray[np.float32] | None,
    ) -> None:
        """As `_on_cpu`, by launches that are recorded for so many points: there is little work in between them."""
        kind, fall = falling(self.absorption_Np_m, *bounds)
        key = len(points), kind, slope is not None, normals is not None
        known = self._small.get(key)
        if known is None:
            if len(self._small) >= SIZES_KEPT:
                self._small.clear()
            known = self._small[key] = []
        try:
            call = known.pop()
        except IndexError:
            call = _SmallCall(self, *key)
        self._put_drive(drive, fall, slope is not None, call.elements.host, call.strengths.host)
        call.run(points, pressure, slope, normals)
        if len(known) < self.threads:
            known.append(call)

    def _upload(self, values: NDArray[Any], dtype: Any) -> Any:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _on_cpu(
        self,
        points: NDArray[Any],
        bounds: tuple[float, float],
        drive: NDArray[np.complex128],
        pressure: NDArray[np.complex64],
        slope: NDArray[np.complex64] | None,
        normals: NDArray[np.float32] | None,
    ) -> None:
        """Fill pressure and slope in place: Warp sees NumPy's memory, slices of the points shared out among threads."""
        kernel, width, inputs = self._inputs(bounds, drive, slope is not None, normals is not None)
        load_kernels(kernel.module, "cpu")

        def run(start: int, stop: int) -> None:
            part: Any = wp.array(points[start:stop], dtype=self._vec3, device="cpu", copy=False)
            outputs = [shared(pressure[start:stop])]
            if slope is not None:
                own: Any = None if normals is None else wp.array(normals[start:stop], dtype=wp.vec3, device="cpu")
                outputs += [shared(slope[start:stop]), *UNSHADED, own]
            wp.launch(kernel, dim=-(-(stop - start) // width), inputs=[part, *inputs, *outputs], device="cpu")

        count = len(points)
        threads = min(self.threads, 1 + count * len(self.array) // PAIRS_PER_THREAD)
        if threads == 1:
            run(0, count)
            return
        size = -(-count // (BLOCKS_PER_THREAD * threads * width)) * width
        # The threads share one iterator, so that a slow core takes fewer blocks
        starts = iter(range(0, count, size))

        def work(_: int) -> None:
            for start in starts:
                run(start, min(start + size, count))

        list(pool().map(work, range(threads)))

    def _launch(
        self,
        points: Any,
        bounds: tuple[float, float],
        drive: NDArray[np.complex128],
        gradient: bool,
        normals: Any = None,
    ) -> tuple[Any, ...]:
        kernel, width, inputs = self._inputs(bounds, drive, gradient, normals is not None)
        count = len(points)
        outputs = [wp.zeros(count, dtype=wp.vec2, device=self.device)]
        if gradient:
            outputs.append(wp.zeros((count, 3), dtype=wp.vec2, device=self.device))
        inputs = [points, *inputs, *outputs, *((*UNSHADED, normals) if gradient else ())]
        wp.launch(kernel, dim=-(-count // width), inputs=inputs, device=self.device, block_dim=128)
        return tuple(outputs)


class _SmallCall:
    """Buffers and recorded launches for a number of points on the CPU; one call at a time uses them.

    elements, strengths: as kernels take them, to be filled before `run`
    """

    def __init__(self, evaluator: FieldEvaluator, count: int, kind: str, gradient: bool, faced: bool):
        vec3, vec4, _ = evaluator._form(kind).vectors
        size = len(evaluator.array)
        self.elements = SharedArray(size, vec4, "cpu")
        self.elements.host[...] = evaluator.elements(gradient)
        self.strengths = SharedArray(size, wp.vec4, "cpu")
        self._points = SharedArray(count, vec3, "cpu")
        self._results = [SharedArray(count, wp.vec2, "cpu")]
        if gradient:
            self._results.append(SharedArray((count, 3), wp.vec2, "cpu"))
        self._normals = SharedArray(count if faced else 0, wp.vec3, "cpu")
        kernel, width = evaluator.kernel(kind, gradient, faced=faced), evaluator.points_per_thread
        inputs = evaluator.inputs(self.elements.array, self.strengths.array, gradient)
        self._threads = max(1, min(evaluator.threads, count * size // SMALL_PAIRS_PER_THREAD))
        step = -(-count // (self._threads * width)) * width
        self._blocks: list[Calls] = []
        for start in range(0, count, step):
            own = slice(start, min(start + step, count))
            arrays = [self._points.array[own], *inputs, *(result.array[own] for result in self._results)]
            arrays += (*UNSHADED, self._normals.array[own] if faced else None) if gradient else ()
            self._blocks.append((recorded(kernel, -(-(own.stop - start) // width), arrays, "cpu"),))

    def run(
        self,
        points: NDArray[Any],
        pressure: NDArray[np.complex64],
        slope: NDArray[np.complex64] | None,
        normals: NDArray[np.float32] | None,
    ) -> None:
        """Fill pressure, and slope where there is one, for points [m], shape (count, 3)."""
        self._points.host[...] = points
        if normals is not None:
            self._normals.host[...] = normals
        if slope is not None:
            for result in self._results:
                result.host.fill(0.0)  # the kernel adds to them
        share(self._blocks, self._threads)
        for target, result in zip((pressure, slope), self._results, strict=False):
            assert target is not None
            target[...] = result.host.view(np.complex64)[..., 0]


@dataclass(frozen=True)
class Points:
    """Points on a GPU; array: Warp's, shape (n,); distances_m: bounds of those to the transducers."""

    array: Any
    distances_m: tuple[float, float]


def shared(values: NDArray[np.complex64]) -> Any:
    """The complex numbers as Warp pairs in the same memory."""
    return wp.array(values.view(np.float32).reshape(*values.shape, 2), dtype=wp.vec2, device="cpu", copy=False)


def distances(points: NDArray[Any], positions: Float) -> tuple[float, float]:
    """Bounds of the distance between any point and any position [m], from their boxes."""
    return box_distances(points, (positions.min(axis=0), positions.max(axis=0)))


def box_distances(points: NDArray[Any], box: tuple[Float, Float]) -> tuple[float, float]:
    """The same for positions in a box, of which two corners are given [m]."""
    # By column: NumPy's reduction along the short rows takes 20 times as long
    columns = np.ascontiguousarray(points.T)
    low, high = np.minimum.reduce(columns, axis=1).tolist(), np.maximum.reduce(columns, axis=1).tolist()
    gap, reach = 0.0, 0.0
    for first, last, least, most in zip(low, high, box[0].tolist(), box[1].tolist(), strict=True):
        gap += max(least - last, first - most, 0.0) ** 2
        reach += (max(last, most) - min(first, least)) ** 2
    return math.sqrt(gap), math.sqrt(reach)


def falling(absorption_Np_m: float, low: float, high: float) -> tuple[str, Float]:
    """How kernels compute exp(-absorption d) for d from low to high [m], and its coefficients, shape (4,)."""
    reach = absorption_Np_m * (high - low)
    if reach > CUBIC_REACH_Np:
        return "exponential", np.array([1.0, 0.0, 0.0, 0.0])
    if reach > QUADRATIC_REACH_Np:
        return "cubic", polynomial_fall(absorption_Np_m, low, high, 3)
    return "quadratic", polynomial_fall(absorption_Np_m, low, high, 2)


@functools.cache
def _chebyshev(power: int) -> tuple[Float, Float]:
    """Points of -1 to 1, shape (power + 1,), and the matrix that takes values there to a polynomial's coefficients."""
    points = np.cos(np.pi * (np.arange(power + 1.0) + 0.5) / (power + 1))
    return points, np.linalg.inv(np.vander(points, increasing=True))


def polynomial_fall(absorption_Np_m: float, low: float, high: float, power: int = 3) -> Float:
    """Coefficients, lowest power first, shape (4,), of exp(-absorption d) for d from low to high [m].

    It meets the exponential at Chebyshev's points. NumPy's own interpolation takes 190 Python calls, and a simulation
    asks for this in between.
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
    """Directivity in q = cos^2 of the angle off the axis, and twice its derivative in q, shapes (6,), (6,).

    The last is whether they are a quartic and a cubic (padded with zeros), see SMOOTH.
    """
    in_sine, _ = directivity_coefficients(array, wavenumber)
    return _in_cosine(tuple(in_sine.tolist()))


@functools.lru_cache(maxsize=64)
def _in_cosine(in_sine: tuple[float, ...]) -> tuple[Float, Float, bool]:
    """`off_axis` from a polynomial in sin^2. Arrays that move get new evaluators each step: it is kept for them."""
    quintic: Any = Polynomial(in_sine)(Polynomial([1.0, -1.0]))
    slope: Any = 2.0 * quintic.deriv()
    quartic = Chebyshev.interpolate(quintic, 4, domain=[0.0, 1.0])
    q = np.linspace(0.0, 1.0, 201)
    smooth = bool(np.abs(quartic(q) - quintic(q)).max() <= SMOOTH)
    if smooth:
        quintic, slope = quartic, Chebyshev.interpolate(slope, 3, domain=[0.0, 1.0])
    kept = padded(quintic, 6), padded(slope, 6)
    for values in kept:
        values.setflags(write=False)
    return *kept, smooth


def in_unit(fall: Float, unit_m: float) -> Float:
    """The coefficients of `falling` for distances in units of unit_m, so that amplitudes over distance stay in Pa."""
    return np.asarray(fall * unit_m ** np.array([-1.0, 0.0, 1.0, 2.0]))


def padded(function: Polynomial | Chebyshev, count: int) -> Float:
    """Coefficients, lowest power first, with zeros up to `count`."""
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
    """Incident field of an array: p = p0/d A g D(angle) exp(ikd - beta d) summed over its transducers.

    D is 1 for a point, 2 J1(kb sin)/(kb sin) for a baffled piston, or a measured table; g is the transducer's gain;
    beta is ISO 9613-1 absorption; a transducer gives nothing in or behind its own plane. This is each transducer's far
    field: within a few k b^2/2 (7 mm for b = 4.5 mm at 40 kHz) of one it does not hold.
    For many calls with one array use FieldEvaluator, which keeps the array on the device and can change the absorption.

    points: [m], array frame, shape (n, 3)
    drive: complex amplitudes, 1 is full drive, shape (len(array),)
    gradient: also the gradient of the whole expression; mode: see FieldEvaluator
    warn: say so (PalmfieldWarning, once a call) where sound is too loud for a linear field or a point too near for the
        transducers' far field; see `palmfield.acoustics.validity.warnings`. FieldEvaluator is silent.
    Returns Field: complex peak pressure [Pa], shape (n,), and gradient [Pa/m], shape (n, 3), or None.
    Raises PalmfieldError for NaN, infinity or a wrong shape in points or drive, SceneError for a bad array or air.
    """
    field = FieldEvaluator(array, air, device, mode=mode).pressure(points, drive, gradient)
    if warn:
        messages = validity.warnings(array, points, field.pressure, air)
        if messages:
            warnings.warn("; ".join(messages), validity.PalmfieldWarning, stacklevel=2)
    return field
