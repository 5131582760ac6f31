"""Test the error estimate of the velocity: random cases of ten kinds, answers of `auto`, and references.

    python scripts/verification/coverage_velocity.py run --seed 1 --count 60 [--limit 60] [--traction]
    python scripts/verification/coverage_velocity.py report [--out docs/bench/skin_velocity.md]

`run` draws the cases and solves each with `auto`, and with another solver at a tenth of the accuracy, on one core and
with a limit of processor time for each. With --traction the load is a Traction at points of the face. It appends a line
per case to docs/bench/coverage/velocity.jsonl and continues from there; each line names its commit. Set
OMP_NUM_THREADS=1, OPENBLAS_NUM_THREADS=1 and PALMFIELD_CACHE=off.
"""

import argparse
import json
import math
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
from coverage_draw import Case, Problem, between, crossing_s, draw_layer, draw_material, pick, problem_of
from coverage_judge import SAME_MESH, TRUTHS, TooLongError, at_most, relative_error, solver_of
from coverage_report import CONVERGED, band
from coverage_store import FOLDER, ROOT, rounded

from palmfield.errors import SceneError
from palmfield.skin.fem import face_points
from palmfield.skin.problem import GAUSSIAN, Layer, Traction
from palmfield.skin.problem import between as interpolated
from palmfield.skin.solver_choice import Name, solve
from palmfield.studies.bench.table import keep_rows

KINDS = (
    "viscous", "short branch", "soft on hard", "hard on soft", "on and off", "pulses", "swinging", "sudden", "moving",
    "layer",
)  # fmt: skip
"""Kinds of cases, drawn in turn."""
FINER, SHARE, LEAST_TRUTH = 0.1, 0.15, 3e-4
"""Accuracy of a reference: shares of that of the case and of the error estimate, and the least value."""
ASKED_TIMES = 40
FIRST_TRACTION = 1000
"""Number of the first case with a Traction as load."""
SPOT_TRUTHS: tuple[Name, ...] = ("lateral_waves", "axisymmetric")
SPACING, KNOTS, SAMPLED = 0.05, 13, 0.0025
"""Sampling of a Traction.

Distance of the points on a slab, in widths of the spot; number of times for a moving spot; change by linear
interpolation between the points, which widens a fixed spot: h^2 / 6 over its variance.
"""


