"""Truths for skin cases by scikit-fem, with nothing of palmfield: own meshes, elements and steps; from the case file.

    ~/.cache/palmfield-peers/bin/python scripts/peers/skin_truths.py CASES.json TRUTHS.jsonl [--limit 300]

A round body under a spot in its middle is solved in r and z by quadratic quadrilaterals of nine nodes, boxes and bent
layers by quadratic hexahedra of 27; in time by the trapezoid rule, the branches with it. Every case is solved twice,
the second time finer in space and time; the error of the finer one is their difference. Rows are appended, so that a
run goes on where it ended.
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
from scipy import sparse
from scipy.sparse.linalg import splu
from skfem.helpers import ddot, div, dot, sym_grad

GAUSSIAN = 4.0 * math.log(2.0)
COARSER = 1.5
"""Size of elements and steps of the first solution over that of the second."""
STEPS_A_WIDTH = 60.0
"""Time steps while a shear wave crosses the spot."""
MOST_UNKNOWNS = 60_000


class TooLongError(Exception):
    """A run took longer than it may."""


def graded(length, first, most, growth=1.35):
    """Lines from 0 to length: cells of `first`, growing to at most `most`."""
    sizes = [first]
    while sum(sizes) < length:
        sizes.append(min(growth * sizes[-1], most))
    lines = np.concatenate([[0.0], np.cumsum(sizes)])
    return lines * (length / lines[-1])


def depth_lines(sheets, size):
    """Lines from the face, 0, down through each sheet."""
    lines, top = [0.0], 0.0
    for sheet in sheets:
        thickness = sheet["thickness_m"]
        count = max(2, math.ceil(thickness / size))
        lines += (top + thickness * np.arange(1, count + 1) / count).tolist()
        top += thickness
    return np.array(lines)


def sheet_at(sheets, depth):
    """Number of the sheet at each depth."""
    bottoms = np.cumsum([sheet["thickness_m"] for sheet in sheets])
    return np.minimum(np.searchsorted(bottoms, depth), len(sheets) - 1)


def axisymmetric(case, size):
    """Matrices, force per pascal, free unknowns and readers of a disc under a spot in its middle."""
    body, width = case["body"], case["load"]["fwhm_m"]
    radius, sheets = body["radius_m"], body["sheets"]
    rim = graded(radius, 0.2 * size, size)
    r = (
        np.unique(np.concatenate([[0.0], radius - rim[:-1]]))
        if body["side"] != "roller"
        else graded(radius, size, size)
    )
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
        strain = 2.0 * (ddot(sym_grad(u), sym_grad(v)) + hoop(u, w) * hoop(v, w))
        return strain * w.x[0] - 2.0 / 3.0 * bulk(u, v, w)

    def inertia(u, v, w):
        return dot(u, v) * w.x[0]

    matrices = by_sheet(mesh, element, which, len(sheets), (shear, bulk, inertia), 6)
    face = mesh.facets_satisfying(lambda x: np.isclose(x[1], 0.0))
    top = fem.FacetBasis(mesh, element, facets=face, intorder=8)
    force = fem.LinearForm(
        lambda v, w: -np.exp(-GAUSSIAN * (w.x[0] / width) ** 2) * v[1] * w.x[0]
    ).assemble(top)  # fmt: skip
    held = [at_places(basis, lambda x: np.isclose(x[0], 0.0), 0)]
    bottom, side = (lambda x: np.isclose(x[1], z[0])), (lambda x: np.isclose(x[0], radius))
    held += [at_places(basis, bottom, 1)] + ([at_places(basis, bottom, 0)] if body["base"] == "bonded" else [])
    if body["side"] in ("fixed", "roller"):
        held.append(at_places(basis, side, 0))
    if body["side"] == "fixed":
        held.append(at_places(basis, side, 1))
    points = np.asarray(case["at_m"])
    away = np.hypot(*points.T)
    probe = basis.probes(np.stack([np.clip(away, 1e-9, radius * (1.0 - 1e-9)), np.full(len(points), -1e-12)])).tocsr()
    out, up = probe[: len(points)], probe[len(points) :]
    unit = points / np.maximum(away, 1e-300)[:, None]
    readers = [sparse.diags(unit[:, 0]) @ out, sparse.diags(unit[:, 1]) @ out, up]
    return matrices, [force], free_of(basis, held), readers


def at_places(basis, where, component):
    """Unknowns of one component whose places satisfy a condition."""
    dofs = np.flatnonzero(where(basis.doflocs))
    return dofs[component_of(basis)[dofs] == component]


def component_of(basis):
    """Component of the vector to which each unknown belongs: vector elements count theirs in turn."""
    size = basis.mesh.dim()
    result = np.zeros(basis.N, dtype=int)
    result[basis.element_dofs] = (np.arange(len(basis.element_dofs)) % size)[:, None]
    return result


def free_of(basis, held):
    free = np.ones(basis.N, dtype=bool)
    free[np.unique(np.concatenate(held))] = False
    return np.flatnonzero(free)


def by_sheet(mesh, element, which, count, forms, intorder):
    """Matrices of each form on the elements of each sheet."""
    result = []
    for number in range(count):
        part = fem.Basis(mesh, element, elements=np.flatnonzero(which == number), intorder=intorder)
        result.append([fem.BilinearForm(form).assemble(part) for form in forms])
    return result


def block(case, size):
    """The same of a box or bent layer, with a force for each time of the load."""
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
    shear = lambda u, v, w: 2.0 * ddot(sym_grad(u), sym_grad(v)) - 2.0 / 3.0 * div(u) * div(v)  # noqa: E731
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
    """Operators that read each component at places of the unbent mesh, whose reference places are the bent one's."""
    rows = basis.probes(points).tocsr()
    count = points.shape[1]
    return [rows[n * count : (n + 1) * count] for n in range(3)]


