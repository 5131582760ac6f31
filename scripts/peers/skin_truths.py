"""Compute reference solutions of skin cases by scikit-fem, without palmfield: own meshes, elements and steps.

    ~/.cache/palmfield-peers/bin/python scripts/peers/skin_truths.py CASES.json TRUTHS.jsonl [--limit 120] [--finer 1]

A round body with a spot in its middle is solved in r and z by quadratic quadrilaterals of nine nodes. An infinite body
is a disc so wide that no wave returns. Boxes and curved layers use quadratic hexahedra of 27 nodes. The bulk part is
integrated with two points along each edge, which prevents locking. The time scheme is the trapezoid rule, also for the
branches; a sudden load accelerates the body at rest from the first step. Every case is solved three times with finer
space and time. The error of the finest solution follows from the two differences and their observed order. Rows are
appended, so an interrupted run can continue. Round bodies may be solved again with all sizes and steps smaller by
--finer, if an estimate is smaller than the error of the reference.
"""

import argparse
import json
import math
import signal
import sys
import time
from pathlib import Path

import numpy as np
import skfem as fem
from pypardiso import PyPardisoSolver
from pypardiso.pardiso_wrapper import PyPardisoError
from scipy import sparse
from skfem.helpers import ddot, div, dot, sym_grad

GAUSSIAN = 4.0 * math.log(2.0)
SCALES = (2.25, 1.5, 1.0)
"""Relative sizes of elements and steps of the three solutions."""
FINEST_STEPS = 9
"""Factor of the number of steps between two times of the finest solution; the others have 6 and 4 instead."""
ORDERS = (0.5, 2.0)
"""Range in which the observed order of the differences is accepted."""
ROUND_SIZE, OTHER_SIZE = 0.06, 0.22
"""Largest elements over the width of the spot, or over one or two depths if they are less; round bodies, others."""
ROUND_STEPS, OTHER_STEPS = 200.0, 40.0
"""Time steps while shear waves cross the spot, or go down and up; round bodies, others."""
STEPS_A_PERIOD = 100.0
"""Time steps per period of a periodic load."""
FASTER = 1.5
"""Speed of the fastest waves along an infinite plate over that of shear waves, for its width; one per solution."""
MOST_UNKNOWNS = 120_000
DIGITS = 6
"""Number of digits in the file of references."""
BULK_INTORDER = 3
"""Integration order with two points along each edge of a cell."""
POSITIVE_DEFINITE, SOLVE = 2, 33
"""Codes of PARDISO for a kind of matrix and for a solution with a factor."""


class TooLongError(Exception):
    """A run exceeded its time limit."""


class Factor:
    """Factor of a symmetric positive definite matrix."""

    def __init__(self, matrix):
        self.upper = sparse.csr_matrix(sparse.triu(matrix))
        self.upper.sort_indices()
        self.solver = PyPardisoSolver(mtype=POSITIVE_DEFINITE)
        self.solver.factorize(self.upper)
        self.solver.set_phase(SOLVE)

    def solve(self, right):
        # The wrapper's own `solve` compares the whole matrix with the one that it knows, each time
        return self.solver._call_pardiso(self.upper, np.ascontiguousarray(right)[:, None])[:, 0]

    def free(self):
        self.solver.free_memory(everything=True)


def graded(length, first, most, growth=1.35):
    """Return grid lines from 0 to length: cells of `first`, growing to at most `most`."""
    sizes = [first]
    while sum(sizes) < length:
        sizes.append(min(growth * sizes[-1], most))
    lines = np.concatenate([[0.0], np.cumsum(sizes)])
    return lines * (length / lines[-1])


def depth_lines(sheets, size):
    """Return grid lines from the face, 0, down through each sheet."""
    lines, top = [0.0], 0.0
    for sheet in sheets:
        thickness = sheet["thickness_m"]
        count = max(2, math.ceil(thickness / size))
        lines += (top + thickness * np.arange(1, count + 1) / count).tolist()
        top += thickness
    return np.array(lines)


def sheet_at(sheets, depth):
    """Return the number of the sheet at each depth."""
    bottoms = np.cumsum([sheet["thickness_m"] for sheet in sheets])
    return np.minimum(np.searchsorted(bottoms, depth), len(sheets) - 1)


