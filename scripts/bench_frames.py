"""Compare the transfer matrix with frame-by-frame fields for thousands of foci on one skin. Writes a page.

python scripts/bench_frames.py                      # CPU: docs/bench/frames.md
python scripts/bench_frames.py --device cuda:0      # GPU: only prints its table, or writes --out
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import warp as wp
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arp import arp
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.transfer import Transfer
from palmfield.device import resolve
from palmfield.drive.quantise import quantise
from palmfield.studies.bench.field import device_name, git_commit
from palmfield.studies.bench.processes import cores, yardstick
from palmfield.studies.bench.table import processor
from palmfield.types import Air, Array, Complex, Float, Float32

ROOT = Path(__file__).resolve().parents[1]
AIR = Air()
LAYOUT = "uhev1"
FRAMES, TURNS, RADIUS_M, HEIGHT_M = 8000, 40, 0.01, 0.2
POINTS = 20_000
RUNS, ONE_BY_ONE, CHECKED = 5, 20, 5
SGEMM = 4000
"""Number of rows of the matrices whose product is the upper limit of the speed."""


@dataclass(frozen=True)
class Case:
    """Frames and the float64 results for CHECKED of them; expected: ARP [Pa], shape (CHECKED, POINTS)."""

    name: str
    drives: Complex
    expected: Float

    def error(self, found: Float32) -> float:
        """Return the relative L2 difference; found: ARP of all frames."""
        return float(np.linalg.norm(found[some()] - self.expected) / np.linalg.norm(self.expected))


def skin() -> tuple[Float, Float]:
    """Return points on a shallow dome over the array and its downward normals."""
    x, y = np.random.default_rng(0).uniform(-0.05, 0.05, (2, POINTS))
    normals = np.column_stack([4.0 * x, 4.0 * y, -np.ones(POINTS)])
    points = np.column_stack([x, y, HEIGHT_M + 2.0 * (x * x + y * y)])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def circle(array: Array) -> Complex:
    """Return the drives of a focus on a circle, shape (FRAMES, transducers), all different."""
    angle = np.linspace(0.0, 2.0 * np.pi * TURNS, FRAMES)
    places = RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle), np.full(FRAMES, HEIGHT_M / RADIUS_M)])
    return np.array([focus(array, AIR, place) for place in places])


def arp64(points: Float, normals: Float, array: Array, drive: Complex) -> Float:
    """Return the ARP [Pa] by the default law in float64 NumPy, from `pressure64`."""
    p, slope = pressure64(points, array, drive, AIR, gradient=True)
    assert slope is not None
    rho, c = density(AIR), sound_speed(AIR)
    u = slope / (2j * np.pi * array.frequency_Hz * rho)
    along = np.einsum("ij,ij->i", u, normals)
    tangential = u - along[:, None] * normals
    load = np.abs(p) ** 2 / (rho * c**2) - rho * (np.abs(tangential) ** 2).sum(axis=1)
    return np.where((p * along.conj()).real < 0.0, load, 0.0)


def median_s(work: Callable[[], object], runs: int = RUNS) -> float:
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def ceiling(threads: int) -> float:
    """Return the GFLOP/s of a large float32 product of NumPy's BLAS on a number of threads."""
    matrix = np.random.default_rng(0).normal(size=(SGEMM, SGEMM)).astype(np.float32)
    with threadpool_limits(threads, user_api="blas"):
        return 2e-9 * SGEMM**3 / median_s(lambda: matrix @ matrix)


def some() -> NDArray[np.int64]:
    """Return the frames that are compared with float64."""
    return np.linspace(0, FRAMES - 1, CHECKED).astype(int)


def one_by_one(evaluator: FieldEvaluator, points: Float, normals: Float, drives: Complex) -> None:
    for drive in drives[:ONE_BY_ONE]:
        field = evaluator.pressure(points, drive, gradient=True)
        arp(field, normals, AIR, evaluator.array.frequency_Hz, device="cpu")


def new_pages_s() -> float:
    """Return the additional time to fill the memory of the result when it is new [s]."""
    used = np.ones((FRAMES, POINTS), np.float32)
    return median_s(lambda: np.ones_like(used)) - median_s(lambda: used.fill(2.0))


