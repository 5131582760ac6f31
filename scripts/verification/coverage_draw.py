"""Draw random skin problems from a seed, as plain data for every solver and the independent code.

A case is a dictionary of numbers and words only, in SI units, so that a program without palmfield can read it.
`problem_of` makes palmfield's bodies and loads from it.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from coverage_scenes import PRESETS, draw_body_scene, draw_scene, numbers_of
from scipy.spatial import Delaunay

from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.mesh.body_mesh import Sizes, box_patch
from palmfield.skin.problem import Body, Layer, Slab, Spot
from palmfield.types import Float, Patch

FAMILIES = ("still", "moving", "rims", "sudden", "smooth", "depths", "contrast", "curved", "meshes", "scenes")
"""Families of cases, drawn in turn."""
CYCLE = 24
"""Number of times per period of the load."""
CONTRAST = 100.0
ASKED_TIMES = 24
ROUND = (0.02, 0.15)
"""Range of the target accuracies of discs and infinite bodies."""
OTHER = (0.04, 0.15)
"""The same for boxes, layers and scenes, whose references cost far more."""
CROSSINGS = (2.0, 6.0)
"""Range of the output times, in times in which shear waves cross the spot or twice the depth, whichever is less."""
LONGEST_S = 0.06
BY_NAME = 2
"""Solvers that are also selected by name, in addition to `auto`."""

Case = dict[str, Any]


@dataclass(frozen=True)
class Problem:
    """Input of a solver: body, load, times (t,) [s], points (n, 3) [m], accuracy."""

    body: Body
    load: Spot
    times: Float
    at: Float
    accuracy: float


def draw(seed: int, count: int) -> list[Case]:
    """Return cases 0 to count - 1 of a seed; a case does not depend on the number of cases."""
    return [draw_case(seed, number) for number in range(count)]


def draw_case(seed: int, number: int) -> Case:
    """Return one case: of a solver, or of a whole scene (coverage_scenes).

    Sizes scale with the spot: the body is only a few spot widths wide, and the time only a few crossings of waves. The
    cost of a case therefore hardly depends on whether its spot is 1 or 300 mm wide.
    """
    random = np.random.default_rng([seed, number])
    family, turn = FAMILIES[number % len(FAMILIES)], number // len(FAMILIES)
    head = {"key": f"{seed}-{number}", "family": family}
    if family == "scenes":
        accuracy, kind = between(random, *OTHER), ("disc", "hand", "mesh")[turn % 3]
        drawn = draw_scene(random, accuracy) if kind == "disc" else draw_body_scene(random, accuracy, kind)
        return head | drawn
    width = between(random, 5e-3, 20e-3)
    if family == "still":
        width = between(random, 1e-3, 0.3)
    depth = float(np.clip(width * between(random, 0.3, 1.2), 1e-3, 20e-3))
    if family == "depths":
        depth = between(random, 1e-3, 50e-3)
        width = float(np.clip(depth * between(random, 0.7, 2.5), 2e-3, 60e-3))
    sheets = draw_sheets(random, depth, contrast=family == "contrast")
    shape = shape_of(family, turn)
    body: Case
    if shape == "layer":
        body = draw_layer(random, width, depth, family == "meshes")
    elif shape == "box":
        sizes = [width * between(random, 2.5, 4.0) for _ in range(2)]
        body = {"shape": "box", "side": pick(random, "fixed", "roller"), "size_m": sizes}
    elif shape == "infinite":
        body = {"shape": "infinite", "side": None}
    else:
        radius = width * (between(random, 0.3, 1.2) if family == "rims" else between(random, 1.2, 2.5))
        body = {"shape": "disc", "side": pick(random, "fixed", "free", "roller"), "radius_m": min(radius, 0.15)}
    body |= {"base": pick(random, "bonded", "bonded", "free_slip"), "sheets": sheets}
    duration = min(LONGEST_S, crossing_s(sheets, width, depth) * between(random, *CROSSINGS))
    load = draw_load(random, family, width, duration, body)
    times = (duration / ASKED_TIMES * np.arange(1, 1 + ASKED_TIMES)).tolist()
    at = draw_points(random, body, load)
    accuracy = between(random, *(ROUND if shape in ("disc", "infinite") else OTHER))
    return head | {
        "body": body, "load": load, "times_s": times, "at_m": at, "accuracy": accuracy,
        "solvers": draw_solvers(random, body, load), "by_scikit_fem": asked_of_scikit_fem(body, turn),
        "by_others": turn == 0 or not asked_of_scikit_fem(body, turn),
    }  # fmt: skip


def shape_of(family: str, turn: int) -> str:
    """Return the shape of the body in case `turn` of a family."""
    if family in ("curved", "meshes"):
        return "layer"
    if family == "moving" or (family == "rims" and turn % 2):
        return "box"
    return "infinite" if family in ("sudden", "smooth", "contrast") and turn % 3 == 2 else "disc"


def asked_of_scikit_fem(body: Case, turn: int) -> bool:
    """Return whether scikit-fem computes a reference: for all round cases, and for one in three of the others.

    Another solver of palmfield computes a reference for the others, and for the first case of each family. The script
    of scikit-fem does not support a curved base that slips.
    """
    if body["shape"] in ("disc", "infinite"):
        return True
    return turn % 3 == 0 and not (body["shape"] == "layer" and body["base"] == "free_slip")


def crossing_s(sheets: list[Case], width: float, depth: float) -> float:
    """Return the time in which shear waves cross the spot or go down and up, whichever is less."""
    down = 0.0
    for sheet in sheets:
        numbers = sheet["material"]
        shear = numbers["shear_relaxed_Pa"] + sum(branch for branch, _ in numbers["branches"])
        down += sheet["thickness_m"] * math.sqrt(numbers["density_kg_m3"] / shear)
    return down / depth * min(width, 2.0 * depth)


def draw_solvers(random: np.random.Generator, body: Case, load: Case) -> list[str]:
    """Return `auto` and the solvers of BY_NAME for such a body and load, each with the same probability."""
    moves = np.ptp(np.asarray(load["centre_m"]), axis=0).any()
    able = [] if body["shape"] == "infinite" else ["wedges", "spectral_elements", "particles"]
    if not moves and body["shape"] != "infinite":
        able.append("reduced")
    if body["shape"] == "disc":
        able.append("axisymmetric")
    if body["shape"] == "infinite":
        return ["auto", "lateral_waves", pick(random, "wedges", "spectral_elements")]
    if body["side"] == "roller":
        able.append("lateral_waves")
    return ["auto", *(str(name) for name in random.choice(able, BY_NAME, replace=False))]


def between(random: np.random.Generator, low: float, high: float) -> float:
    """Return a random number with a uniform logarithm."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def pick(random: np.random.Generator, *names: str) -> str:
    return names[int(random.integers(len(names)))]


