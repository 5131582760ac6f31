"""Solver spectral_elements: explicit spectral elements in the common form of the skin solvers."""

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from palmfield.device import resolve
from palmfield.errors import SceneError
from palmfield.skin.approximation.load_scales import edge_is_felt, motion_width
from palmfield.skin.approximation.reduce_bulk_modulus import reduce_bulk_modulus
from palmfield.skin.approximation.richardson import differences, error_of_coarser, error_of_finer
from palmfield.skin.approximation.truncate_domain import refusal_of_spot
from palmfield.skin.base import Foundation
from palmfield.skin.materials.material import Sheet
from palmfield.skin.problem import (
    ONLY_WEDGES,
    Body,
    Layer,
    Load,
    Motion,
    SkinProblem,
    Spot,
    normals_on_face,
    points_on_face,
)
from palmfield.skin.solvers.spectral_elements.mesh import Plan, build, fast_speed, plan
from palmfield.skin.solvers.spectral_elements.model import SAFETY, Holds, Model, constraints
from palmfield.skin.solvers.spectral_elements.places import find, table_of
from palmfield.skin.solvers.spectral_elements.run import Points, Stepper
from palmfield.skin.solvers.spectral_elements.solid import Solid
from palmfield.types import Float

COARSER = 1.4
"""Element size of the run for the error estimate over that of the returned run."""

LEAST_WIDER = 1.2
"""Least ratio of the widths under the load of two meshes whose difference estimates the error."""

LOWER = 0.6
"""Upper limit of error over difference from the next lower order; it was 0.05 to 0.5 on 20 random discs and boxes."""

AT_EDGE = 1.5
"""Order of the error near a singular fixed edge over the order of the elements. On two discs, with fixed and free side,
under a spot of 0.6 radii, the estimate is 1.1 and 1.6 times the error."""

STEP_ORDER = 1.0
"""Least order of the error in the step: dashpots, and branches shorter than a step, use the velocity of the previous
half step. Without them the order is 2."""

LOWER_SPONGE = 0.7
"""The same limit as LOWER with a sponge, which is also smaller in the second run; it was 0.03 to 0.53 on 10 random
infinite slabs."""

LONGEST_S = 3600.0
"""Largest predicted time of a run [s]; longer runs are refused."""

WINDOW = 0.05
"""Share of the simulated time in a second run of higher order."""

STIFFEST = 1e5
"""Largest allowed ratio of instantaneous bulk to shear modulus (nu 0.499995); above it the step is too small."""

COURANT = {1: 0.587, 2: 0.477, 3: 0.406, 4: 0.345, 5: 0.295}
"""Stable step of a cube times wave speed over node spacing (size / N), by order, nu 0.495; higher orders:
1.5 / (N + 0.1)."""

CPU_COST = (8.5e-9, 12e-9, 15e-6)
"""Time per element node, per node and per step on one CPU core (AMD EPYC) [s], scripts/bench_spectral_elements.py."""

MAKING = (0.012, 6e-5)
"""Time of a mesh and its stable step: constant, and per element [s] (docs/bench/skin_costs.md)."""

LIKELY = 1.2
"""Ratio of estimated to computed step; it was 1.05 to 1.4 on 11 slabs and layers without much viscosity."""

REPEATED, FEW, THIN = (1.2, 3.0), 50, 0.5
"""Time of all solutions of a slab over that of the first. The second value applies to discs of less than FEW elements
with a singular fixed edge (8 of 20 missed the target), and to depths below THIN widths of the load (8 of 11)."""

BY_NODES, ROOM, MOST_MISS = 1.5, 0.8, 10.0
"""Power of the number of nodes in the error of a mesh (0.4 to 2.5 on 40 problems), share of the target error for the
next mesh, and largest assumed error of the first mesh over the target."""

GPU_COST = (0.035e-9, 0.1e-9, 5e-6)
"""The same as CPU_COST on a GPU: layers of 13 k to 40 k elements of order 1 and 2 on an H200."""


