"""A traction over and beside a body: what lies on it presses, whatever the solver, and what lies off it does not."""

from dataclasses import replace

import numpy as np
import pytest

from palmfield.skin import Layer, Sheet, Slab, Traction, solve, static
from palmfield.skin.fem.on_body import off_face, on_body
from palmfield.skin.materials.material import standard_linear
from palmfield.types import Patch

GEL = standard_linear("gel", 1030.0, 12.5e3, 20e3, 3.42 / 20e3, 0.45, nu_of="relaxed")
DEEP, SIDE, RADIUS = 0.02, 0.03, 0.015
COLUMN = DEEP / (GEL.bulk_Pa + 4.0 / 3.0 * GEL.shear_relaxed_Pa)
"""What a column between rollers moves by under 1 Pa [m], exactly."""
BOX = Slab((Sheet(GEL, DEEP),), shape="box", side="roller", size_m=(SIDE, SIDE))
DISC = Slab((Sheet(GEL, DEEP),), shape="disc", side="roller", radius_m=RADIUS)
PERIOD = 4.0 * DEEP * np.sqrt(GEL.density_kg_m3 / (GEL.bulk_Pa + 4.0 / 3.0 * GEL.shear_relaxed_Pa))
RAMP = np.array([0.0, 2.0 * PERIOD])
"""Load within whole periods of the column, after which it hardly rings [s]."""
LATE = np.linspace(2.2, 4.2, 40) * PERIOD


def even(line, angle=0.0, weight=1.0):
    """1 Pa on a square grid of points, turned by an angle."""
    x, y = np.meshgrid(line, line, indexing="ij")
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = np.column_stack([np.column_stack([x.ravel(), y.ravel()]) @ turn.T, np.zeros(x.size)])
    weights = np.full(len(points), weight * (line[1] - line[0]) ** 2)
    return Traction(points, weights, RAMP, np.outer([0.0, 1.0], np.ones(len(points))))


LOADS = {
    "inside": even((np.arange(11) - 5) * SIDE / 11),
    "one row off": even((np.arange(13) - 6) * SIDE / 11),
    "on the rim": even(np.linspace(-0.5 * SIDE, 0.5 * SIDE, 12)),
    "turned, far off, between the rows": even((np.arange(28) - 13.3) * 0.0023, 0.4),
}


@pytest.mark.parametrize("solver", ["wedges", "reduced", "lateral_waves", "spectral_elements", "particles"])
@pytest.mark.parametrize("name", LOADS)
def test_even_pressure_moves_a_column_by_its_own_stiffness(solver, name):
    motion = solve(BOX, LOADS[name], LATE, [[0.0, 0.0], [0.005, 0.002]], solver=solver, accuracy=0.2, device="cpu")
    moved = -motion.displacement_m[:, :, 2].mean(axis=0)
    assert np.abs(moved / COLUMN - 1.0).max() < min(motion.displacement_error, 0.02) + 0.005


def test_a_disc_under_a_map_that_is_larger():
    load = LOADS["turned, far off, between the rows"]
    for solver in ("wedges", "spectral_elements"):
        motion = solve(DISC, load, LATE, [[0.0, 0.0], [0.007, 0.0]], solver=solver, accuracy=0.2, device="cpu")
        moved = -motion.displacement_m[:, :, 2].mean(axis=0)
        assert np.abs(moved / COLUMN - 1.0).max() < min(motion.displacement_error, 0.02) + 0.005


@pytest.mark.parametrize("seed", range(10))
def test_the_force_is_that_of_the_pressure_over_the_face(seed):
    """Random bodies, spacings, angles and offsets under p = 1 + x / 20 mm + y / 50 mm: against its integral."""
    random = np.random.default_rng(seed)
    round_body = bool(seed % 2)
    body = DISC if round_body else replace(BOX, size_m=tuple(random.uniform(0.02, 0.04, 2)))
    step = random.uniform(0.0004, 0.003)
    load = even((np.arange(-30, 31) + random.uniform(-0.5, 0.5)) * max(step, 0.0012), random.uniform(0.0, np.pi))
    pressure = 1.0 + load.points[:, 0] / 0.02 + load.points[:, 1] / 0.05
    found = on_body(body, replace(load, pressure_Pa=np.outer([0.0, 1.0], pressure)))
    area = np.pi * RADIUS**2 if round_body else np.prod(body.size_m)
    assert off_face(body, found.points).max() == 0.0
    assert float(found.pressure_Pa[-1] @ found.weights_m2) == pytest.approx(area, rel=2e-3)
    centre = (found.pressure_Pa[-1] * found.weights_m2) @ found.points[:, :2] / area
    second = RADIUS**2 / 4.0 if round_body else np.array(body.size_m) ** 2 / 12.0
    assert centre == pytest.approx(second / np.array([0.02, 0.05]), rel=0.02)


def test_what_lies_on_the_body_is_left_as_it_is():
    inside = LOADS["inside"]
    assert np.array_equal(on_body(BOX, inside).pressure_Pa, inside.pressure_Pa)
    endless = Slab((Sheet(GEL, DEEP),))
    assert np.array_equal(on_body(endless, LOADS["one row off"]).points, LOADS["one row off"].points)


@pytest.mark.parametrize("body", [BOX, DISC])
def test_a_load_off_the_body_moves_nothing(body):
    points = [[0.05, 0.0, 0.0], [0.051, 0.0, 0.0], [0.0, 0.06, 0.0]]
    for count in (1, 3):
        load = Traction(points[:count], np.full(count, 1e-6), np.zeros(1), np.full((1, count), 1e3), "held")
        assert not solve(body, load, [0.001], [[0.0, 0.0]], device="cpu").displacement_m.any()
        assert not static(body, load, [[0.0, 0.0]]).displacement_m.any()


def test_a_layer_is_pressed_to_its_rim_and_no_further():
    line = np.linspace(-0.01, 0.01, 11)
    x, y = (a.ravel() for a in np.meshgrid(line, line, indexing="ij"))
    corner = np.arange(100) + np.repeat(np.arange(10), 10)
    faces = np.concatenate(
        [np.stack([corner, corner + 11, corner + 1], 1), np.stack([corner + 1, corner + 11, corner + 12], 1)]
    )
    vertices = np.column_stack([x, y, 2.0 * x**2])
    patch = Patch(
        vertices=vertices,
        faces=faces.astype(np.int32),
        inward=np.tile([0.0, 0.0, -1.0], (121, 1)),
        depth=np.full(121, 0.004),
        rim=np.maximum(abs(x), abs(y)) > 0.00999,
    )
    layer = Layer(patch, (Sheet(GEL, 0.004),))
    wide = even((np.arange(41) - 20) * 0.0008)
    wide = replace(wide, points=np.column_stack([wide.points[:, :2], 2.0 * wide.points[:, 0] ** 2]))
    found = on_body(layer, wide)
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    assert float(found.pressure_Pa[-1] @ found.weights_m2) == pytest.approx(area, rel=1e-3)
    near = np.abs(wide.points[:, :2]).max(axis=1) < 0.0105
    inner = Traction(wide.points[near], wide.weights_m2[near], RAMP, wide.pressure_Pa[:, near])
    moved = [static(layer, load, [[0.0, 0.0]], accuracy=0.5).displacement_m for load in (wide, inner)]
    assert np.abs(moved[0] - moved[1]).max() < 0.01 * np.abs(moved[1]).max()