def axisymmetric(case, size):
    """Return matrices, force per pascal, free unknowns and readers of a disc, or infinite body, with a central spot."""
    body, width = case["body"], case["load"]["fwhm_m"]
    sheets = body["sheets"]
    if body["shape"] == "infinite":
        near = np.hypot(*np.asarray(case["at_m"]).T).max() + 1.5 * width
        # Of finer solutions the rim is farther away, so that the differences tell what it does
        radius = near + FASTER * fastest(sheets) * case["times_s"][-1] / (size / finest_size(case)) ** 0.5
        count = math.ceil(near / size)
        r = np.concatenate([near * np.arange(count) / count, near + graded(radius - near, size, 3.0 * size, 1.1)])
    elif body["side"] == "roller":
        radius = body["radius_m"]
        r = graded(radius, size, size)
    else:
        radius = body["radius_m"]
        r = np.unique(np.concatenate([[0.0], radius - graded(radius, 0.15 * size, size)[:-1]]))
    z = -depth_lines(sheets, size)[::-1]
    mesh = fem.MeshQuad.init_tensor(r, z)
    element = fem.ElementVector(fem.ElementQuad2())
    basis = fem.Basis(mesh, element, intorder=6)
    which = sheet_at(sheets, -mesh.p[1][mesh.t].mean(axis=0))

    def hoop(u, w):
        return u.value[0] / w.x[0]

    def bulk(u, v, w):
        return (div(u) + hoop(u, w)) * (div(v) + hoop(v, w)) * w.x[0]

    def shear(u, v, w):
        return 2.0 * (ddot(sym_grad(u), sym_grad(v)) + hoop(u, w) * hoop(v, w)) * w.x[0]

    def inertia(u, v, w):
        return dot(u, v) * w.x[0]

    matrices = by_sheet(mesh, element, which, len(sheets), (shear, bulk, inertia), 6)
    face = mesh.facets_satisfying(lambda x: np.isclose(x[1], 0.0))
    top = fem.FacetBasis(mesh, element, facets=face, intorder=8)
    load = case["load"]

    def pressure(r):
        if "profile_Pa" in load:
            return np.interp(r, load["radii_m"], load["profile_Pa"])
        return np.exp(-GAUSSIAN * (r / width) ** 2)

    force = fem.LinearForm(lambda v, w: -pressure(w.x[0]) * v[1] * w.x[0]).assemble(top)
    held = [at_places(basis, lambda x: np.isclose(x[0], 0.0), 0)]
    bottom, side = (lambda x: np.isclose(x[1], z[0])), (lambda x: np.isclose(x[0], radius))
    held += [at_places(basis, bottom, 1)] + ([at_places(basis, bottom, 0)] if body["base"] == "bonded" else [])
    if body["side"] != "free":
        held.append(at_places(basis, side, 0))
    if body["side"] in ("fixed", None):
        held.append(at_places(basis, side, 1))
    points = np.asarray(case["at_m"])
    away = np.hypot(*points.T)
    probe = basis.probes(np.stack([np.clip(away, 1e-9, radius * (1.0 - 1e-9)), np.full(len(points), -1e-12)])).tocsr()
    out, up = probe[: len(points)], probe[len(points) :]
    unit = points / np.maximum(away, 1e-300)[:, None]
    readers = [sparse.diags(unit[:, 0]) @ out, sparse.diags(unit[:, 1]) @ out, up]
    return matrices, [force], free_of(basis, held), readers


def at_places(basis, where, component):
    """Return the unknowns of one component whose positions satisfy a condition."""
    dofs = np.flatnonzero(where(basis.doflocs))
    return dofs[component_of(basis)[dofs] == component]


def component_of(basis):
    """Return the component of each unknown; vector elements number their components in turn."""
    size = basis.mesh.dim()
    result = np.zeros(basis.N, dtype=int)
    result[basis.element_dofs] = (np.arange(len(basis.element_dofs)) % size)[:, None]
    return result


def free_of(basis, held):
    free = np.ones(basis.N, dtype=bool)
    free[np.unique(np.concatenate(held))] = False
    return np.flatnonzero(free)


def by_sheet(mesh, element, which, count, forms, intorder):
    """Return shear, bulk and mass matrices of the elements of each sheet; forms: of 2 e : e, div div and u . v."""
    strain, bulk, inertia = (fem.BilinearForm(form) for form in forms)
    result = []
    for number in range(count):
        elements = np.flatnonzero(which == number)
        part = fem.Basis(mesh, element, elements=elements, intorder=intorder)
        volume = bulk.assemble(fem.Basis(mesh, element, elements=elements, intorder=BULK_INTORDER))
        result.append([strain.assemble(part) - 2.0 / 3.0 * volume, volume, inertia.assemble(part)])
    return result