def refusal_spectral_elements(body: Body, load: Load) -> str | None:
    """Return the reason why solver spectral_elements cannot solve a problem, in a sentence, or None."""
    if isinstance(body.base, Foundation):
        return ONLY_WEDGES
    if isinstance(body, Layer) and body.side == "absorbing":
        return (
            "spectral elements have only dashpots at absorbing sides, which reflect slow waves by an unknown "
            "amount: use solver 'wedges'"
        )
    turned = refusal_of_spot(body, load)
    if turned is not None:
        return turned
    for sheet in body.sheets:
        material = sheet.material
        if material.bulk_Pa > STIFFEST * material.shear_instant_Pa:
            return (
                f"spectral-element steps resolve the pressure wave, and '{material.name}' has a bulk modulus of "
                f"{material.bulk_Pa / material.shear_instant_Pa:.3g} times its shear modulus; allowed: at most "
                f"{STIFFEST:g}: use solver 'wedges' or 'lateral_waves', or nu_at_most"
            )
    return None


def cost_spectral_elements(problem: SkinProblem) -> float:
    """Return the predicted time of `solve_spectral_elements` [s], from the size of its mesh and its step.

    The body has the bulk modulus of the solution (reduce_bulk_modulus). Raises SceneError above LONGEST_S.
    """
    body, load, points, device = problem.body, problem.load, problem.at, problem.device
    chosen, singular = plan(body, load, points, problem.accuracy), edge_is_felt(body, load, points)
    total = 0.0
    requested, start = problem.times, float(load.times_s[0])
    ends = float(requested[-1]), window(body, chosen, singular, load, requested)
    second = comparison_plan(body, chosen, singular)
    # The second plan runs with the whole step and with half the step
    runs = [(chosen, ends[0], 1.0), (second, ends[1], 3.0)]
    if second.order == chosen.order > 1:
        runs.append((at_lower_order(chosen), ends[0], 1.0))
    for each, end, shorter in runs:
        solid, _ = build(body, each)
        step = likely_step(solid, body.sheets) / LIKELY
        steps = shorter * max(0.0, end - start) / step
        total += steps * step_seconds(solid, device != "cpu") + MAKING[0] + MAKING[1] * len(solid.elements)
        if not total <= LONGEST_S:
            raise SceneError(
                f"spectral elements would take about {total:.2g} s in steps of {step:.2g} s; allowed: "
                f"{LONGEST_S:g} s: use solver 'wedges'"
            )
    if isinstance(body, Layer):
        return total
    few = singular and body.shape == "disc" and len(build(body, chosen)[0].elements) < FEW
    return total * REPEATED[few or body.thickness_m < THIN * motion_width(body, load)]


def prepared_spectral_elements(problem: SkinProblem) -> tuple[Body, dict[str, Any]]:
    """Return the body with the bulk modulus of the solution, and data that `solve_spectral_elements` reuses."""
    softened = reduce_bulk_modulus(
        problem.body, problem.load, float(problem.times[-1]), problem.at, problem.accuracy, None
    )
    return softened[0], {"softened": softened}


def finer_spectral_elements(problem: SkinProblem, miss: float, **last: Any) -> Any:
    """Return order, width and depth of finer elements after the error of the `last` was `miss` times too large."""
    body, load, at, accuracy = problem.body, problem.load, problem.at, problem.accuracy
    finer = plan(body, load, at, accuracy, **last)
    needed = (min(miss, MOST_MISS) / ROOM) ** (1.0 / BY_NODES) * len(build(body, finer)[0].nodes)
    while len(build(body, finer)[0].nodes) < needed:
        accuracy *= ROOM
        finer = plan(body, load, at, accuracy)
    return {"order": finer.order, "size_m": finer.size_m, "deep": finer.deep}