def on_cpu(points: Float, normals: Float, cases: list[Case]) -> list[str]:
    lines = [
        "| frames | threads | matrix [s] | rank | reduction [s] | product and ARP [s] | GFLOP/s | frame by frame [s] "
        "| error |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for threads in sorted({1, os.cpu_count() or 1}):
        evaluator = FieldEvaluator(layout(LAYOUT), AIR, "cpu", threads=threads)
        transfer = Transfer(evaluator, points, normals)
        build_s = median_s(partial(Transfer, evaluator, points, normals))
        for case in cases:
            single_s = median_s(partial(one_by_one, evaluator, points, normals, case.drives)) * FRAMES / ONE_BY_ONE
            with threadpool_limits(1, user_api="blas"):
                reduce_s = median_s(partial(transfer.reduced, case.drives))
            error = case.error(transfer.arp(case.drives))
            arp_s = median_s(partial(transfer.arp, case.drives)) - reduce_s
            rank = transfer.reduced(case.drives)[0].shape[1]
            work = 2.0 * (2.0 * rank) * (8.0 * POINTS) * FRAMES
            lines.append(
                f"| {case.name} | {threads} | {build_s:.2f} | {rank} | {reduce_s:.2f} | {arp_s:.2f} "
                f"| {1e-9 * work / arp_s:.0f} | {single_s:.0f} | {error:.1e} |"
            )
    return lines


def gpu_s(transfer: Transfer, drives: Complex, device: str) -> float:
    """Return the time of one call with an idle GPU before and after it [s]."""
    wp.synchronize_device(device)
    start = time.perf_counter()
    result = transfer.arp_on_gpu(drives)
    wp.synchronize_device(device)
    seconds = time.perf_counter() - start
    assert result.shape == (FRAMES, POINTS)
    return seconds


def on_gpu(points: Float, normals: Float, cases: list[Case], device: str) -> list[str]:
    lines = [
        "| frames | rank | first call [s] | later calls [s] | reduction on the CPU, part of both [s] | error |",
        "|---|---|---|---|---|---|",
    ]
    evaluator = FieldEvaluator(layout(LAYOUT), AIR, device)
    for case in cases:
        transfer = Transfer(evaluator, points, normals)
        error = case.error(transfer.arp_on_gpu(case.drives).numpy())
        first_s = statistics.median(
            gpu_s(Transfer(evaluator, points, normals), case.drives, device) for _ in range(RUNS)
        )
        again_s = statistics.median(gpu_s(transfer, case.drives, device) for _ in range(RUNS))
        reduce_s = median_s(partial(transfer.reduced, case.drives))
        rank = transfer.reduced(case.drives)[0].shape[1]
        lines.append(f"| {case.name} | {rank} | {first_s:.3f} | {again_s:.3f} | {reduce_s:.3f} | {error:.1e} |")
    return lines


def head(device: str, commit: str) -> list[str]:
    option = "" if device == "cpu" else f" --device {device} --out docs/bench/frames.md"
    peaks = " and ".join(
        f"{ceiling(n):.0f} GFLOP/s on {n} thread{'s' * (n > 1)}" for n in sorted({1, os.cpu_count() or 1})
    )
    with threadpool_limits(1, user_api="blas"):
        yard_s = statistics.median(yardstick() for _ in range(RUNS))
    share = statistics.median(cores() for _ in range(RUNS))
    place = processor() if device == "cpu" else f"{device_name(device)}, Warp {wp.__version__}, host {processor()}"
    return [
        f"    python scripts/bench_frames.py{option}",
        "",
        f"{place}; commit {commit}. Yardstick: one float64 product of 1000 x 1000 matrices on one thread took "
        f"{1e3 * yard_s:.1f} ms; {os.cpu_count()} threads together did {share:.2f} times the hashing of one thread.  "
        f"The upper bound is the speed of NumPy's product of {SGEMM} x {SGEMM} float32 matrices: {peaks}.",
        "",
    ]


TEXT = f"""# Many frames on the same skin

For developers. This page has the time to compute the ARP of {FRAMES} frames of 256 transducers (uhev1) at {POINTS}
points of a dome {HEIGHT_M:g} m above the array. The frames move a focus {TURNS} times round a circle of
{2e3 * RADIUS_M:g} mm, with exact phases or with phases rounded to 8 bits. `Transfer` computes the matrix of pressures
and gradients once. `Transfer` then finds a small basis of the frames (its size is the rank). With it, matrix products
compute the ARP of all frames. The result has {4e-6 * FRAMES * POINTS:.0f} MB. Values are medians of {RUNS} runs.
The error is the relative L2 difference from float64 over {CHECKED} frames.
"""

CPU_TEXT = f"""
GFLOP/s is the work of the product divided by the time of product and ARP. Clearing new memory takes {{pages_s:.2f}} s
of this time; argument `out` avoids this. The time "frame by frame" is extrapolated from {ONE_BY_ONE} frames.
"""

GPU_TEXT = """
Times are for `Transfer.arp_on_gpu`, from NumPy drives to ARP on the GPU, with compiled kernels. The first call uploads
the matrix.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--commit", default="", help="where no git is")
    parser.add_argument("--out", type=Path, help="page [default: docs/bench/frames.md, none on a GPU]")
    args = parser.parse_args()
    device = resolve(args.device)
    array, (points, normals) = layout(LAYOUT), skin()
    exact = circle(array)
    cases = []
    for name, drives in (("circle", exact), ("circle, 8 bits", quantise(exact, phase_steps=256))):
        expected = np.array([arp64(points, normals, array, drives[i]) for i in some()])
        cases.append(Case(name, drives, expected))
    lines = head(device, args.commit or git_commit())
    if device == "cpu":
        lines = [TEXT, *lines, *on_cpu(points, normals, cases), CPU_TEXT.format(pages_s=new_pages_s())]
    else:
        lines = ["", "## On a GPU", "", *lines, *on_gpu(points, normals, cases, device), GPU_TEXT]
    text = "\n".join(lines)
    print(text)
    if args.out is not None or device == "cpu":
        with open(args.out or ROOT / "docs" / "bench" / "frames.md", "w" if device == "cpu" else "a") as page:
            page.write(text)


if __name__ == "__main__":
    main()
