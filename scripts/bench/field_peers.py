"""Other programs that compute the same field, for the comparison and for reference arrays.

Nothing of palmfield's acoustics is used here. autd3-emulator, levitate and numba may be missing, or be installed in
another environment (scripts/peers/setup.py makes one).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.studies.bench.problem import MOST_RUNS, Method, Problem
from palmfield.types import Float

CHUNK = 256
"""Number of points per block, for programs that build a whole matrix of points and transducers."""

UNIT = 249
"""Number of transducers of one AUTD3 unit."""

EMULATOR_P0_PA_M = 275.574246625 * 0.2 / (4.0 * math.pi)
"""Peak pressure at 1 m of a transducer in autd3-emulator 0.12: its T4010A1 amplitude over 4 pi [Pa m]."""

PERIODS = MOST_RUNS + 1
"""Number of periods of ultrasound that the emulator records: one per run, and one before the measurement."""


def numpy_prepare(problem: Problem) -> tuple[Problem, NDArray[np.float32], NDArray[np.float32]]:
    return problem, problem.points(), np.empty((6, CHUNK, len(problem.positions)), np.float32)


def numpy_run(state: tuple[Problem, NDArray[np.float32], NDArray[np.float32]]) -> NDArray[np.complex64]:
    """Compute the sum in NumPy float32, 256 points at a time, in cached buffers that are never freed."""
    problem, points, buffers = state
    turns_per_m = np.float32(problem.wavenumber / (2.0 * np.pi))
    beta = np.float32(problem.absorption_Np_m)
    quintic = problem.directivity.astype(np.float32)
    positions, normals = problem.positions.astype(np.float32), problem.normals.astype(np.float32)
    strength = (problem.p0_Pa_m * problem.drive).astype(np.complex64)
    result = np.empty(len(points), np.complex64)
    for start in range(0, len(points), CHUNK):
        part = points[start : start + CHUNK]
        d, cosine, gain, f, ray, work = buffers[:, : len(part)]
        d[:], cosine[:] = 0, 0
        for axis in range(3):
            np.subtract(part[:, axis, None], positions[:, axis], out=ray)
            d += np.multiply(ray, ray, out=work)
            cosine += np.multiply(ray, normals[:, axis], out=work)
        np.sqrt(d, out=d)
        cosine /= d
        np.multiply(cosine, cosine, out=work)
        np.subtract(1, work, out=work)
        gain[:] = quintic[5]
        for coefficient in quintic[4::-1]:
            gain *= work
            gain += coefficient
        np.multiply(d, -beta, out=work)
        gain *= np.exp(work, out=work)
        gain /= d
        gain *= np.greater(cosine, 0, out=work, casting="unsafe")
        np.multiply(d, turns_per_m, out=f)
        f -= np.rint(f, out=work)
        f *= np.float32(2.0 * np.pi)
        re = np.multiply(gain, np.cos(f, out=work), out=ray)
        im = np.multiply(gain, np.sin(f, out=work), out=gain)
        result[start : start + CHUNK] = (re @ strength.real - im @ strength.imag) + 1j * (
            re @ strength.imag + im @ strength.real
        )
    return result


def levitate_prepare(problem: Problem) -> tuple[Any, Problem, Float]:
    from levitate.materials import air
    from levitate.transducers import CircularPiston, PointSource

    air.c = problem.sound_speed_m_s
    options: dict[str, float] = {"freq": problem.frequency_Hz, "p0": problem.p0_Pa_m}
    if problem.piston_radius_m == 0.0:
        return PointSource(**options), problem, problem.points().astype(float)
    return CircularPiston(problem.piston_radius_m, **options), problem, problem.points().astype(float)


def levitate_run(state: tuple[Any, Problem, Float]) -> NDArray[np.complex128]:
    transducer, problem, points = state
    result = np.empty(len(points), np.complex128)
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        result[part] = problem.drive @ transducer.pressure(problem.positions.T, problem.normals.T, points[part].T)
    return result


def emulator_geometry(positions: Float) -> Any:
    """Return AUTD3 units with transducers at `positions` [m], shape (units x 249, 3). ValueError if they do not fit."""
    from autd3_core import Autd3, Geometry

    geometry = Geometry([Autd3(1e3 * origin) for origin in positions[::UNIT]])
    theirs = 1e-3 * np.concatenate([geometry.device(i).positions() for i in range(geometry.num_devices())])
    if theirs.shape != positions.shape or np.abs(theirs - positions).max() > 1e-6:
        raise ValueError("the transducers are not those of AUTD3 units, in their order")
    return geometry


def emulator_record(geometry: Any, phase: NDArray[np.uint8], intensity: NDArray[np.uint8], periods: int) -> Any:
    """Return the emission of the emulated units for bytes of phase and intensity, shape (transducers,), no silencer."""
    from autd3.commands import Pattern, SetSilencer
    from autd3_core import Duration
    from autd3_emulator import Emulator
    from autd3_pattern import IntensityBuffer, PhaseBuffer

    pattern = Pattern(
        PhaseBuffer.from_array(phase.reshape(-1, UNIT)), IntensityBuffer.from_array(intensity.reshape(-1, UNIT))
    )

    def play(recorder: Any) -> None:
        recorder.send(SetSilencer.disable())
        recorder.send(pattern)
        recorder.tick(Duration.from_micros(25 * periods))

    return Emulator(geometry).record(play)


def emulator_field(record: Any, low_m: Float, steps: NDArray[np.int64], resolution_m: float, speed_m_s: float) -> Any:
    """Return the emulator's sound field (rms) at the points of a grid; ValueError if its points differ."""
    from autd3_core import Velocity
    from autd3_emulator import Grid, RmsRecordOption

    high_m = low_m + resolution_m * (steps - 1)
    axes = [(1e3 * a, 1e3 * b) for a, b in zip(low_m.tolist(), high_m.tolist(), strict=True)]
    field = record.sound_field(Grid(*axes, 1e3 * resolution_m, "xyz"), RmsRecordOption(Velocity.from_m_s(speed_m_s)))
    if len(field.observe_points()) != np.prod(steps):
        raise ValueError("the emulator's grid has another number of points")
    return field


