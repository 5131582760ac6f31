"""Measure time and error of solver lateral_waves: Ecoflex disc, and fast foci over a nearly lossless plate.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_lateral_waves.py [--threads 2] [--deep]

Writes docs/bench/skin_lateral_waves.md. `--deep` adds the slab of 100 mm, which takes minutes.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np

from palmfield.skin.analytic.mach import mach_half_angle
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import Load, Motion, SkinProblem, Slab, Spot
from palmfield.skin.solvers.lateral_waves import cost_lateral_waves, solve_lateral_waves, static_lateral_waves
from palmfield.skin.solvers.lateral_waves.resolution import relative_error
from palmfield.studies.bench.table import cells, keep_rows, ranged

ROOT = Path(__file__).parents[1]
TIMES = np.arange(2001) * 1e-4
AT = np.array([[0.0, 0.0], [0.01, 0.0]])
SHEAR = 23087.5
X, Y = np.arange(-0.12, 0.1201, 1e-3), np.arange(-0.06, 0.0601, 1e-3)
SURFACE = np.stack([part.ravel() for part in np.meshgrid(X, Y, indexing="ij")], axis=1)


def reference_loads() -> dict[str, Load]:
    turn = 2.0 * np.pi * 70.0 * TIMES
    ramp = 0.5 * (1.0 - np.cos(np.pi * np.minimum(TIMES / 1e-3, 1.0)))
    circle = 0.01 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return {
        "static": Spot(0.0103, np.zeros(1), np.ones(1), law="held"),
        "ramp 1 ms": Spot(0.0103, TIMES, ramp),
        "step": Spot(0.0103, np.zeros(1), np.ones(1), law="held"),
        "AM 200 Hz": Spot(0.0103, TIMES, 0.5 * (1.0 + np.sin(2.0 * np.pi * 200.0 * TIMES))),
        "STM 70 Hz": Spot(0.0103, TIMES, np.ones(len(TIMES)), circle),
    }


def timed(call, *arguments, **keywords) -> tuple[Motion, float, float]:
    """Return the answer, the wall time and the processor time of all threads [s]."""
    wall, busy = time.perf_counter(), time.process_time()
    motion = call(*arguments, **keywords)
    return motion, time.perf_counter() - wall, time.process_time() - busy


def reference_rows(threads: int) -> list[str]:
    rows = []
    sheets = (Sheet(PRESETS["ecoflex_00-10"], 0.02),)
    for body in (Slab(sheets), Slab(sheets, shape="disc", side="roller", radius_m=0.06)):
        for name, load in reference_loads().items():
            if body.shape == "disc" and name == "STM 70 Hz":
                continue
            if name == "static":
                motion, wall, busy = timed(static_lateral_waves, body, load, AT, accuracy=0.01, threads=threads)
                finer = static_lateral_waves(body, load, AT, tolerance=3e-4, threads=threads)
                predicted = float("nan")
            else:
                motion, wall, busy = timed(
                    solve_lateral_waves, SkinProblem(body, load, TIMES, AT, accuracy=0.01), threads=threads
                )
                finer = solve_lateral_waves(SkinProblem(body, load, TIMES, AT), tolerance=3e-4, threads=threads)
                predicted = cost_lateral_waves(SkinProblem(body, load, TIMES, AT, 0.01))
            error = relative_error(motion.displacement_m, finer.displacement_m)
            lowest = -1e9 * finer.displacement_m[..., 2].min(axis=0)
            last = -1e9 * finer.displacement_m[-1, :, 2]
            rows.append(
                f"| {body.shape} | {name} | {wall:.2f} | {busy:.2f} | {predicted:.1f} | {100 * motion.error:.3f} % | "
                f"{100 * error:.3f} % | {100 * finer.error:.4f} % | {lowest[0]:.3f} / {lowest[1]:.3f} | "
                f"{last[0]:.3f} / {last[1]:.3f} |"
            )
            print(rows[-1], flush=True)
    return rows


def plate(nu: float) -> Material:
    if nu == 0.5:
        return Material("plate", 923.5, SHEAR, (), 1e6 * SHEAR, "K = 1e6 G stands for nu 0.5", 0.0202)
    return Material("plate", 923.5, SHEAR, (), bulk_from_poisson(nu, SHEAR), "damping on K too", 0.0202, True)


def passage(speed: float) -> Spot:
    return Spot(0.006, np.array([0.0, 0.16 / speed]), np.ones(2), np.array([[-0.08, 0.0], [0.08, 0.0]]))


def wake(
    body: Slab, speed: float, points: np.ndarray, threads: int, accuracy: float = 0.05, tolerance: float | None = None
) -> tuple[Motion, float, float]:
    load = passage(speed)
    problem = SkinProblem(body, load, load.times_s[-1:], points, accuracy)
    return timed(solve_lateral_waves, problem, threads=threads, tolerance=tolerance)


def plate_rows(threads: int) -> list[str]:
    rows = []
    some = SURFACE[::37]
    for nu in (0.5, 0.495):
        for base in ("bonded", "free"):
            for speed in (3.0, 5.0, 7.0):
                body = Slab((Sheet(plate(nu), 0.01),), base=base)
                motion, wall, busy = wake(body, speed, SURFACE, threads, accuracy=0.05)
                finer = wake(body, speed, some, threads, tolerance=1e-3)[0]
                found, exact = motion.velocity_m_s[0, ::37, 2], finer.velocity_m_s[0, :, 2]
                error = np.linalg.norm(found - exact) / np.linalg.norm(exact)
                snapshot = motion.velocity_m_s[0, :, 2].reshape(len(X), len(Y))
                angle = f"{mach_half_angle(snapshot, X, Y, 0.009):.1f}" if speed > 5.0 else "-"
                rows.append(
                    f"| {nu} | {base} | {speed:g} | {wall:.2f} | {busy:.2f} | {100 * motion.error:.3f} % | "
                    f"{100 * error:.3f} % | {1e6 * np.sqrt((snapshot**2).mean()):.4f} | "
                    f"{1e6 * np.abs(snapshot).max():.3f} | {angle} |"
                )
                print(rows[-1], flush=True)
    return rows


def deep_lines(threads: int) -> list[str]:
    motion, wall, busy = wake(Slab((Sheet(plate(0.495), 0.1),)), 5.5, SURFACE, threads, tolerance=0.05)
    snapshot = motion.velocity_m_s[0, :, 2].reshape(len(X), len(Y))
    angle = mach_half_angle(snapshot, X, Y, 0.009)
    expected = np.degrees(np.arcsin(0.95449 * np.sqrt(SHEAR / 923.5) / 5.5))
    return [
        "",
        f"For a bonded slab of 100 mm (nu 0.495) and a focus at 5.5 m/s, `mach_half_angle` gives {angle:.2f} degrees. "
        f"The theory, asin(c_R/v), gives {expected:.2f} degrees. The computation took {wall:.0f} s ({busy:.0f} CPU s "
        f"over all threads), with an error of {100 * motion.error:.2f} %.",
    ]


BODIES = "| body | load | s | s of threads | predicted | estimate | error | of the finer | largest push | last push |"
PLATES = "| nu | base | m/s | s | s of threads | estimate (displacement) | error (velocity) | rms | largest | angle |"
PAGE = ROOT / "docs" / "bench" / "skin_lateral_waves.md"


def picked(table: list[str], columns: tuple[int, ...]) -> list[str]:
    """Return some columns of a table without a rule, with a rule."""
    lines = [f"| {' | '.join(cells(line)[i] for i in columns)} |" for line in table]
    return [lines[0], "|" + "---|" * len(columns), *lines[1:]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--deep", action="store_true")
    choice = parser.parse_args()
    # Loads the kernels
    solve_lateral_waves(
        SkinProblem(Slab((Sheet(PRESETS["ecoflex_00-10"], 0.02),)), passage(5.0), np.array([1e-3]), AT), tolerance=0.1
    )
    load = os.getloadavg()[0]
    bodies, plates = reference_rows(choice.threads), plate_rows(choice.threads)
    lines = [
        "# Solver `lateral_waves`: time and error",
        "",
        "For developers of solvers. Command: `OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python "
        f"scripts/bench_lateral_waves.py --threads {choice.threads}{' --deep' if choice.deep else ''}`",
        f"{os.cpu_count()} cores, load average {load:.1f} at the start, compiled kernels. The finer run for the",
        "estimate has a fifth of the tolerance.",
        "",
        "A layer of Ecoflex 00-10, 20 mm thick and bonded, is under a spot of 10.3 mm for 0.2 s. The target is 1 % at",
        "2001 times, at the centre and at r = 10 mm. The error is relative to a run at tolerance 3e-4.",
        "`cost_lateral_waves` predicts the time on one core. The last column has the largest displacement at the",
        f"centre / at r = 10 mm. {keep_rows(PAGE, [BODIES, '', *bodies])} also has the estimate of the finer run.",
        "",
        *picked([BODIES, *bodies], (0, 1, 2, 3, 4, 5, 6, 8)),
        "",
        "An infinite plate is 10 mm thick and has a density of 923.5 kg/m3, a shear modulus of 23087.5 Pa and a",
        "Kelvin-Voigt viscosity of 0.0202 Pa s. A spot of 6 mm moves over 160 mm. The normal velocity at the end is",
        "computed at 241 x 121 points, for a target accuracy of 5 % of the displacement. The error is the relative L2",
        "error over every 37th point, compared with a run at tolerance 1e-3.",
        "",
        "| nu | base | time [s] | estimate (displacement) | error (velocity) | largest velocity [um/s per Pa] |",
        "|---|---|---|---|---|---|",
        *ranged(plates, (0, 1), (3, 5, 6, 8)),
        "",
        keep_rows(PAGE, [PLATES, "", *plates], "skin_lateral_waves_plate")
        + " has each speed, the time of all threads, rms values and Mach angles.",
        *(deep_lines(choice.threads) if choice.deep else []),
        "",
    ]
    PAGE.write_text("\n".join(lines))


if __name__ == "__main__":
    main()
