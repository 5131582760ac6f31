"""Skin problems by implicit finite elements: quadratic wedges, generalised-alpha, for any slab or layer.

Sizes come from the wanted accuracy, then from what coarser runs show: two steps, on an endless slab two extents, and
two meshes. The error is the sum of the three differences, each divided by what its order of convergence says.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from palmfield.device import resolve
from palmfield.errors import SceneError
from palmfield.skin.assembly import SkinSystem
from palmfield.skin.body_mesh import Sizes, build
from palmfield.skin.estimate import load_centre, load_frequency, load_width
from palmfield.skin.load import PressureHistory
from palmfield.skin.material import shear_wave
from palmfield.skin.pcg import DeviceStepper
from palmfield.skin.problem import Body, Layer, Load, Motion, Slab, points_on_face, rising
from palmfield.skin.solver import Scheme, SkinSolver, static
from palmfield.skin.surface import SurfaceProbe
from palmfield.types import Float

RATIO = 4.0 / 3.0
"""Element sizes of the coarser over those of the finer mesh; a layer's triangles are quartered, so there it is 2."""
MESH_ORDER = 2.0
"""Between such meshes the disc's errors fall with an order of 2.5 to 4; 3 told too small an error in a test."""
SHRINK = 0.7
"""Extent of the smaller of two endless slabs."""
MOST_DOFS = 400_000
"""Above this the factors of the matrix take more than 10 GB."""
ROUNDS = 3


@dataclass(frozen=True)
class Numerics:
    """Sizes of the mesh, step [s], spectral radius at infinite frequency, and device."""

    sizes: Sizes
    step_s: float
    rho_inf: float
    device: str


@dataclass(frozen=True)
class Answer:
    """Displacement [m] and velocity [m/s] at the asked times and points, (t, n, 3), and the unknowns it took."""

    displacement: Float
    velocity: Float
    dofs: int


def refusal_implicit(body: Body, load: Load) -> str | None:
    """Why this solver can't, in a sentence, or None."""
    if isinstance(body, Layer) and body.side == "roller" and body.patch.axis is None:
        return "roller sides need a patch with an axis; this layer's has none"
    dofs = expected_dofs(body, first_sizes(body, load, np.zeros((0, 3)), 0.05))
    if dofs > MOST_DOFS:
        return f"the mesh would have about {dofs:.0f} unknowns, above {MOST_DOFS}: its matrix can't be factorised here"
    return None


def cost_implicit(body: Body, load: Load, times: Float, at: Float, accuracy: float) -> float:
    """Predicted time [s] on one core, to a factor of two or so."""
    dofs = expected_dofs(body, first_sizes(body, load, np.asarray(at, dtype=float), accuracy))
    span = max(float(np.max(times)) - float(load.times_s[0]), 0.0)
    steps = span / first_step(body, load, accuracy)
    # Factorising and stepping the last mesh; the coarser runs before it cost about as much again.
    return 2.0 * (FACTOR_S * (dofs / 1e4) ** 1.5 + steps * SOLVE_S * (dofs / 1e4) ** 1.15)


FACTOR_S, SOLVE_S = 1.5, 0.02
"""Seconds to factorise, and to step, 10^4 unknowns on one core (docs/bench/skin_linear.md, on a busier machine)."""


