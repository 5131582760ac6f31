"""Motion of a body by particles: one run at one spacing, and runs to a target accuracy."""

import time

import numpy as np
import warp as wp
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.skin.approximation.load_scales import load_width, motion_width
from palmfield.skin.approximation.richardson import differences, error_of_finer
from palmfield.skin.problem import Load, Motion, SkinProblem, Slab, in_space, normals_on_face
from palmfield.skin.solvers.particles.cloud import Cloud, Columns, build_cloud
from palmfield.skin.solvers.particles.pressure import Pressure
from palmfield.skin.solvers.particles.resolution import (
    COARSE_CELLS,
    COARSER,
    SECONDS_A_STEP,
    choose_spacing,
    law_error,
    length_of,
    refusal_particles,
)
from palmfield.skin.solvers.particles.run import (
    BLOCK,
    SAFETY,
    CrushedError,
    Particles,
    Reader,
    StepTooLongError,
    stable_step,
)
from palmfield.types import Float, Int

ORDER = 1.0
"""Least observed order between two spacings, for motion along the face near nu = 0.5; normal motion has 1.5 to 2."""
RESTARTS = 12
"""Largest number of repetitions with a shorter step."""
LONGEST_S = 3600.0
"""Largest predicted time of a run [s]; longer runs are refused."""
SHORTEST = 1.0 / 8.0
"""Least step, over the first step, with which a body that breaks apart is tried again: strain may have stiffened it so
much that the step became unstable within one block of steps. A body that still breaks apart is crushed."""
NEIGHBOURS = 16


def solve_particles(
    problem: SkinProblem, *, spacing_m: float | None = None, step_s: float | None = None, follower: bool = False
) -> Motion:
    """Return the motion at points of the face, by total-Lagrangian particles at finite strain (neo-Hookean).

    spacing_m: distance of particles [m]; None: chosen for the accuracy. The particles of a layer are the vertices of
        its patch, and spacing_m determines only its levels. step_s, follower: as in run_particles.
    The spot on a layer is measured in x and y of the frame of the patch.
    The error of a slab follows, with ORDER, from a second run with particles COARSER times as far apart. It is at least
    half of law_error, because the difference may pass through 0, and at least law_error if the spot reaches the sides.
    The error of a layer is law_error for its own edges. Errors are L2 over the times, at the worst point.
    Raises SceneError if refusal_particles returns a reason, for a wrong spacing, accuracy or step, and for a crushed
    body.
    """
    begun = time.perf_counter()
    body, load, requested, at, device = problem.body, problem.load, problem.times, problem.at, problem.device
    problem.refuse("particles", refusal_particles)
    spacing = choose_spacing(body, load, problem.accuracy) if spacing_m is None else spacing_m
    longest = length_of(body) / (2.0 * COARSER)
    if isinstance(body, Slab) and spacing > longest:
        raise SceneError(f"particles: spacing_m is {spacing}; allowed by the size of the body: at most {longest:.4g}")
    cloud = build_cloud(body, spacing)
    points, u, v, step = run_particles(cloud, load, requested, at, device=device, step_s=step_s, follower=follower)
    law = law_error(body, load, cloud.columns.spacing_m)
    source = "error measured on discs at this spacing (docs/bench/skin_particles.md)"
    errors = np.full(3, law)
    if isinstance(body, Slab):
        coarse_cloud = build_cloud(body, COARSER * spacing, COARSE_CELLS)
        _, coarse, slower, _ = run_particles(coarse_cloud, load, requested, at, device=device, follower=follower)
        ratio = coarse_cloud.columns.spacing_m / cloud.columns.spacing_m
        gap = differences((coarse, slower), (u, v), normals_on_face(body, points))
        # With few particles across a narrow body, errors at its sides are different for each spacing
        least = 1.0 if motion_width(body, load) < load_width(load) else 0.5
        errors = np.maximum(error_of_finer(gap, ratio, ORDER), least * law)
        source = f"particles {ratio:.2f} times as far apart, order {ORDER:g}, and at least {least:g} of {source}"
    count = len(cloud.points)
    words = f"particles: {count}, {1e3 * cloud.columns.spacing_m:.3g} mm apart, step {1e6 * step:.3g} us"
    return problem.solved(u, v, errors, source, words, begun, points)


def run_particles(
    cloud: Cloud,
    load: Load,
    times: Float,
    at: Float,
    *,
    device: str = "cpu",
    step_s: float | None = None,
    follower: bool = False,
) -> tuple[Float, Float, Float, float]:
    """Step particles from rest to the last of `times`.

    times: [s], ascending, shape (t,). at: points of the face [m], (n, 3) or (n, 2).
    step_s: step [s]; None: a stable step, and a new run with a shorter step if strain stiffens the body.
    follower: True: pressure stays normal to the moving face and acts on its present area; False: dead load.
    Returns points [m] (n, 3), displacement [m] and velocity [m/s], both (t, n, 3), and the step [s].
    Raises SceneError for a given step above the stable step, and for a body that is crushed or inverted.
    """
    requested = np.asarray(times, dtype=float)
    longest = stable_step(cloud)
    if step_s is not None and not 0.0 < step_s <= longest:
        raise SceneError(f"particles: step_s is {step_s} s; give one above 0 and at most the stable {longest:.4g} s")
    _refuse_hours(cloud, float(requested[-1] - load.times_s[0]) / longest, longest, device)
    points, near, weights = point_weights(cloud.columns, cloud.face_area, at)
    step = SAFETY * longest if step_s is None else step_s
    for _ in range(RESTARTS):
        body = Particles(cloud, device, step)
        try:
            history = _history(body, load, requested, (near, weights), longest, follower)
        except CrushedError:
            if step_s is not None or step < 2.0 * SHORTEST * SAFETY * longest:
                raise
            step *= 0.5
        except StepTooLongError as stiffened:
            step = stiffened.step_s
            if step_s is not None:
                raise SceneError(
                    f"particles: under strain step_s = {step_s} s is too long; give at most {step:.4g} s"
                ) from stiffened
        else:
            return points, *history, step
    raise SceneError(
        f"particles: the body stiffens without limit, and its stable step has fallen to {step:.3g} s: lower the "
        "pressure"
    )