def comparison_plan(body: Body, chosen: Plan, singular: bool) -> Plan:
    """Return the mesh for the error estimate: wider elements, or another order if the elements would not change.

    Elements do not change on a given patch of triangles, and if few elements lie under the load. Near a singular fixed
    edge, the elements at the edge may not change, so that no error shows. There is no order below 1, so the next higher
    order estimates its error, over a shorter time (`window`). The sponge is smaller too."""
    margin, sponge = 0.6 * chosen.margin_m, 0.8 * chosen.sponge_m
    if not isinstance(body, Layer) and not singular:
        deep = tuple(max(1, math.floor(count / COARSER + 0.5)) for count in chosen.deep)
        wider = replace(chosen, size_m=COARSER * chosen.size_m, deep=deep, margin_m=margin, sponge_m=sponge)
        if width_under(build(body, wider)[0], wider) > LEAST_WIDER * width_under(build(body, chosen)[0], chosen):
            return wider
    if chosen.order > 1:
        return at_lower_order(chosen)
    return replace(chosen, order=2, margin_m=margin, sponge_m=sponge)


def at_lower_order(chosen: Plan) -> Plan:
    """Return the same elements with the next lower order and a smaller sponge."""
    return replace(chosen, order=chosen.order - 1, margin_m=0.6 * chosen.margin_m, sponge_m=0.8 * chosen.sponge_m)


def width_under(solid: Solid, chosen: Plan) -> float:
    """Return the mean width [m] of the cells with their middle in the watched box, or of the nearest cell."""
    corners = solid.quads.nodes[solid.quads.cells[:, [0, 0, -1, -1], [0, -1, -1, 0]]]
    middles = corners.mean(axis=1)[:, :2]
    low, high = chosen.watched_m.T
    outside = np.linalg.norm(np.maximum(np.maximum(low - middles, middles - high), 0.0), axis=1)
    here = corners[outside <= outside.min()]
    across = np.cross(here[:, 2] - here[:, 0], here[:, 3] - here[:, 1])
    return float(np.sqrt(0.5 * np.linalg.norm(across, axis=1).mean()))


def window(body: Body, chosen: Plan, singular: bool, load: Load, times: Float) -> float:
    """Return the end of the second run [s]: the last requested time, or a twentieth of it if the run costs more."""
    if chosen.order == 1 and comparison_plan(body, chosen, singular).order == 2:
        pressing = load.peak_Pa if isinstance(load, Spot) else np.abs(load.pressure_Pa).max(axis=1)
        start = float(load.times_s[max(0, int(np.argmax(pressing != 0.0)) - 1)])
        begun = times[times > start]
        if len(begun):
            return max(start + WINDOW * (float(times[-1]) - start), float(begun[0]))
    return float(times[-1])