def emulator_next(field: Any) -> NDArray[np.float64]:
    """Return the magnitude (peak) of the next period of a field, shape (n,)."""
    from autd3_core import Duration

    return math.sqrt(2.0) * field.next(Duration.from_micros(25)).to_numpy()[:, 0].astype(float)


def emulator_prepare(problem: Problem) -> tuple[Any, float]:
    phase = np.round(256.0 * np.angle(problem.drive) / (2.0 * np.pi)).astype(int) % 256
    full = np.full(len(phase), 255, np.uint8)
    record = emulator_record(emulator_geometry(problem.positions), phase.astype(np.uint8), full, PERIODS)
    field = emulator_field(record, problem.low_m, problem.steps, problem.resolution_m, problem.sound_speed_m_s)
    return field, problem.p0_Pa_m / EMULATOR_P0_PA_M


def emulator_run(state: tuple[Any, float]) -> NDArray[np.float64]:
    field, scale = state
    return scale * emulator_next(field)


def numba_prepare(polynomial: bool) -> Callable[[Problem], Any]:
    """Return a `prepare` with numba kernels: sine, cosine and exponential of the C library, or short polynomials."""

    def prepare(problem: Problem) -> Any:
        from numba_kernels import libm, polynomials

        single = np.float32
        strength = problem.p0_Pa_m * problem.drive
        elements = np.column_stack(
            [problem.positions, problem.normals, np.abs(strength), np.angle(strength) / (2.0 * np.pi)]
        ).astype(single)
        constants = (
            single(problem.wavenumber / (2.0 * np.pi)),
            single(problem.absorption_Np_m),
            problem.directivity.astype(single),
        )
        if polynomial:
            more = (problem.attenuation.astype(single), problem.sine.astype(single), problem.cosine.astype(single))
            return polynomials, (problem.points(), elements, constants[0], constants[2], *more)
        return libm, (problem.points(), elements, *constants)

    return prepare


def numba_run(state: Any) -> NDArray[np.complex64]:
    kernel, arguments = state
    return kernel(*arguments)


METHODS = [
    Method("NumPy float32", "piston", numpy_prepare, numpy_run, ("numpy",)),
    Method("numba, libm", "piston", numba_prepare(False), numba_run, ("numba",)),
    Method("numba, polynomials", "piston", numba_prepare(True), numba_run, ("numba",)),
    Method("levitate, piston", "piston, lossless", levitate_prepare, levitate_run, ("levitate",)),
    Method("levitate, point", "sphere", levitate_prepare, levitate_run, ("levitate",)),
    Method("autd3-emulator, rms", "sphere", emulator_prepare, emulator_run, ("autd3-emulator", "autd3-pattern")),
]
