"""Speed and accuracy of the field kernels on this machine's CPU, beside NumPy; writes docs/bench/field.md.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_field.py

A pair is one transducer and one point. Speeds are medians, per second on the clock and per second that a core worked:
the second figure stays the same when other programs share the machine.
"""

import functools
import hashlib
import os
import statistics
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

import numpy as np
import warp as wp
from numpy.typing import NDArray

from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.polynomials import directivity
from palmfield.acoustics.reference import pressure64
from palmfield.types import Air, Array, Complex, Field, Float32

ROOT = Path(__file__).resolve().parents[1]
RUNS = 7
POINTS = 100_003
CHECKED = 20_003
"""Points compared with the float64 twin."""


def cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return "unknown CPU"


def commit() -> str:
    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    changed = git("status", "--porcelain", "--", "palmfield/acoustics", "warp_kernels", "scripts/bench_field.py")
    return git("rev-parse", "--short", "HEAD") + (" with uncommitted changes" if changed else "")


def numpy_pressure(points: Float32, array: Array, drive: Complex, air: Air) -> NDArray[np.complex64]:
    """The same sum in NumPy float32, 256 points at a time, in buffers that stay in the cache and are never freed."""
    wavenumber = 2 * np.pi * array.frequency_Hz / sound_speed(air)
    turns_per_m = np.float32(wavenumber / (2 * np.pi))
    beta = np.float32(absorption_Np_m(air, array.frequency_Hz))
    quintic = directivity(wavenumber * array.piston_radius_m)[0].astype(np.float32)
    positions, normals = array.positions.astype(np.float32), array.normals.astype(np.float32)
    strength = (array.p0_Pa_m * drive).astype(np.complex64)
    result = np.empty(len(points), np.complex64)
    buffers = np.empty((6, 256, len(array)), np.float32)
    for start in range(0, len(points), 256):
        part = points[start : start + 256]
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
        f *= np.float32(2 * np.pi)
        re = np.multiply(gain, np.cos(f, out=work), out=ray)
        im = np.multiply(gain, np.sin(f, out=work), out=gain)
        result[start : start + 256] = (re @ strength.real - im @ strength.imag) + 1j * (
            re @ strength.imag + im @ strength.real
        )
    return result


def median_s(work: Callable[[], object]) -> tuple[float, float]:
    """Median seconds of one run, on the clock and summed over the cores that worked."""
    work()
    clock, cores = [], []
    for _ in range(RUNS):
        start, worked = time.perf_counter(), time.process_time()
        work()
        clock.append(time.perf_counter() - start)
        cores.append(time.process_time() - worked)
    return statistics.median(clock), statistics.median(cores)


def second_core() -> float:
    """How much more two Python threads do than one here, on hashing, which lets go of the interpreter's lock."""
    data = bytes(50_000_000)

    def digest() -> None:
        hashlib.sha256(data).digest()

    def both() -> None:
        with ThreadPoolExecutor(2) as pool:
            for job in [pool.submit(digest) for _ in range(2)]:
                job.result()

    return 2 * median_s(digest)[0] / median_s(both)[0]


def difference(found: NDArray[np.complex64], expected: Complex) -> str:
    return f"{np.linalg.norm(found - expected) / np.linalg.norm(expected):.1e}"


def main() -> None:
    wp.config.log_level = wp.LOG_WARNING
    array, air = layout("uhev1"), Air()
    drive = focus(array, air, (0.02, 0.01, 0.2))
    points = np.random.default_rng(0).uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.4], (POINTS, 3)).astype(np.float32)
    pressure, gradient = pressure64(points[:CHECKED], array, drive, air, gradient=True)
    assert gradient is not None

    rows: list[str] = []

    def row(name: str, count: int, work: Callable[[], Field]) -> None:
        clock, cores = (count * len(array) / seconds / 1e6 for seconds in median_s(work))
        found = work()
        errors = difference(found.pressure[:CHECKED], pressure)
        if found.gradient is not None:
            errors += f", gradient {difference(found.gradient[:CHECKED], gradient)}"
        rows.append(f"| {name} | {clock:.0f} | {cores:.0f} | {errors} |")
        print(rows[-1])

    cases: list[tuple[Literal["wide", "plain"], int, int]] = [
        ("wide", 1, POINTS),
        ("wide", 2, POINTS),
        ("plain", 1, CHECKED),
    ]
    for form, threads, count in cases:
        evaluator = FieldEvaluator(array, air, "cpu", threads=threads, form=form)
        for wanted in (False, True):
            name = f"{form} kernel, {'p and gradient' if wanted else 'p'}, {threads} thread{'s'[: threads - 1]}"
            row(name, count, functools.partial(evaluator.pressure, points[:count], drive, wanted))
    row(
        "NumPy float32, 256-point chunks, p",
        CHECKED,
        lambda: Field(numpy_pressure(points[:CHECKED], array, drive, air)),
    )

    lines = [
        "# Field on the CPU",
        "",
        f"{cpu_model()}, {os.cpu_count()} cores seen, Python threads as named (NumPy: 1); commit {commit()}.",
        f"Array uhev1 (256 pistons with directivity and absorption), points 0.05 to 0.4 m away, {RUNS} runs, median.",
        f"Difference: relative L2 to the float64 twin at {CHECKED} points.",
        f"Two threads of plain hashing did {second_core():.2f} times the work of one just after: "
        "that is what a second thread could give on this machine.",
        "",
        "    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_field.py",
        "",
        "| what | million pairs/s | million pairs per core-second | difference |",
        "|---|---|---|---|",
        *rows,
        "",
    ]
    target = ROOT / "docs" / "bench" / "field.md"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text("\n".join(lines))
    print("\n".join(lines))


if __name__ == "__main__":
    main()