def block(case, size):
    """Return the same for a box or curved layer, with a force for each time of the load."""
    body, load = case["body"], case["load"]
    sheets, width = body["sheets"], load["fwhm_m"]
    lines = []
    for length in body["size_m"]:
        half = graded(0.5 * length, 0.6 * size, 1.2 * size)
        edge = 0.5 * length - half
        lines.append(np.unique(np.concatenate([-edge, edge])))
    down = depth_lines(sheets, size)
    mesh = fem.MeshHex.init_tensor(lines[0], lines[1], -down[::-1])
    which = sheet_at(sheets, -mesh.p[2][mesh.t].mean(axis=0))
    flat = mesh.p.copy()
    if body["shape"] == "layer":
        curved = fem.MeshHex2.from_mesh(mesh)
        locations = bent(body, curved.doflocs)
        mesh = fem.MeshHex2(locations, curved.t)
    element = fem.ElementVector(fem.ElementHex2())
    basis = fem.Basis(mesh, element, intorder=4)
    shear = lambda u, v, w: 2.0 * ddot(sym_grad(u), sym_grad(v))  # noqa: E731
    bulk = lambda u, v, w: div(u) * div(v)  # noqa: E731
    matrices = by_sheet(mesh, element, which, len(sheets), (shear, bulk, lambda u, v, w: dot(u, v)), 4)
    flat_basis = fem.Basis(fem.MeshHex(flat, mesh.t[:8]), element, intorder=1)
    places, component = flat_basis.doflocs, component_of(flat_basis)
    facets = np.flatnonzero(np.isclose(flat[2][fem.MeshHex(flat, mesh.t[:8]).facets].max(axis=0), 0.0) & np.isclose(
        flat[2][fem.MeshHex(flat, mesh.t[:8]).facets].min(axis=0), 0.0))  # fmt: skip
    top = fem.FacetBasis(mesh, element, facets=facets, intorder=8)

    # Force of a pressure at each quadrature point of the face, so that a spot that moves costs a product a step
    shares = [-np.einsum("cfq,cfq->fq", top.basis[i][0].value, top.normals.value) * top.dx for i in range(top.Nbfun)]
    rows = np.repeat(top.element_dofs[:, :, None], top.dx.shape[1], axis=2)
    columns = np.broadcast_to(np.arange(top.dx.size).reshape(top.dx.shape), rows.shape)
    spread = sparse.coo_matrix((np.ravel(shares), (rows.ravel(), columns.ravel())), (basis.N, top.dx.size)).tocsr()
    x, y = (top.global_coordinates().value[axis].ravel() for axis in range(2))

    def push(centre):
        return spread @ np.exp(-GAUSSIAN * ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / width**2)

    sides = np.zeros(basis.N, dtype=bool)
    held = []
    for axis in range(2):
        side = np.isclose(np.abs(places[axis]), 0.5 * body["size_m"][axis])
        sides |= side
        if body["side"] == "roller":
            held.append(np.flatnonzero(side & (component == axis)))
    if body["side"] == "fixed":
        held.append(np.flatnonzero(sides))
    bottom = np.isclose(places[2], -down[-1])
    if body["base"] == "bonded":
        held.append(np.flatnonzero(bottom))
    elif body["shape"] == "layer":
        raise ValueError("free slip along a bent base is not solved here")
    else:
        held.append(np.flatnonzero(bottom & (component == 2)))
    points = np.asarray(case["at_m"])
    flat_points = np.vstack([points.T, np.full(len(points), -1e-12)])
    readers = flat_readers(flat_basis, flat_points)
    return matrices, push, free_of(basis, held), readers


def flat_readers(basis, points):
    """Return operators that evaluate each component at points of the flat mesh.

    The reference coordinates of these points are those of the curved mesh.
    """
    rows = basis.probes(points).tocsr()
    count = points.shape[1]
    return [rows[n * count : (n + 1) * count] for n in range(3)]


def bent(body, places):
    """Return points of a curved layer: each depth along the normal of the face below (x, y)."""
    x, y, z = places
    (a, k), (rx, ry) = body["bump"], body["radii_m"]
    face = -0.5 * (x**2 / rx + y**2 / ry) + a * np.cos(k * x) * np.cos(k * y)
    along = -x / rx - a * k * np.sin(k * x) * np.cos(k * y)
    across = -y / ry - a * k * np.cos(k * x) * np.sin(k * y)
    inward = np.stack([along, across, -np.ones_like(x)])
    inward /= np.linalg.norm(inward, axis=0)
    return np.stack([x, y, face]) - z * inward


