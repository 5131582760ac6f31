"""Measure the cost of a skin by accuracy and by radius of its patch.

    python scripts/bench/growth.py [--scene palm_am200] [--times 3] [--picture docs/bench/growth.png]

Each point runs the scene in its own process, on one thread, without a cache of results. Points of the first series set
key `accuracy`, those of the second key `patch_radius_m`. It prints unknowns, processor time of one factorisation, of
the reduced model and of the error estimate (without kernels), numbers in the factor, and the memory of the run without
that of the imports: up to its reduced model, and in total. Exponents are slopes of log(cost) over log(unknowns), with
their standard errors. The exponents of the estimate and of the total memory use only points whose estimate uses a
coarser mesh.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from palmfield.estimate.cost import compares_with_finer
from palmfield.types import Float

ROOT = Path(__file__).resolve().parents[2]
ACCURACIES = (0.2, 0.119, 0.0707, 0.042, 0.025)
RADII_M = (0.010, 0.0157, 0.0245, 0.0383, 0.060)
COSTS = {
    "factor_s": "factor [CPU s]", "fill": "numbers in the factor", "reduced_s": "reduced model [CPU s]",
    "model_MiB": "memory of the model [MiB]", "estimate_s": "estimate [CPU s]", "peak_MiB": "memory of all [MiB]",
}  # fmt: skip
OF_COARSER = ("estimate_s", "peak_MiB")
"""Costs whose exponents use only points with a coarser mesh in the estimate."""
HEADS = {
    "accuracy": "accuracy",
    "radius": "patch radius [m]",
    "rows": "rows of elements",
    "unknowns": "unknowns",
    **COSTS,
}


def measured(scene: str, keys: dict[str, float]) -> dict[str, float]:
    """Run a scene with other keys in this process, and return its costs."""
    import palmfield
    from palmfield import profile, threads
    from palmfield.outputs import schema  # noqa: F401  what a run loads is not its memory
    from palmfield.session import recorded_run  # noqa: F401
    from palmfield.skin.fem.factor import factorise
    from palmfield.skin.reduction.ritz import shifted

    threads.limit(1)
    imported = profile.peak_bytes()
    with profile.measured() as phases:
        sim = palmfield.Simulation(ROOT / f"mjcf/scenes/{scene}.xml", device="cpu", keys=keys)
        palmfield.run(sim, None, duration_s=0.02, progress=False, plots=[], usd=False)
    peak = profile.peak_bytes()

    def spent(name: str) -> float:
        """CPU time of the outermost phases of a name without the loading of kernels [s]."""
        paths = [path for path in phases.phases if path[-1] == name and name not in path[:-1]]
        inside = [path for path in phases.phases if path[-1] == "kernels" and name in path[:-1]]
        return sum(phases.phases[path].cpu_s for path in paths) - sum(phases.phases[path].cpu_s for path in inside)

    layer = sim.runtime.model.skins[0].layer
    system = layer.system
    matrix, order = shifted(system), system.elimination_order()
    factorise(matrix, order)  # loads its kernels
    began = time.process_time()
    factor = factorise(matrix, order)
    factor_s = time.process_time() - began
    return {
        "rows": len(layer.sizes.depth_fractions) - 1,
        "unknowns": system.ndof,
        "factor_s": factor_s,
        "fill": factor.fill,
        "reduced_s": spent("reduced model, modes or full wedge model"),
        "estimate_s": spent("error estimate"),
        "model_MiB": (phases.phases["preparing",].peak_bytes - imported) / 2**20,
        "peak_MiB": (peak - imported) / 2**20,
    }


def point(scene: str, keys: dict[str, float], times: int) -> dict[str, float]:
    """Measure in new processes, and return medians."""
    env = os.environ | {"PALMFIELD_CACHE": "off", "PALMFIELD_PARDISO": "off", "OPENBLAS_NUM_THREADS": "1"}
    words = [sys.executable, __file__, "--scene", scene, "--child", json.dumps(keys)]
    runs: list[dict[str, float]] = []
    for _ in range(times):
        done = subprocess.run(words, env=env, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(done.stderr)
        runs.append(json.loads(done.stdout.splitlines()[-1]))
    return {name: statistics.median(one[name] for one in runs) for name in runs[0]}


def slope(x: Float, y: Float) -> tuple[float, float]:
    """Return the slope of log y over log x and its standard error."""
    (value, _), covariance = np.polyfit(np.log(x), np.log(y), 1, cov=True)
    return float(value), float(np.sqrt(covariance[0, 0]))


def exponents(points: list[dict[str, Any]]) -> dict[str, tuple[float, float]]:
    """Return slope and standard error of each cost over the unknowns; without those of fewer than 4 points."""
    result = {}
    for name in COSTS:
        chosen = [one for one in points if name not in OF_COARSER or not compares_with_finer(one["unknowns"])]
        if len(chosen) > 3:
            result[name] = slope(*(np.array([one[key] for one in chosen]) for key in ("unknowns", name)))
    return result


def draw(series: dict[str, list[dict[str, float]]], path: Path) -> None:
    """Draw the costs over the unknowns."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8.6, 4.0), layout="constrained")
    marks = {"accuracy": "o", "radius": "s"}
    for colour, name in zip(("C0", "C1", "C2"), ("factor_s", "reduced_s", "estimate_s"), strict=True):
        for kind, points in series.items():
            x, y = ([one[key] for one in points] for key in ("unknowns", name))
            line = "-" if kind == "accuracy" else "--"
            axes.loglog(
                x, y, line, color=colour, marker=marks[kind], label=f"{COSTS[name].partition(' [')[0]}, by {kind}"
            )
    n, first = np.array([4e3, 5e4]), series["radius"][0]
    for power, line, body in ((1.5, ":", "flat layer"), (2.0, "-.", "cube")):
        scale = first["factor_s"] * (n / first["unknowns"]) ** power
        axes.loglog(n, scale, line, color="0.4", label=f"factor, slope {power:g} ({body})")
    axes.set_xlabel("unknowns of the skin layer")
    axes.set_ylabel("processor time [s]")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small", frameon=False)
    axes.grid(alpha=0.3, which="both")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="palm_am200")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--picture", type=Path, help="where the costs are drawn")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(measured(options.scene, json.loads(options.child))))
        return
    from palmfield.studies.bench.table import processor

    print(f"{processor()}, one thread, median of {options.times}\n\n| " + " | ".join(HEADS.values()) + " |")
    print("|---" * len(HEADS) + "|", flush=True)
    series: dict[str, list[dict[str, Any]]] = {"accuracy": [], "radius": []}
    for kind, values in (("accuracy", ACCURACIES), ("radius", RADII_M)):
        for value in values:
            key = "skin.accuracy" if kind == "accuracy" else "skin.patch_radius_m"
            one = point(options.scene, {key: value}, options.times)
            series[kind].append(one | {kind: value})
            cells = (f"{series[kind][-1][name]:.3g}" if name in series[kind][-1] else "" for name in HEADS)
            print("| " + " | ".join(cells) + " |", flush=True)
    print()
    for kind, points in (series | {"both": series["accuracy"] + series["radius"]}).items():
        found = exponents(points)
        print(f"by {kind}: " + ", ".join(f"{COSTS[name]} {a:.2f} +- {b:.2f}" for name, (a, b) in found.items()))
    for kind, points in series.items():
        at, unknowns = (np.array([one[name] for one in points]) for name in (kind, "unknowns"))
        print(f"unknowns over {kind}: {slope(at, unknowns)[0]:.2f} +- {slope(at, unknowns)[1]:.2f}")
    if options.picture is not None:
        draw(series, options.picture)


if __name__ == "__main__":
    main()
