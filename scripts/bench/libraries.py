"""Compare libraries with palmfield's own code: sparse factors, paths on the skin, mesh repair, psychometric fits.

    python scripts/bench/libraries.py [factors] [paths] [meshes] [fits]

It compares the libraries that are installed and lists the others. It prints tables in Markdown.
"""

import argparse
import hashlib
import importlib.util
import json
import math
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "out" / "libraries"
HAND = "open_men_p50"
MATRICES = {"28,272": None, "8,064": 0.1}
"""Numbers of unknowns of the palm of mjcf/scenes/palm_am200.xml, and the accuracies of the scene for them."""
f_Hz, BLOCK = 200.0, 64
SLOWEST_s = 300
PATHS, OBSERVERS = 30, 40


def installed(name: str) -> bool:
    if importlib.util.find_spec(name) is not None:
        return True
    print(f"{name} is not installed: left out\n")
    return False


# ---- Sparse factors ------------------------------------------------------------------------------------------------


def save_matrices() -> None:
    """Save the real static matrix of a palm, its complex dynamic matrix at f_Hz, and the order of elimination."""
    import palmfield

    OUT.mkdir(parents=True, exist_ok=True)
    for name, accuracy in MATRICES.items():
        if (OUT / f"{name}_order.npy").exists():
            continue
        sim = palmfield.Simulation(ROOT / "mjcf" / "scenes" / "palm_am200.xml", accuracy=accuracy)
        system = sim.runtime.model.skins[0].layer.system
        s = -2j * math.pi * f_Hz
        real = system.elastic + sum(part.stiffness for part in system.parts)
        dynamic = s**2 * system.mass + s * system.damping + system.elastic
        dynamic = dynamic + sum(complex(part.material.stiffening(s)) * part.stiffness for part in system.parts)
        for kind, matrix in (("real", real), ("complex", dynamic.astype(complex))):
            sparse.save_npz(OUT / f"{name}_{kind}.npz", sparse.csc_matrix(matrix), compressed=False)
        np.save(OUT / f"{name}_order.npy", system.elimination_order())


def own(matrix: Any, order: Any) -> Callable[[Any], Any]:
    os.environ["PALMFIELD_PARDISO"] = "off"
    from palmfield.skin.fem.factor import factorise

    return factorise(matrix, order).solve


def superlu(matrix: Any, order: Any) -> Callable[[Any], Any]:
    from palmfield.skin.fem.factor import superlu

    return superlu(matrix, order).solve


def pardiso(matrix: Any, order: Any) -> Callable[[Any], Any]:
    from palmfield.skin.fem.pardiso import PardisoFactor

    return PardisoFactor(matrix).solve


def cholespy(matrix: Any, order: Any) -> Callable[[Any], Any]:
    from cholespy import CholeskySolverD, MatrixType

    columns = sparse.csc_matrix(matrix)
    factor = CholeskySolverD(
        columns.shape[0], columns.indptr.astype(np.int32), columns.indices.astype(np.int32), columns.data,
        MatrixType.CSC,
    )  # fmt: skip

    def solve(right: Any) -> Any:
        result = np.zeros_like(right)
        factor.solve(np.ascontiguousarray(right), result)
        return result

    return solve


def qdldl(matrix: Any, order: Any) -> Callable[[Any], Any]:
    from qdldl import Solver

    factor = Solver(sparse.csc_matrix(matrix))
    return lambda right: (
        np.column_stack([factor.solve(one) for one in right.T]) if right.ndim > 1 else factor.solve(right)
    )


FACTORS: dict[str, tuple[Callable[..., Any], str, tuple[str, ...]]] = {
    "own": (own, "palmfield", ("real", "complex")),
    "SuperLU": (superlu, "scipy", ("real", "complex")),
    "PARDISO": (pardiso, "pypardiso", ("real",)),
    "cholespy": (cholespy, "cholespy", ("real",)),
    "qdldl": (qdldl, "qdldl", ("real",)),
}


def clocks() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def timed(work: Callable[[], Any], repeats: int) -> tuple[Any, list[float]]:
    """Return the last result, and the least elapsed time and processor time [s]."""
    least = [math.inf, math.inf]
    for _ in range(repeats):
        begin = clocks()
        result = work()
        least = [min(old, now - then) for old, now, then in zip(least, clocks(), begin, strict=True)]
    return result, least