def draw_material(random: np.random.Generator) -> Case:
    which = random.integers(4)
    if which < 2:
        return numbers_of(pick(random, *PRESETS))
    shear = between(random, 3e3, 50e3)
    bulk = bulk_from_poisson(0.5 - between(random, 5e-4, 0.05), shear)
    viscosity, branches = between(random, 0.3, 6.0), []
    if which == 3:
        viscosity, branches = 0.0, [[shear * between(random, 0.3, 3.0), between(random, 3e-4, 0.03)]]
    density = float(random.uniform(900.0, 1150.0))
    return {
        "density_kg_m3": density, "shear_relaxed_Pa": shear, "bulk_Pa": bulk, "viscosity_Pa_s": viscosity,
        "bulk_relaxes": False, "branches": branches,
    }  # fmt: skip


def draw_sheets(random: np.random.Generator, depth: float, contrast: bool) -> list[Case]:
    first = draw_material(random)
    if not contrast and random.random() > 0.25:
        return [{"thickness_m": depth, "material": first}]
    second, share = draw_material(random), float(random.uniform(0.2, 0.6))
    if contrast:
        ratio = CONTRAST ** (1.0 if random.random() < 0.5 else -1.0) * first["shear_relaxed_Pa"]
        scale = ratio / second["shear_relaxed_Pa"]
        for name in ("shear_relaxed_Pa", "bulk_Pa", "viscosity_Pa_s"):
            second[name] *= scale
        second["branches"] = [[scale * shear, time_s] for shear, time_s in second["branches"]]
    return [
        {"thickness_m": share * depth, "material": first},
        {"thickness_m": (1.0 - share) * depth, "material": second},
    ]