def draw_case(seed: int, number: int) -> Case:
    """Return a velocity case as plain data in SI units, as those of coverage_draw."""
    random = np.random.default_rng([seed, number, 29])
    kind = KINDS[number % len(KINDS)]
    width = between(random, 5e-3, 20e-3)
    depth = float(np.clip(width * between(random, 0.3, 1.2), 1e-3, 20e-3))
    material = draw_material(random)
    if kind in ("viscous", "short branch"):
        shear = between(random, 10e3, 80e3)
        damping_s = between(random, 2e-4, 5e-3)
        material |= {"shear_relaxed_Pa": shear, "bulk_Pa": shear * between(random, 10.0, 300.0), "branches": []}
        material["viscosity_Pa_s"] = shear * damping_s if kind == "viscous" else 0.0
        if kind == "short branch":
            tau = between(random, 1e-6, 1e-4)
            material["branches"] = [[shear * min(damping_s / tau, 100.0), tau]]
    else:
        # Without a dashpot the bulk rings on, and the velocity after a jump has no truth that can be had
        floor = material["shear_relaxed_Pa"] * between(random, 2e-4, 3e-3)
        material["viscosity_Pa_s"] = max(material["viscosity_Pa_s"], floor)
    sheets = [{"thickness_m": depth, "material": material}]
    if kind in ("soft on hard", "hard on soft"):
        ratio = between(random, 10.0, 300.0)
        names = ("shear_relaxed_Pa", "bulk_Pa", "viscosity_Pa_s")
        stiff = material | {name: material[name] * ratio for name in names}
        stiff["branches"] = [[ratio * shear, tau] for shear, tau in material["branches"]]
        share = float(random.uniform(0.2, 0.6))
        pair = (material, stiff) if kind == "soft on hard" else (stiff, material)
        sheets = [
            {"thickness_m": part * depth, "material": each}
            for part, each in zip((share, 1.0 - share), pair, strict=True)
        ]
    body: Case
    if kind == "layer":
        body = draw_layer(random, width, depth, rough=False)
    elif kind == "moving":
        body = {"shape": "box", "side": "roller", "size_m": [width * between(random, 4.0, 5.0) for _ in range(2)]}
    else:
        side = pick(random, "fixed", "free", "roller")
        body = {"shape": "disc", "side": side, "radius_m": width * between(random, 1.2, 2.5)}
    body |= {"base": pick(random, "bonded", "bonded", "free_slip"), "sheets": sheets}
    if kind == "layer":
        body["base"] = "bonded"
    span = float(np.clip(crossing_s(sheets, width, depth) * between(random, 2.0, 6.0), 1e-3, 0.06))
    times, peaks, law = [0.0], [1.0], "held"
    centre = np.zeros(2)
    if kind == "on and off":
        times, peaks = [0.0, span * between(random, 0.1, 0.5)], [1.0, 0.0]
    elif kind == "pulses":
        gap = span * between(random, 0.05, 0.2)
        times, peaks = [k * gap for k in range(8)], [1.0, 0.0] * 4
    elif kind in ("swinging", "layer"):
        frequency = between(random, 1.0 / span, 4.0 / span)
        even = np.arange(1 + math.ceil(24 * span * frequency)) / (24 * frequency)
        times, peaks, law = even.tolist(), (0.5 - 0.5 * np.cos(2.0 * math.pi * frequency * even)).tolist(), "linear"
    elif kind == "moving":
        times, peaks, law = [0.0, 0.7 * span, 0.9 * span], [1.0, 1.0, 0.0], "linear"
        way = min(width, between(random, 0.3, 6.0) * 0.7 * span)
        centre = np.array([-0.5 * way, 0.5 * way, 0.5 * way])[:, None] * np.array([[0.8, 0.6]])
    elif kind in ("viscous", "short branch", "soft on hard", "hard on soft") and random.random() < 0.5:
        times, peaks, law = [0.0, span * between(random, 0.05, 0.4)], [0.0, 1.0], "linear"
    centres = np.broadcast_to(centre, (len(times), 2)).tolist()
    load = {"fwhm_m": width, "law": law, "times_s": times, "peak_Pa": peaks, "centre_m": centres}
    room = 0.4 * min(body["size_m"]) if "size_m" in body else 0.8 * body["radius_m"]
    away, angle = min(width, room) * random.random(), random.uniform(0.0, 2.0 * math.pi)
    at = [[0.0, 0.0], [away * math.cos(angle), away * math.sin(angle)]]
    return {
        "key": f"{seed}-{number}", "kind": kind, "body": body, "load": load, "at_m": at,
        "times_s": (span / ASKED_TIMES * np.arange(1, 1 + ASKED_TIMES)).tolist(),
        "accuracy": between(random, 0.03, 0.15), "accuracy_of": pick(random, "velocity", "displacement"),
    }  # fmt: skip


def as_traction(problem: Problem) -> Traction:
    """Return the spot of a case as pressures at points: a square grid, or the triangles of a layer."""
    body, load = problem.body, problem.load
    if isinstance(body, Layer):
        points, areas = face_points(body.patch, 2)
    else:
        half = np.full(2, body.radius_m) if body.size_m is None else 0.5 * np.array(body.size_m)
        counts = np.ceil(2.0 * half / (SPACING * load.fwhm_m)).astype(int)
        x, y = (h * ((2.0 * np.arange(n) + 1.0) / n - 1.0) for h, n in zip(half, counts, strict=True))
        grid = [axis.ravel() for axis in np.meshgrid(x, y, indexing="ij")]
        points = np.column_stack([*grid, np.zeros(counts.prod())])
        areas = np.full(len(points), np.prod(2.0 * half / counts))
    times = load.times_s
    if np.ptp(load.centres(), axis=0).any():
        times = np.union1d(times, np.linspace(times[0], times[-1], KNOTS))
    centres, peaks = (interpolated(load, values, times) for values in (load.centres(), load.peak_Pa))
    away = ((points[None, :, :2] - centres[:, None]) ** 2).sum(axis=2)
    return Traction(points, areas, times, peaks[:, None] * np.exp(-GAUSSIAN * away / load.fwhm_m**2), load.law)


