"""Compare the GPU with the CPU and with the float64 twin: error and speed of the field.

    python scripts/check_gpu.py [--out docs/bench/gpu.md] [--commit HASH]

Needs a CUDA device. A pair is one transducer and one point. Times are medians of 7 and include the transfer of the
results to the host.
"""

import argparse
import hashlib
import statistics
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import warp as wp

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import MODES, FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.device import resolve
from palmfield.types import Air

eight = wp.types.vector(length=8, dtype=wp.float32)
ROOT = Path(__file__).resolve().parents[1]


def field_rows(device: str) -> list[str]:
    array, air = layout("uhev1"), Air()
    drive = focus(array, air, np.array([0.02, -0.01, 0.2]))
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.4], (1_000_003, 3)).astype(np.float32)
    exact = pressure64(points[:20_003], array, drive, air, gradient=True)
    rows = []
    for where in (device, "cpu"):
        evaluator = FieldEvaluator(array, air, where)
        for gradient in (False, True):
            evaluator.pressure(points, drive, gradient)
            times = []
            for _ in range(7):
                start = time.perf_counter()
                field = evaluator.pressure(points, drive, gradient)
                times.append(time.perf_counter() - start)
            got = field.gradient if gradient else field.pressure
            expected = exact[1] if gradient else exact[0]
            error = np.linalg.norm(got[:20_003] - expected) / np.linalg.norm(expected)
            speed = len(points) * len(array) / statistics.median(times) / 1e9
            rows.append(f"| {where} | {'p + gradient' if gradient else 'p'} | {speed:.2f} | {error:.1e} |")
    return rows


SLOTS = {"p": 24.5, "p + gradient": 44.75}
"""Instructions per pair in the inner loops of mode fast, flat, as compiled for sm_90 (counted with nvdisasm).

Beyond 0.4 m there is one more, because the decay with distance is then a cubic.
"""

COUNTED = "0ce19cda68bb"
"""First 12 digits of the SHA-256 of the files of warp_kernels, in sequence, with these instruction counts."""

KERNELS = ("pressure.py", "gradient.py")

SINES = 3
"""Instructions on the special-function unit: a root, a sine, a cosine; it does 16 per clock and multiprocessor."""

CHAINS = 8
KERNEL_POINTS = 40_000_000


@wp.kernel(module="unique", module_options={"fast_math": True}, enable_backward=False)
def multiply_add(result: wp.array(dtype=wp.float32), rounds: int, factor: wp.float32):
    thread = wp.tid()
    values = eight()
    for i in range(CHAINS):
        values[i] = wp.float32(thread + i)
    for _ in range(rounds):
        for _ in range(CHAINS):
            for i in range(CHAINS):
                values[i] = values[i] * factor + factor
    total = wp.float32(0.0)
    for i in range(CHAINS):
        total += values[i]
    result[thread] = total


def issue_rate(device: str) -> float:
    """Return the fused multiply-adds of this GPU per second, which is the issue rate of its schedulers."""
    result = wp.zeros(132 * 2048 * 8, dtype=wp.float32, device=device)
    times = []
    for _ in range(5):
        wp.synchronize_device(device)
        start = time.perf_counter()
        wp.launch(multiply_add, dim=len(result), inputs=[result, 2000, 0.999], device=device)
        wp.synchronize_device(device)
        times.append(time.perf_counter() - start)
    return len(result) * 2000 * CHAINS**2 / statistics.median(times)


def counted() -> bool:
    """Return whether SLOTS are those of the present kernels."""
    return digest() == COUNTED


def digest() -> str:
    source = b"".join((ROOT / "warp_kernels" / name).read_bytes() for name in KERNELS)
    return hashlib.sha256(source).hexdigest()[:12]


