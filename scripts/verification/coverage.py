"""Are the skin solvers' error estimates true? Random cases against converged answers; writes a table.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/verification/coverage.py --cases 40 --seed 1 --processes 2 \
        [--device cpu] [--out docs/bench/skin_coverage.md] [--commit NAME] [--longest 60] [--limit 600] [--duration 0.1]

The table is written anew whenever a case is done, so that Ctrl-C keeps what there is.
"""

import argparse
import multiprocessing
import os
import time
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
from coverage_cases import Row, judge, summary
from random_cases import random_case

from palmfield.skin.materials.catalogue import preset
from palmfield.skin.problem import Sheet, Slab, Spot
from palmfield.skin.solvers.lateral_waves.solve import solve_lateral_waves
from palmfield.skin.solvers.particles.solve import solve_particles
from palmfield.skin.solvers.spectral_elements.solve import solve_spectral_elements
from palmfield.skin.solvers.wedges import first_sizes, solve_wedges
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor

HEAD = (
    "| case | asked | solver | wanted | estimate | true | estimate / true | s | processor s | predicted s | reference |"
)


def warm(device: str) -> None:
    """Compile what the solvers need, so that no case pays for it."""
    box = Slab((Sheet(preset("ecoflex_00-10"), 0.005),), "box", side="roller", size_m=(0.03, 0.03))
    load, times, at = Spot(0.008, [0.0, 0.01], [0.0, 1.0]), [0.001], [[0.0, 0.0]]
    solve_lateral_waves(box, load, times, at, accuracy=0.5, device=device)
    sizes = first_sizes(box, load, np.zeros((1, 3)), 0.5)
    solve_wedges(box, load, times, at, device=device, sizes=sizes, step_s=0.0005)
    solve_particles(box, load, times, at, accuracy=0.5, device=device)
    for order in (1, 2, 3, 4):
        solve_spectral_elements(box, load, times, at, device=device, order=order, size_m=0.01)


def one(seed: int, number: int, settings: argparse.Namespace) -> list[Row]:
    case = random_case(seed, number, settings.duration)
    return judge(case, settings.device, settings.longest, settings.limit)


def line(row: Row) -> str:
    if row.missing:
        return (
            f"| {row.number} | {row.asked} | {row.missing} | {100 * row.wanted:.2g} % | | | | | | | {row.reference} |"
        )
    ratio = f"{row.estimate / row.true:.2g}" if row.true > 0.0 else "-"
    mark = "" if row.estimate >= row.true else " **low**"
    return (
        f"| {row.number} | {row.asked} | {row.solver} | {100 * row.wanted:.2g} % | {100 * row.estimate:.2g} % "
        f"| {100 * row.true:.2g} % | {ratio}{mark} | {row.seconds:.2g} | {row.processor_s:.2g} | {row.predicted:.2g} "
        f"| {row.reference} |"
    )


def report(rows: list[Row], settings: argparse.Namespace, begun_load: float) -> str:
    rows = sorted(rows, key=lambda row: row.number)
    chosen = [row for row in rows if row.asked == "auto"]
    named = [row for row in rows if row.asked != "auto"]
    dropped = [row for row in chosen if row.missing.startswith("dropped")]
    lines = [
        "# Are the error estimates of the skin solvers true?",
        "",
        f"    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/verification/coverage.py "
        f"--cases {settings.cases} --seed {settings.seed} --processes {settings.processes} --device {settings.device}",
        "",
        f"{processor()}, {os.cpu_count()} cores, load {begun_load:.1f} at the start; commit {settings.commit}.",
        "",
        "Random bodies, materials and loads (`scripts/verification/random_cases.py`). True: relative L2 over the "
        "times at a "
        "point, the largest of the points, of the difference from a converged answer; the estimate is of the same. "
        "Converged: lateral waves at 1e-4 where they know the body (absorbing slabs count as endless, flat roller "
        "layers as boxes), else the disc's harmonics of degree 7 at a tenth of the accuracy, else spectral elements of "
        "high order on two meshes that agree to a tenth of the accuracy; a case without one is dropped. "
        f"A run above {settings.limit:.0f} s was given up. Seconds and processor seconds include finer solutions where "
        "an estimate missed; predictions are for one core and the first solution.",
        "",
        f"Cases done: {len(chosen)}; dropped: {len(dropped)}.",
        "",
        "| asked | answers | estimate >= true | median of estimate / true | median of predicted / processor seconds |",
        "|---|---|---|---|---|",
    ]
    for asked, (count, share, ratio, cost) in sorted(summary(rows).items()):
        lines.append(f"| {asked} | {count} | {100 * share:.0f} % | {ratio:.2g} | {cost:.2g} |")
    for title, part in (("By `auto`", chosen), ("By name", named)):
        lines += ["", f"## {title}", "", HEAD, "|" + "---|" * HEAD.count(" |"), *(line(row) for row in part)]
    lines += ["", "## Cases", "", "| case | what |", "|---|---|"]
    lines += [f"| {row.number} | {row.words} |" for row in chosen]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=Path("docs/bench/skin_coverage.md"))
    parser.add_argument("--commit", default="", help="name of the commit, where there is no git")
    parser.add_argument("--longest", type=float, default=60.0, help="longest prediction of a solver asked by name [s]")
    parser.add_argument("--limit", type=float, default=600.0, help="longest run [s]")
    parser.add_argument("--duration", type=float, default=0.1, help="longest case [s]")
    settings = parser.parse_args()
    settings.commit = settings.commit or git_commit()
    settings.out.parent.mkdir(parents=True, exist_ok=True)
    begun, begun_load = time.perf_counter(), os.getloadavg()[0]
    rows: list[Row] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(settings.processes, mp_context=context) as pool:
        pool.submit(warm, settings.device).result()
        print(f"kernels compiled in {time.perf_counter() - begun:.0f} s", flush=True)
        begun = time.perf_counter()
        numbers = range(settings.first, settings.first + settings.cases)
        futures = {pool.submit(one, settings.seed, number, settings): number for number in numbers}
        try:
            for done, future in enumerate(as_completed(futures), 1):
                rows += finished(future, futures[future])
                settings.out.write_text(report(rows, settings, begun_load))
                passed = time.perf_counter() - begun
                left = passed / done * (len(futures) - done)
                print(f"{done} of {len(futures)}, {passed:.0f} s, about {left:.0f} s left", flush=True)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            print(f"stopped; {settings.out} holds what was done", flush=True)


def finished(future: Future[list[Row]], number: int) -> list[Row]:
    try:
        rows = future.result()
    except BrokenProcessPool:
        print(f"case {number}: its process died (memory?)", flush=True)
        return []
    for row in rows:
        print(line(row), flush=True)
    return rows


if __name__ == "__main__":
    main()