def judged(case: Case, limit_s: float, traction: bool = False) -> dict[str, Any]:
    """Return one line: velocity error estimate of `auto`, and its error relative to the best reference.

    displacement_estimate, _true, _truth_error: the same numbers of the displacement, by the same reference.
    """
    problem, row = problem_of(case), {"key": case["key"], "kind": case["kind"], "accuracy_of": case["accuracy_of"]}
    row |= {"accuracy": case["accuracy"], "load": "traction" if traction else "spot"}
    load = as_traction(problem) if traction else problem.load
    arguments = (problem.body, load, problem.times, problem.at)
    begin = time.process_time()
    try:
        with at_most(limit_s):
            found = solve(*arguments, accuracy=case["accuracy"], accuracy_of=case["accuracy_of"], device="cpu")
    except (SceneError, TooLongError, MemoryError) as error:
        return row | {"missing": str(error)}
    row |= {"seconds": time.process_time() - begin, "estimate": found.velocity_error, "solver": found.solver}
    row |= {"source": found.error_source, "displacement_estimate": found.displacement_error}
    own = solver_of(row)
    others = [name for name in (*TRUTHS[case["body"]["shape"]], "wedges") if name not in (own, SAME_MESH.get(own))]
    finest = max(LEAST_TRUTH, min(FINER * case["accuracy"], SHARE * found.velocity_error))
    best = math.inf
    # Another solver is the surer truth; its own at a finer accuracy tells what the others can't
    # A Traction of a spot at rest on a slab has the spot as its truth
    spot = traction and case["kind"] not in ("moving", "layer")
    if spot:
        arguments, others, own = (problem.body, problem.load, *arguments[2:]), list(SPOT_TRUTHS), SPOT_TRUTHS[-1]
    more = SAMPLED if spot else 0.0
    for name in (*others, own):
        try:
            with at_most(limit_s):
                truth = solve(
                    *arguments, solver=name, accuracy=finest, accuracy_of="velocity", device="cpu", whole=True
                )
        except (SceneError, TooLongError, MemoryError) as error:
            row.setdefault("no_truth", []).append(f"{name}: {error}"[:120])
            continue
        if truth.velocity_error + more < best:
            best = truth.velocity_error + more
            row |= {"by": name, "true": relative_error(found.velocity_m_s, truth.velocity_m_s), "truth_error": best}
            row["displacement_true"] = relative_error(found.displacement_m, truth.displacement_m)
            row["displacement_truth_error"] = truth.displacement_error + more
        if best <= CONVERGED * max(row["true"], row["estimate"]):
            break
    return row


def counted(row: dict[str, Any]) -> bool:
    return "true" in row and row["truth_error"] <= CONVERGED * max(row["true"], row["estimate"])


def _own(row: dict[str, Any]) -> bool:
    """Return whether the reference is by the solver that answered."""
    return bool(row["by"] == solver_of(row))


def of_displacement(row: dict[str, Any]) -> dict[str, Any]:
    """Return a line with the numbers of the displacement in place of those of the velocity."""
    names = [name for name in ("estimate", "true", "truth_error") if f"displacement_{name}" in row]
    return row | {name: row[f"displacement_{name}"] for name in names}


