"""Pressure and its gradient from an array of baffled pistons, in float32 on the CPU or a GPU."""

import functools
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from palmfield.acoustics import check, polynomials
from palmfield.acoustics.air import absorption_Np_m as air_absorption
from palmfield.acoustics.air import sound_speed
from palmfield.device import resolve
from palmfield.types import Air, Array, Field, Float32
from warp_kernels import field as plain
from warp_kernels import field_wide as wide

PAIRS_PER_THREAD = 1_000_000
"""Fewest pairs of point and transducer worth a thread of its own: about 2 ms of work against 0.1 ms to hand it over."""


class FieldEvaluator:
    """The field of one array in one air; it holds the array on the device, so that a call moves only points and drive.

    Safe to call from several threads at once. On the CPU large sets of points are shared among `threads` threads.
    The float32 phase limits the accuracy: the error relative to float64 grows in proportion to distance.

    absorption_Np_m: instead of that of the air, for example 0 for lossless air
    threads: on the CPU, all cores by default
    form: kernel for the CPU; "wide" steps aside for "plain", 20 times slower, where absorption times distance is large
    Raises SceneError for a bad array or air, PalmfieldError for an unknown device or a negative absorption.
    """

    def __init__(
        self,
        array: Array,
        air: Air,
        device: str = "auto",
        *,
        absorption_Np_m: float | None = None,
        threads: int | None = None,
        form: Literal["wide", "plain"] = "wide",
    ) -> None:
        check.array(array)
        self.array = array
        self.device = resolve(device)
        self.threads = threads or os.cpu_count() or 1
        self.form = form
        self.absorption_Np_m = check.absorption(
            air_absorption(air, array.frequency_Hz) if absorption_Np_m is None else absorption_Np_m
        )
        wavenumber = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
        directivity, slope = polynomials.directivity(wavenumber * array.piston_radius_m)
        sine, cosine = polynomials.sine_cosine()

        turns_per_m = wavenumber / (2.0 * np.pi)
        self._plain = filled(
            plain.Sound(),
            turns_per_m=turns_per_m,
            absorption_Np_m=self.absorption_Np_m,
            directivity=plain.vec6(*directivity),
            slope=plain.vec6(*slope, 0.0),
        )
        self._wide = filled(
            wide.Sound(),
            turns_per_m=turns_per_m,
            wavenumber_rad_m=wavenumber,
            absorption_Np_m=self.absorption_Np_m,
            attenuation=wide.vec4(*polynomials.attenuation(self.absorption_Np_m)),
            directivity=wide.vec6(*directivity),
            slope=wide.vec5(*slope),
            sine=wide.vec6(*sine),
            cosine=wide.vec6(*cosine),
        )
        self._positions: wp.array = wp.array(array.positions.astype(np.float32), dtype=wp.vec3, device=self.device)
        self._normals: wp.array = wp.array(array.normals.astype(np.float32), dtype=wp.vec3, device=self.device)

    def pressure(self, points: ArrayLike, drive: ArrayLike, gradient: bool = False) -> Field:
        """Field at points; see `pressure` below for shapes, units and errors."""
        where = check.points(points, np.float32)
        amplitude = self.array.p0_Pa_m * check.drive(drive, self.array)
        strength = np.column_stack([np.abs(amplitude), np.angle(amplitude) / (2.0 * np.pi)]).astype(np.float32)
        pressure = np.zeros(len(where), np.complex64)
        slope = np.zeros((len(where), 3), np.complex64) if gradient else None
        if len(where) == 0 or len(self.array) == 0:
            return Field(pressure, slope)
        if self.device != "cpu":
            self._on_gpu(where, strength, pressure, slope)
        elif self.form == "wide" and self.absorption_Np_m * self._reach_m(where) <= polynomials.ATTENUATION_REACH_Np:
            self._on_cpu(wide, self._wide, wide.WIDTH, where, strength, pressure, slope)
        else:
            self._on_cpu(plain, self._plain, 1, where, strength, pressure, slope)
        return Field(pressure, slope)

    def _reach_m(self, points: Float32) -> float:
        """Upper bound of the distance between any point and any transducer: the diagonal of their common box."""
        low = np.minimum(points.min(axis=0), self.array.positions.min(axis=0))
        high = np.maximum(points.max(axis=0), self.array.positions.max(axis=0))
        return float(np.linalg.norm(high - low))

    def _on_cpu(
        self,
        kernels: Any,
        sound: Any,
        width: int,
        points: Float32,
        strength: Float32,
        pressure: NDArray[np.complex64],
        slope: NDArray[np.complex64] | None,
    ) -> None:
        """Fill pressure and slope in place: Warp sees NumPy's memory, one slice of the points per thread."""
        wp.load_module(kernels, device="cpu")
        drive: wp.array = wp.array(strength, dtype=wp.vec2, device="cpu", copy=False)

        def run(start: int, stop: int) -> None:
            inputs = [
                wp.array(points[start:stop], dtype=wp.vec3, device="cpu", copy=False),
                self._positions,
                self._normals,
                drive,
                sound,
                wp.array(pressure[start:stop].view(np.float32).reshape(-1, 2), dtype=wp.vec2, device="cpu", copy=False),
            ]
            kernel = kernels.pressure
            if slope is not None:
                kernel = kernels.pressure_gradient
                rows = slope[start:stop].view(np.float32).reshape(-1, 3, 2)
                inputs.append(wp.array(rows, dtype=wp.vec2, device="cpu", copy=False))
            wp.launch(kernel, dim=-(-(stop - start) // width), inputs=inputs, device="cpu")

        count = len(points)
        parts = min(self.threads, 1 + count * len(self.array) // PAIRS_PER_THREAD)
        if parts == 1:
            run(0, count)
            return
        size = -(-count // (parts * wide.WIDTH)) * wide.WIDTH
        starts = range(0, count, size)
        jobs = [pool().submit(run, start, min(start + size, count)) for start in starts]
        for job in jobs:
            job.result()

    def _on_gpu(
        self,
        points: Float32,
        strength: Float32,
        pressure: NDArray[np.complex64],
        slope: NDArray[np.complex64] | None,
    ) -> None:
        count = len(points)
        result = wp.empty(count, dtype=wp.vec2, device=self.device)
        inputs = [
            wp.array(points, dtype=wp.vec3, device=self.device),
            self._positions,
            self._normals,
            wp.array(strength, dtype=wp.vec2, device=self.device),
            self._plain,
            result,
        ]
        if slope is None:
            wp.launch(plain.pressure, dim=count, inputs=inputs, device=self.device)
        else:
            rows = wp.empty((count, 3), dtype=wp.vec2, device=self.device)
            wp.launch(plain.pressure_gradient, dim=count, inputs=[*inputs, rows], device=self.device)
            slope[:] = rows.numpy().view(np.complex64)[..., 0]
        pressure[:] = result.numpy().view(np.complex64)[..., 0]


def filled(struct: Any, **values: Any) -> Any:
    """The Warp struct with its members set."""
    for name, value in values.items():
        setattr(struct, name, value)
    return struct


@functools.cache
def pool() -> ThreadPoolExecutor:
    """Threads shared by all evaluators of this process."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="palmfield-field")


def pressure(
    points: ArrayLike, array: Array, drive: ArrayLike, air: Air, *, gradient: bool = False, device: str = "auto"
) -> Field:
    """Incident field of an array: p = p0/d A D(angle) exp(ikd - beta d) summed over baffled pistons.

    D = 2 J1(kb sin)/(kb sin); beta is ISO 9613-1 absorption; a transducer gives nothing in or behind its own plane.
    For many calls with one array use FieldEvaluator, which keeps the array on the device and can change the absorption.

    points: [m], array frame, shape (n, 3); computed in float32
    drive: complex amplitudes, 1 is full drive, shape (len(array),)
    gradient: also the gradient of the whole expression
    Returns Field: complex peak pressure [Pa], shape (n,), and gradient [Pa/m], shape (n, 3), or None.
    Raises PalmfieldError for NaN, infinity or a wrong shape in points or drive, SceneError for a bad array or air.
    """
    return FieldEvaluator(array, air, device).pressure(points, drive, gradient)
