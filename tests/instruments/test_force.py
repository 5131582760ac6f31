"""Plates and scales against the integral of a Gaussian, and a pole's exact answer."""

import numpy as np
import pytest
from scipy.special import erf

from palmfield.errors import MeasurementError
from palmfield.instruments import Plate, Scale, mesh_force, plate_force, scale_reading

SIGMA, PEAK = 0.004, 100.0


def gaussian(points, normals=None):
    return PEAK * np.exp(-(points[:, 0] ** 2 + points[:, 1] ** 2) / (2.0 * SIGMA**2))


def on_square(side, x=0.0):
    def part(low, high):
        return SIGMA * np.sqrt(np.pi / 2.0) * (erf(high / SIGMA / np.sqrt(2)) - erf(low / SIGMA / np.sqrt(2)))

    return PEAK * part(x - side / 2, x + side / 2) * part(-side / 2, side / 2)


@pytest.mark.parametrize("side", [0.005, 0.012, 0.2])
def test_a_plate_takes_the_integral_over_its_face(side):
    found = plate_force(gaussian, Plate(width_m=side, height_m=side, centre_m=(0, 0, 0)))
    assert found.force_N == pytest.approx(on_square(side), rel=5e-3)
    assert abs(found.force_N - on_square(side)) <= abs(found.force_N - found.coarser_N) + 1e-12


@pytest.mark.parametrize("shape", ["rectangle", "disc"])
def test_the_error_of_a_plate_of_few_places_is_told(shape):
    for plate in (Plate(shape=shape, spacing_m=0.006), Plate(shape=shape, width_m=0.002, height_m=0.002)):
        found = plate_force(gaussian, plate)
        width = plate.width_m
        disc = 2.0 * np.pi * SIGMA**2 * PEAK * -np.expm1(-(width**2) / 8.0 / SIGMA**2)
        off = found.force_N - (on_square(width) if shape == "rectangle" else disc)
        # Gauss' rule on a small disc has no error left
        assert abs(off) <= abs(found.force_N - found.coarser_N) + 1e-15, plate


def test_a_disc_and_a_plate_off_the_middle():
    found = plate_force(gaussian, Plate(shape="disc", width_m=0.01, centre_m=(0, 0, 0)))
    exact = 2.0 * np.pi * SIGMA**2 * PEAK * (1.0 - np.exp(-(0.005**2) / 2.0 / SIGMA**2))
    assert found.force_N == pytest.approx(exact, rel=1e-6)
    shifted = plate_force(gaussian, Plate(centre_m=(0.003, 0, 0), spacing_m=2.5e-4))
    assert shifted.force_N == pytest.approx(on_square(0.012, 0.003), rel=1e-3)


def test_a_plate_asks_for_the_pressure_where_it_stands():
    seen = {}

    def uniform(points, normals):
        seen.setdefault("points", points)
        seen.setdefault("normals", normals)
        return np.ones(len(points))

    turned = Plate(centre_m=(0.1, 0.2, 0.3), normal=(1, 0, 0), x_axis=(0, 0, 1), width_m=0.02, height_m=0.01)
    found = plate_force(uniform, turned)
    assert found.force_N == pytest.approx(2e-4) and found.change < 1e-12
    assert np.ptp(seen["points"], axis=0) == pytest.approx([0.0, 0.009, 0.019], abs=1e-12)
    assert np.array_equal(seen["normals"][0], [1.0, 0.0, 0.0])


@pytest.mark.parametrize(("shape", "x"), [("rectangle", 0.0), ("rectangle", 0.003), ("disc", 0.0)])
def test_a_part_of_a_mesh(shape, x):
    at = np.arange(-20, 21) * 1e-3
    grid = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(41 * 41).reshape(41, 41)
    a, b, c, d = number[:-1, :-1].ravel(), number[1:, :-1].ravel(), number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    vertices = np.column_stack([grid, np.zeros(len(grid))])
    plate = Plate(shape=shape, centre_m=(x, 0, 0), normal=(0, 0, 1))
    found = mesh_force(np.stack([gaussian(vertices), np.ones(len(vertices))]), vertices, faces, plate)
    exact = (
        on_square(0.012, x) if shape == "rectangle"
        else 2.0 * np.pi * SIGMA**2 * PEAK * (1.0 - np.exp(-(0.006**2) / 2.0 / SIGMA**2))
    )  # fmt: skip
    assert found[0] == pytest.approx(exact, rel=0.01)
    assert found[1] == pytest.approx(0.012**2 if shape == "rectangle" else np.pi * 0.006**2, rel=0.01)
    # The back of a closed body is pushed the other way
    back = (vertices - [0, 0, 0.01], faces[:, ::-1] + len(vertices))
    closed = np.vstack([vertices, back[0]]), np.vstack([faces, back[1]])
    assert abs(mesh_force(np.ones(len(closed[0])), *closed, plate)) < 1e-12
    with pytest.raises(MeasurementError, match="arp has shape"):
        mesh_force(np.ones(3), vertices, faces, plate)


def test_a_scale_settles_as_a_pole_and_shows_its_digits():
    times = np.arange(0.0, 2.0, 0.01)
    force = np.zeros((200, 3))
    force[:, 2] = -1e-3 * np.clip(times, 0.0, 1.0)
    shown = scale_reading(times, force, Scale(time_constant_s=0.1))
    ramp = 1e-3 * (times - 0.1 * (1.0 - np.exp(-times / 0.1)))
    assert shown[times < 1.0] == pytest.approx(ramp[times < 1.0], abs=1e-15)
    coarse = scale_reading(times, force, Scale(resolution_N=1e-4))
    assert set(np.round(coarse / 1e-4, 9) % 1.0) == {0.0}
    assert scale_reading(times, force - np.array([0, 0, 1.0]), Scale())[-1] == pytest.approx(1e-3)
    assert scale_reading(times, force - np.array([0, 0, 1.0]), Scale(tared=False))[-1] == pytest.approx(1.001)


def test_what_can_not_be_weighed_is_told():
    with pytest.raises(MeasurementError, match=r"x_axis .* lies along the normal"):
        plate_force(gaussian, Plate(x_axis=(0, 0, 1)))
    with pytest.raises(MeasurementError, match="the ARP at"):
        plate_force(lambda points, normals: np.full(len(points), np.nan), Plate())
    with pytest.raises(MeasurementError, match="key 'shape' has value 'ring'"):
        Plate(shape="ring")
    with pytest.raises(MeasurementError, match="force has shape"):
        scale_reading([0.0, 1.0], np.zeros((2, 2)), Scale())
