"""Measure time and error of the reference disc and of fast foci by their best solvers, on a quiet machine.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_skin_targets.py [--runs 5] [--out FILE]

Times are medians. Run it without other load: it prints the load of the machine and the time of a fixed matrix product
in the same period.
"""

import argparse
import os
import re
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
from bench_axisymmetric import SIDES, disc, loads
from bench_lateral_waves import SURFACE, passage, plate
from bench_spectral_elements import gap

from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet
from palmfield.skin.problem import Motion, SkinProblem, Slab
from palmfield.skin.solvers.axisymmetric.solve import solve_axisymmetric
from palmfield.skin.solvers.lateral_waves import solve_lateral_waves
from palmfield.skin.solvers.spectral_elements.solve import solve_spectral_elements
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import keep_rows, processor, ranged

ROOT = Path(__file__).resolve().parents[1]
TIMES = 1e-4 * np.arange(1, 2001)
AT = np.array([[0.0, 0.0], [0.01, 0.0]])
OTHER_m = count(0.0, 1e-12)
SHORT = ["| case | time [s] | error | estimate |", "|---|---|---|---|"]
MATRIX = np.random.default_rng(0).standard_normal((1000, 1000))


def yardstick() -> float:
    """Return the time of a product of two float64 matrices of 1000 x 1000 on one thread [ms]."""
    begin = time.perf_counter()
    MATRIX @ MATRIX
    return 1e3 * (time.perf_counter() - begin)


