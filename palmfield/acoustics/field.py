"""Pressure and its gradient from an array of transducers, on the CPU or a GPU."""

import functools
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal

import numpy as np
import warp as wp
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import ArrayLike, NDArray

from palmfield.acoustics import check, polynomials
from palmfield.acoustics.air import absorption_Np_m as air_absorption
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.groups import groups
from palmfield.acoustics.transducer import directivity_coefficients
from palmfield.device import resolve
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Field, Float
from warp_kernels import pressure as kernels

PAIRS_PER_THREAD = 1_000_000
"""Fewest pairs of point and transducer worth a thread of its own: about 1 ms of work against 0.1 ms to hand it over."""

CUBIC_REACH_Np = 0.4
"""Absorption times range of distances up to which a cubic follows the exponential, with an error of 1e-5."""

SMOOTH = 1e-5
"""Directivities that a quartic follows as well as this take one power less, which is a twentieth of the work."""

Mode = Literal["fast", "accurate"]
MODES: tuple[Mode, ...] = ("fast", "accurate")


class FieldEvaluator:
    """The field of one array in one air; it holds the array on the device, so that a call moves only points and drive.

    Safe to call from several threads at once. On the CPU large sets of points are shared among `threads` threads.

    mode: "fast" computes in float32, whose phase error grows with distance: 1.2e-5 of the field at 0.05 to 0.4 m and
        4e-5 at 0.4 to 1.2 m (on a GPU 2e-5 and 6e-5); "accurate" takes distance and phase in float64
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
        self.array = array
        self.device = resolve(device)
        self.threads = threads or os.cpu_count() or 1
        self.mode = mode
        self.absorption_Np_m = check.absorption(
            air_absorption(air, array.frequency_Hz) if absorption_Np_m is None else absorption_Np_m
        )
        self._gpu = self.device != "cpu"
        self._accurate = mode == "accurate"
        self._real: Any = np.float64 if self._accurate else np.float32
        wavenumber = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
        directivity, slope, self._smooth = off_axis(array, wavenumber)
        sine, cosine = polynomials.sine_cosine()
        self.sound = filled(
            kernels.Sound(),
            turns_per_m=wavenumber / (2.0 * np.pi),
            turns32_per_m=wavenumber / (2.0 * np.pi),
            wavenumber_rad_m=wavenumber,
            absorption_Np_m=self.absorption_Np_m,
            directivity=kernels.vec6(*directivity),
            slope=kernels.vec6(*slope / wavenumber),
            sine=kernels.vec6(*sine),
            cosine=kernels.vec6(*cosine),
        )
        self._groups = groups(array)
        vec3, _, mat33 = self._form(False).vectors
        self._origins = self._upload(self._groups.origins.astype(self._real), vec3)
        self._turns = self._upload(self._groups.turns.astype(self._real), mat33)
        self._ranges = self._upload(self._groups.ranges, wp.vec2i)

    def pressure(self, points: ArrayLike, drive: ArrayLike, gradient: bool = False) -> Field:
        """Field at points; see `pressure` below for shapes, units and errors."""
        where = check.points(points, self._real)
        amplitude = check.drive(drive, self.array)
        count = len(where)
        pressure = np.zeros(count, np.complex64)
        slope = np.zeros((count, 3), np.complex64) if gradient else None
        if count == 0 or len(self.array) == 0:
            return Field(pressure, slope)
        form, elements, strengths = self._elements(where, amplitude)
        kernel = (kernels.gradient if gradient else kernels.pressure)(form)
        width = (kernels.GRADIENT_WIDTH if gradient else kernels.PRESSURE_WIDTH)["gpu" if self._gpu else "cpu"]
        _, vec4, _ = form.vectors
        inputs = [
            self._origins, self._turns, self._ranges,
            self._upload(elements, vec4), self._upload(strengths, wp.vec4), self.sound,
        ]  # fmt: skip
        if self._gpu:
            self._on_gpu(kernel, width, where, inputs, pressure, slope)
        else:
            self._on_cpu(kernel, width, where, inputs, pressure, slope)
        return Field(pressure, slope)

    def _form(self, steep: bool) -> kernels.Form:
        return kernels.Form(self._gpu, self._accurate, steep, self._smooth and not self._accurate)

    def _elements(self, points: NDArray[Any], drive: NDArray[np.complex128]) -> tuple[kernels.Form, Any, Any]:
        """Form of the kernel for these points; place and phase, and strength and fall, of the ordered transducers."""
        order = self._groups.order
        emitted = drive if self.array.gain is None else drive * self.array.gain
        emitted = emitted[order]
        low, high = distances(points, self.array.positions)
        steep = self.absorption_Np_m * (high - low) > CUBIC_REACH_Np
        fall = np.array([1.0, 0.0, 0.0, 0.0]) if steep else cubic_fall(self.absorption_Np_m, low, high)
        strengths = (self.array.p0_Pa_m * np.abs(emitted)[:, None] * fall).astype(np.float32)
        elements = np.zeros((len(order), 4), self._real)
        elements[:, :2] = self._groups.places
        radians = self._gpu and not self._accurate
        elements[:, 2] = np.angle(emitted) / (1.0 if radians else 2.0 * np.pi)
        return self._form(bool(steep)), elements, strengths

    def _upload(self, values: NDArray[Any], dtype: Any) -> Any:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _on_cpu(
        self,
        kernel: Any,
        width: int,
        points: NDArray[Any],
        inputs: list[Any],
        pressure: NDArray[np.complex64],
        slope: NDArray[np.complex64] | None,
    ) -> None:
        """Fill pressure and slope in place: Warp sees NumPy's memory, one slice of the points per thread."""
        wp.load_module(kernel.module, device="cpu")
        vec3, _, _ = self._form(False).vectors

        def run(start: int, stop: int) -> None:
            part: Any = wp.array(points[start:stop], dtype=vec3, device="cpu", copy=False)
            outputs = [shared(pressure[start:stop])]
            if slope is not None:
                outputs.append(shared(slope[start:stop]))
            wp.launch(kernel, dim=-(-(stop - start) // width), inputs=[part, *inputs, *outputs], device="cpu")

        count = len(points)
        parts = min(self.threads, 1 + count * len(self.array) // PAIRS_PER_THREAD)
        if parts == 1:
            run(0, count)
            return
        size = -(-count // (parts * width)) * width
        jobs = [pool().submit(run, start, min(start + size, count)) for start in range(0, count, size)]
        for job in jobs:
            job.result()

    def _on_gpu(
        self,
        kernel: Any,
        width: int,
        points: NDArray[Any],
        inputs: list[Any],
        pressure: NDArray[np.complex64],
        slope: NDArray[np.complex64] | None,
    ) -> None:
        vec3, _, _ = self._form(False).vectors
        count = len(points)
        outputs = [wp.zeros(count, dtype=wp.vec2, device=self.device)]
        if slope is not None:
            outputs.append(wp.zeros((count, 3), dtype=wp.vec2, device=self.device))
        place = self._upload(points, vec3)
        wp.launch(kernel, dim=-(-count // width), inputs=[place, *inputs, *outputs], device=self.device, block_dim=128)
        for target, output in zip((pressure, slope), outputs, strict=False):
            assert target is not None
            target[:] = output.numpy().view(np.complex64)[..., 0]


def filled(struct: Any, **values: Any) -> Any:
    """The Warp struct with its members set."""
    for name, value in values.items():
        setattr(struct, name, value)
    return struct


def shared(values: NDArray[np.complex64]) -> Any:
    """The complex numbers as Warp pairs in the same memory."""
    return wp.array(values.view(np.float32).reshape(*values.shape, 2), dtype=wp.vec2, device="cpu", copy=False)


def distances(points: NDArray[Any], positions: Float) -> tuple[float, float]:
    """Bounds of the distance between any point and any position [m], from their boxes."""
    # By column: NumPy's reduction along the short rows takes 20 times as long
    low = np.array([points[:, i].min() for i in range(3)])
    high = np.array([points[:, i].max() for i in range(3)])
    least, most = positions.min(axis=0), positions.max(axis=0)
    gap = np.maximum(np.maximum(least - high, low - most), 0.0)
    reach = np.maximum(high, most) - np.minimum(low, least)
    return float(np.linalg.norm(gap)), float(np.linalg.norm(reach))


def cubic_fall(absorption_Np_m: float, low: float, high: float) -> Float:
    """Coefficients, lowest power first, shape (4,), of exp(-absorption d) for d from low to high [m]."""
    if absorption_Np_m == 0.0 or high <= low:
        return np.array([np.exp(-absorption_Np_m * low), 0.0, 0.0, 0.0])
    return padded(Chebyshev.interpolate(lambda d: np.exp(-absorption_Np_m * d), 3, domain=[low, high]), 4)


def off_axis(array: Array, wavenumber: float) -> tuple[Float, Float, bool]:
    """Directivity in q = cos^2 of the angle off the axis, and twice its derivative in q, shapes (6,), (6,).

    The last is whether they are a quartic and a cubic (padded with zeros), see SMOOTH.
    """
    in_sine, _ = directivity_coefficients(array, wavenumber)
    quintic = Polynomial(in_sine)(Polynomial([1.0, -1.0]))
    slope = 2.0 * quintic.deriv()
    quartic = Chebyshev.interpolate(quintic, 4, domain=[0.0, 1.0])
    q = np.linspace(0.0, 1.0, 201)
    if np.abs(quartic(q) - quintic(q)).max() > SMOOTH:
        return padded(quintic, 6), padded(slope, 6), False
    return padded(quartic, 6), padded(Chebyshev.interpolate(slope, 3, domain=[0.0, 1.0]), 6), True


def padded(function: Polynomial | Chebyshev, count: int) -> Float:
    """Coefficients, lowest power first, with zeros up to `count`."""
    coefficients = np.asarray(function.convert(kind=Polynomial).coef, dtype=float)
    return np.pad(coefficients, (0, count - len(coefficients)))


@functools.cache
def pool() -> ThreadPoolExecutor:
    """Threads shared by all evaluators of this process."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="palmfield-field")


def pressure(
    points: ArrayLike,
    array: Array,
    drive: ArrayLike,
    air: Air,
    *,
    gradient: bool = False,
    device: str = "auto",
    mode: Mode = "fast",
) -> Field:
    """Incident field of an array: p = p0/d A g D(angle) exp(ikd - beta d) summed over its transducers.

    D is 1 for a point, 2 J1(kb sin)/(kb sin) for a baffled piston, or a measured table; g is the transducer's gain;
    beta is ISO 9613-1 absorption; a transducer gives nothing in or behind its own plane. This is each transducer's far
    field: within a few k b^2/2 (7 mm for b = 4.5 mm at 40 kHz) of one it does not hold.
    For many calls with one array use FieldEvaluator, which keeps the array on the device and can change the absorption.

    points: [m], array frame, shape (n, 3)
    drive: complex amplitudes, 1 is full drive, shape (len(array),)
    gradient: also the gradient of the whole expression; mode: see FieldEvaluator
    Returns Field: complex peak pressure [Pa], shape (n,), and gradient [Pa/m], shape (n, 3), or None.
    Raises PalmfieldError for NaN, infinity or a wrong shape in points or drive, SceneError for a bad array or air.
    """
    return FieldEvaluator(array, air, device, mode=mode).pressure(points, drive, gradient)