def solve_implicit(
    body: Body,
    load: Load,
    times: Float,
    at: Float,
    *,
    accuracy: float = 0.05,
    device: str = "cpu",
    sizes: Sizes | None = None,
    step_s: float | None = None,
    rho_inf: float = 0.8,
) -> Motion:
    """Displacement and velocity of the skin under a load, from rest.

    times: [s], rising, shape (t,); at: points of the face [m], shape (n, 3) or (n, 2)
    accuracy: wanted relative error, L2 over the times, largest over the points
    device: "cpu" factorises; "cuda:N" takes conjugate gradients there
    sizes, step_s: to pin mesh and step [s] instead of choosing them; rho_inf: see SkinSolver
    Raises SceneError for what refusal_implicit names, an inverted element, points off the face, and bad numbers.
    """
    begin = time.perf_counter()
    asked, points = _check(body, load, times, at, accuracy)
    now = Numerics(
        sizes or first_sizes(body, load, points, accuracy),
        step_s or first_step(body, load, accuracy),
        rho_inf,
        resolve(device),
    )

    def run(numerics: Numerics, factor: float = 1.0, reach: float = 1.0) -> Answer:
        return _run(body, load, asked, points, replace(numerics, sizes=_resized(numerics.sizes, factor, reach)))

    coarse = run(now, _ratio(body))
    step_error = difference(coarse, run(replace(now, step_s=2.0 * now.step_s), _ratio(body))) / 3.0
    while step_s is None and step_error > 0.4 * accuracy and now.step_s > first_step(body, load, accuracy) / 32.0:
        now = replace(now, step_s=now.step_s / 2.0)
        finer = run(now, _ratio(body))
        step_error, coarse = difference(finer, coarse) / 3.0, finer
    found = _settle(body, now, run, coarse, accuracy, pinned=sizes is not None)
    return Motion(
        times_s=asked,
        points=points,
        displacement_m=found.fine.displacement,
        velocity_m_s=found.fine.velocity,
        error=found.mesh_error + step_error + found.reach_error,
        error_source=f"two steps {step_error:.2g}, {found.source}",
        solver=f"implicit: quadratic wedges, {found.fine.dofs} unknowns, edges {1e3 * found.sizes.fine_m:.2f} mm, "
        f"steps of {1e3 * now.step_s:.3f} ms",
        seconds=time.perf_counter() - begin,
    )


def static_implicit(body: Body, load: Load, at: Float, *, accuracy: float = 0.05, sizes: Sizes | None = None) -> Motion:
    """Displacement under the load's last pressure, held for ever; times_s is its last time, the velocity 0.

    Arguments as for solve_implicit. Raises SceneError also for a body without a support.
    """
    begin = time.perf_counter()
    end = np.array([float(load.times_s[-1])])
    _, points = _check(body, load, end, at, accuracy)
    now = Numerics(sizes or first_sizes(body, load, points, accuracy), math.inf, 1.0, "cpu")

    def run(numerics: Numerics, factor: float = 1.0, reach: float = 1.0) -> Answer:
        system = build(body, _resized(numerics.sizes, factor, reach))
        moved = static(system, PressureHistory(load, system.mesh, system).final_force())
        found = (_probe(system, points).vectors @ moved).reshape(1, -1, 3)
        return Answer(found, np.zeros_like(found), system.ndof)

    found = _settle(body, now, run, run(now, _ratio(body)), accuracy, pinned=sizes is not None)
    return Motion(
        times_s=end,
        points=points,
        displacement_m=found.fine.displacement,
        velocity_m_s=found.fine.velocity,
        error=found.mesh_error + found.reach_error,
        error_source=found.source,
        solver=f"implicit, static: quadratic wedges, {found.fine.dofs} unknowns",
        seconds=time.perf_counter() - begin,
    )


@dataclass(frozen=True)
class Settled:
    """The finest answer, its sizes, and what other meshes and extents differ from it."""

    fine: Answer
    sizes: Sizes
    mesh_error: float
    reach_error: float

    @property
    def source(self) -> str:
        return f"two meshes {self.mesh_error:.2g}, two extents {self.reach_error:.2g}, added"


def _settle(
    body: Body, now: Numerics, run: Callable[..., Answer], coarse: Answer, accuracy: float, pinned: bool
) -> Settled:
    """Widen an endless slab, then refine, until both errors fit the accuracy; at most ROUNDS times each.

    run: (numerics, element factor, extent factor) -> Answer; coarse: that of now, one mesh coarser
    pinned: neither widen nor refine, only tell the errors
    """
    reach_error = 0.0
    if isinstance(body, Slab) and body.shape == "infinite":
        reach_error = difference(coarse, run(now, _ratio(body), SHRINK))
        for _ in range(ROUNDS):
            if pinned or reach_error <= 0.3 * accuracy:
                break
            now = replace(now, sizes=_resized(now.sizes, 1.0, 1.0 / SHRINK))
            wider = run(now, _ratio(body))
            reach_error, coarse = difference(wider, coarse), wider
    fine = run(now)
    mesh_error = difference(fine, coarse) / (_ratio(body) ** MESH_ORDER - 1.0)
    for _ in range(ROUNDS):
        if pinned or mesh_error <= 0.6 * accuracy or fine.dofs * _ratio(body) ** 3 > MOST_DOFS:
            break
        now, coarse = replace(now, sizes=_resized(now.sizes, 1.0 / _ratio(body), 1.0)), fine
        fine = run(now)
        mesh_error = difference(fine, coarse) / (_ratio(body) ** MESH_ORDER - 1.0)
    return Settled(fine, now.sizes, mesh_error, reach_error)


