"""Compute the answer of each solver to a case, and converged answers of other solvers, with time limits."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import numpy as np
from coverage_draw import Case, Problem, problem_of
from coverage_scenes import run_scene

from palmfield.errors import SceneError
from palmfield.skin.problem import QUANTITIES
from palmfield.skin.solver_choice import Name, choices, solve

NAMES: tuple[Name, ...] = (
    "auto",
    "lateral_waves",
    "axisymmetric",
    "reduced",
    "wedges",
    "spectral_elements",
    "particles",
)
TRUTHS: dict[str, tuple[Name, ...]] = {
    "infinite": ("lateral_waves", "wedges"),
    "disc": ("axisymmetric", "lateral_waves"),
    "box": ("lateral_waves", "spectral_elements", "wedges"),
    "layer": ("spectral_elements", "wedges"),
}
"""Solvers for references, by shape of the body, the most reliable first."""
SAME_MESH = {"reduced": "wedges"}
"""Solvers with the same mesh and matrices as a solver for references."""
FINER = 0.1
"""Accuracy of a reference relative to that of the case."""
SCENE_FINER = 0.25
"""The same for a scene."""
LEAST_FINER = 1.1
"""Smallest ratio of two meshes whose difference is used to estimate an error."""


class TooLongError(Exception):
    """A run exceeded its time limit."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise TooLongError in the body if it exceeds this processor time; main thread of a Unix process only."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooLongError(f"given up after {seconds:.0f} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def truths(case: Case, auto: dict[str, Any], limit_s: float) -> list[dict[str, Any]]:
    """Return answers of another solver than `auto` chose, at FINER of the accuracy; failed rows contain the reason.

    auto: row of `answers` of `auto`
    """
    if "scene" in case:
        return [_scene_truth(case, limit_s)]
    took = {solver_of(auto)} if "solver" in auto else set()
    took |= {SAME_MESH[name] for name in took if name in SAME_MESH}
    problem, rows = problem_of(case), []
    accuracy = max(1e-4, FINER * problem.accuracy)
    for name in (name for name in TRUTHS[case["body"]["shape"]] if name not in took):
        row: dict[str, Any] = {"key": case["key"], "by": name}
        begin = time.process_time()
        try:
            with at_most(limit_s):
                motion = solve(
                    problem.body, problem.load, problem.times, problem.at, solver=name, accuracy=accuracy,
                    accuracy_of="displacement", device="cpu", whole=True,
                )  # fmt: skip
            row |= {"displacement_m": motion.displacement_m.tolist(), "velocity_m_s": motion.velocity_m_s.tolist()}
            row |= {"error": motion.error, "velocity_error": motion.velocity_error}
        except (SceneError, TooLongError, MemoryError) as error:
            row["missing"] = f"{type(error).__name__}: {error}"
        rows.append(row | {"seconds": time.process_time() - begin})
        if row.get("error", 1.0) <= 2.0 * accuracy:
            break
    return rows


def _scene_truth(case: Case, limit_s: float) -> dict[str, Any]:
    """Solve a scene by elements on its own finer mesh; its error follows from a coarser mesh by order 2.

    Cut edges belong to the body, so both have them.
    """
    name = "spectral_elements"

    def work() -> dict[str, Any]:
        coarse, fine = (run_scene(case, name, part * SCENE_FINER * case["accuracy"]) for part in (2.0, 1.0))
        finer = (nodes_of(fine) / nodes_of(coarse)) ** (1.0 / 3.0)
        if finer < LEAST_FINER:
            raise SceneError(f"two meshes for one error are too much alike: edges are {finer:.2f} times as fine")
        error = relative_error(coarse["displacement_m"], fine["displacement_m"]) / (finer**2 - 1.0)
        return {"displacement_m": fine["displacement_m"], "error": error}

    row = _limited(case, name, limit_s, work)
    row["by"] = row.pop("asked")
    return {("missing" if key == "refused_late" else key): value for key, value in row.items()}


def nodes_of(found: dict[str, Any]) -> int:
    """Return the number of nodes from the description by an element solver."""
    words = str(found["solver"]).replace(",", "").split()
    return int(words[words.index("nodes") - 1])


def solver_of(row: dict[str, Any]) -> str:
    """Return the name of the solver from the description of an answer."""
    return str(row["solver"].replace(",", " ").replace(":", " ").split()[0])


def answers(case: Case, limit_s: float, longest_s: float) -> list[dict[str, Any]]:
    """Return a row for each solver: answer and estimates, or why there is none, and if the plan said so.

    limit_s: processor time of an answer; longest_s: largest predicted time of a solver by name
    """
    if "scene" in case:
        return [_limited(case, name, limit_s, lambda name=name: run_scene(case, name)) for name in case["solvers"]]
    problem = problem_of(case)
    predicted = {choice.name: choice for choice in _choices(problem)}
    rows = []
    for name in case["solvers"]:
        choice = predicted.get(name)
        if choice is not None and choice.refusal is not None:
            rows.append({"key": case["key"], "asked": name, "refused": choice.refusal})
        elif choice is not None and choice.seconds > longest_s:
            words = f"predicted {choice.seconds:.3g} s, above {longest_s:g}"
            rows.append({"key": case["key"], "asked": name, "missing": words})
        else:
            rows.append(_limited(case, name, limit_s, lambda name=name: _answer(problem, name)))
    return rows


def _limited(case: Case, name: str, limit_s: float, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    row, begin = {"key": case["key"], "asked": name}, time.process_time()
    try:
        with at_most(limit_s):
            row |= work()
    except SceneError as error:
        row["refused_late"] = str(error)
    except (TooLongError, MemoryError) as error:
        row["missing"] = f"{type(error).__name__}: {error}"
    return row | {"seconds": time.process_time() - begin}


def _answer(problem: Problem, name: Name) -> dict[str, Any]:
    motion = solve(
        problem.body, problem.load, problem.times, problem.at, solver=name, accuracy=problem.accuracy, device="cpu"
    )  # fmt: skip
    row = {"displacement_m": motion.displacement_m.tolist(), "velocity_m_s": motion.velocity_m_s.tolist()}
    row |= {f"{quantity}_error": getattr(motion, f"{quantity}_error") for quantity in QUANTITIES}
    return row | {"solver": motion.solver}


def _choices(problem: Problem) -> list[Any]:
    return choices(
        problem.body, problem.load, problem.times, problem.at, accuracy=problem.accuracy, device="cpu"
    )  # fmt: skip


def relative_error(found: Any, known: Any) -> float:
    """Return the relative L2 error over the times, the largest over the moving points: the norm of the estimates."""
    found, known = np.asarray(found, dtype=float), np.asarray(known, dtype=float)
    size = np.linalg.norm(known, axis=(0, 2))
    off = np.linalg.norm(found - known, axis=(0, 2))
    moving = size > 1e-9 * size.max(initial=0.0)
    return float((off[moving] / size[moving]).max(initial=0.0))