def row(name: str, runs: int, call: Callable[[], Motion], finer: Callable[[], Motion], velocity: bool = False) -> str:
    """Return median wall and processor time, the yardstick, the error relative to the finer run, and the estimate."""
    wall, busy, yards = [], [], []
    for _ in range(runs):
        yards.append(yardstick())
        clock, process = time.perf_counter(), time.process_time()
        motion = call()
        wall.append(time.perf_counter() - clock)
        busy.append(time.process_time() - process)
    reference = finer()
    if velocity:
        found, exact = motion.velocity_m_s[0, ::37, 2], reference.velocity_m_s[0, :, 2]
        error = float(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    else:
        error = gap(motion.displacement_m[:, :, 2], reference.displacement_m[:, :, 2])
    seconds, threads, yard = (statistics.median(values) for values in (wall, busy, yards))
    line = (
        f"| {name} | {seconds:.2f} | {threads:.2f} | {max(wall):.2f} | {yard:.1f} | {100 * error:.2f} % "
        f"| {100 * motion.error:.2f} % | {motion.solver} |"
    )
    print(line, flush=True)
    return line


def disc_rows(runs: int, solve: Callable[..., Motion], accuracy: float) -> list[str]:
    """Run every side and load of the disc by one solver, relative to the disc solver's own finer run."""
    lines = []
    for side in SIDES:
        for name, load in loads().items():
            body = disc(side)

            def call(body=body, load=load) -> Motion:
                # Another spot each time: models of the same one are kept, for other courses of its pressure
                other = replace(load, fwhm_m=load.fwhm_m + next(OTHER_m))
                return solve(SkinProblem(body, other, TIMES, AT, accuracy))

            def finer(body=body, load=load) -> Motion:
                return solve_axisymmetric(SkinProblem(body, load, TIMES, AT, accuracy=0.002), degree=7)

            lines.append(row(f"{side}, {name}", runs, call, finer))
    return lines


def endless_rows(runs: int) -> list[str]:
    lines = []
    body = Slab((Sheet(preset("ecoflex_00-10"), 0.02),))
    for name, load in loads().items():

        def call(load=load) -> Motion:
            return solve_lateral_waves(SkinProblem(body, load, TIMES, AT, accuracy=0.01), threads=2)

        def finer(load=load) -> Motion:
            return solve_lateral_waves(SkinProblem(body, load, TIMES, AT), tolerance=3e-4, threads=2)

        lines.append(row(f"endless, {name}", runs, call, finer))
    return lines


def plate_rows(runs: int) -> list[str]:
    lines = []
    for nu in (0.5, 0.495):
        for base in ("bonded", "free"):
            for speed in (3.0, 5.0, 7.0):
                body, load = Slab((Sheet(plate(nu), 0.01),), base=base), passage(speed)

                def call(body=body, load=load) -> Motion:
                    return solve_lateral_waves(
                        SkinProblem(body, load, load.times_s[-1:], SURFACE, accuracy=0.05), threads=2
                    )

                def finer(body=body, load=load) -> Motion:
                    return solve_lateral_waves(
                        SkinProblem(body, load, load.times_s[-1:], SURFACE[::37]), tolerance=1e-3, threads=2
                    )

                lines.append(row(f"nu {nu}, {base}, {speed:g} m/s", runs, call, finer, velocity=True))
    return lines


def short(lines: list[str], case: str) -> list[str]:
    """Return time, error and estimate over all rows whose case has the same first group of a pattern."""
    kinds = [re.sub(rf"^\| {case} \|", r"| \1 |", line) for line in lines]
    return ranged(kinds, (0,), (1, 5, 6))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--general-runs", type=int, default=1, help="of the general elements, which take longer")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "skin_targets.md")
    arguments = parser.parse_args()
    busy = os.getloadavg()[0]
    # Kernels are compiled before anything is timed
    first = loads()["1 ms ramp"]
    solve_lateral_waves(
        SkinProblem(Slab((Sheet(preset("ecoflex_00-10"), 0.02),)), first, TIMES[:10], AT), tolerance=0.1
    )
    solve_spectral_elements(SkinProblem(disc("fixed"), first, TIMES[:5], AT, accuracy=0.02))
    head = "| case | s | s of threads | slowest | yardstick [ms] | error | estimate | how |"
    rule = "|---|---|---|---|---|---|---|---|"
    parts = [
        disc_rows(arguments.runs, solve_axisymmetric, 0.01),
        endless_rows(arguments.runs),
        plate_rows(arguments.runs),
        disc_rows(arguments.general_runs, solve_spectral_elements, 0.02),
    ]
    link = keep_rows(
        arguments.out,
        [head, rule, *(f"| general, {line[2:]}" if part is parts[-1] else line for part in parts for line in part)],
    )
    round_ones, general = (short(parts[i], r"[\w ]+, ([^|]+)") for i in (0, 3))
    lines = [
        "# Time and error for the reference disc",
        "",
        "    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_skin_targets.py",
        "",
        f"For developers of solvers. {processor()}, {os.cpu_count()} cores, load average {busy:.1f} at the start; "
        f"commit {git_commit()}. Medians of {arguments.runs} runs with compiled kernels. {link} also has the "
        "slowest run, the time of all threads, the mesh, a yardstick (a float64 product of 1000 x 1000 matrices on "
        "one thread), and the cases of [lateral waves](skin_lateral_waves.md).",
        "",
        "## Solver `axisymmetric`, target 1 %",
        "",
        "The body is a bonded disc of Ecoflex 00-10 (diameter 120 mm, height 20 mm) with free, fixed or roller sides, "
        "under a spot of 10.3 mm. The motion is computed for 0.2 s at 2000 times, at the centre and 10 mm off. The "
        "error is the relative L2 error of the normal displacement at the worse point, compared with a finer solution "
        "of the same solver. This is a test of consistency; [skin](skin.md) has the accuracy.",
        "",
        *SHORT,
        *round_ones,
        "",
        "## Solver `spectral_elements`, target 2 %",
        "",
        f"Times are medians of {arguments.general_runs} runs, for all kinds of sides. The reference is "
        "`axisymmetric`. If the estimate is above the target, `solve` continues with finer elements. Then the other "
        "loads take as long as the ramp.",
        "",
        *SHORT,
        *general,
        "",
    ]
    arguments.out.write_text("\n".join(lines))


if __name__ == "__main__":
    main()