def difference(answer: Answer, other: Answer) -> float:
    """Relative difference of the displacement, L2 over times, the largest of the points that move at all.

    At one time only, two meshes may agree at a point by chance: half of the largest difference of all points, in
    metres, is then the least for each.
    """
    size = np.linalg.norm(answer.displacement, axis=(0, 2))
    apart = np.linalg.norm(answer.displacement - other.displacement, axis=(0, 2))
    if len(answer.displacement) == 1:
        apart = np.maximum(apart, 0.5 * apart.max(initial=0.0))
    moving = size > 1e-9 * size.max(initial=0.0)
    return float((apart[moving] / size[moving]).max(initial=0.0))


def first_step(body: Body, load: Load, accuracy: float) -> float:
    """Step [s] whose error is a third of the wanted one at the load's frequency: 0.1 (w h)^2, see estimate."""
    frequency = load_frequency(load, _slowest(body, 200.0), load_width(load))
    return math.sqrt(10.0 * min(accuracy, 0.2) / 3.0) / (2.0 * math.pi * frequency)


def first_sizes(body: Body, load: Load, points: Float, accuracy: float) -> Sizes:
    """Sizes of a mesh for an accuracy, from the load's width, the shear wavelength and where load and points lie.

    A disc's errors by these sizes are in estimate.py. A layer's triangles are quartered at least once, as the coarser
    mesh that tells the error is the patch itself or lies between.
    """
    if not 1e-4 <= accuracy <= 0.5:
        raise SceneError(f"accuracy is {accuracy}; give one in 0.0001 to 0.5")
    width = load_width(load)
    frequency = load_frequency(load, _slowest(body, 200.0), width)
    speed = _slowest(body, frequency)
    wavelength = speed / frequency
    share = 0.75 * min(1.0, (accuracy / 0.02) ** (1.0 / 3.0))
    depth = float(np.median(body.patch.depth)) if isinstance(body, Layer) else body.thickness_m
    fine = share * min(0.78 * width, 0.43 * wavelength)
    centre, path = load_centre(load)
    seen = np.hypot(*(points[:, :2] - centre).T).max(initial=0.0) if len(points) else 0.0
    coarse = share * max(min(1.95 * width, wavelength), 0.78 * width)
    if seen > path + 1.2 * width:
        coarse = min(coarse, share * 0.6 * wavelength)
    refinements = 0
    if isinstance(body, Layer):
        corners = body.patch.vertices[body.patch.faces]
        near = np.hypot(*(corners.mean(axis=1)[:, :2] - centre).T) < path + 1.2 * width
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
        mean = float(edges[near].mean()) if near.any() else float(edges.mean())
        refinements = max(1, math.ceil(math.log2(mean / fine) - 0.2))
    return Sizes(
        centre_m=(float(centre[0]), float(centre[1])),
        fine_radius_m=path + 1.2 * width,
        fine_m=fine,
        coarse_m=coarse,
        row_m=share * min(0.75 * width, 0.5 * wavelength),
        deepest_row_m=share * max(0.66 * wavelength, 0.75 * width),
        refinements=refinements,
        reach_m=max(path, seen) + max(1.5 * width, depth),
        ring_m=max(wavelength, 2.0 * depth),
        match_Hz=frequency,
    )