def bent(body, places):
    """Places of a bent layer: each depth along the face's normal below (x, y)."""
    x, y, z = places
    (a, k), (rx, ry) = body["bump"], body["radii_m"]
    face = -0.5 * (x**2 / rx + y**2 / ry) + a * np.cos(k * x) * np.cos(k * y)
    along = -x / rx - a * k * np.sin(k * x) * np.cos(k * y)
    across = -y / ry - a * k * np.cos(k * x) * np.sin(k * y)
    inward = np.stack([along, across, -np.ones_like(x)])
    inward /= np.linalg.norm(inward, axis=0)
    return np.stack([x, y, face]) - z * inward


def solved(case, scale):
    """Displacement at the case's times and points, (t, n, 3), by elements and steps `scale` times as large."""
    body, load = case["body"], case["load"]
    sheets, width = body["sheets"], load["fwhm_m"]
    depth = sum(sheet["thickness_m"] for sheet in sheets)
    materials = [sheet["material"] for sheet in sheets]
    speed = max(math.sqrt(instant(m) / m["density_kg_m3"]) for m in materials)
    small = min(width, 2.0 * depth)
    if body["shape"] == "disc":
        matrices, forces, free, readers = axisymmetric(case, scale * 0.05 * small)
        push = None
    else:
        matrices, push, free, readers = block(case, scale * 0.3 * min(width, 1.5 * depth))
    if len(free) > MOST_UNKNOWNS:
        raise ValueError(f"{len(free)} unknowns, above {MOST_UNKNOWNS}")
    times = np.asarray(case["times_s"])
    between = times[1] - times[0] if len(times) > 1 else times[0]
    step = scale * small / speed / STEPS_A_WIDTH
    count = max(1, math.ceil(between / step))
    step = between / count
    knots = np.asarray(load["times_s"])
    clock = np.arange(count * len(times) + 1) * step
    cut = [[m[free][:, free].tocsc() for m in each] for each in matrices]
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
    solver = factor(4.0 / step**2 * mass + 2.0 / step * damping + whole)
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
    a = factor(mass).solve(first) if np.any(first) else np.zeros(len(free))
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
    return seen, len(free)


def factor(matrix):
    """Factors of a symmetric positive definite matrix."""
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def instant(material):
    return material["shear_relaxed_Pa"] + sum(shear for shear, _ in material["branches"])


def eligible(case):
    """Why a case isn't solved here, or None."""
    body, load = case["body"], case["load"]
    if body["shape"] == "infinite":
        return "an endless body"
    if body["shape"] == "disc" and np.any(np.asarray(load["centre_m"])):
        return "a disc under a spot beside its axis"
    return None


def truth(case):
    why = eligible(case)
    if why is not None:
        return {"missing": why}
    coarse, _ = solved(case, COARSER)
    fine, unknowns = solved(case, 1.0)
    size, off = (np.linalg.norm(x, axis=(0, 2)) for x in (fine, fine - coarse))
    moving = size > 1e-9 * size.max()
    return {
        "displacement_m": fine.tolist(), "error": float((off[moving] / size[moving]).max()), "unknowns": unknowns,
    }  # fmt: skip


def give_up(number, frame):
    raise TooLongError("given up: too long")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path)
    parser.add_argument("truths", type=Path)
    parser.add_argument("--limit", type=float, default=300.0, help="longest time for a case [s]")
    settings = parser.parse_args()
    done = set()
    if settings.truths.exists():
        done = {json.loads(line)["key"] for line in settings.truths.read_text().splitlines()}
    signal.signal(signal.SIGALRM, give_up)
    for case in json.loads(settings.cases.read_text())["cases"]:
        if case["key"] in done:
            continue
        begin = time.perf_counter()
        signal.setitimer(signal.ITIMER_REAL, settings.limit)
        try:
            row = truth(case)
        except (TooLongError, MemoryError, ValueError, RuntimeError) as error:
            row = {"missing": f"{type(error).__name__}: {error}"}
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        row = {"key": case["key"], "by": "scikit-fem", **row, "seconds": time.perf_counter() - begin}
        with settings.truths.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(case["key"], case["family"], row.get("missing", f"error {row.get('error', 0.0):.2g}"),
              f"{row['seconds']:.0f} s", flush=True)  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
