#!/usr/bin/env python3
"""Measure one call of the field: in all, with points on the device, and the kernels alone.

python scripts/bench/field_call.py [--device cuda:0] [--points 22000] [--repeats 200] [--layout autd3_2x2]

It prints a table by mode and result: median and 10th percentile of the time [ms], pairs of point and transducer per
second from the median, and the difference from mode "accurate" with the same points from NumPy, relative to its norm.
`kernels` are the launches of a call without checks and copies. In `one part` each thread of a GPU sums all transducers.
The script checks that results agree with the float64 reference, that repeated calls return equal bits, and that
points from NumPy and from the device give equal results. Its exit status is 1 if a check fails.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from palmfield.acoustics import field
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.device import resolve
from palmfield.studies.bench.table import processor
from palmfield.threads import cores
from palmfield.types import Air, Field

FIRST = 5
"""Number of omitted first calls: kernels are compiled and graphs captured in them."""
LIMIT = 1e-4
"""Largest allowed difference from the reference, relative to its norm, of mode fast at 0.05 to 0.4 m."""
SECONDS = 2.0
"""Time after which a row has enough repeats [s]."""


def times(call: Callable[[], object], repeats: int, device: str) -> list[float]:
    """Return the time of each call until its results are available, sorted [s]."""
    spans: list[float] = []
    until = time.perf_counter() + SECONDS
    for i in range(FIRST + repeats):
        start = time.perf_counter()
        call()
        if device != "cpu":
            wp.synchronize_stream(device)
        if i >= FIRST:
            spans.append(time.perf_counter() - start)
        if len(spans) >= 5 and start > until:
            break
    return sorted(spans)


def on_host(values: Any) -> np.ndarray:
    """Return the complex numbers of a result from NumPy or a device."""
    return values.numpy().view(np.complex64)[..., 0] if isinstance(values, wp.array) else values


def difference(found: Field, expected: Field) -> float:
    """Return the larger difference of pressure and gradient, relative to the norm."""
    pairs = [(found.pressure, expected.pressure), (found.gradient, expected.gradient)]
    errors = [np.linalg.norm(on_host(a) - on_host(b)) / np.linalg.norm(on_host(b)) for a, b in pairs if a is not None]
    return float(max(errors))


def same(one: Field, other: Field) -> bool:
    """Return whether two results agree to the bit."""
    return np.array_equal(on_host(one.pressure), on_host(other.pressure)) and (
        one.gradient is None or np.array_equal(on_host(one.gradient), on_host(other.gradient))
    )


def launches(evaluator: field.FieldEvaluator, gradient: bool) -> Callable[[], object]:
    """Return the kernels of the last call of the evaluator with points on its device."""
    (calls,) = (kept for (_, slope, _), kept in evaluator._calls.items() if slope == gradient)
    return next(launch for (_, copied), launch in calls[0]._launches.items() if not copied)


def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--points", type=int, default=22_000, help=f"1 to {field.MOST_POINTS} [%(default)s]")
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--layout", default="autd3_2x2")
    args = parser.parse_args()
    if not 1 <= args.points <= field.MOST_POINTS or args.repeats < 5:
        parser.error(f"--points {args.points} --repeats {args.repeats}: 1 to {field.MOST_POINTS} points, >= 5 repeats")
    device, array, air = resolve("cuda:0" if args.device == "cuda" else args.device), layout(args.layout), Air()
    drive = focus(array, air, np.array([0.02, -0.01, 0.2]))
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.4], (args.points, 3))
    few = slice(0, min(args.points, 2000))
    name = f"{processor()}, {cores()} cores" if device == "cpu" else wp.get_device(device).name
    print(f"{name}, Warp {wp.__version__}: {args.points} points, {len(array)} transducers of {args.layout}")
    print(
        "| mode | result | call | p50 [ms] | p10 [ms] | G pairs/s | against accurate |\n|---|---|---|---|---|---|---|"
    )
    wrong = []
    enough = field.THREADS_ENOUGH
    for gradient in (False, True):
        what = "p + gradient" if gradient else "p"
        best = field.FieldEvaluator(array, air, device, mode="accurate").pressure(points, drive, gradient)
        exact = Field(*pressure64(points[few], array, drive, air, gradient=gradient))
        for mode in field.MODES:
            evaluator = field.FieldEvaluator(array, air, device, mode=mode)
            where, raw = evaluator.upload(points), evaluator.upload(points).array
            calls: dict[str, Callable[[], Any]] = {
                "NumPy in and out": lambda e=evaluator, g=gradient: e.pressure(points, drive, g),
                "`upload`ed points": lambda e=evaluator, g=gradient, w=where: e.pressure(w, drive, g),
                "Warp array": lambda e=evaluator, g=gradient, w=raw: e.pressure(w, drive, g),
            }
            found = {how: call() for how, call in calls.items()}
            for how, call in calls.items():
                report(mode, what, how, times(call, args.repeats, device), points, array, difference(found[how], best))
                if not same(found[how], call()):
                    wrong.append(f"{mode}, {what}, {how}: a repeated call differs")
                if difference(found[how], found["NumPy in and out"]) > LIMIT:
                    wrong.append(f"{mode}, {what}, {how}: differs from NumPy's")
            start = Field(*(None if v is None else on_host(v)[few] for v in vars(found["NumPy in and out"]).values()))
            if difference(start, exact) > LIMIT:
                wrong.append(f"{mode}, {what}: {difference(start, exact):.1e} from the float64 reference")
            for how, threads in (("kernels", enough), ("kernels, one part", 0))[
                : 1 + (device != "cpu" and not gradient)
            ]:
                field.THREADS_ENOUGH = threads
                alone = field.FieldEvaluator(array, air, device, mode=mode)
                alone.pressure(where, drive, gradient)
                report(mode, what, how, times(launches(alone, gradient), args.repeats, device), points, array, None)
            field.THREADS_ENOUGH = enough
    print(
        "\n".join(wrong) or "Checked: the reference, repeats to the bit, and results from NumPy and the device agree."
    )
    sys.exit(bool(wrong))


def report(mode: str, what: str, how: str, spans: list[float], points: Any, array: Any, error: float | None) -> None:
    """Return a row of the table."""
    median = statistics.median(spans)
    speed, low = len(points) * len(array) / median / 1e9, spans[len(spans) // 10]
    shown = "" if error is None else f"{error:.1e}"
    print(f"| {mode} | {what} | {how} | {1e3 * median:.3f} | {1e3 * low:.3f} | {speed:.1f} | {shown} |", flush=True)


if __name__ == "__main__":
    main()
