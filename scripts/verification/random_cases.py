"""Random skin problems from a seed, on which the solvers' error estimates are held against known answers."""

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.tri import LinearTriInterpolator, Triangulation

from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Material, kelvin_voigt, standard_linear
from palmfield.skin.mesh.body_mesh import Sizes, box_patch
from palmfield.skin.problem import BaseKind, Body, Law, Layer, Sheet, SideKind, Slab, Spot, Springs
from palmfield.types import Float, Patch

KINDS = ("endless", "disc", "box", "layer")
"""Bodies, taken in turn."""
COURSES = ("step", "ramp", "modulated", "burst", "line", "circle")
"""Loads, taken in turn as well, so that every body meets every load within 12 cases."""
PRESETS = ("ecoflex_00-10", "gelatin_2", "palm", "finger_pad")
RIM = 1.7
"""Least way of the spot's centre from an end of the body, in widths of the spot."""
CYCLE = 24
"""Times of the load in one of its periods."""


@dataclass(frozen=True)
class Case:
    """A problem and the accuracy asked for. number, seed: with them `random_case` makes it again; words: what it is."""

    seed: int
    number: int
    words: str
    body: Body
    load: Spot
    times: Float
    at: Float
    accuracy: float


def random_case(seed: int, number: int, longest_s: float = 0.1) -> Case:
    """Case of a number; it does not depend on how many others are made. longest_s: of its duration [s], >= 0.02.

    Spot 5-20 mm wide; depth 0.3 to 1.5 widths, at most 20 mm; 20 to 100 ms asked every 0.5 ms; accuracy 0.5 to 10 %,
    of a layer 2 to 10 %; one to three points up to two widths off the load's path.
    """
    random = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    course = COURSES[(number + number // len(KINDS)) % len(COURSES)]
    width = 1e-3 * between(random, 5.0, 20.0)
    duration = between(random, 0.02, longest_s)
    load, words = random_load(random, course, width, duration)
    reach = float(np.hypot(*load.centres().T).max())
    body, about = random_body(random, kind, width, reach)
    times: Float = 5e-4 * np.arange(1, 1 + round(duration / 5e-4), dtype=np.float64)
    accuracy = between(random, 0.02 if kind == "layer" else 0.005, 0.1)
    at = random_points(random, body, load, reach)
    text = f"{about}; spot {1e3 * width:.1f} mm, {words}, {1e3 * duration:.0f} ms, {len(at)} points"
    return Case(seed, number, text, body, load, times, at, accuracy)


def between(random: np.random.Generator, low: float, high: float) -> float:
    """A number, even in its logarithm."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def one_of(random: np.random.Generator, *sides: SideKind) -> SideKind:
    return sides[int(random.integers(len(sides)))]


def random_material(random: np.random.Generator) -> Material:
    which = random.integers(4)
    if which < 2:
        return preset(str(random.choice(PRESETS)))
    shear, density = between(random, 3e3, 50e3), random.uniform(900.0, 1150.0)
    # Even in the bulk modulus' logarithm: 0.45 to 0.4999
    nu = 0.5 - between(random, 1e-4, 0.05)
    if which == 2:
        return kelvin_voigt("Kelvin-Voigt", density, shear, between(random, 0.3, 6.0), nu)
    ratio, time_s = between(random, 0.3, 3.0), between(random, 3e-4, 0.03)
    return standard_linear("standard linear", density, shear, ratio * shear, time_s, nu)


def random_sheets(random: np.random.Generator, depth: float) -> tuple[tuple[Sheet, ...], str]:
    first = random_material(random)
    sheets: tuple[Sheet, ...] = (Sheet(first, depth),)
    if random.random() < 0.35:
        share = random.uniform(0.25, 0.6)
        sheets = (Sheet(first, share * depth), Sheet(random_material(random), (1.0 - share) * depth))
    words = " on ".join(f"{1e3 * sheet.thickness_m:.1f} mm {describe(sheet.material)}" for sheet in sheets)
    return sheets, words


def describe(material: Material) -> str:
    bulk, shear = material.bulk_Pa, material.shear_instant_Pa
    return f"{material.name} (G {1e-3 * shear:.0f} kPa, nu {(3 * bulk - 2 * shear) / (6 * bulk + 2 * shear):.4f})"


def random_base(random: np.random.Generator) -> tuple[BaseKind | Springs, str]:
    which = random.integers(3)
    if which == 2:
        stiffness = between(random, 3e5, 3e7)
        return Springs(stiffness, 0.3 * stiffness, 1e-3 * stiffness, 3e-4 * stiffness), f"springs {stiffness:.1g} Pa/m"
    base: BaseKind = "bonded" if which == 0 else "free_slip"
    return base, base


def random_body(random: np.random.Generator, kind: str, width: float, reach: float) -> tuple[Body, str]:
    """A body with room for a spot whose centre comes `reach` [m] from the middle, and what it is in words."""
    depth = float(np.clip(width * between(random, 0.3, 1.5), 2e-3, 20e-3))
    sheets, words = random_sheets(random, depth)
    base, below = random_base(random)
    room = reach + RIM * width
    radius = room * between(random, 1.0, 1.8)
    sides = 2.0 * room * np.array([between(random, 1.0, 1.5), between(random, 1.0, 1.5)])
    if kind == "endless":
        return Slab(sheets, base=base), f"endless, {words}, {below}"
    if kind == "disc":
        side = one_of(random, "fixed", "free", "roller")
        return (
            Slab(sheets, shape="disc", base=base, side=side, radius_m=radius),
            f"disc R {1e3 * radius:.0f} mm, {side}, {words}, {below}",
        )
    if kind == "box":
        side = one_of(random, "fixed", "roller", "absorbing")
        return (
            Slab(sheets, shape="box", base=base, side=side, size_m=(float(sides[0]), float(sides[1]))),
            f"box {1e3 * sides[0]:.0f} x {1e3 * sides[1]:.0f} mm, {side}, {words}, {below}",
        )
    flat = random.random() < 0.4
    radii = np.full(2, np.inf) if flat else np.array([between(random, 4.0, 12.0), between(random, 4.0, 12.0)]) * room
    side = one_of(random, "fixed", "roller" if flat else "free")
    patch = curved_patch(sides, depth, radii, 0.9 * width)
    shape = "flat" if flat else f"radii {1e3 * radii[0]:.0f} and {1e3 * radii[1]:.0f} mm"
    return (
        Layer(patch, sheets, base=base, side=side),
        f"layer {1e3 * sides[0]:.0f} x {1e3 * sides[1]:.0f} mm, {shape}, {side}, {words}, {below}",
    )


def curved_patch(sides: Float, depth: float, radii: Float, edge: float) -> Patch:
    """A rectangle bent down by -(x^2 / R_x + y^2 / R_y) / 2; triangles with edges of about `edge` [m]."""
    even = Sizes((0.0, 0.0), float(sides.max()), edge, edge, depth, depth, 0, 0.0, 0.0, 0.0)
    patch = box_patch(0.5 * sides, depth, even)
    plane = patch.vertices[:, :2]
    outward = np.column_stack([plane / radii, np.ones(len(plane))])
    return replace(
        patch,
        vertices=np.column_stack([plane, -0.5 * (plane**2 / radii).sum(axis=1)]),
        inward=-outward / np.linalg.norm(outward, axis=1, keepdims=True),
        axis=patch.axis if np.isinf(radii).all() else None,
    )


def random_load(random: np.random.Generator, course: str, width: float, duration: float) -> tuple[Spot, str]:
    """A spot of 1 Pa and what it does in words."""
    place = random.uniform(-0.3, 0.3, 2) * width if random.random() < 0.5 else np.zeros(2)
    frequency = between(random, 20.0, 400.0)
    law: Law = "held" if random.random() < 0.3 else "linear"
    if course == "step":
        return Spot(width, np.zeros(1), np.ones(1), place, "held"), "step"
    if course == "ramp":
        rise = between(random, 5e-4, 1e-2)
        return Spot(width, np.array([0.0, rise]), np.array([0.0, 1.0]), place), f"ramp of {1e3 * rise:.1f} ms"
    if course in ("modulated", "burst"):
        cycles = duration * frequency if course == "modulated" else 3.0
        times = np.arange(1 + int(np.ceil(CYCLE * cycles))) / (CYCLE * frequency)
        peak = 0.5 - 0.5 * np.cos(2.0 * np.pi * frequency * times)
        return Spot(width, times, peak, place, law), f"{course} {frequency:.0f} Hz, {law}"
    if course == "line":
        speed, turn = between(random, 0.5, 8.0), random.uniform(0.0, np.pi)
        half = min(width * random.uniform(0.5, 1.5), 0.4 * speed * duration)
        along = np.array([np.cos(turn), np.sin(turn)])
        times = np.array([0.0, 2.0 * half / speed, 2.0 * half / speed + 1e-3])
        path = np.array([-half, half, half])[:, None] * along
        return Spot(width, times, np.array([1.0, 1.0, 0.0]), path), f"line at {speed:.1f} m/s over {2e3 * half:.0f} mm"
    rate, radius = between(random, 15.0, 120.0), width * random.uniform(0.3, 0.9)
    times = np.arange(1 + int(np.ceil(2 * CYCLE * rate * duration))) / (2 * CYCLE * rate)
    angle = 2.0 * np.pi * rate * times
    path = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return Spot(width, times, np.ones(len(times)), path, law), f"circle {rate:.0f} Hz, R {1e3 * radius:.1f} mm, {law}"


def random_points(random: np.random.Generator, body: Body, load: Spot, reach: float) -> Float:
    """The load's middle place, and up to two points within two widths of its path, on the face; shape (n, 3)."""
    centres = load.centres()
    points = [centres[len(centres) // 2]]
    for _ in range(int(random.integers(3))):
        away, angle = reach + load.fwhm_m * random.uniform(0.0, 1.6), random.uniform(0.0, 2.0 * np.pi)
        points.append(away * np.array([np.cos(angle), np.sin(angle)]))
    flat = np.column_stack([points, np.zeros(len(points))])
    if isinstance(body, Layer):
        x, y, z = body.patch.vertices.T
        flat[:, 2] = LinearTriInterpolator(Triangulation(x, y, body.patch.faces), z)(*flat[:, :2].T)
    return flat
