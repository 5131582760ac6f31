"""Skin problems by quadratic wedges with generalised-alpha, for any slab or layer.

Sizes come first from the target accuracy, then from differences of runs (`refine_until_converged`): two steps, two
extents if sides absorb, more rows in depth, and two meshes. The error is the sum of the estimates from these
differences.
"""

import math
import time
from dataclasses import replace

import numpy as np

from palmfield.errors import SceneError
from palmfield.hand.remesh import is_height_field
from palmfield.hand.triangles import face_normals
from palmfield.skin.approximation.load_scales import edge_is_felt, load_centre, load_frequency, load_width, motion_width
from palmfield.skin.approximation.refine import (
    MOST_DOFS,
    Discretisation,
    MeshSolution,
    difference,
    ratio_of,
    refine_until_converged,
    resized,
)
from palmfield.skin.approximation.richardson import error_of_finer
from palmfield.skin.approximation.truncate_domain import refusal_of_spot, trim_absorbing_rim
from palmfield.skin.base import NEEDS_AXIS
from palmfield.skin.costs import assembly_s, wedges_s
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.body import build
from palmfield.skin.fem.generalised_alpha import RHO_INF
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import static
from palmfield.skin.fem.traction import PressureHistory
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.material import shear_wave
from palmfield.skin.mesh.body_mesh import Sizes
from palmfield.skin.problem import Body, Layer, Load, Motion, SkinProblem, Slab, depth_of, normals_on_face
from palmfield.types import Float


def refusal_wedges(body: Body, load: Load) -> str | None:
    """Return the reason why this solver cannot solve a problem, in a sentence, or None."""
    if isinstance(body, Layer) and body.side == "roller" and body.patch.axis is None:
        return NEEDS_AXIS
    turned = refusal_of_spot(body, load)
    if turned is not None:
        return turned
    dofs = expected_dofs(body, first_sizes(body, load, np.zeros((0, 3)), 0.05))
    if dofs > MOST_DOFS:
        return (
            f"the mesh would have about {dofs:.0f} unknowns; allowed: at most {MOST_DOFS}, because larger matrices "
            "cannot be factorised"
        )
    return None


def cost_wedges(problem: SkinProblem) -> float:
    """Return the predicted time [s] on one core.

    The time of a given run is right to a factor of 1.5; the predicted sizes of mesh and steps only to a factor of 4.
    """
    body, load, accuracy = problem.body, problem.load, problem.accuracy
    span = max(float(problem.times[-1]) - float(load.times_s[0]), 0.0)
    # The first step is halved about twice. All earlier runs together cost as much as the last, and some problems are
    # solved again with a finer mesh.
    steps = 4.0 * span / first_step(body, load, accuracy)
    return 0.05 + 3.0 * run_cost(last_dofs(problem), steps)


def last_dofs(problem: SkinProblem) -> float:
    """Return the expected number of unknowns of the finest mesh of a solution."""
    body, load, points, accuracy = problem.body, problem.load, problem.at, problem.accuracy
    first = expected_dofs(body, first_sizes(body, load, points, accuracy))
    if not isinstance(body, Slab):
        return first
    growth = ENDLESS_GROWTH * 0.05 / accuracy if body.shape == "infinite" else GROWTH * math.sqrt(0.05 / accuracy)
    if body.shape == "disc" and edge_is_felt(body, load, points):
        growth = EDGE_GROWTH * 0.05 / accuracy
    # The motion of a thin sheet depends on the second derivative of its load
    grown = first * growth * max(1.0, THIN * motion_width(body, load) / depth_of(body)) ** 2
    return math.sqrt(grown * max(grown, OFTEN_DOFS))


OFTEN_DOFS, THIN = 4.5e3, 0.4
"""Usual least number of unknowns of the last mesh of a slab (meshes of few elements give poor estimates), and ratio of
depth to load width below which it grows: by factors 22 and 12 at ratios 0.13 and 0.22, by 2 and 11 at 0.3."""


def run_cost(dofs: float, steps: float) -> float:
    """Return the time [s] to build, factorise and step a mesh on one core."""
    return assembly_s(dofs) + wedges_s(dofs, steps)


FINER_THAN_REQUESTED = 0.6
"""Ratio of actual to requested edges below which coarser triangles replace the triangles of a layer."""

