"""Explicit spectral elements behind the skin solvers' common call."""

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from palmfield.device import resolve
from palmfield.errors import SceneError
from palmfield.skin.explicit.loads import table_of
from palmfield.skin.explicit.mesh import Plan, build, fast_speed, load_frequency, load_width, plan
from palmfield.skin.explicit.model import SAFETY, Model, hold
from palmfield.skin.explicit.places import find
from palmfield.skin.explicit.run import Points, Stepper
from palmfield.skin.layer_oracle import centre_response
from palmfield.skin.material import bulk_from_poisson
from palmfield.skin.problem import Body, Layer, Load, Motion, Springs, rising
from palmfield.types import Float

COARSER = 1.4
"""Element size of the run by which the error is estimated, over that of the run that is returned."""

STIFFEST = 1e5
"""Bulk over shear modulus at once, above which the step is so small that the solver refuses (nu 0.499995)."""

COURANT = {1: 0.587, 2: 0.477, 3: 0.406, 4: 0.345, 5: 0.295}
"""Stable step of a cube times wave speed over node spacing (size / N), nu 0.495; higher orders like 1.5 / (N + 0.1)."""

CPU_COST = (8.5e-9, 22e-9, 15e-6)
"""Seconds by element node, by node and by step on one CPU core (AMD EPYC), measured by scripts/bench_explicit.py."""

GPU_COST = (0.05e-9, 0.05e-9, 8e-6)
"""The same on a GPU: an assumption from its bandwidth, until scripts/bench_explicit.py has run on one."""


def refusal_explicit(body: Body, load: Load) -> str | None:
    """Why the explicit solver cannot take this problem, in a sentence, or None."""
    for sheet in body.sheets:
        material = sheet.material
        if material.bulk_Pa > STIFFEST * material.shear_instant_Pa:
            return (
                f"explicit elements step with the pressure wave, and '{material.name}' has a bulk modulus of "
                f"{material.bulk_Pa / material.shear_instant_Pa:.3g} times its shear modulus (at most {STIFFEST:g}): "
                "use the implicit or spectral solver, or nu_at_most"
            )
    return None


def cost_explicit(body: Body, load: Load, times: Float, at: Float, accuracy: float, device: str = "cpu") -> float:
    """Predicted seconds of `solve_explicit`, from the size of its mesh and its step."""
    chosen = plan(body, load, np.atleast_2d(np.asarray(at, dtype=float)), accuracy)
    total = 0.0
    for each in (chosen, coarser(body, chosen)):
        nodes, step = size_of(body, each)
        rates = CPU_COST if device == "cpu" else GPU_COST
        steps = max(0.0, float(np.max(times)) - float(load.times_s[0])) / step
        repeated = nodes * ((each.order + 1) / each.order) ** 3
        total += steps * (repeated * rates[0] + nodes * rates[1] + rates[2])
    return total


def size_of(body: Body, chosen: Plan) -> tuple[float, float]:
    """Nodes and step [s], roughly, without building the mesh."""
    n = chosen.order
    if isinstance(body, Layer):
        area = 3.0 * len(body.patch.faces) * chosen.size_m**2
        thickness = float(np.mean(body.patch.depth))
    else:
        thickness = body.thickness_m
        reach = chosen.watched_m[:, 1] - chosen.watched_m[:, 0] + 2.0 * (chosen.sponge_m + chosen.margin_m)
        area = {
            "infinite": 0.6 * float(np.prod(reach)),
            "box": float(np.prod(np.asarray(body.size_m or (0.0, 0.0)) + 2.0 * chosen.sponge_m)),
            "disc": math.pi * ((body.radius_m or 0.0) + chosen.sponge_m) ** 2,
        }[body.shape]
        # Cells outside what is watched are wider
        area *= 0.6
    nodes = area / chosen.size_m**2 * n**2 * (sum(chosen.deep) * n + 1)
    total = sum(sheet.thickness_m for sheet in body.sheets)
    step = math.inf
    for sheet, count in zip(body.sheets, chosen.deep, strict=True):
        deep = thickness * sheet.thickness_m / total / count
        across = 0.6 * chosen.size_m if isinstance(body, Layer) else 0.85 * chosen.size_m
        spacing = math.sqrt(3.0 / (2.0 / across**2 + 1.0 / deep**2)) / n
        courant = COURANT.get(n, 1.5 / (n + 0.1))
        step = min(step, SAFETY * courant * spacing / fast_speed(sheet.material))
    return nodes, step