def _refuse_hours(cloud: Cloud, steps: float, step_s: float, device: str) -> None:
    """Raise SceneError, with the place of the smallest cell, if these steps would take more than LONGEST_S."""
    kind = "cuda" if device.startswith("cuda") else "cpu"
    seconds = len(cloud.points) * steps * SECONDS_A_STEP[kind]
    if seconds <= LONGEST_S:
        return
    difference = np.linalg.norm(cloud.offset, axis=2)
    closest = np.where(difference > 0.0, difference, np.inf).min(axis=1)
    place = ", ".join(f"{x:.4g}" for x in cloud.points[cloud.owner[np.argmin(closest)]])
    raise SceneError(
        f"particles: {steps:.2g} steps of {step_s:.3g} s would take about {seconds:.2g} s; allowed: {LONGEST_S:g} "
        f"s; near ({place}) m the particle distance is only {closest.min():.2g} m: smooth the body there, or use "
        "solver 'wedges'"
    )


def _history(
    body: Particles, load: Load, requested: Float, probe: tuple[Int, Float], longest_s: float, follower: bool
) -> tuple[Float, Float]:
    begin, step = float(load.times_s[0]), body.step_s
    reader = Reader(probe[0], probe[1], body.device)
    pressure = Pressure(body.cloud, load, body.device)
    table = wp.zeros((BLOCK, len(body.cloud.face_area)), dtype=wp.float32, device=body.device)
    # Displacement is stored at two steps before and two steps after each requested time
    late = requested > begin
    first = np.floor((requested - begin) / step).astype(np.int64) - 1
    target = np.unique(np.concatenate([first[late] + shift for shift in range(4)])) if late.any() else np.zeros(0, int)
    samples = np.zeros((len(target), reader.count, 3))
    total = int(target[-1]) + 1 if len(target) else 0
    for start in range(0, total, BLOCK):
        rows = min(BLOCK, total - start)
        pressure.fill(table, begin + step * np.arange(start, start + rows, dtype=float), step)
        body.steps(rows, table, follower, reader)
        body.check(longest_s)
        low, high = np.searchsorted(target, [max(start, 0), start + rows])
        if high > low:
            samples[low:high] = reader.rows.numpy()[target[low:high] - start]
    displacement = np.zeros((len(requested), reader.count, 3))
    velocity = np.zeros_like(displacement)
    for row in np.flatnonzero(late):
        place = np.searchsorted(target, first[row])
        before, low_u, high_u, after = samples[place : place + 4]
        x = (requested[row] - begin) / step - (first[row] + 1)
        low_v, high_v = 0.5 * (high_u - before), 0.5 * (after - low_u)
        # Cubic Hermite interpolation between the two steps, with central differences as slopes
        a, b = 2.0 * (low_u - high_u) + low_v + high_v, 3.0 * (high_u - low_u) - 2.0 * low_v - high_v
        displacement[row] = ((a * x + b) * x + low_v) * x + low_u
        velocity[row] = ((3.0 * a * x + 2.0 * b) * x + low_v) / step
    return displacement, velocity


def point_weights(columns: Columns, normals: Float, at: Float) -> tuple[Float, Int, Float]:
    """Return the points on the face, and the weights that give their displacement from particles of the face.

    normals: outward area vectors of the particles of the face, shape (f, 3); at: shape (n, 3), or (n, 2) on a flat
    face. Returns points [m] (n, 3), particles (n, k), weights (n, k). The method is moving least squares in the tangent
    plane of the nearest particle, with a quadratic basis. Weights are infinite at a particle (Lancaster & Salkauskas
    1981). So quadratic fields are exact, and so is the displacement of a particle at its own place.
    Raises SceneError for other shapes and points that are not finite or farther from all particles than two spacings.
    """
    points = in_space(at)
    tree = cKDTree(columns.face)
    distance, particles = tree.query(points, k=min(NEIGHBOURS, len(columns.face)))
    far = int(np.argmax(distance[:, 0]))
    if distance[far, 0] > 2.0 * columns.spacing_m:
        raise SceneError(
            f"point {np.round(points[far], 6).tolist()} m is {distance[far, 0]:.3g} m from the face; give points "
            "on the face"
        )
    weights = np.empty(particles.shape)
    for row, (point, near) in enumerate(zip(points, particles, strict=True)):
        normal = normals[near[0]] / np.linalg.norm(normals[near[0]])
        _, _, frame = np.linalg.svd(normal[None])
        flat = (columns.face[near] - point) @ frame[1:].T / columns.spacing_m
        x, y = flat.T
        away = x**2 + y**2
        root = np.exp(-0.5 * away) / (away + 1e-6)
        basis = np.column_stack([np.ones_like(x), x, y, x**2, x * y, y**2])
        # The value at the point is the first coefficient of the weighted fit
        weights[row] = np.linalg.pinv(basis * root[:, None], rcond=1e-9)[0] * root
    return points, particles.astype(np.int32), weights
