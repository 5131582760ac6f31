"""Choose a skin solver and solve: one call for every solver.

`solve` uses the cheapest solver that should reach the target accuracy, and refines if it does not. The predicted costs
are those of the stepper choice in scenes (palmfield.skin.costs).
"""

import inspect
import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.device import resolve
from palmfield.errors import SceneError
from palmfield.skin.approximation.truncate_domain import truncate_domain
from palmfield.skin.base import Foundation, Springs
from palmfield.skin.costs import Choice, ranked
from palmfield.skin.fem.on_body import on_body
from palmfield.skin.problem import (
    QUANTITIES,
    Body,
    Layer,
    Load,
    Motion,
    Quantity,
    SkinProblem,
    Slab,
    Spot,
    Traction,
    depth_of,
    is_pressed,
    numbers,
    points_on_face,
)

Name = Literal["auto", "lateral_waves", "axisymmetric", "reduced", "wedges", "spectral_elements", "particles"]

FUNCTIONS = ("solve", "refusal", "cost")
WHERE = {
    "lateral_waves": {
        "solve": "solvers.lateral_waves.solve",
        "static": "solvers.lateral_waves.solve",
        "refusal": "solvers.lateral_waves.build",
        "cost": "solvers.lateral_waves.cost",
    },
    "axisymmetric": dict.fromkeys((*FUNCTIONS, "static"), "solvers.axisymmetric.solve"),
    "reduced": dict.fromkeys(FUNCTIONS, "solvers.reduced"),
    "wedges": dict.fromkeys((*FUNCTIONS, "static"), "solvers.wedges"),
    "spectral_elements": dict.fromkeys((*FUNCTIONS, "finer", "prepared"), "solvers.spectral_elements.solve"),
    "particles": {
        "solve": "solvers.particles.solve",
        "refusal": "solvers.particles.resolution",
        "cost": "solvers.particles.resolution",
    },
}
"""Modules of palmfield.skin that hold solve_NAME, refusal_NAME and cost_NAME of each solver.

solve_NAME has a SkinProblem and its own resolution as arguments; it raises SceneError if it cannot solve the problem.
Optional functions: finer_NAME returns the resolution of the next solution; prepared_NAME returns the body of the cost
prediction, with data that solve_NAME reuses.
"""

FORMER = {
    "spectral": "lateral_waves",
    "disc": "axisymmetric",
    "implicit": "wedges",
    "explicit": "spectral_elements",
    "full": "wedges",
}
"""Former names of solvers, and their present names."""

PREVIEW = ("particles",)
"""Solvers for large deformation and previews: never chosen by `auto`."""

AT_REST = ("lateral_waves", "axisymmetric", "wedges")
"""Solvers for a static load, the fastest first."""

LATE = 20.0
"""Number of periods after the last change of a load from which output times of a lossless body count as static."""

HARDER: dict[Quantity, float] = {"displacement": 1.0, "velocity": 0.5, "normal": 1.0}
"""Displacement error over the error of each quantity, at about the same work."""

COMMON = ("accuracy", "accuracy_of", "device")
"""Options of every solver, in addition to its own resolution."""

SLAB_S, LAYER_S = 0.02, 0.12
"""Time of the choice itself for a slab and a layer [s], with the search for the relevant part of a layer."""

FINER = 3
"""Largest number of refinements if the error estimate misses the target accuracy."""


def choices(
    body: Body,
    load: Load,
    times: ArrayLike,
    at: ArrayLike,
    *,
    accuracy: float = 0.05,
    accuracy_of: Quantity = "displacement",
    device: str = "auto",
) -> list[Choice]:
    """Return the predictions of all solvers for a problem, the cheapest first; arguments as for `solve`."""
    problem = checked(body, load, times, at, accuracy, accuracy_of, device)
    return ranking(truncated(problem)[0])


def ranking(problem: SkinProblem) -> list[Choice]:
    """Rank the solvers for a problem; solvers without a computable cost come last."""
    options = []
    for name in WHERE:
        refusal = function(name, "refusal")(problem.body, problem.load)
        seconds, arguments = math.inf, dict[str, Any]()
        if refusal is None:
            try:
                own = replace(problem, accuracy=HARDER[problem.accuracy_of] * problem.accuracy)
                if "prepared" in WHERE[name]:
                    body, arguments = function(name, "prepared")(own)
                    own = replace(own, body=body)
                choosing = LAYER_S if isinstance(own.body, Layer) else SLAB_S
                seconds = choosing + float(function(name, "cost")(own))
            except (SceneError, MemoryError) as reason:
                refusal = f"{reason}"
            except Exception:
                seconds = math.inf
        options.append(Choice(name, math.inf if math.isnan(seconds) else seconds, refusal, arguments))
    return ranked(options)


def seconds_in_words(choice: Choice) -> str:
    return f"{choice.seconds:.2g} s" if math.isfinite(choice.seconds) else "cost unknown"


