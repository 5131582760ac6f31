"""One call for every skin solver: the cheapest that reaches the wanted accuracy, and solved finer where it did not."""

import inspect
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.device import resolve
from palmfield.errors import SceneError
from palmfield.skin.approximation.truncate_domain import crop
from palmfield.skin.problem import Body, Load, Motion, Spot, asked_points, points_on_face, rising
from palmfield.types import Float

Name = Literal["auto", "spectral", "disc", "reduced", "implicit", "explicit", "particles"]

ASKED = ("solve", "refusal", "cost")
WHERE = {
    "spectral": {
        "solve": "solvers.lateral_waves.solve",
        "static": "solvers.lateral_waves.solve",
        "refusal": "solvers.lateral_waves.build",
        "cost": "solvers.lateral_waves.cost",
    },
    "disc": dict.fromkeys(ASKED, "solvers.axisymmetric.solve"),
    "reduced": dict.fromkeys(ASKED, "solvers.reduced"),
    "implicit": dict.fromkeys((*ASKED, "static"), "solvers.wedges"),
    "explicit": dict.fromkeys(ASKED, "solvers.spectral_elements.solve"),
    "particles": {
        "solve": "solvers.particles.solve",
        "refusal": "solvers.particles.resolution",
        "cost": "solvers.particles.resolution",
    },
}
"""Modules of palmfield.skin that hold each solver's solve_NAME, refusal_NAME and cost_NAME."""

PREVIEW = ("particles",)
"""Solvers for large deformation and previews: never chosen by `auto`."""

FINER = 3
"""How often a solution is made finer when its estimate misses the wanted accuracy."""


@dataclass(frozen=True)
class Choice:
    """What a solver would do: predicted seconds, or the sentence with which it refuses (then seconds is infinite)."""

    name: str
    seconds: float
    refusal: str | None


def choices(
    body: Body, load: Load, times: ArrayLike, at: ArrayLike, *, accuracy: float = 0.05, device: str = "auto"
) -> list[Choice]:
    """Every solver's prediction for a problem, the cheapest first; arguments as for `solve`."""
    moments, points = checked(times, at, accuracy)
    body, load, _ = crop(body, load, float(moments[-1]), points, accuracy)
    return ranking(body, load, moments, points, accuracy, resolve(device))


def ranking(body: Body, load: Load, times: Float, at: Float, accuracy: float, device: str) -> list[Choice]:
    """Choices for arguments that are checked."""
    found = []
    for name in WHERE:
        refusal = function(name, "refusal")(body, load)
        seconds = math.inf
        if refusal is None:
            try:
                seconds = cost(name, body, load, times, at, accuracy, device)
            except SceneError as reason:
                refusal = str(reason)
        found.append(Choice(name, seconds, refusal))
    return sorted(found, key=lambda choice: choice.seconds)