def solve_spectral_elements(
    problem: SkinProblem,
    *,
    order: int | None = None,
    size_m: float | None = None,
    deep: tuple[int, ...] | None = None,
    step_s: float | None = None,
    precision: str = "float32",
    nu_at_most: float | None = None,
    estimate: bool = True,
    softened: tuple[Body, float] | None = None,
) -> Motion:
    """Return the motion of the face by explicit spectral elements (Patera 1984; Komatitsch & Vilotte 1998).

    order: N of the elements, 1 to 7 (1 integrates too coarsely except in prisms). size_m: their width [m] (slabs).
    deep: number of elements through each sheet. step_s: [s], at most the stable step.
    precision: "float32" or "float64". softened: result of reduce_bulk_modulus for the body, or None.
    nu_at_most: largest instantaneous Poisson's ratio; above it the bulk modulus is reduced for longer steps, and the
        error includes the effect. Default: a value that the accuracy allows
        (palmfield.skin.approximation.reduce_bulk_modulus); 0.5 leaves the material unchanged.
    estimate: False: no second run; the error is then NaN.
    Raises SceneError if `refusal_spectral_elements` returns a reason, for an inverted element, a step above the stable
    step, and points off the face.
    """
    began = time.perf_counter()
    body, load, requested, points = problem.body, problem.load, problem.times, problem.at
    accuracy, judged, device = problem.accuracy, problem.judged, resolve(problem.device)
    if precision not in ("float32", "float64"):
        raise SceneError(f"solver 'spectral_elements': precision is '{precision}'; use float32 or float64")
    if size_m is not None and not size_m > 0.0:
        raise SceneError(f"solver 'spectral_elements': size_m is {size_m}; give a width above 0")
    if order is not None and not 1 <= order <= 7:
        raise SceneError(f"solver 'spectral_elements': order is {order}; give 1 to 7")
    if step_s is not None and not 0.0 < step_s < math.inf:
        raise SceneError(f"solver 'spectral_elements': step_s is {step_s}; give a time above 0 s, or omit it")
    if deep is not None and (len(deep) != len(body.sheets) or min(deep) < 1):
        raise SceneError(
            f"solver 'spectral_elements': deep is {deep}; give 1 or more for each of {len(body.sheets)} sheets"
        )
    body, bulk_error = softened or reduce_bulk_modulus(body, load, requested[-1], points, accuracy, nu_at_most)
    replace(problem, body=body).refuse("spectral_elements", refusal_spectral_elements)
    chosen = plan(body, load, points, accuracy, order, size_m, deep)
    fine = march(prepared(body, chosen, device, precision), load, requested, points, step_s)
    errors, source = np.full(3, math.nan), "not estimated"
    if estimate:
        singular = edge_is_felt(body, load, points)
        other = comparison_plan(body, chosen, singular)
        early = requested[requested <= window(body, chosen, singular, load, requested)]
        made = prepared(body, other, device, precision)
        rough = march(made, load, early, points)
        shorter = march(made, load, early, points, 0.5 * rough[3])
        normals = normals_on_face(body, lifted_points(body, points))
        gap = differences(rough[:2], (fine[0][: len(early)], fine[1][: len(early)]), normals)
        by_steps = differences(rough[:2], shorter[:2], normals)
        step_errors = error_of_coarser(by_steps, 2.0, STEP_ORDER) * (fine[3] / rough[3]) ** STEP_ORDER
        if other.order != chosen.order:
            lower = LOWER_SPONGE if chosen.sponge_m > 0.0 else LOWER
            if singular and other.order < chosen.order:
                lower = max(lower, error_of_finer(1.0, chosen.order / other.order, AT_EDGE))
            share = lower if other.order < chosen.order else 1.0
            errors, source = share * gap, f"{share:.2g} of the difference to order {other.order} on the same elements"
            if chosen.sponge_m > 0.0:
                source += " in a smaller sponge"
            if len(early) < len(requested):
                source += f" up to {early[-1]:.3g} s"
        else:
            # Such large elements do not converge with their order: the difference was 0.7 to 59 times the error. With
            # a sponge it was 1.2 times; the error of a sponge follows no known power of its size
            errors, source = gap, f"the difference to elements {COARSER} times as wide"
            if chosen.order > 1:
                # Both meshes may miss the same part of a sudden velocity; the estimate was 1/4 with a short branch
                same = march(prepared(body, at_lower_order(chosen), device, precision), load, requested, points)
                shares = LOWER * differences(same[:2], fine[:2], normals)
                errors[1] = max(errors[1], shares[1])
            if chosen.sponge_m > 0.0:
                source += " in a smaller sponge"
        source += f", two steps {step_errors[judged]:.2g}"
        errors = errors + step_errors + bulk_error
    if bulk_error > 0.0:
        source += f"; {bulk_error:.2g} for a bulk modulus of {body.sheets[0].material.bulk_Pa:.3g} Pa"
    where = f"spectral_elements, order {chosen.order}, {fine[2]} elements of {1e3 * chosen.size_m:.3g} mm, "
    where += f"step {fine[3]:.3g} s"
    return problem.solved(*fine[:2], errors, source, where, began, lifted_points(body, points))


def lifted_points(body: Body, points: Float) -> Float:
    """Return points (n, 3) on the face of a layer, or at z = 0 for a slab, from points (n, 2 or 3)."""
    if points.shape[1] == 3:
        return points
    return points_on_face(body, points)


def prepared(body: Body, chosen: Plan, device: str, precision: str) -> tuple[Model, Holds, float]:
    """Return elements, constraints and stable step [s], shared by runs on one mesh."""
    solid, damping = build(body, chosen)
    model = Model(solid, body.sheets, device, precision)
    side = body.side if isinstance(body, Layer) or chosen.sponge_m == 0.0 else "absorbing"
    assert not isinstance(body.base, Foundation)
    return model, *constraints(model, body.base, side, damping)