def coarser(body: Body, chosen: Plan) -> Plan:
    """The mesh by which the error is estimated: wider elements, or a lower order on a patch's own."""
    if isinstance(body, Layer):
        return replace(chosen, order=max(1, chosen.order - 1))
    deep = tuple(max(1, math.floor(count / COARSER + 0.5)) for count in chosen.deep)
    margin, sponge = 0.6 * chosen.margin_m, 0.8 * chosen.sponge_m
    return replace(chosen, size_m=COARSER * chosen.size_m, deep=deep, margin_m=margin, sponge_m=sponge)


def solve_explicit(
    body: Body,
    load: Load,
    times: Float,
    at: Float,
    *,
    accuracy: float = 0.05,
    device: str = "cpu",
    order: int | None = None,
    size_m: float | None = None,
    deep: tuple[int, ...] | None = None,
    step_s: float | None = None,
    precision: str = "float32",
    nu_at_most: float | None = None,
    estimate: bool = True,
) -> Motion:
    """Motion of the face by explicit spectral elements, matrix-free (Patera 1984; Komatitsch & Vilotte 1998).

    times: [s], rising, shape (t,); at: points of the face [m], shape (n, 3) or (n, 2); device: "cpu" or "cuda:0"
    order: N of the elements, 1 to 7 (1 integrates too coarsely unless they are prisms); size_m: their width [m] (slabs)
    deep: elements through each sheet; step_s: [s], at most the stable one; precision: "float32" or "float64"
    nu_at_most: takes a smaller bulk modulus where Poisson's ratio at once is above this, which makes larger steps; only
    where the spectral layer says that it changes less than the wanted accuracy, and the change goes into the error
    estimate: False leaves the second, coarser run out; the error is then NaN
    Raises SceneError for a problem that `refusal_explicit` names, an element inside out, a step above the stable one,
    times that do not rise, and points off the face.
    """
    began = time.perf_counter()
    device = resolve(device)
    asked = rising("times", times)
    if precision not in ("float32", "float64"):
        raise SceneError(f"explicit skin: precision is '{precision}'; use float32 or float64")
    if order is not None and not 1 <= order <= 7:
        raise SceneError(f"explicit skin: order is {order}; give 1 to 7")
    softened = 0.0
    if nu_at_most is not None:
        body, softened = soften(body, load, nu_at_most, accuracy)
    reason = refusal_explicit(body, load)
    if reason is not None:
        raise SceneError(reason)
    points = np.atleast_2d(np.asarray(at, dtype=float))
    chosen = plan(body, load, points, accuracy, order, size_m, deep)
    fine = march(body, chosen, load, asked, points, device, precision, step_s)
    error, source = math.nan, "not estimated"
    if estimate:
        less = coarser(body, chosen)
        rough = march(body, less, load, asked, points, device, precision, None)
        size = float(np.linalg.norm(fine[0]))
        gap = float(np.linalg.norm(fine[0] - rough[0])) / size if size > 0.0 else 0.0
        if isinstance(body, Layer):
            error, source = gap, f"difference to order {less.order} on the same elements"
        else:
            # What a sponge does falls with no known power of its size
            share = 0.8 if chosen.sponge_m > 0.0 else 1.0 / (COARSER**chosen.order - 1.0)
            error = share * gap
            source = f"{share:.2f} of the difference to elements {COARSER} times as wide"
            if chosen.sponge_m > 0.0:
                source += " in a smaller sponge"
        error += lag(body, load, fine[3]) + softened
    if softened > 0.0:
        source += f"; {softened:.2g} for nu at most {nu_at_most}"
    where = f"explicit, order {chosen.order}, {fine[2]} elements of {1e3 * chosen.size_m:.3g} mm, step {fine[3]:.3g} s"
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return Motion(asked, points, fine[0], fine[1], error, source, where, time.perf_counter() - began)