def solve(
    body: Body,
    load: Load,
    times: ArrayLike,
    at: ArrayLike,
    *,
    solver: Name = "auto",
    accuracy: float = 0.05,
    device: str = "auto",
    whole: bool = False,
    **resolution: Any,
) -> Motion:
    """Motion of skin under a load, with an estimate of its error.

    body: Slab or Layer; load: Spot or Traction (palmfield.skin.problem); the body is at rest before the load begins
    times: asked times [s], rising, shape (t,); at: points on the face [m], shape (n, 2) or (n, 3)
    solver: "auto", the cheapest by prediction that doesn't refuse, or one by name
    accuracy: wanted relative error of the displacement, L2 over the times at a point, the largest of the points
    device: "auto", "cpu" or "cuda:N"
    whole: keep all of a layer, also what lies beyond the reach of load and points
    (palmfield.skin.approximation.truncate_domain)
    resolution: passed on to a solver asked for by name, which is then not made finer
    Where the estimate misses the accuracy the problem is solved again, finer, up to FINER times; a Motion whose `error`
    is above `accuracy` says so in its `solver`.
    Raises SceneError for bad arguments and where no solver, or not the one asked for, can do it.
    """
    begin = time.perf_counter()
    moments, points = checked(times, at, accuracy)
    where = resolve(device)
    if solver != "auto" and solver not in WHERE:
        raise SceneError(f"solver is '{solver}'; use auto or one of {', '.join(WHERE)}")
    if not np.any(load.peak_Pa if isinstance(load, Spot) else load.pressure_Pa):
        still = np.zeros((len(moments), len(points), 3))
        where_to = points_on_face(body, points)
        return Motion(moments, where_to, still, still.copy(), 0.0, "no load: all is at rest", "none needed", 0.0)
    cut = 0.0
    if not whole:
        body, load, cut = crop(body, load, float(moments[-1]), points, accuracy)
    if solver == "auto":
        if resolution:
            raise SceneError(f"{', '.join(resolution)}: resolutions are a solver's own; name one with solver=")
        ranked = ranking(body, load, moments, points, accuracy, where)
        able = [choice for choice in ranked if choice.refusal is None and choice.name not in PREVIEW]
        if not able:
            raise SceneError("no solver can do this: " + "; ".join(f"{c.name}: {c.refusal}" for c in ranked))
        name = able[0].name
        others = ", ".join(f"{c.name} {c.seconds:.2g} s" for c in able[1:])
        why = f"auto: predicted {able[0].seconds:.2g} s" + (f"; {others}" if others else "")
    else:
        name, why = solver, "asked for"
        refusal = None if resolution else function(name, "refusal")(body, load)
        if refusal is not None:
            raise SceneError(f"solver '{name}': {refusal}")
    run = function(name, "solve")
    known = inspect.signature(run).parameters
    for key in resolution:
        if key not in known:
            raise SceneError(f"solver '{name}' has no '{key}'; it takes {', '.join(list(known)[4:])}")
    motion: Motion = run(body, load, moments, points, accuracy=accuracy, device=where, **resolution)
    wanted = accuracy
    for _ in range(FINER):
        if motion.error + cut <= accuracy or resolution:
            break
        wanted *= 0.7 * accuracy / (motion.error + cut)
        try:
            motion = run(body, load, moments, points, accuracy=wanted, device=where)
        except SceneError as reason:
            why += f"; not solved finer: {reason}"
            break
    error = motion.error + cut
    source = motion.error_source
    if cut > 0.0:
        source += f"; {cut:.2g} for leaving out the layer beyond the reach of load and points"
    if error > accuracy:
        why += f"; error {100 * error:.2g} % NOT within the wanted {100 * accuracy:.2g} %"
    spent = time.perf_counter() - begin
    return replace(motion, error=error, error_source=source, solver=f"{motion.solver} ({why})", seconds=spent)


def static(body: Body, load: Load, at: ArrayLike, *, accuracy: float = 0.05) -> Motion:
    """Displacement under the load's last pressure, held for ever, by lateral waves or else implicit elements.

    Arguments as for `solve`; times_s is the load's last time, the velocity 0.
    Raises SceneError for bad arguments and a body that nothing holds.
    """
    _, points = checked(load.times_s[-1:], at, accuracy)
    name = "implicit" if function("spectral", "refusal")(body, load) else "spectral"
    solver: Callable[..., Motion] = function(name, "static")
    return solver(body, load, points, accuracy=accuracy)


def checked(times: ArrayLike, at: ArrayLike, accuracy: float) -> tuple[Float, Float]:
    """Times, shape (t,), and points, shape (n, 2 or 3). Raises SceneError."""
    moments, points = rising("times", times), asked_points(at)
    if not isinstance(accuracy, (int, float)) or not 1e-5 <= accuracy <= 0.5:
        raise SceneError(f"accuracy is {accuracy}; give a relative error of 1e-5 to 0.5")
    return moments, points


def function(name: str, what: str) -> Callable[..., Any]:
    """A solver's solve_NAME, refusal_NAME or cost_NAME; loaded when asked for, as some take Warp."""
    return getattr(import_module(f"palmfield.skin.{WHERE[name][what]}"), f"{what}_{name}")


def cost(name: str, body: Body, load: Load, times: Float, at: Float, accuracy: float, device: str) -> float:
    """Predicted seconds."""
    predict = function(name, "cost")
    if device != "cpu" and name in ("explicit", "particles"):
        return predict(body, load, times, at, accuracy, device)
    return predict(body, load, times, at, accuracy)