def solve(
    body: Body,
    load: Load,
    times: ArrayLike,
    at: ArrayLike,
    *,
    solver: Name = "auto",
    accuracy: float = 0.05,
    accuracy_of: Quantity = "displacement",
    device: str = "auto",
    whole: bool = False,
    **resolution: Any,
) -> Motion:
    """Return the motion of skin under a load, with an estimate of its error.

    body: Slab or Layer. load: Spot or Traction (palmfield.skin.problem); the body is at rest before the load begins.
    times: requested times [s], rising, shape (t,). at: points on the face [m], shape (n, 2) or (n, 3).
    solver: name of a solver, or "auto": the solver with the lowest predicted cost that can solve the problem.
    accuracy: target relative error of accuracy_of, L2 over the times at a point, at the worst point.
    accuracy_of: quantity of the error: "displacement", "velocity", or "normal" (displacement along the normal of the
        face; its error is larger if the skin moves mostly along its surface).
    device: "auto", "cpu" or "cuda:N".
    whole: whether to keep the whole layer, also the part that hardly affects the points
        (palmfield.skin.approximation.truncate_domain).
    resolution: arguments for the named solver; with them the solution is not refined.
    If the estimate misses the accuracy, the problem is solved again on a finer mesh, up to FINER times. If `error` of
    the Motion is still above `accuracy`, its `solver` states this.
    Raises SceneError for bad arguments, if no solver (or not the named one) can solve the problem, and for a body
    without losses if only late times are requested (`check_rest`).
    """
    begin = time.perf_counter()
    problem = checked(body, load, times, at, accuracy, accuracy_of, device)
    if solver in FORMER:
        raise SceneError(f"solver '{solver}' has been renamed: use {FORMER[solver]}")
    if solver != "auto" and solver not in WHERE:
        raise SceneError(f"solver is '{solver}'; use auto or one of {', '.join(WHERE)}")
    check_rest(problem)
    # Checked first, because every solver would refuse points off the body.
    points_on_face(body, problem.at)
    cut, law = 0.0, max(sheet.material.series_error for sheet in body.sheets)
    if whole or not is_pressed(load):
        problem = replace(problem, load=on_body(body, load))
    else:
        problem, cut = truncated(problem)
    if not is_pressed(problem.load):
        return at_rest(problem)
    if solver == "auto":
        if resolution:
            raise SceneError(f"{', '.join(resolution)}: resolutions apply to one solver; choose it with solver=")
        options = ranking(problem)
        able = [choice for choice in options if choice.refusal is None and choice.name not in PREVIEW]
        if not able:
            raise SceneError("no solver supports this problem: " + "; ".join(f"{c.name}: {c.refusal}" for c in options))
        chosen, motion, why = _first_that_can(able, problem)
        name, more = chosen.name, chosen.arguments
    else:
        name, why, more = solver, "requested", {}
        motion = _by_name(name, problem, resolution)
    again = partial(function(name, "solve"), **more)
    target, mesh = accuracy, dict[str, Any]()
    for _ in range(FINER):
        miss = (motion.error + cut + law) / accuracy
        if miss <= 1.0 or resolution:
            break
        if "finer" in WHERE[name]:
            mesh = function(name, "finer")(problem, miss, **mesh)
        else:
            target *= 0.7 / miss
        try:
            motion = again(replace(problem, accuracy=target), **mesh)
        except SceneError as reason:
            why += f"; no finer solution: {reason}"
            break
    error = motion.error + cut + law
    reasons = "without the layer beyond the reach of load and points", "branches in place of the law of a material"
    added = (f"; {part:.2g} for {what}" for part, what in zip((cut, law), reasons, strict=True) if part > 0.0)
    source = motion.error_source + "".join(added)
    if error > accuracy:
        why += f"; error {100 * error:.2g} % NOT within the target of {100 * accuracy:.2g} %"
    spent = time.perf_counter() - begin
    all_errors = {f"{quantity}_error": getattr(motion, f"{quantity}_error") + cut + law for quantity in QUANTITIES}
    solver_words = f"{motion.solver} ({why})"
    return replace(motion, error=error, error_source=source, solver=solver_words, seconds=spent, **all_errors)


def _first_that_can(able: list[Choice], problem: SkinProblem) -> tuple[Choice, Motion, str]:
    """Return the first solver of a list that does not fail at run time, its result, and the reason in words."""
    refused: list[str] = []
    for place, choice in enumerate(able):
        try:
            motion = function(choice.name, "solve")(problem, **choice.arguments)
        except (SceneError, MemoryError) as reason:
            refused.append(f"{choice.name} refused: {reason}")
            continue
        others = ", ".join(f"{c.name} {seconds_in_words(c)}" for c in able[place + 1 :])
        words = [f"auto: predicted {seconds_in_words(choice)}", *([others] if others else []), *refused]
        return choice, motion, "; ".join(words)
    raise SceneError("no solver supports this problem: " + "; ".join(refused))


def _by_name(name: str, problem: SkinProblem, resolution: dict[str, Any]) -> Motion:
    """Return the result of one solver with a given resolution. Raises SceneError if it cannot solve the problem."""
    if not resolution:
        problem.refuse(name, function(name, "refusal"))
    run: Callable[..., Motion] = function(name, "solve")
    own = list(inspect.signature(run).parameters)[1:]
    for key in resolution:
        if key not in own:
            raise SceneError(f"solver '{name}' has no '{key}'; allowed: {', '.join([*COMMON, *own])}")
    return run(problem, **resolution)