OVERDAMPED = 2.0
"""Largest relevant ratio of wave speed with dashpots to that without: faster waves decay within one wavelength."""

STEP_ORDER = np.array([1.5, 1.0, 1.5])
"""Least orders of the error of generalised-alpha in the step, by QUANTITIES. The order is 2 for small steps, but less
if the load has few steps: with 2, the estimate for a ramp in 6 steps was 0.6 of the error. A sudden velocity has
pressure waves that no step resolves."""

TOGETHER = 32
"""Number of substeps in one call."""

NARROWEST = 3.0
"""Least number of requested edges across a patch for this replacement."""

GROWTH, EDGE_GROWTH, ENDLESS_GROWTH = 1.7, 6.0, 10.0
"""Ratio of the unknowns of the last mesh to the first estimate, at 5 %: 1.3 to 2.4 on four discs of 2 to 10 %, 4 to 30
on three discs with a singular fixed edge, and 7 to 20 on three infinite slabs, which are widened. The triangles of a
layer are quartered first."""


def solve_wedges(
    problem: SkinProblem, *, sizes: Sizes | None = None, step_s: float | None = None, rho_inf: float = RHO_INF
) -> Motion:
    """Return the displacement and velocity of the skin under a load, from rest; on the CPU.

    sizes, step_s: sizes of the mesh and step [s], None to choose them; rho_inf: see WedgeStepper
    Raises SceneError if refusal_wedges returns a reason, for an inverted element, points off the face, and bad numbers.
    """
    begin = time.perf_counter()
    body, load, accuracy, judged = problem.body, problem.load, problem.accuracy, problem.judged
    problem.refuse("wedges", refusal_wedges)
    points = problem.points
    _check_pinned(body, load, sizes)
    if step_s is not None and not 0.0 < step_s < math.inf:
        raise SceneError(f"solver 'wedges': step_s is {step_s}; give a time above 0 s, or omit it")
    now = Discretisation(
        sizes or first_sizes(body, load, points, accuracy), step_s or first_step(body, load, accuracy), rho_inf
    )

    def run(discretisation: Discretisation, factor: float = 1.0, reach: float = 1.0) -> MeshSolution:
        part = trim_absorbing_rim(body, load, points, reach)
        sizes = resized(discretisation.sizes, factor, reach)
        return _run(part, load, problem.times, points, replace(discretisation, sizes=sizes))

    coarse = run(now, ratio_of(body, now.sizes))
    longer = run(replace(now, step_s=2.0 * now.step_s), ratio_of(body, now.sizes))
    step_error = error_of_finer(difference(coarse, longer), 2.0, STEP_ORDER)
    while (
        step_s is None and step_error[judged] > 0.4 * accuracy and now.step_s > first_step(body, load, accuracy) / 32.0
    ):
        now = replace(now, step_s=now.step_s / 2.0)
        finer = run(now, ratio_of(body, now.sizes))
        step_error, coarse = error_of_finer(difference(finer, coarse), 2.0, STEP_ORDER), finer
    result = refine_until_converged(body, now, run, coarse, accuracy, sizes is not None, judged, step_error[judged])
    return problem.solved(
        result.fine.displacement,
        result.fine.velocity,
        result.errors + step_error,
        f"two steps {step_error[judged]:.2g}, {result.source}",
        f"wedges: {result.fine.dofs} unknowns, edges {1e3 * result.sizes.fine_m:.2f} mm, "
        f"steps of {1e3 * now.step_s:.3f} ms",
        begin,
    )


def static_wedges(body: Body, load: Load, at: Float, *, accuracy: float = 0.05, sizes: Sizes | None = None) -> Motion:
    """Return the static displacement under the last pressure of the load; times_s is its last time, the velocity 0.

    Arguments as for solve_wedges. Raises SceneError also for a body without support.
    """
    begin = time.perf_counter()
    problem = SkinProblem(body, load, load.times_s[-1:], at, accuracy)
    problem.refuse("wedges", refusal_wedges)
    points = problem.points
    _check_pinned(body, load, sizes)
    now = Discretisation(sizes or first_sizes(body, load, points, accuracy), math.inf, 1.0)

    def run(discretisation: Discretisation, factor: float = 1.0, reach: float = 1.0) -> MeshSolution:
        system = build(trim_absorbing_rim(body, load, points, reach), resized(discretisation.sizes, factor, reach))
        moved = static(system, PressureHistory(load, system.mesh, system).final_force())
        result = (SurfaceProbe(system.mesh, points, system).vectors @ moved).reshape(1, -1, 3)
        return on_mesh(system, result, np.zeros_like(result), normals_on_face(body, points))

    result = refine_until_converged(
        body, now, run, run(now, ratio_of(body, now.sizes)), accuracy, pinned=sizes is not None
    )
    return problem.solved(
        result.fine.displacement,
        result.fine.velocity,
        result.errors,
        result.source,
        f"wedges, static: {result.fine.dofs} unknowns",
        begin,
    )


