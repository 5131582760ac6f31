"""Are the solvers' error estimates true? Random cases solved, and held against an answer known to be converged."""

import math
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import FrameType

import numpy as np
from random_cases import Case

from palmfield.errors import SceneError
from palmfield.skin.problem import Body, Layer, Motion, Slab
from palmfield.skin.solver_choice import Name, choices, solve
from palmfield.skin.solvers.axisymmetric.solve import refusal_axisymmetric, solve_axisymmetric
from palmfield.skin.solvers.lateral_waves.build import refusal_lateral_waves
from palmfield.skin.solvers.lateral_waves.solve import solve_lateral_waves
from palmfield.skin.solvers.spectral_elements.mesh import plan
from palmfield.skin.solvers.spectral_elements.solve import refusal_spectral_elements, size_of, solve_spectral_elements
from palmfield.types import Float

NAMES: tuple[Name, ...] = ("lateral_waves", "axisymmetric", "wedges", "spectral_elements", "particles")
TENTH = 0.1
"""Most that two reference runs may differ by, as a share of the wanted accuracy."""
SPECTRAL_ACCURACY = 1e-4
REFERENCE_ROUNDS = 3
CORE_RATE = 60e6
"""Element nodes that a core steps in a second: to tell whether a reference can be had at all."""


class TooLongError(Exception):
    """A run took longer than it may."""


@dataclass(frozen=True)
class Reference:
    """A converged answer: displacement [m], (t, n, 3), or None where none was found; how, or why not."""

    displacement: Float | None
    how: str


@dataclass(frozen=True)
class Row:
    """What one solver made of one case.

    asked: "auto" or a name; solver: who answered; estimate, true: relative errors, NaN where there is none
    seconds: of the clock; processor_s: of all cores; predicted: seconds; missing: why there is no answer
    """

    number: int
    words: str
    asked: str
    solver: str
    wanted: float
    estimate: float
    true: float
    seconds: float
    processor_s: float
    predicted: float
    reference: str
    missing: str = ""


def relative_error(found: Float, known: Float) -> float:
    """L2 over the times at a point, relative, the largest of the points that move: the estimates' own norm."""
    size = np.linalg.norm(known, axis=(0, 2))
    apart = np.linalg.norm(found - known, axis=(0, 2))
    moving = size > 0.0
    return float((apart[moving] / size[moving]).max(initial=0.0))


def judge(case: Case, device: str = "cpu", longest_s: float = 60.0, limit_s: float = 600.0) -> list[Row]:
    """Rows of a case: by `auto`, then by each other solver that doesn't refuse and is predicted below longest_s [s].

    limit_s: of one run, and of the reference [s]; what takes longer is given up, and its row says so
    """
    try:
        with at_most(limit_s):
            reference = converged(case, device, limit_s)
    except (SceneError, TooLongError) as error:
        reference = Reference(None, f"reference: {error}")
    if reference.displacement is None:
        return [_missing(case, "auto", reference, "dropped: " + reference.how)]
    ranked = choices(case.body, case.load, case.times, case.at, accuracy=case.accuracy, device=device)
    predicted = {choice.name: choice.seconds for choice in ranked if choice.refusal is None}
    rows = [_row(case, "auto", reference, predicted, device, limit_s)]
    for name in NAMES:
        if name == rows[0].solver:
            rows.append(replace(rows[0], asked=name))
        elif predicted.get(name, math.inf) <= longest_s:
            rows.append(_row(case, name, reference, predicted, device, limit_s))
    return rows


def _row(
    case: Case, asked: Name, reference: Reference, predicted: dict[str, float], device: str, limit_s: float
) -> Row:
    begin = time.perf_counter(), time.process_time()
    try:
        with at_most(limit_s):
            motion = solve(
                case.body, case.load, case.times, case.at, solver=asked, accuracy=case.accuracy, device=device
            )
    except (SceneError, TooLongError) as error:
        return _missing(case, asked, reference, str(error))
    solver = motion.solver.replace(",", " ").replace(":", " ").split()[0]
    assert reference.displacement is not None
    return Row(
        case.number,
        case.words,
        asked,
        solver,
        case.accuracy,
        motion.error,
        relative_error(motion.displacement_m, reference.displacement),
        time.perf_counter() - begin[0],
        time.process_time() - begin[1],
        predicted[solver],
        reference.how,
    )


