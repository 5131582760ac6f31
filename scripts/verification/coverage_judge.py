"""What each solver answers to a case, and converged answers of other solvers; each limited in time, nothing dropped."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import numpy as np
from coverage_draw import Case, Problem, problem_of

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
TRUTHS: tuple[Name, ...] = ("lateral_waves", "axisymmetric", "spectral_elements", "wedges")
"""Solvers that give truths, the surest first."""
FINER = 0.1
"""Accuracy of a truth in the case's own."""


class TooLongError(Exception):
    """A run took longer than it may."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raises TooLongError in the body when it takes longer; main thread of a Unix process only."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooLongError(f"given up after {seconds:.0f} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def truths(case: Case, limit_s: float) -> list[dict[str, Any]]:
    """Answers of up to two solvers at FINER of the accuracy; rows without one say why."""
    problem, rows = problem_of(case), []
    accuracy = max(1e-4, FINER * problem.accuracy)
    for name in TRUTHS:
        row: dict[str, Any] = {"key": case["key"], "by": name}
        begin = time.perf_counter()
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
        rows.append(row | {"seconds": time.perf_counter() - begin})
        if sum("error" in each and each["error"] <= 2.0 * accuracy for each in rows) == 2:
            break
    return rows


def answers(case: Case, limit_s: float, longest_s: float) -> list[dict[str, Any]]:
    """A row for each solver: its answer and estimates, or why there is none, and whether that was known before."""
    problem = problem_of(case)
    predicted = {choice.name: choice for choice in _choices(problem)}
    rows = []
    for name in NAMES:
        row: dict[str, Any] = {"key": case["key"], "asked": name}
        choice = predicted.get(name)
        if choice is not None and choice.refusal is not None:
            rows.append(row | {"refused": choice.refusal})
            continue
        if choice is not None and choice.seconds > longest_s:
            rows.append(row | {"missing": f"predicted {choice.seconds:.3g} s, above {longest_s:g}"})
            continue
        begin = time.perf_counter(), time.process_time()
        try:
            with at_most(limit_s):
                motion = solve(
                    problem.body, problem.load, problem.times, problem.at, solver=name, accuracy=problem.accuracy,
                    device="cpu",
                )  # fmt: skip
            row |= {"displacement_m": motion.displacement_m.tolist(), "velocity_m_s": motion.velocity_m_s.tolist()}
            row |= {f"{quantity}_error": getattr(motion, f"{quantity}_error") for quantity in QUANTITIES}
            row["solver"] = motion.solver
        except SceneError as error:
            row["refused_late"] = str(error)
        except (TooLongError, MemoryError) as error:
            row["missing"] = f"{type(error).__name__}: {error}"
        row |= {"seconds": time.perf_counter() - begin[0], "processor_s": time.process_time() - begin[1]}
        rows.append(row)
    return rows


def _choices(problem: Problem) -> list[Any]:
    return choices(
        problem.body, problem.load, problem.times, problem.at, accuracy=problem.accuracy, device="cpu"
    )  # fmt: skip


def relative_error(found: Any, known: Any) -> float:
    """L2 over the times at a point, relative, the largest of the points that move: the estimates' own norm."""
    found, known = np.asarray(found, dtype=float), np.asarray(known, dtype=float)
    size = np.linalg.norm(known, axis=(0, 2))
    off = np.linalg.norm(found - known, axis=(0, 2))
    moving = size > 1e-9 * size.max(initial=0.0)
    return float((off[moving] / size[moving]).max(initial=0.0))