def first_step(body: Body, load: Load, accuracy: float) -> float:
    """Return the step [s] with an error of a third of the target at the load frequency: 0.1 (w h)^2, see estimate."""
    frequency = load_frequency(load, slowest_wave(body, 200.0), motion_width(body, load))
    return math.sqrt(10.0 * min(accuracy, 0.2) / 3.0) / (2.0 * math.pi * frequency)


def first_sizes(body: Body, load: Load, points: Float, accuracy: float) -> Sizes:
    """Return the mesh sizes for an accuracy, from width and place of the load, shear wavelength and points.

    Errors of a disc with these sizes are in estimate.py. The triangles of a layer are quartered at least once: the
    coarser mesh of the error estimate is the patch or a mesh in between. Too fine triangles are replaced.
    """
    if not 1e-4 <= accuracy <= 0.5:
        raise SceneError(f"accuracy is {accuracy}; give one in 0.0001 to 0.5")
    width = motion_width(body, load)
    frequency = load_frequency(load, slowest_wave(body, 200.0), width)
    speed = slowest_wave(body, frequency)
    wavelength = speed / frequency
    share = 0.75 * min(1.0, (accuracy / 0.02) ** (1.0 / 3.0))
    depth = depth_of(body)
    fine = share * min(0.78 * width, 0.43 * wavelength)
    centre, path = load_centre(load)
    farthest = np.hypot(*(points[:, :2] - centre).T).max(initial=0.0) if len(points) else 0.0
    coarse = share * max(min(1.95 * width, wavelength), 0.78 * width)
    if farthest > path + 1.2 * width:
        coarse = min(coarse, share * 0.6 * wavelength)
    refinements, remesh = 0, False
    if isinstance(body, Layer):
        corners = body.patch.vertices[body.patch.faces]
        near = np.hypot(*(corners.mean(axis=1)[:, :2] - centre).T) < path + 1.2 * width
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
        mean = float(edges[near].mean()) if near.any() else float(edges.mean())
        across = float(np.ptp(body.patch.vertices[:, :2], axis=0).min())
        remesh = mean < FINER_THAN_REQUESTED * fine and across > NARROWEST * fine and is_height_field(body.patch)
        coarse = max(fine, min(coarse, across / NARROWEST)) if remesh else coarse
        refinements = 0 if remesh else max(1, math.ceil(math.log2(mean / fine) - 0.2))
    return Sizes(
        centre_m=(float(centre[0]), float(centre[1])),
        fine_radius_m=path + 1.2 * width,
        fine_m=fine,
        coarse_m=coarse,
        row_m=share * min(0.75 * width, 0.5 * wavelength),
        deepest_row_m=share * max(0.66 * wavelength, 0.75 * width),
        refinements=refinements,
        reach_m=max(path, farthest) + max(1.5 * width, depth),
        ring_m=max(wavelength, 2.0 * depth),
        match_Hz=frequency,
        remesh=remesh,
    )