def draw_layer(random: np.random.Generator, width: float, depth: float, rough: bool) -> Case:
    """Return a curved rectangle z = -(x^2 / R_x + y^2 / R_y) / 2 + a cos(k x) cos(k y).

    rough: whether triangles have any shape
    """
    sizes = [width * between(random, 2.5, 4.0) for _ in range(2)]
    radii = [max(sizes) * between(random, 2.0, 6.0) for _ in range(2)]
    bump = [0.1 * depth * float(random.random()), 2.0 * math.pi / (2.0 * max(sizes))] if rough else [0.0, 0.0]
    seed = int(random.integers(1 << 30)) if rough else None
    side = pick(random, "fixed", "free")
    return {
        "shape": "layer", "side": side, "size_m": sizes, "radii_m": radii, "bump": bump, "depth_m": depth,
        "edge_m": 0.6 * width, "triangles_seed": seed,
    }  # fmt: skip


def draw_load(random: np.random.Generator, family: str, width: float, duration: float, body: Case) -> Case:
    def load(times: Any, peak: Any, centre: Any, law: str = "linear") -> Case:
        rows = np.broadcast_to(np.asarray(centre, dtype=float), (len(times), 2))
        arrays = (np.asarray(times, dtype=float), np.asarray(peak, dtype=float), rows)
        names = ("times_s", "peak_Pa", "centre_m")
        return {"fwhm_m": width, "law": law} | {n: a.tolist() for n, a in zip(names, arrays, strict=True)}

    round_body = body["shape"] in ("disc", "infinite")
    centre = np.zeros(2) if round_body else random.uniform(-0.3, 0.3, 2) * width
    if body["shape"] == "box":
        reach, turn = 0.5 * min(body["size_m"]), random.uniform(0.0, math.pi)
        # Slow spots move as far as they get in the time
        half = reach if family == "rims" else min(0.3 * reach, width)
        speed, end = between(random, 0.3, 6.0), 0.8 * duration
        way = min(2.0 * half, speed * end)
        along = np.array([math.cos(turn), math.sin(turn)])
        path = np.array([-half, way - half, way - half])[:, None] * along
        return load([0.0, min(end, way / speed), 0.95 * duration], [1.0, 1.0, 0.0], path)
    if family == "sudden":
        return load([0.0], [1.0], centre, "held")
    if family in ("smooth", "contrast", "depths") and random.random() < 0.7:
        frequency = between(random, max(20.0, 0.7 / duration), max(250.0, 2.0 / duration))
        times = np.arange(1 + math.ceil(CYCLE * duration * frequency)) / (CYCLE * frequency)
        return load(times, 0.5 - 0.5 * np.cos(2.0 * math.pi * frequency * times), centre)
    return load([0.0, duration * between(random, 0.1, 0.6)], [0.0, 1.0], centre)