def _missing(case: Case, asked: str, reference: Reference, why: str) -> Row:
    nan = math.nan
    return Row(case.number, case.words, asked, "-", case.accuracy, nan, nan, nan, nan, nan, reference.how, why)


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


def converged(case: Case, device: str, limit_s: float) -> Reference:
    """The answer, by lateral waves where there are such, by the disc's harmonics, else by elements of high order."""
    body = equivalent(case.body)
    if refusal_lateral_waves(body, case.load) is None:
        motion = solve_lateral_waves(body, case.load, case.times, case.at, accuracy=SPECTRAL_ACCURACY)
        return _accepted(motion.displacement_m, motion.error, case, "lateral_waves")
    if refusal_axisymmetric(body, case.load) is None:
        wanted = max(1e-4, 0.02 * case.accuracy)
        motion = solve_axisymmetric(body, case.load, case.times, case.at, accuracy=wanted, degree=7, fine=1.5)
        return _accepted(motion.displacement_m, motion.error, case, "disc, degree 7")
    reason = refusal_spectral_elements(body, case.load)
    return Reference(None, reason) if reason else _by_elements(case, device, limit_s)


def equivalent(body: Body) -> Body:
    """The same problem where another solver knows it: absorbing slabs go on for ever, flat layers are boxes."""
    if isinstance(body, Slab):
        return Slab(body.sheets, base=body.base) if body.side == "absorbing" else body
    corners = body.patch.vertices
    if body.side == "absorbing" or np.ptp(corners[:, 2]) > 0.0:
        return body
    size = np.ptp(corners[:, :2], axis=0)
    return Slab(body.sheets, "box", body.base, body.side, size_m=(float(size[0]), float(size[1])))


def _accepted(displacement: Float, error: float, case: Case, how: str) -> Reference:
    if error > TENTH * case.accuracy:
        return Reference(None, f"{how}: its own error of {error:.1e} is above a tenth of the wanted accuracy")
    return Reference(displacement, f"{how}, {error:.1e}")


def _by_elements(case: Case, device: str, limit_s: float) -> Reference:
    """Spectral elements of order 6 to 8, finer until two runs agree."""
    body = equivalent(case.body)
    first = plan(body, case.load, case.at, 0.01)
    before: Motion | None = None
    apart = math.nan
    for level in range(1 + REFERENCE_ROUNDS):
        # A layer's elements are its triangles': there only the order can rise.
        order = 4 + level if isinstance(body, Layer) else 6
        size = None if isinstance(body, Layer) else 1.2 * first.size_m / 1.35**level
        chosen = plan(body, case.load, case.at, 0.01, order, size)
        nodes, step = size_of(body, chosen)
        seconds = nodes * ((order + 1) / order) ** 3 * float(case.times[-1]) / step / CORE_RATE
        if device == "cpu" and seconds > limit_s:
            return Reference(None, f"spectral elements of order {order} would take {seconds:.0f} s")
        motion = solve_spectral_elements(
            body, case.load, case.times, case.at, device=device, order=order, size_m=size, estimate=False,
            precision="float64", nu_at_most=0.5,
        )  # fmt: skip
        if before is not None:
            apart = relative_error(before.displacement_m, motion.displacement_m)
            if apart <= TENTH * case.accuracy:
                return Reference(
                    motion.displacement_m, f"spectral_elements, order {order}, two meshes {apart:.1e} apart"
                )
        before = motion
    return Reference(None, f"spectral elements: two meshes still {apart:.1e} apart")


def summary(rows: list[Row]) -> dict[str, tuple[int, float, float, float]]:
    """By "auto" and by solver: how many answers, the share with true <= estimate, the medians of estimate / true and of
    predicted seconds over the processor's."""
    result = {}
    for asked in dict.fromkeys(row.asked for row in rows):
        some = [row for row in rows if row.asked == asked and not row.missing]
        if not some:
            continue
        ratios = np.array([row.estimate / row.true if row.true > 0.0 else math.inf for row in some])
        taken = np.array([row.predicted / max(row.processor_s, 1e-3) for row in some])
        result[asked] = (len(some), float(np.mean(ratios >= 1.0)), float(np.median(ratios)), float(np.median(taken)))
    return result
