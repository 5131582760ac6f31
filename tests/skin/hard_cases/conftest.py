"""One small body and one short load for every solver, so that a case is one test with six parameters."""

import dataclasses
import importlib

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from palmfield.cache import digest
from palmfield.skin.fem.body import build
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.traction import PressureHistory
from palmfield.skin.mesh.body_mesh import Sizes
from palmfield.skin.problem import Motion, SkinProblem, Spot, points_on_face
from palmfield.skin.reduction.reducer import reduce
from palmfield.skin.solvers.axisymmetric.samples import principal_shapes

FWHM = 0.0103
SIZES = Sizes((0.0, 0.0), 0.012, 0.0055, 0.0055, 0.004, 0.004, 1, 0.03, 0.02, 150.0)
"""Edges of 5.5 mm, rows of 4 mm: 1.5 k unknowns on a disc of 40 x 8 mm."""

HOW = {
    "lateral_waves": {"accuracy": 2e-3},
    "axisymmetric": {"degree": 5},
    "wedges": {"sizes": SIZES, "step_s": 2.5e-4},
    "spectral_elements": {"size_m": 0.0055, "estimate": False},
    "particles": {"spacing_m": 2e-3},
    "reduced": {"sizes": SIZES},
}
WHERE = {
    "lateral_waves": "palmfield.skin.solvers.lateral_waves",
    "axisymmetric": "palmfield.skin.solvers.axisymmetric.solve",
    "wedges": "palmfield.skin.solvers.wedges",
    "spectral_elements": "palmfield.skin.solvers.spectral_elements.solve",
    "particles": "palmfield.skin.solvers.particles",
}


def reduced(body, load, times, at, *, sizes=SIZES, band_Hz=(0.0, 900.0), tolerance=3e-3):
    """Motion by a reduced model of the wedges' matrices: shapes of the load in, asked points out."""
    points = points_on_face(body, at)
    system = build(body, sizes)
    history = PressureHistory(load, system.mesh, system)
    start, end = float(load.times_s[0]), float(times[-1])
    knots = load.times_s[load.times_s <= end]
    moves = isinstance(load, Spot) and np.ptp(load.centres(), axis=0).any()
    fine = np.linspace(start, end, 160) if moves else np.zeros(0)
    grid = np.unique(np.concatenate([[start], knots, times[times > start], fine]))
    forces = np.column_stack([history.operator @ history.pressure(t) for t in grid])
    shapes, course = principal_shapes(forces, 1e-3)
    read = SurfaceProbe(system.mesh, points, system).vectors
    model = reduce(system, shapes, read, band_Hz, tolerance, order=system.elimination_order())
    moved = [part.reshape(len(grid), len(points), 3) for part in model.run(course.T, grid, load.law)]
    rows = np.searchsorted(grid, times)
    late = (times > start)[:, None, None]
    u, v = (np.where(late, part[np.minimum(rows, len(grid) - 1)], 0.0) for part in moved)
    return Motion(times, points, u, v, model.error, "", f"reduced, {model.order} vectors", 0.0)


@pytest.fixture(autouse=True)
def one_thread():
    """Factors of such small matrices take a hundred times as long where threads of BLAS wait for each other."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(scope="session")
def solve_by():
    """(name, body, load, times, at, **resolution) -> Motion, at a cheap resolution unless one is given.

    Solved once: what a solver is compared with is the same in many cases.
    """
    known = {}

    def run(name, body, load, times, at, **resolution):
        asked = digest(name, body, load, times, at, {**HOW[name], **resolution})
        if asked not in known:
            known[asked] = solved(name, body, load, times, at, **resolution)
        return known[asked]

    def solved(name, body, load, times, at, **resolution):
        how = {**HOW[name], **resolution}
        at = np.asarray(at, dtype=float)
        if name == "reduced":
            return reduced(body, load, np.asarray(times, dtype=float), at, **how)
        asked = {key: how.pop(key) for key in ("accuracy", "accuracy_of", "device") if key in how}
        problem = SkinProblem(body, load, times, at, **asked)
        return getattr(importlib.import_module(WHERE[name]), f"solve_{name}")(problem, **how)

    return run


@pytest.fixture(scope="session")
def refusal_by():
    """(name, body, load) -> str | None. A reduced model is of the wedges' matrices."""

    def why(name, body, load):
        name = "wedges" if name == "reduced" else name
        return getattr(importlib.import_module(WHERE[name]), f"refusal_{name}")(body, load)

    return why


@pytest.fixture(scope="session")
def sizes_like():
    def make(**changes):
        return dataclasses.replace(SIZES, **changes)

    return make


@pytest.fixture(scope="session")
def miss():
    """(found, exact) displacements (t, n, 3) -> L2 over times at a point, the largest of the points, relative."""

    def relative(found, exact):
        size = np.linalg.norm(exact, axis=(0, 2))
        return float((np.linalg.norm(found - exact, axis=(0, 2)) / size).max())

    return relative


@pytest.fixture(scope="session")
def burst():
    """A smooth push of 1 Pa and 8 ms under a spot of 10.3 mm."""
    times = np.linspace(0.0, 8e-3, 65)
    return Spot(FWHM, times, 0.5 * (1.0 - np.cos(2.0 * np.pi * times / 8e-3)))