def expected_dofs(body: Body, sizes: Sizes) -> float:
    """Return the expected number of unknowns of the mesh of a body."""
    depth = depth_of(body)
    if isinstance(body, Layer) and not sizes.remesh:
        triangles = len(body.patch.faces) * 4.0**sizes.refinements
    else:
        ring = 0.0
        if isinstance(body, Layer):
            radius = math.sqrt(float(face_normals(body.patch.vertices, body.patch.faces)[1].sum()) / math.pi)
        elif body.shape == "box":
            assert body.size_m is not None
            radius = math.sqrt(body.size_m[0] * body.size_m[1] / math.pi)
        else:
            radius = body.radius_m or sizes.reach_m
        if not isinstance(body, Layer) and (body.shape == "infinite" or body.side == "absorbing"):
            ring = sizes.ring_m
        r = np.linspace(0.0, radius + ring, 400)
        edge = sizes.fine_m + np.clip(0.4 * (r - sizes.fine_radius_m), 0.0, max(sizes.coarse_m - sizes.fine_m, 0.0))
        triangles = float(np.trapezoid(2.0 * math.pi * r / (0.433 * edge**2), r))
    rows = max(2.0, depth / sizes.deepest_row_m + 1.0, len(body.sheets))
    return 3.0 * 2.0 * triangles * 2.0 * rows


def slowest_wave(body: Body, f_Hz: float) -> float:
    """Return the shear speed [m/s] of the slowest sheet at f_Hz, at most OVERDAMPED times that without dashpots."""
    return min(
        min(shear_wave(m, f_Hz)[0], OVERDAMPED * math.sqrt(m.shear_instant_Pa / m.density_kg_m3))
        for m in (sheet.material for sheet in body.sheets)
    )


def _check_pinned(body: Body, load: Load, sizes: Sizes | None) -> None:
    """Raise SceneError if edges are so long that a spot lies between the quadrature points, about 0.4 edges apart."""
    if isinstance(body, Slab) and sizes is not None and sizes.fine_m > 2.0 * load_width(load):
        raise SceneError(
            f"sizes: edges of {sizes.fine_m:.3g} m do not resolve a spot {load_width(load):.3g} m wide; give "
            "fine_m of at most twice its width, or omit sizes"
        )


def _run(body: Body, load: Load, requested: Float, points: Float, discretisation: Discretisation) -> MeshSolution:
    """Step from the first time of the load to the last requested time; interpolate by cubic Hermite between steps."""
    system, step_s = build(body, discretisation.sizes), discretisation.step_s
    history = PressureHistory(load, system.mesh, system)
    stepper = WedgeStepper(system, history.operator, step_s, discretisation.rho_inf)
    reader = stepper.reader(SurfaceProbe(system.mesh, points, system).vectors)
    start = float(history.knots_s[0])
    steps = max(1, math.ceil((float(requested[-1]) - start) / step_s - 1e-9))
    clock: Float = start + step_s * np.arange(steps + 1, dtype=np.float64)
    motion = np.zeros((steps + 1, 2, reader.count))
    state = np.zeros((1, stepper.state_size))
    for begin in range(0, steps, TOGETHER):
        end = min(begin + TOGETHER, steps)
        moved = stepper.step(state, history.loads(clock[begin : end + 1]), clock[begin], clock[end], reader)
        assert moved is not None
        motion[begin + 1 : end + 1] = moved[0]
    displacement = _between(clock, motion[:, 0], motion[:, 1], requested)
    velocity = _between(clock, motion[:, 1], np.gradient(motion[:, 1], step_s, axis=0), requested)
    u, v = (moved.reshape(len(requested), len(points), 3) for moved in (displacement, velocity))
    return on_mesh(system, u, v, normals_on_face(body, points))


def on_mesh(system: SkinSystem, displacement: Float, velocity: Float, normals: Float) -> MeshSolution:
    """Return a solution on the mesh of a system; arguments as for MeshSolution."""
    sizes = system.ndof, len(system.mesh.surface_triangles6), (system.mesh.levels - 1) // 2
    return MeshSolution(displacement, velocity, *sizes, normals)


def _between(clock: Float, values: Float, slopes: Float, requested: Float) -> Float:
    """Return cubic Hermite interpolation at the requested times, 0 before the first time of the clock; (t, m)."""
    step = clock[1] - clock[0]
    place = np.clip(np.floor((requested - clock[0]) / step).astype(int), 0, len(clock) - 2)
    x = np.clip((requested - clock[place]) / step, 0.0, 1.0)[:, None]
    start = (1 + 2 * x) * (1 - x) ** 2 * values[place] + step * x * (1 - x) ** 2 * slopes[place]
    end = x**2 * (3 - 2 * x) * values[place + 1] - step * x**2 * (1 - x) * slopes[place + 1]
    return np.where(requested[:, None] >= clock[0], start + end, 0.0)