def peak_MB() -> float:
    """Return the largest memory of this process; Linux only."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def factor_once(library: str, name: str, kind: str, threads: int) -> None:
    """Run one library on one matrix in this process, and print a row as JSON."""
    from palmfield.threads import limit

    limit(threads)
    make = FACTORS[library][0]
    line = sparse.diags([-1.0, 2.5, -1.0], [-1, 0, 1], shape=(30, 30))
    small = sparse.csc_matrix(sparse.kronsum(line, line))
    if kind == "complex":
        small = small.astype(complex)
    make(small, np.arange(900, dtype=np.int32))(np.ones(900, small.dtype))  # builds kernels, loads libraries
    matrix, order = sparse.load_npz(OUT / f"{name}_{kind}.npz"), np.load(OUT / f"{name}_order.npy")
    rng = np.random.default_rng(0)
    rights = rng.standard_normal((matrix.shape[0], BLOCK)).astype(matrix.dtype)
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    before = peak_MB()
    solve, factor_s = timed(lambda: make(matrix, order), 1)
    memory = peak_MB() - before
    one, one_s = timed(lambda: solve(rights[:, 0].copy()), 8)
    many, many_s = timed(lambda: solve(rights), 2)
    row = {
        "library": library, "name": name, "kind": kind, "threads": threads, "MB": memory,
        "factor": factor_s, "one": one_s, "many": many_s,
        "error": float(np.linalg.norm(matrix @ many - rights) / np.linalg.norm(rights)),
        "bits": hashlib.sha256(one.tobytes() + many.tobytes()).hexdigest()[:12],
    }  # fmt: skip
    print(json.dumps(row))


def factors() -> None:
    save_matrices()
    print(
        "| unknowns | matrix | library | factor [s] | 1 solution [ms] | 64 solutions together [ms] | peak memory [MB] "
        "| residual | 2 threads: factor [s], 1 solution [ms], 64 [ms] | same bits again | same bits on 2 threads |\n"
        + "|---" * 11
        + "|"
    )
    for name in MATRICES:
        for kind in ("real", "complex"):
            for library, (_, package, kinds) in FACTORS.items():
                if kind not in kinds or importlib.util.find_spec(package) is None:
                    continue
                rows = [_in_child(library, name, kind, threads) for threads in (1, 1, 2)]
                print(_factor_line(name, kind, library, rows), flush=True)
    for _, package, _ in FACTORS.values():
        installed(package)


def _in_child(library: str, name: str, kind: str, threads: int) -> dict[str, Any] | None:
    count = str(threads)
    threads_of = {key: count for key in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    command = [sys.executable, __file__, "--one", library, name, kind, count]
    try:
        done = subprocess.run(
            command, env={**os.environ, **threads_of}, capture_output=True, text=True, check=False, timeout=SLOWEST_s
        )
    except subprocess.TimeoutExpired:
        return None
    return json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else {"failed": done.stderr[-300:]}


def _factor_line(name: str, kind: str, library: str, rows: list[dict[str, Any] | None]) -> str:
    bad = next((row for row in rows if row is None or "failed" in row), {})
    if bad is None or bad:
        why = f"over {SLOWEST_s} s" if bad is None else bad["failed"].splitlines()[-1]
        return f"| {name} | {kind} | {library} | {why} |"
    one, again, two = rows
    # One thread: seconds of the process, which other work on the machine changes little
    scales = {"factor": 1.0, "one": 1e3, "many": 1e3}
    cells = [f"{min(one[key][1], again[key][1]) * scale:.3g}" for key, scale in scales.items()]
    both = ", ".join(f"{two[key][0] * scale:.3g}" for key, scale in scales.items())
    same = ["yes" if one["bits"] == other["bits"] else "no" for other in (again, two)]
    return (
        f"| {name} | {kind} | {library} | {' | '.join(cells)} | {one['MB']:.0f} | {one['error']:.0e} | {both} "
        f"| {' | '.join(same)} |"
    )


# ---- Shortest paths on the skin ------------------------------------------------------------------------------------


def paths() -> None:
    """Compare path lengths between random vertices with the exact length, which pygeodesic computes."""
    from palmfield.hand.preset import load_preset
    from palmfield.hand.surface import hand_surface
    from palmfield.stimulus.surface_path import through

    if not (installed("potpourri3d") and installed("pygeodesic")):
        return
    from potpourri3d import EdgeFlipGeodesicSolver
    from pygeodesic.geodesic import PyGeodesicAlgorithmExact

    sys.path.insert(0, str(ROOT / "tests" / "stimulus"))
    from test_onskin import plate, sphere, tube

    print("| surface | code | longest over exact | mean | longer by 1e-6 | ms a path |\n" + "|---" * 6 + "|")
    surfaces = {
        "hand": hand_surface(load_preset(HAND)).surface,
        "sphere": sphere(4),
        "plate": plate(),
        "tube": tube()[0],
    }
    for name, surface in surfaces.items():
        flips = EdgeFlipGeodesicSolver(surface.vertices, surface.faces)
        exact = PyGeodesicAlgorithmExact(surface.vertices, surface.faces)
        ways: dict[str, Callable[[int, int], float]] = {
            "own": lambda a, b, s=surface: through(s, s.vertices[[a, b]]).length_m,
            "potpourri3d": lambda a, b, f=flips: length_of(f.find_geodesic_path(a, b)),
            "pygeodesic": lambda a, b, e=exact: float(e.geodesicDistance(a, b)[0]),
        }
        pairs = np.random.default_rng(11).choice(len(surface.vertices), (PATHS, 2)).tolist()
        lengths: dict[str, list[float]] = {}
        seconds = {}
        for code, way in ways.items():
            begin = time.process_time()
            lengths[code] = [way(a, b) for a, b in pairs if a != b]
            seconds[code] = (time.process_time() - begin) / len(lengths[code])
        for code in ways:
            excess = np.array(lengths[code]) / lengths["pygeodesic"] - 1.0
            print(f"| {name} | {code} | {excess.max():.1e} | {excess.mean():.1e} | {(excess > 1e-6).sum()} of "
                  f"{len(excess)} | {1e3 * seconds[code]:.1f} |")  # fmt: skip


def length_of(points: Any) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


# ---- Repair of meshes ----------------------------------------------------------------------------------------------


def meshes() -> None:
    """Repair the faulty meshes of docs/report_cards.md by each code, and check that the results are closed hands."""
    sys.path[:0] = [str(ROOT / "tests" / "hand"), str(ROOT / "scripts" / "verification")]
    from test_reportcard import FAULTS, hand

    sound = volume_of(*hand())
    codes = {"own": own_repair, "trimesh": trimesh_repair, "manifold3d": manifold_repair, "pymeshfix": meshfix_repair}
    codes = {code: work for code, work in codes.items() if code == "own" or installed(code)}
    print(f"| fault | {' | '.join(codes)} |\n" + "|---" * (1 + len(codes)) + "|")
    for fault, (spoil, _) in FAULTS.items():
        vertices, faces, _ = spoil()
        cells = []
        for work in codes.values():
            begin = time.process_time()
            try:
                words = work(vertices, faces)
            except Exception as error:
                words = f"{type(error).__name__}: {str(error)[:60]}"
            if not isinstance(words, str):
                closed = is_closed(words[1])
                words = f"closed, volume {volume_of(*words) / sound:.3f}" if closed else "not closed, without a message"
            cells.append(f"{words}; {1e3 * (time.process_time() - begin):.0f} ms")
        print(f"| {fault} | {' | '.join(cells)} |", flush=True)


def volume_of(vertices: Any, faces: Any) -> float:
    return float(
        np.einsum("ij,ij->", vertices[faces[:, 0]], np.cross(vertices[faces[:, 1]], vertices[faces[:, 2]])) / 6
    )


def is_closed(faces: Any) -> bool:
    from palmfield.hand.triangles import unique_edges

    return bool((unique_edges(faces)[1] == 2).all())


def own_repair(vertices: Any, faces: Any) -> Any:
    from palmfield.hand.repair import repair

    mesh = repair(vertices, faces)
    return "refused, with positions" if mesh.refused else (mesh.vertices, mesh.faces)


def trimesh_repair(vertices: Any, faces: Any) -> Any:
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=True, validate=True)
    mesh.fill_holes()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def manifold_repair(vertices: Any, faces: Any) -> Any:
    from manifold3d import Manifold, Mesh

    mesh = Mesh(np.asarray(vertices, np.float32), np.asarray(faces, np.uint32))
    mesh.merge()
    body = Manifold(mesh)
    if body.status().name != "NoError":
        return f"refused: {body.status().name}"
    made = body.to_mesh()
    return np.asarray(made.vert_properties[:, :3], float), np.asarray(made.tri_verts)


def meshfix_repair(vertices: Any, faces: Any) -> Any:
    from pymeshfix import clean_from_arrays

    return clean_from_arrays(vertices, faces)


# ---- Psychometric fits ---------------------------------------------------------------------------------------------


def fits() -> None:
    """Fit thresholds of simulated observers, and count how often 95 % intervals contain the true value."""
    if not installed("psignifit"):
        return
    from palmfield.perception.psychometric import PsychometricFunction

    function = PsychometricFunction("normal", 0.0, 3.0, 0.5, 0.02)
    print("| answers | code | rms error | mean error | held | median width | s a fit |\n" + "|---" * 7 + "|")
    for kind, draw in (("7 levels of 40", constant_answers), ("staircase of 40", staircase_answers)):
        answers = [draw(function, np.random.default_rng(seed)) for seed in range(OBSERVERS)]
        for code, work in (("own", own_fit), ("psignifit", psignifit_fit)):
            begin = time.process_time()
            found = np.array([work(*one, kind) for one in answers])
            seconds = (time.process_time() - begin) / OBSERVERS
            held = int(((found[:, 1] <= 0.0) & (found[:, 2] >= 0.0)).sum())
            cells = [
                np.sqrt(np.mean(found[:, 0] ** 2)),
                found[:, 0].mean(),
                np.median(found[:, 2] - found[:, 1]),
                seconds,
            ]
            rms, mean, width, took = (f"{cell:.2f}" for cell in cells)
            print(f"| {kind} | {code} | {rms} | {mean} | {held} of {OBSERVERS} | {width} | {took} |", flush=True)


def constant_answers(function: Callable[[Any], Any], rng: Any) -> tuple[Any, Any, Any]:
    levels = np.linspace(-6.0, 6.0, 7)
    return levels, np.full(7, 40.0), rng.binomial(40, function(levels)).astype(float)


def staircase_answers(function: Callable[[Any], Any], rng: Any) -> tuple[Any, Any, Any]:
    """Return the answers in a staircase: 1 up 2 down, steps of 4, then 2.

    It is the staircase of tests/perception/test_psychometric.py.
    """
    from palmfield.perception.psychometric import counts

    level, streak, levels, right = 12.0, 0, [], []
    for trial in range(40):
        levels.append(level)
        right.append(bool(rng.random() < function(level)))
        streak = streak + 1 if right[-1] else 0
        step = 4.0 if trial < 10 else 2.0
        if not right[-1]:
            level += step
        elif streak == 2:
            level, streak = level - step, 0
    return counts(levels, right)


def own_fit(levels: Any, trials: Any, right: Any, kind: str) -> tuple[float, float, float]:
    from palmfield.perception.psychometric import fit

    found = fit(levels, trials, right, guess=0.5, lapse=None, adaptive=kind.startswith("staircase"))
    return found.threshold, *found.threshold_interval


def psignifit_fit(levels: Any, trials: Any, right: Any, kind: str) -> tuple[float, float, float]:
    from psignifit import psignifit

    found = psignifit(np.column_stack([levels, right, trials]), sigmoid="norm", experiment_type="2AFC", verbose=False)
    return found.parameter_estimate["threshold"], *found.confidence_intervals["threshold"]["0.95"]


def cpu() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[[], *PARTS])
    parser.add_argument("--one", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        factor_once(*options.one[:3], int(options.one[3]))
        return
    from palmfield.studies.bench.field import git_commit

    print(f"{cpu()}, Python {platform.python_version()}, commit {git_commit()}\n")
    for part in options.parts or PARTS:
        print(f"## {part}\n")
        PARTS[part]()
        print()


PARTS = {"factors": factors, "paths": paths, "meshes": meshes, "fits": fits}

if __name__ == "__main__":
    main()