def report(rows: list[dict[str, Any]], out: Path) -> None:
    """Write the page of all lines."""

    def cells(some: list[dict[str, Any]]) -> str:
        sure = [row for row in some if counted(row)]
        covered = sum(row["estimate"] >= row["true"] for row in sure)
        half = sum(row["estimate"] < 0.5 * row["true"] for row in sure)
        ratio = f"{np.median([row['estimate'] / row['true'] for row in sure]):.2g}" if sure else "-"
        return f"{len(some)} | {len(sure)} | {band(covered, len(sure))} | {half} | {ratio}"

    spots, tractions = ([row for row in rows if row["load"] == load] for load in ("spot", "traction"))
    groups = {
        "velocity": spots,
        "velocity, reference by another solver": [row for row in spots if "by" in row and not _own(row)],
        "velocity, reference by the same solver, finer": [row for row in spots if "by" in row and _own(row)],
        "displacement of the same cases": [of_displacement(row) for row in spots],
        "velocity under a `Traction`": tractions,
        "displacement under a `Traction`": [of_displacement(row) for row in tractions],
    }
    lines = [
        "# Is the estimated error of the velocity true?",
        "",
        "`python scripts/verification/coverage_velocity.py run` solves the "
        "cases, and `report` writes the page. [velocity.jsonl](coverage/velocity.jsonl) has one line per case. Code: "
        + ", ".join(sorted({row["commit"] for row in rows}))
        + f". Seed: {', '.join(sorted({row['key'].partition('-')[0] for row in rows}))}.",
        "",
        "Bodies, materials and loads are random, of ten kinds. Half of the cases have a target accuracy for the "
        "velocity, and half for the displacement. A `Traction` has its pressures at points of the face. True error and "
        "judged cases are defined as for [displacements](skin_coverage.md). The reference is another solver with "
        f"{FINER:g} of the target accuracy, or with {SHARE:g} of the estimate, else a finer solution of the same "
        "solver. All materials except those with short branches have a dashpot. "
        f"{sum('missing' in row for row in rows)} cases had no result. "
        "Intervals are 95 % intervals.",
        "",
        "| quantity | cases | judged | estimate >= true | below half | median estimate / true |",
        "|---|---|---|---|---|---|",
        *(f"| {name} | {cells(some)} |" for name, some in groups.items()),
        "",
    ]
    low = [
        "| case | kind | target for | target [%] | estimate [%] | true error [%] | reference, its error [%] | time [s] "
        "| solver |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    views = [("", row) for row in rows] + [(", displacement", of_displacement(row)) for row in rows]
    for quantity, row in ((name, row) for name, row in views if counted(row) and row["estimate"] < row["true"]):
        numbers = [f"{100 * row[key]:.2g}" if key in row else "-" for key in ("accuracy", "estimate", "true")]
        own = "own " if "by" in row and _own(row) else ""
        by = f"{own}{row['by']}, {100 * row['truth_error']:.2g}" if "by" in row else "none"
        words = row.get("solver", row.get("missing", "")).split("(")[0].replace("|", "/").strip()[:80]
        low.append(
            f"| {row['key']}{quantity} | {row['kind']} | {row['accuracy_of']} | {' | '.join(numbers)} | {by} "
            f"| {row.get('seconds', math.nan):.2g} | {words} |"
        )
    lines.append(f"{keep_rows(out, low)} has the cases with an estimate below the true error.")
    out.write_text("\n".join(lines) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("run", "report"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--limit", type=float, default=60.0, help="longest answer [s]")
    parser.add_argument("--traction", action="store_true", help="loads are a Traction instead of a spot")
    parser.add_argument("--kept", type=Path, default=FOLDER / "velocity.jsonl", help="one line per case")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "skin_velocity.md")
    settings = parser.parse_args()
    kept = settings.kept
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    if settings.step == "report":
        report(rows, settings.out)
        return
    commit = subprocess.run(
        ["git", "-C", str(ROOT), "describe", "--always", "--dirty"], capture_output=True, text=True, check=True
    ).stdout.strip()
    done = {row["key"] for row in rows}
    first = FIRST_TRACTION if settings.traction else 0
    for number in range(first, first + settings.count):
        case = draw_case(settings.seed, number)
        if case["key"] in done:
            continue
        row = judged(case, settings.limit, settings.traction) | {"commit": commit}
        with kept.open("a") as file:
            file.write(json.dumps(rounded(row)) + "\n")
        numbers = (f"{k} {row[k]:.3g}" for k in ("estimate", "true", "truth_error") if k in row)
        print(number, row["kind"], *numbers, flush=True)


if __name__ == "__main__":
    main()