def march(
    made: tuple[Model, Holds, float], load: Load, times: Float, points: Float, step_s: float | None = None
) -> tuple[Float, Float, int, float]:
    """Return displacement and velocity, (t, n, 3), number of elements and step [s] of one run."""
    model, holds, stable = made
    solid, step = model.solid, SAFETY * stable if step_s is None else step_s
    start = float(load.times_s[0])
    late = np.maximum(times - start, 0.0) / step
    first = np.floor(late).astype(np.int64)
    target = np.unique(first[:, None] + np.array([-1, 0, 1]))
    target = target[target >= 0]
    steps = int(target[-1]) + 1
    check_time(model, steps, step)
    table = table_of(load, solid, step, steps)
    stepper = Stepper(model, holds, step, table, Points(*find(solid, points)), target, stable)
    stepper.advance(steps)
    u, v = (np.concatenate([np.zeros((1, len(points), 3)), a.numpy()[: len(target)]]) for a in stepper.readings())

    def row(step_number: Any) -> Any:
        """Return the reading after a step; it is 0 before the first step."""
        return np.where(step_number < 0, 0, 1 + np.searchsorted(target, np.maximum(step_number, 0)))

    before, here, after = (v[row(first + k)] for k in (-1, 0, 1))
    part = (late - first)[:, None, None]
    place = u[row(first - 1)] + part * step * here + 0.5 * part * (part - 1.0) * step * (here - before)
    speed = np.where(part < 0.5, here + (part - 0.5) * (here - before), here + (part - 0.5) * (after - here))
    resting = (times < start)[:, None, None]
    place, speed = np.where(resting, 0.0, place), np.where(resting, 0.0, speed)
    wp.synchronize_device(model.device)
    return place, speed, len(solid.elements), step


def step_seconds(solid: Solid, gpu: bool) -> float:
    """Return the predicted seconds of one step of the scheme."""
    rates = GPU_COST if gpu else CPU_COST
    return solid.elements.size * rates[0] + len(solid.nodes) * rates[1] + rates[2]


def likely_step(solid: Solid, sheets: tuple[Sheet, ...]) -> float:
    """Return an estimate of the stable step [s] from the heights of elements; 1.1 to 1.4 times the step on layers."""
    n = solid.order + 1
    corners = solid.nodes[solid.elements.reshape(-1, n, n, n)[:, [0, -1]][:, :, [0, -1]][..., [0, -1]]]
    edges = [np.diff(corners, axis=axis).squeeze(axis).mean(axis=(1, 2)) for axis in (1, 2, 3)]
    slopes = np.linalg.inv(np.stack(edges, axis=1))
    spacing = np.sqrt(3.0 / (slopes**2).sum(axis=(1, 2))) / solid.order
    courant = COURANT.get(solid.order, 1.5 / (solid.order + 0.1))
    step = math.inf
    for number, material in enumerate(sheet.material for sheet in sheets):
        fast = fast_speed(material)
        elastic = courant * float(spacing[solid.sheet == number].min()) / fast
        # The dashpot force is that of the previous half step: h^2 rate + 2 h t (its share of the rate) = 4
        speed = math.sqrt(material.shear_instant_Pa / material.density_kg_m3)
        late = 4.0 / 3.0 * (speed / fast) ** 2 * material.relaxation.viscous_time_s
        step = min(step, SAFETY * elastic**2 / (late + math.hypot(late, elastic)))
    return step


def check_time(model: Model, steps: int, step_s: float) -> None:
    """Raise SceneError, with the element that makes the step small, if a run would take longer than LONGEST_S."""
    solid = model.solid
    seconds = steps * step_seconds(solid, model.layout.gpu)
    if seconds > LONGEST_S:
        worst = int(np.argmin(model.volume.sum(axis=1)))
        raise SceneError(
            f"solver 'spectral_elements': {steps} steps of {step_s:.3g} s would take about {seconds:.2g} s; "
            f"allowed: {LONGEST_S:g} s; the smallest element is near ({solid.place(worst)}) m: make the mesh "
            "uniform there, or use solver 'wedges'"
        )