def ceilings(rate: float) -> str:
    """Describe the upper limits of the GPU in words. rate: as returned by `issue_rate`."""
    sines = (
        f"A pair also takes {SINES} roots, sines and cosines, at an eighth of the rate of multiply-adds. These alone "
        f"limit the speed to {rate / 8 / SINES / 1e12:.2f} T "
    )
    if not counted():
        return sines + "pairs/s. The other instructions of these kernels were not counted, so there is no ceiling."
    most = [rate / SLOTS[what] / 1e12 for what in SLOTS]
    return (
        f"A pair takes {SLOTS['p']} instructions, or {SLOTS['p + gradient']} with the gradient, and one more beyond "
        f"0.4 m. So the ceiling is {most[0]:.2f} T pairs/s, or {most[1]:.2f} T pairs/s with the gradient. "
        f"{sines}pairs/s."
    )


def kernel_rows(device: str, rate: float) -> list[str]:
    """Measure the field kernels alone, with 996 transducers: points and results stay on the GPU.

    The number of points makes the work of the host per call negligible.
    """
    array, air = layout("autd3_2x2"), Air()
    array = replace(array, directivity_table=None)
    drive = focus(array, air, np.array([0.02, -0.01, 0.2]))
    rng = np.random.default_rng(2)
    rows = []
    for low, high in ((0.05, 0.4), (0.4, 1.2)):
        points = rng.uniform([-0.15, -0.15, low], [0.15, 0.15, high], (KERNEL_POINTS, 3))
        exact = pressure64(points[:10_000], array, drive, air, gradient=True)
        for mode in MODES:
            evaluator = FieldEvaluator(array, air, device, mode=mode)
            there = evaluator.upload(points)
            for gradient in (False, True):
                found = evaluator.pressure(there, drive, gradient)
                times = []
                for _ in range(7):
                    wp.synchronize_device(device)
                    start = time.perf_counter()
                    found = evaluator.pressure(there, drive, gradient)
                    wp.synchronize_device(device)
                    times.append(time.perf_counter() - start)
                errors = [
                    np.linalg.norm(got.numpy()[: len(expected)].view(np.complex64)[..., 0] - expected)
                    / np.linalg.norm(expected)
                    for got, expected in zip((found.pressure, found.gradient), exact, strict=True)
                    if got is not None
                ]
                speed = len(points) * len(array) / statistics.median(times) / 1e12
                what = "p + gradient" if gradient else "p"
                error = ", gradient ".join(f"{e:.1e}" for e in errors)
                slots = SLOTS[what] + (low >= 0.4)
                share = f"{100 * speed * 1e12 * slots / rate:.0f} %" if mode == "fast" and counted() else "-"
                rows.append(f"| {low} to {high} m | {mode} | {what} | {speed:.3f} | {share} | {error} |")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--commit", default="unknown", help="commit for the page")
    arguments = parser.parse_args()
    device = resolve("cuda:0")
    rate = issue_rate(device)
    lines = [
        "# The field on a GPU",
        "",
        f"For developers. `python scripts/check_gpu.py`, {wp.get_device(device).name}, Warp {wp.__version__}, commit "
        f"{arguments.commit}. The field of 256 pistons with absorption is computed at 1,000,003 points. Times include "
        "the transfer of the results. A pair is one transducer and one point. The error is relative L2 over 20,003 "
        "points, compared with our own code in float64; [peers](peers.md) has the accuracy of that code.",
        "",
        "| device | result | G pairs/s | error |",
        "|---|---|---|---|",
        *field_rows(device),
        "",
        "## Only the kernels",
        "",
        f"The field of 996 pistons with absorption (four AUTD3 units) is computed at {KERNEL_POINTS:,} points that "
        f"stay on the GPU. The GPU does {rate / 1e12:.1f} T multiply-adds a second. {ceilings(rate)}",
        "",
        "| distance | mode | result | T pairs/s | share of the ceiling | error |",
        "|---|---|---|---|---|---|",
        *kernel_rows(device, rate),
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    if arguments.out:
        arguments.out.write_text(text)


if __name__ == "__main__":
    main()
