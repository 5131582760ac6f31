"""Choice of the elements of a body from load and target accuracy, and of a sponge if the body has no sides."""

import math
from dataclasses import dataclass

import numpy as np

from palmfield.hand.triangles import face_normals
from palmfield.skin.approximation.load_scales import course_frequency, motion_width
from palmfield.skin.materials.material import Material, shear_wave
from palmfield.skin.problem import Body, Layer, Load, Spot
from palmfield.skin.solvers.spectral_elements.solid import Solid, box_quads, disc_quads, extrude, patch_quads
from palmfield.types import Float

SIZE = 0.87
"""Element of order 4, in spot widths, for an accuracy of 1 %. Its error on the reference disc is 0.8 %."""

SIZE_POWER = 1.0 / 6.0
"""Size is proportional to accuracy^(1/6); the measured order is 4 (1.05 to 0.87 widths) to 8 (0.87 to 0.66 widths)."""

DEEPER = 1.15
"""Depth of an element over its width."""

LINEAR = 0.04
"""Element of order 1, in spot widths, for an accuracy of 1 %. On a layer of a palm, 0.07 to 0.1 give 2 to 3 %."""

LINEAR_DEEP = 0.36
"""Accuracy times the square of the number of elements of order 1 through a layer: 3, 2, 1 give 2, 4.5, 24 %."""

DEPTHS, LEAST = {2: (0.076, 0.75), 3: (0.3, 0.5)}, 0.04
"""Depth of elements of a layer by order, in spot widths for 1 %, and power of the accuracy. On 22 layers, half a width
gives 4 to 12 % at order 2, and 1 to 2 % at order 3. LEAST: least accuracy for order 2, whose errors are 3 to 4 %."""

GROWTH = 1.3
"""Growth of elements with distance from the load and the requested points."""

COARSEST = 2.0
"""Largest element over the fine one."""

SPONGE_TRANSMITS = 1e-3
"""Amplitude of a shear wave after it has crossed an ideal sponge and back, as a share of the initial amplitude."""

MARGIN = 3.0
"""Distance to a sponge, in widths of the load or thicknesses; it is needed because a sponge also damps slow motion."""

MOST = 0.995
"""Share of the power of a load below the highest frequency whose shear waves elements resolve."""

CORE = 0.45
"""Half width of the inner square of a disc as a share of the radius."""


@dataclass(frozen=True)
class Plan:
    """Plan of a mesh. order: N; size_m: width of elements under the load [m]; deep: number of elements by sheet.

    watched_m: box round the path of the load and the requested points, along x and y [m], shape (2, 2).
    margin_m: from this box to the sponge of an infinite body [m]. sponge_m: width of the sponge [m], or 0."""

    order: int
    size_m: float
    deep: tuple[int, ...]
    watched_m: Float
    margin_m: float
    sponge_m: float


def fast_speed(material: Material) -> float:
    """Return the instantaneous speed of pressure waves [m/s]."""
    return math.sqrt((material.bulk_instant_Pa + 4.0 / 3.0 * material.shear_instant_Pa) / material.density_kg_m3)


def plan(
    body: Body,
    load: Load,
    at: Float,
    accuracy: float,
    order: int | None = None,
    size_m: float | None = None,
    deep: tuple[int, ...] | None = None,
) -> Plan:
    """Return the plan for an accuracy; given values are used unchanged."""
    materials = [sheet.material for sheet in body.sheets]
    width = motion_width(body, load)
    top = course_frequency(load, MOST)
    if top > 0.0:
        width = min(width, 0.7 * min(shear_wave(m, top)[0] for m in materials) / top)
    chosen = SIZE * width * (accuracy / 0.01) ** SIZE_POWER
    spots = load.centres() if isinstance(load, Spot) else np.asarray(load.points)[:, :2]
    margin = 0.5 * width if isinstance(load, Spot) else 0.0
    points = np.asarray(at, dtype=float)[:, :2]
    low = np.minimum((spots - margin).min(axis=0), points.min(axis=0, initial=np.inf))
    high = np.maximum((spots + margin).max(axis=0), points.max(axis=0, initial=-np.inf))
    watched = np.stack([low, high], axis=1)
    if isinstance(body, Layer):
        area = face_normals(body.patch.vertices, body.patch.faces)[1]
        # Each triangle becomes three quadrilaterals
        quad = float(np.sqrt(np.median(area) / 3.0))
        if order is None:
            wide = LINEAR * width * math.sqrt(accuracy / 0.01)
            least = 2 if accuracy >= LEAST else 3
            order = 1 if quad <= wide else int(np.clip(math.ceil(4.0 * quad / (size_m or chosen)), least, 4))
        thickness = float(np.mean(body.patch.depth))
        total = sum(sheet.thickness_m for sheet in body.sheets)
        sizes = [thickness * sheet.thickness_m / total for sheet in body.sheets]
        share, power = DEPTHS.get(order, (math.inf, 0.0))
        fit = min(chosen * order / 4.0, share * width * (accuracy / 0.01) ** power)
        if order == 1:
            fit = thickness / (DEEPER * math.ceil(math.sqrt(LINEAR_DEEP / accuracy)))
        return Plan(order, quad, deep or through(sizes, fit), watched, 0.0, 0.0)
    order = order or 4
    size = size_m or chosen * order / 4.0
    sponge = 0.0
    if body.shape == "infinite" or body.side == "absorbing":
        sponge = float(np.clip(4.0 * body.thickness_m, 3.0 * width, 8.0 * width))
    margin = MARGIN * max(width, body.thickness_m)
    deep = deep or through([sheet.thickness_m for sheet in body.sheets], size)
    return Plan(order, size, deep, watched, margin, sponge)