def march(
    body: Body,
    chosen: Plan,
    load: Load,
    times: Float,
    points: Float,
    device: str,
    precision: str,
    step_s: float | None,
) -> tuple[Float, Float, int, float]:
    """Displacement and velocity, (t, n, 3), elements and step of one run."""
    solid, damping = build(body, chosen)
    model = Model(solid, body.sheets, device, precision)
    side = "absorbing" if isinstance(body, Layer) and body.side == "absorbing" else body.side
    if not isinstance(body, Layer) and chosen.sponge_m > 0.0:
        side = "absorbing"
    holds = hold(model, body.base, side, damping)
    rows = model.mass[holds.rows, None, None]
    spring_rate = float((np.abs(holds.spring) / rows).sum(axis=2).max(initial=0.0))
    stable = model.stable_step(spring_rate)
    step = SAFETY * stable if step_s is None else step_s
    start = float(load.times_s[0])
    late = np.maximum(times - start, 0.0) / step
    first = np.floor(late).astype(np.int64)
    wanted = np.unique(first[:, None] + np.array([-1, 0, 1]))
    wanted = wanted[wanted >= 0]
    steps = int(wanted[-1]) + 1
    table = table_of(load, solid, step, steps)
    stepper = Stepper(model, holds, step, table, Points(*find(solid, points)), wanted, stable)
    stepper.advance(steps)
    u, v = (np.concatenate([np.zeros((1, len(points), 3)), a.numpy()[: len(wanted)]]) for a in stepper.readings())

    def row(step_number: Any) -> Any:
        """Reading after a step; before the first the body rests."""
        return np.where(step_number < 0, 0, 1 + np.searchsorted(wanted, np.maximum(step_number, 0)))

    before, here, after = (v[row(first + k)] for k in (-1, 0, 1))
    part = (late - first)[:, None, None]
    place = u[row(first - 1)] + part * step * here + 0.5 * part * (part - 1.0) * step * (here - before)
    speed = np.where(part < 0.5, here + (part - 0.5) * (here - before), here + (part - 0.5) * (after - here))
    resting = (times < start)[:, None, None]
    place, speed = np.where(resting, 0.0, place), np.where(resting, 0.0, speed)
    wp.synchronize_device(device)
    return place, speed, len(solid.elements), step


def lag(body: Body, load: Load, step_s: float) -> float:
    """What the dashpots' velocity of half a step before does: as if h t K_d / 2 less mass, h w / 2 times the loss.

    w: angular frequency of the load's course or of a shear wave as long as the load is wide, whichever is higher
    """
    worst = 0.0
    for sheet in body.sheets:
        material = sheet.material
        if material.viscosity_Pa_s > 0.0:
            speed = math.sqrt(material.shear_relaxed_Pa / material.density_kg_m3)
            omega = 2.0 * math.pi * max(load_frequency(load), 0.5 * speed / load_width(load))
            worst = max(worst, 0.5 * step_s * omega * min(1.0, omega * material.viscous_time_s))
    return worst


def soften(body: Body, load: Load, nu: float, accuracy: float) -> tuple[Body, float]:
    """The body with Poisson's ratio at once of at most nu, and what that changes, from the spectral layer.

    Raises SceneError for more than one sheet or springs, which that layer does not know, and where it changes more than
    the wanted accuracy.
    """
    if len(body.sheets) != 1 or isinstance(body.base, Springs):
        raise SceneError("explicit skin: nu_at_most needs one sheet on a plain base; leave it out")
    sheet = body.sheets[0]
    most = bulk_from_poisson(nu, sheet.material.shear_instant_Pa)
    if sheet.material.bulk_Pa <= most:
        return body, 0.0
    soft = replace(sheet.material, bulk_Pa=most)
    thickness = float(np.mean(body.patch.depth)) if isinstance(body, Layer) else body.thickness_m
    width, change = load_width(load), 0.0
    frequencies = {load_frequency(load)} | ({0.0} if body.base != "free" else set())
    for f in frequencies:
        exact, near = (centre_response(f, m, thickness, width, base=body.base) for m in (sheet.material, soft))
        change = max(change, float(abs(near / exact - 1.0)))
    if change > accuracy:
        raise SceneError(
            f"explicit skin: nu_at_most {nu} would change this layer's motion by {change:.2g}, above the accuracy of "
            f"{accuracy:g}: leave it out, or use the implicit or spectral solver"
        )
    return replace(body, sheets=(replace(sheet, material=soft),)), change