def expected_dofs(body: Body, sizes: Sizes) -> float:
    """About how many unknowns a body's mesh will have."""
    if isinstance(body, Layer):
        depth = float(np.median(body.patch.depth))
        triangles = len(body.patch.faces) * 4.0**sizes.refinements
    else:
        depth = body.thickness_m
        ring = sizes.ring_m if body.shape == "infinite" or body.side == "absorbing" else 0.0
        radius = {"infinite": sizes.reach_m, "disc": body.radius_m}.get(body.shape)
        if radius is None:
            assert body.size_m is not None
            radius = math.sqrt(body.size_m[0] * body.size_m[1] / math.pi)
        r = np.linspace(0.0, radius + ring, 400)
        edge = sizes.fine_m + np.clip(0.4 * (r - sizes.fine_radius_m), 0.0, max(sizes.coarse_m - sizes.fine_m, 0.0))
        triangles = float(np.trapezoid(2.0 * math.pi * r / (0.433 * edge**2), r))
    rows = max(2.0, depth / sizes.deepest_row_m + 1.0, len(body.sheets))
    return 3.0 * 2.0 * triangles * 2.0 * rows


def _ratio(body: Body) -> float:
    return 2.0 if isinstance(body, Layer) else RATIO


def _slowest(body: Body, f_Hz: float) -> float:
    return min(shear_wave(sheet.material, f_Hz)[0] for sheet in body.sheets)


def _resized(sizes: Sizes, factor: float, reach: float) -> Sizes:
    return replace(sizes.scaled(factor), reach_m=reach * sizes.reach_m, ring_m=reach * sizes.ring_m)


def _check(body: Body, load: Load, times: Float, at: Float, accuracy: float) -> tuple[Float, Float]:
    reason = refusal_implicit(body, load)
    if reason is not None:
        raise SceneError(f"solver 'implicit': {reason}")
    return rising("times", times), points_on_face(body, at)


def _probe(system: SkinSystem, points: Float) -> SurfaceProbe:
    return SurfaceProbe(system.mesh, points, system)


def _run(body: Body, load: Load, asked: Float, points: Float, numerics: Numerics) -> Answer:
    """March from the load's first time to the last asked one; the motion between steps by cubic Hermite pieces."""
    system = build(body, numerics.sizes)
    history = PressureHistory(load, system.mesh, system)
    read = SurfaceProbe(system.mesh, points, system).vectors
    start = float(history.knots_s[0])
    steps = max(1, math.ceil((float(asked[-1]) - start) / numerics.step_s - 1e-9))
    seen = np.zeros((steps + 1, 3, read.shape[0]))
    clock: Float = start + numerics.step_s * np.arange(steps + 1, dtype=np.float64)
    if numerics.device == "cpu":
        solver = SkinSolver(system, numerics.step_s, numerics.rho_inf)
        state = solver.new_state()
        for n in range(steps):
            solver.step(state, *history.force(clock[n], clock[n + 1]))
            seen[n + 1] = (read @ state[:3].T).T
    else:
        stepper = DeviceStepper(Scheme(system, numerics.step_s, numerics.rho_inf), read, numerics.device)
        for n in range(steps):
            seen[n + 1] = stepper.step(*history.force(clock[n], clock[n + 1])).T
    moved, velocity = (_between(clock, seen[:, i], seen[:, i + 1], asked) for i in (0, 1))
    shape = (len(asked), len(points), 3)
    return Answer(moved.reshape(shape), velocity.reshape(shape), system.ndof)


def _between(clock: Float, values: Float, slopes: Float, asked: Float) -> Float:
    """Cubic Hermite interpolation at the asked times, 0 before the first of the clock; shape (t, m)."""
    step = clock[1] - clock[0]
    place = np.clip(np.floor((asked - clock[0]) / step).astype(int), 0, len(clock) - 2)
    x = np.clip((asked - clock[place]) / step, 0.0, 1.0)[:, None]
    start = (1 + 2 * x) * (1 - x) ** 2 * values[place] + step * x * (1 - x) ** 2 * slopes[place]
    end = x**2 * (3 - 2 * x) * values[place + 1] - step * x**2 * (1 - x) * slopes[place + 1]
    return np.where(asked[:, None] >= clock[0], start + end, 0.0)