def is_round(case):
    return case["body"]["shape"] in ("disc", "infinite")


def finest_size(case):
    """Return the largest elements of the finest solution."""
    width, depth = case["load"]["fwhm_m"], sum(sheet["thickness_m"] for sheet in case["body"]["sheets"])
    if is_round(case):
        return ROUND_SIZE * min(width, 2.0 * depth)
    return OTHER_SIZE * min(width, 1.5 * depth)


def fastest(sheets):
    """Return the speed of the fastest shear waves of all sheets."""
    materials = [sheet["material"] for sheet in sheets]
    return max(math.sqrt(instant(m) / m["density_kg_m3"]) for m in materials)


def step_of(case):
    """Return the time step of the finest solution."""
    sheets, load = case["body"]["sheets"], case["load"]
    depth, width = sum(sheet["thickness_m"] for sheet in sheets), load["fwhm_m"]
    slowness = [math.sqrt(s["material"]["density_kg_m3"] / instant(s["material"])) for s in sheets]
    mean = sum(s["thickness_m"] * slow for s, slow in zip(sheets, slowness, strict=True)) / depth
    count = ROUND_STEPS if is_round(case) else OTHER_STEPS
    steps = [mean * min(width, 2.0 * depth) / count]
    peaks = np.asarray(load["peak_Pa"])
    tops = np.flatnonzero((peaks[1:-1] > peaks[:-2]) & (peaks[1:-1] >= peaks[2:])) + 1
    if len(tops) > 1:
        steps.append((load["times_s"][tops[1]] - load["times_s"][tops[0]]) / STEPS_A_PERIOD)
    return min(steps)