def through(thicknesses: list[float], size_m: float) -> tuple[int, ...]:
    return tuple(max(1, math.ceil(t / (DEEPER * size_m) - 1e-9)) for t in thicknesses)


def graded(low: float, high: float, fine: tuple[float, float], size_m: float) -> Float:
    """Return grid lines from low to high [m], at most size_m apart between `fine`; the distance grows outside."""
    inner = (max(low, fine[0]), min(high, fine[1]))
    if inner[1] <= inner[0]:
        inner = (low, high)
    middle = np.linspace(*inner, max(1, math.ceil((inner[1] - inner[0]) / size_m - 1e-9)) + 1)

    left, right = (
        growing(length, size_m, size_m) if length > 1e-9 * (high - low) else np.zeros(0)
        for length in (inner[0] - low, high - inner[1])
    )
    return np.concatenate([inner[0] - left[::-1], middle, inner[1] + right])


def growing(length: float, first: float, size_m: float) -> Float:
    """Return ends of elements from 0 to length [m], which grow from `first` to about COARSEST * size_m."""
    steps = [first]
    while sum(steps) < length:
        steps.append(min(GROWTH * steps[-1], COARSEST * size_m))
    return np.cumsum(steps) * (length / sum(steps))


def build(body: Body, chosen: Plan) -> tuple[Solid, Float]:
    """Return the elements, and the damping rate of the sponge at their nodes [1/s]."""
    order, size = chosen.order, chosen.size_m
    if isinstance(body, Layer):
        solid = extrude(patch_quads(body.patch, order), body.sheets, chosen.deep)
        return solid, np.zeros(len(solid.nodes))
    thickness, sponge, watched = body.thickness_m, chosen.sponge_m, chosen.watched_m
    middle, half = watched.mean(axis=1), 0.5 * np.diff(watched, axis=1)[:, 0]
    compact = float(half.max()) < 3.0 * float(half.min())
    if body.shape == "box" or (body.shape == "infinite" and not compact):
        if body.shape == "box":
            edges = 0.5 * np.asarray(body.size_m)
            ends = np.stack([-edges, edges], axis=1)
        else:
            ends = watched + chosen.margin_m * np.array([-1.0, 1.0])
        outer = ends + sponge * np.array([-1.0, 1.0])
        x, y = (graded(outer[i, 0], outer[i, 1], (watched[i, 0], watched[i, 1]), size) for i in range(2))
        quads = box_quads(x, y, thickness, order)
        beyond = np.maximum(ends[:, 0] - quads.nodes[:, :2], quads.nodes[:, :2] - ends[:, 1]).max(axis=1)
    else:
        if body.shape == "disc":
            middle, radius = np.zeros(2), float(body.radius_m or 0.0)
            reach = float(np.linalg.norm(np.abs(watched).max(axis=1)))
            inner = CORE * radius
            # Cells near the rim are wider by half pi / (2 CORE); output points there need finer cells everywhere
            if reach > radius * (0.5 + 0.5 * CORE):
                size = size / 1.5
        else:
            radius = float(np.linalg.norm(half)) + chosen.margin_m
            inner = float(half.max())
        core = max(2, math.ceil(2.0 * inner / size - 1e-9))
        outer_radius = radius + sponge
        start = 1.15 * inner
        radii = start + growing(outer_radius - start, size if body.shape == "infinite" else 1.6 * size, size)
        quads = disc_quads(thickness, inner, core, radii, order)
        quads.nodes[:, :2] += middle
        beyond = np.linalg.norm(quads.nodes[:, :2] - middle, axis=1) - radius
    solid = extrude(quads, body.sheets, chosen.deep)
    damping = np.zeros(len(quads.nodes))
    if sponge > 0.0:
        speed = max(math.sqrt(s.material.shear_instant_Pa / s.material.density_kg_m3) for s in body.sheets)
        peak = 4.0 * speed * math.log(1.0 / SPONGE_TRANSMITS) / sponge
        damping = peak * np.clip(beyond / sponge, 0.0, 1.0) ** 3
    return solid, np.tile(damping, solid.levels)