def draw_points(random: np.random.Generator, body: Case, load: Case) -> list[list[float]]:
    """Return the middle of the load and up to two more points on the body within 1.5 spot widths of it; (n, 2)."""
    centres = np.asarray(load["centre_m"])
    points = [centres[len(centres) // 2] * (0.8 if len(centres) > 1 else 1.0)]
    room = 0.9 * body["radius_m"] if body["shape"] == "disc" else 0.45 * min(body.get("size_m", [np.inf]))
    for _ in range(int(random.integers(3))):
        away, angle = min(1.5 * load["fwhm_m"], room) * random.random(), random.uniform(0.0, 2.0 * math.pi)
        points.append(away * np.array([math.cos(angle), math.sin(angle)]))
    return [np.clip(point, -room, room).tolist() for point in points]


def height(body: Case, x: Float, y: Float) -> Float:
    """Return the height of a layer's face over its plane [m]."""
    (a, k), (rx, ry) = body["bump"], body["radii_m"]
    return np.asarray(-0.5 * (x**2 / rx + y**2 / ry) + a * np.cos(k * x) * np.cos(k * y))


def slopes(body: Case, x: Float, y: Float) -> Float:
    """Return the slopes of the face along x and y, (n, 2)."""
    (a, k), (rx, ry) = body["bump"], body["radii_m"]
    along = -x / rx - a * k * np.sin(k * x) * np.cos(k * y)
    across = -y / ry - a * k * np.cos(k * x) * np.sin(k * y)
    return np.column_stack([along, across])


def twice_areas(plane: Float, faces: Any) -> Float:
    """Return twice the areas of triangles (m, 3) of points (n, 2), positive for counter-clockwise, (m,)."""
    (ax, ay), (bx, by) = ((plane[faces[:, i]] - plane[faces[:, 0]]).T for i in (1, 2))
    return np.asarray(ax * by - ay * bx)


def patch_of(body: Case) -> Patch:
    """Return triangles of a layer's face: of a grid, or, with a seed, of scattered points as on a user's mesh."""
    half, edge = 0.5 * np.asarray(body["size_m"]), body["edge_m"]
    even = Sizes((0.0, 0.0), float(2.0 * half.max()), edge, edge, body["depth_m"], body["depth_m"], 0, 0.0, 0.0, 0.0)
    flat = box_patch(half, body["depth_m"], even)
    plane, faces = flat.vertices[:, :2].copy(), flat.faces
    if body["triangles_seed"] is not None:
        random = np.random.default_rng(body["triangles_seed"])
        inside = ~flat.rim
        plane[inside] += 0.25 * edge * random.uniform(-1.0, 1.0, (int(inside.sum()), 2))
        faces = Delaunay(plane).simplices.astype(np.int32)
        areas = twice_areas(plane, faces)
        faces[areas < 0.0] = faces[areas < 0.0][:, ::-1]
        faces = faces[np.abs(areas) > 1e-9 * edge**2]
    x, y = plane.T
    inward = np.column_stack([slopes(body, x, y), -np.ones(len(x))])
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    depth = np.full(len(x), body["depth_m"])
    axis = flat.axis if np.isinf(body["radii_m"]).all() and body["bump"][0] == 0.0 else None
    return Patch(np.column_stack([plane, height(body, x, y)]), faces, inward, depth, flat.rim, axis)


def problem_of(case: Case) -> Problem:
    """Return the palmfield objects of a case."""
    body, load = case["body"], case["load"]
    sheets = []
    for number, sheet in enumerate(body["sheets"]):
        numbers = dict(sheet["material"])
        branches = tuple(Branch(*pair) for pair in numbers.pop("branches"))
        material = Material(name=f"sheet {number}", branches=branches, source="drawn at random", **numbers)
        sheets.append(Sheet(material, sheet["thickness_m"]))
    solid: Body
    if body["shape"] == "layer":
        solid = Layer(patch_of(body), tuple(sheets), base=body["base"], side=body["side"])
    else:
        size = tuple(body["size_m"]) if "size_m" in body else None
        solid = Slab(tuple(sheets), body["shape"], body["base"], body["side"], body.get("radius_m"), size)
    at = np.asarray(case["at_m"])
    z = height(body, *at.T) if body["shape"] == "layer" else np.zeros(len(at))
    spot = Spot(load["fwhm_m"], load["times_s"], load["peak_Pa"], load["centre_m"], load["law"])
    return Problem(solid, spot, np.asarray(case["times_s"]), np.column_stack([at, z]), case["accuracy"])