def solved(case, scale, finer):
    """Return the displacement at times and points, (t, n, 3), with sizes and steps larger by scale / finer."""
    body, load = case["body"], case["load"]
    sheets = body["sheets"]
    materials = [sheet["material"] for sheet in sheets]
    size = scale * finest_size(case) / finer
    if is_round(case):
        matrices, forces, free, readers = axisymmetric(case, size)
        push = None
    else:
        matrices, push, free, readers = block(case, size)
    if len(free) > MOST_UNKNOWNS:
        raise ValueError(f"{len(free)} unknowns, above {MOST_UNKNOWNS}")
    times = np.asarray(case["times_s"])
    between = times[1] - times[0] if len(times) > 1 else times[0]
    # A whole number of steps between the times asked for, in the ratios of the scales
    count = round(FINEST_STEPS / scale) * math.ceil(between * finer / (step_of(case) * FINEST_STEPS))
    step = between / count
    knots = np.asarray(load["times_s"])
    clock = np.arange(count * len(times) + 1) * step
    cut = [[m.tocsr()[free][:, free] for m in each] for each in matrices]
    mass = sum(m["density_kg_m3"] * each[2] for m, each in zip(materials, cut, strict=True))
    relaxed, elastic, damping = [], 0.0, 0.0
    for material, each in zip(materials, cut, strict=True):
        shear, bulk = material["shear_relaxed_Pa"] * each[0], material["bulk_Pa"] * each[1]
        law = shear + bulk if material["bulk_relaxes"] else shear
        elastic = elastic + shear + bulk
        damping = damping + material["viscosity_Pa_s"] / material["shear_relaxed_Pa"] * law
        for branch, tau in material["branches"]:
            relaxed.append((branch / material["shear_relaxed_Pa"] * law, tau))
    # q' = (u - q) / tau by the trapezoid rule: q = (1 - c) q_0 + c (u_0 + u) / 2 with c = 2 x / (1 + x), x = h / 2 tau
    fades = [2.0 * x / (1.0 + x) for x in (0.5 * step / tau for _, tau in relaxed)]
    whole = elastic + sum((1.0 - 0.5 * c) * k for (k, _), c in zip(relaxed, fades, strict=True))
    solver = Factor(4.0 / step**2 * mass + 2.0 / step * damping + whole)
    u, v = np.zeros(len(free)), np.zeros(len(free))
    q = [np.zeros(len(free)) for _ in relaxed]
    known = {}

    def load_at(moment):
        if load["law"] == "held" or len(knots) == 1:
            row = max(0, int(np.searchsorted(knots, moment + 1e-12, side="right")) - 1)
            peak, centre = load["peak_Pa"][row], load["centre_m"][row]
        else:
            peak = np.interp(moment, knots, load["peak_Pa"])
            centre = [np.interp(moment, knots, [row[axis] for row in load["centre_m"]]) for axis in range(2)]
        if push is None:
            return peak * forces[0][free]
        place = tuple(np.round(centre, 9))
        if place not in known:
            known.clear()
            known[place] = push(place)[free]
        return peak * known[place]

    # A load that is there at once accelerates the body at rest
    first = load_at(0.0)
    a = np.zeros(len(free))
    if np.any(first):
        inertia = Factor(mass)
        a = inertia.solve(first)
        inertia.free()
    seen = np.zeros((len(times), len(case["at_m"]), 3))
    for n in range(1, len(clock)):
        right = load_at(clock[n]) + mass @ (4.0 / step**2 * u + 4.0 / step * v + a) + damping @ (2.0 / step * u + v)
        for (k, _), c, inner in zip(relaxed, fades, q, strict=True):
            right = right + k @ ((1.0 - c) * inner + 0.5 * c * u)
        after = solver.solve(right)
        q = [(1.0 - c) * inner + 0.5 * c * (u + after) for c, inner in zip(fades, q, strict=True)]
        a = 4.0 / step**2 * (after - u) - 4.0 / step * v - a
        v = 2.0 / step * (after - u) - v
        u = after
        if n % count == 0:
            full = np.zeros(readers[0].shape[1])
            full[free] = u
            seen[n // count - 1] = np.column_stack([reader @ full for reader in readers])
    solver.free()
    return seen, len(free)


def instant(material):
    return material["shear_relaxed_Pa"] + sum(shear for shear, _ in material["branches"])


def eligible(case):
    """Return why a case is not solved here, or None."""
    if not case["by_scikit_fem"]:
        return "not asked for"
    if is_round(case) and np.any(np.asarray(case["load"]["centre_m"])):
        return "a disc under a spot beside its axis"
    return None


def truth(case, finer):
    why = eligible(case)
    if why is not None:
        return {"missing": why}
    coarsest, coarse, (fine, unknowns) = [solved(case, scale, finer) for scale in SCALES]
    first, second = worst(coarse[0], coarsest[0]), worst(fine, coarse[0])
    order = float(np.clip(math.log(first / second) / math.log(SCALES[1] / SCALES[2]), *ORDERS))
    error = second / ((SCALES[1] / SCALES[2]) ** order - 1.0)
    return {"displacement_m": fine.tolist(), "error": error, "order": order, "unknowns": unknowns}


def worst(found, known):
    """Return the relative L2 difference over the times, the largest over the points that move."""
    size, off = (np.linalg.norm(x, axis=(0, 2)) for x in (known, found - known))
    moving = size > 1e-9 * size.max()
    return float((off[moving] / size[moving]).max())


def rounded(value):
    """Return plain data with its numbers rounded to DIGITS digits."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    return [rounded(each) for each in value] if isinstance(value, list) else value


def give_up(number, frame):
    raise TooLongError("given up: too long")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path)
    parser.add_argument("truths", type=Path)
    parser.add_argument("--limit", type=float, default=120.0, help="longest processor time for a case [s]")
    parser.add_argument("--finer", type=float, default=1.0, help="how many times as fine round bodies are solved")
    settings = parser.parse_args()
    done = set()
    if settings.truths.exists():
        rows = map(json.loads, settings.truths.read_text().splitlines())
        done = {(row["key"], row.get("finer", 1.0)) for row in rows}
    signal.signal(signal.SIGPROF, give_up)
    # What is solved quickly comes first
    cases = json.loads(settings.cases.read_text())["cases"]
    for case in sorted(cases, key=lambda case: not is_round(case)):
        finer = settings.finer if is_round(case) else 1.0
        if (case["key"], finer) in done:
            continue
        begin = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, settings.limit)
        try:
            row = truth(case, finer)
        except (TooLongError, MemoryError, ValueError, RuntimeError, PyPardisoError) as error:
            row = {"missing": f"{type(error).__name__}: {error}"}
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        row = {"key": case["key"], "by": "scikit-fem", "finer": finer, **row, "seconds": time.process_time() - begin}
        with settings.truths.open("a") as file:
            file.write(json.dumps(rounded(row), separators=(",", ":")) + "\n")
        found = row.get("missing") or "error {error:.2g}, order {order:.2g}, {unknowns} unknowns".format(**row)
        print(f"{case['key']} {case['family']}: {found}, {row['seconds']:.0f} s", flush=True)


if __name__ == "__main__":
    sys.exit(main())