def static(body: Body, load: Load, at: ArrayLike, *, accuracy: float = 0.05) -> Motion:
    """Return the static displacement under the last pressure of the load, from the first usable solver of AT_REST.

    Arguments as for `solve`. In the Motion, times_s is the last time of the load and the velocity is 0.
    Raises SceneError for bad arguments and a body without support.
    """
    begin = time.perf_counter()
    check_load(load)
    problem = checked(body, load, load.times_s[-1:], at, accuracy, "displacement", "cpu")
    points_on_face(body, problem.at)
    load = on_body(body, load)
    if not is_pressed(load):
        return at_rest(problem)
    refused: list[str] = []
    for name in AT_REST:
        reason = function(name, "refusal")(body, load)
        if reason is not None:
            refused.append(f"{name}: {reason}")
            continue
        solver: Callable[..., Motion] = function(name, "static")
        try:
            motion = solver(body, load, problem.at, accuracy=accuracy)
        except (SceneError, MemoryError) as refusal:
            refused.append(f"{name}: {refusal}")
            continue
        target = accuracy
        for _ in range(FINER):
            if motion.error <= accuracy:
                break
            target *= 0.7 * accuracy / motion.error
            try:
                motion = solver(body, load, problem.at, accuracy=target)
            except (SceneError, MemoryError):
                break
        words = "" if motion.error <= accuracy else f" (error NOT within the target of {100 * accuracy:.2g} %)"
        return replace(motion, solver=motion.solver + words, seconds=time.perf_counter() - begin)
    raise SceneError("no solver has a static solution: " + "; ".join(refused))


def at_rest(problem: SkinProblem) -> Motion:
    """Return the motion of a body without a load."""
    still = np.zeros((len(problem.times), len(problem.points), 3))
    return problem.solved(
        still, still.copy(), np.zeros(3), "no load: the motion is 0", "none needed", time.perf_counter()
    )


def check_rest(problem: SkinProblem) -> None:
    """Raise SceneError if only late times are requested and the body never comes to rest.

    A body without losses in sheets, base and sides oscillates for ever. Late times are more than LATE periods of its
    quarter-wave resonance after the last change of the load.
    """
    body, times = problem.body, problem.times
    base, last = body.base, float(problem.load.times_s[-1])
    damped = isinstance(base, Springs) and max(base.normal_Pa_s_m, base.tangential_Pa_s_m) > 0.0
    endless = body.side == "absorbing" or (isinstance(body, Slab) and body.shape == "infinite")
    lossy = any(sheet.material.relaxes for sheet in body.sheets)
    if lossy or damped or endless or isinstance(base, Foundation):
        return
    slowest = min(math.sqrt(s.material.shear_relaxed_Pa / s.material.density_kg_m3) for s in body.sheets)
    period = 4.0 * depth_of(body) / slowest
    if float(times[0]) > last + LATE * period:
        raise SceneError(
            f"times begin {float(times[0]) - last:.3g} s after the last change of the load, {LATE:g} or more "
            "periods of the body, but it still oscillates, because it has no damping. Use palmfield.skin.static for "
            "the static solution, add a branch or a viscosity to the material, or give times from the load on"
        )


def check_load(load: object) -> None:
    """Raise SceneError unless the load is a Spot or a Traction."""
    if isinstance(load, Spot | Traction):
        return
    if isinstance(load, (list, tuple)):
        raise SceneError(
            f"load is a {type(load).__name__} of {len(load)}; give one Spot or Traction: solve for each and add their "
            "motions, or give the whole pressure as a Traction"
        )
    raise SceneError(f"load is {str(load)[:60]!r}; give a Spot or a Traction")


def checked(
    body: Body, load: Load, times: ArrayLike, at: ArrayLike, accuracy: float, accuracy_of: Quantity, device: str
) -> SkinProblem:
    """Return the problem for the arguments of a user. Raises SceneError for invalid arguments."""
    check_load(load)
    problem = SkinProblem(
        body, load, numbers("times", times), numbers("at", at), accuracy, accuracy_of, resolve(device)
    )
    if not isinstance(accuracy, (int, float)) or not 1e-5 <= accuracy <= 0.5:
        raise SceneError(f"accuracy is {accuracy}; give a relative error of 1e-5 to 0.5")
    return problem


def truncated(problem: SkinProblem) -> tuple[SkinProblem, float]:
    """Return the problem without the part of the body that hardly affects the points, and the error of omitting it."""
    body, load, cut = truncate_domain(
        problem.body, problem.load, float(problem.times[-1]), problem.at, problem.accuracy
    )
    return replace(problem, body=body, load=on_body(body, load)), cut


def function(name: str, what: str) -> Callable[..., Any]:
    """Return solve_NAME, refusal_NAME or cost_NAME of a solver; loaded at first use, because some need Warp."""
    return getattr(import_module(f"palmfield.skin.{WHERE[name][what]}"), f"{what}_{name}")
