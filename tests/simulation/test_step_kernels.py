"""Kernels that carry bodies, add up forces and drive transducers in a step on a device, against NumPy in float64."""

import itertools

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.acoustics.point_sound import Transducers
from palmfield.config import ArrayConfig, StimulusConfig
from palmfield.device import SharedBlock, filled
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.boards import BOARDS
from palmfield.drive.path_drives import PathDrives, PathMemory, push_rows
from palmfield.drive.response import Pole
from palmfield.drive.response_error import ResponseError
from palmfield.drive.transducer_response import TransducerResponse, delays_now, emitted_over, flight_delays
from palmfield.simulation.emission import mean_weights
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.schedule import frames_at, substep_moments
from palmfield.transforms import IDENTITY, Placement, Transform
from warp_kernels import carried_points, resultants, world_steps

WORLDS = 2
HERE = Placement.of(IDENTITY)
NONE = ResponseError(0.0, 0.0)


@pytest.fixture
def random():
    return np.random.default_rng(5)


def ran(kernel, dim, inputs, *results):
    """Launches a kernel, and what it leaves; results: shape and type of each."""
    made = [wp.zeros(shape, dtype=dtype, device="cpu") for shape, dtype in results]
    wp.launch(kernel, dim, [*inputs, *made], device="cpu")
    return [one.numpy() for one in made]


def given(values, dtype):
    return wp.array(np.asarray(values), dtype=dtype, device="cpu")


def turned(random, *shape):
    return Rotation.random(int(np.prod(shape)), random).as_matrix().reshape(*shape, 3, 3)


def test_bodies_and_foci_are_where_the_first_array_sees_them(random):
    places, axes, rows = random.normal(size=(WORLDS, 4, 3)), turned(random, WORLDS, 4), [1, 3]
    frames = given(places, wp.vec3d), given(axes, wp.mat33d)
    rest, points = random.normal(size=(2, 2, 3))
    inputs = [*frames, given(rows, wp.int32), given(rest, wp.vec3d)]
    results = [((WORLDS, 2), dtype) for dtype in (wp.mat33d, wp.vec3d, wp.vec3d)]
    turns, shifts, origins = ran(world_steps.place_parts, (WORLDS, 2), inputs, *results)
    own = random.normal(size=(WORLDS, 5, 3))
    inputs = [*frames, 2, given(own, wp.vec3d)]
    [foci] = ran(world_steps.place_foci, (WORLDS, 5), inputs, ((WORLDS, 5), wp.vec3d))
    for world in range(WORLDS):
        first, _, stimulus, _ = (Transform(*frame) for frame in zip(places[world], axes[world], strict=True))
        np.testing.assert_allclose(foci[world], first.inverse_points(stimulus.points(own[world])), atol=1e-12)
        for part, row in enumerate(rows):
            body = Transform(places[world, row], axes[world, row])
            now = first.inverse_points(body.points(points[part] - rest[part]))
            np.testing.assert_allclose(turns[world, part] @ points[part] + shifts[world, part], now, atol=1e-12)
            np.testing.assert_allclose(origins[world, part], first.inverse_points(body.position), atol=1e-12)


def test_the_lowest_corner_of_a_box_is_told_over_the_highest_board(random):
    turns, origins = turned(random, WORLDS, 3), random.normal(size=(WORLDS, 3, 3))
    centres, halves = random.normal(size=(3, 3)), random.uniform(0.1, 1.0, (3, 3))
    boards = np.column_stack([turned(random, 2)[:, 2], [0.1, -0.3]])
    inputs = [given(turns, wp.mat33d), given(origins, wp.vec3d), given(centres, wp.vec3d), given(halves, wp.vec3d)]
    inputs.append(given(boards, wp.vec4d))
    [found] = ran(world_steps.heights, (WORLDS, 3), inputs, ((WORLDS, 3), wp.float64))
    corners = centres + np.array(list(itertools.product((-1, 1), repeat=3)))[:, None] * halves
    moved = np.einsum("wpij,cpj->wcpi", turns, corners) + origins[:, None]
    above = moved @ boards[:, :3].T - boards[:, 3]
    np.testing.assert_allclose(found, above.min(axis=(1, 3)), atol=1e-12)


def test_points_and_faces_go_with_the_mean_of_their_motions(random):
    turns, shifts = turned(random, WORLDS, 3), random.normal(size=(WORLDS, 3, 3))
    rest, directions = random.normal(size=(2, 6, 3))
    numbers, shares = random.integers(0, 3, (6, 4)), random.dirichlet(np.ones(4), 6)
    faces = np.array([[0, 1, 2], [3, 4, 5], [2, 0, 4]])
    carriers = filled(carried_points.Carriers(), motions=given(numbers, wp.vec4i), shares=given(shares, wp.vec4d))
    motions = filled(carried_points.Motions(), turns=given(turns, wp.mat33d), shifts=given(shifts, wp.vec3d))
    points, normals = ran(
        carried_points.carry_points,
        (WORLDS, 6),
        [given(rest, wp.vec3d), given(directions, wp.vec3d), carriers, motions],
        *[((WORLDS, 6), wp.vec3)] * 2,
    )
    middles, outwards, areas = ran(
        carried_points.carry_faces,
        (WORLDS, 3),
        [given(rest, wp.vec3d), given(faces, wp.vec3i), carriers, motions],
        *[((WORLDS, 3), wp.vec3)] * 2,
        ((WORLDS, 3), wp.float64),
    )
    turn = np.einsum("nk,wnkij->wnij", shares, turns[:, numbers])
    moved = np.einsum("wnij,nj->wni", turn, rest) + np.einsum("nk,wnkj->wnj", shares, shifts[:, numbers])
    outward = np.einsum("wnij,nj->wni", turn, directions)
    np.testing.assert_allclose(points, moved, atol=1e-6)
    np.testing.assert_allclose(normals, outward / np.linalg.norm(outward, axis=2, keepdims=True), atol=1e-6)
    a, b, c = np.moveaxis(moved[:, faces], 2, 0)
    across = np.cross(b - a, c - a)
    np.testing.assert_allclose(middles, (a + b + c) / 3.0, atol=1e-6)
    np.testing.assert_allclose(areas, 0.5 * np.linalg.norm(across, axis=2), rtol=1e-12)
    np.testing.assert_allclose(outwards, across / np.linalg.norm(across, axis=2, keepdims=True), atol=1e-6)


def test_a_mean_pressure_pushes_each_part_about_its_own_origin(random):
    moments, count, parts = 3, 90, np.repeat([0, 1], [40, 50])
    points, normals = random.normal(size=(2, WORLDS, count, 3)).astype(np.float32)
    arp = random.uniform(1.0, 2.0, (WORLDS * moments, count)).astype(np.float32)
    areas, weights = random.uniform(0.1, 1.0, (WORLDS, count)), random.uniform(0.1, 1.0, (WORLDS, moments))
    used, corners = np.array([3, 2]), random.normal(size=(4, 3)).astype(np.float32)
    surface = given(points, wp.vec3), given(normals, wp.vec3)
    inputs = [given(np.column_stack([used, used]), wp.int32), given(weights, wp.float64), given(arp, wp.float32)]
    inputs += [given(areas, wp.float64), *surface, given(corners, wp.vec3)]
    [load] = ran(resultants.mean_load, (WORLDS, count), inputs, ((WORLDS, count), wp.float64))
    counted = np.where(np.arange(moments) < used[:, None], weights, 0.0)
    mean = np.einsum("wm,wmn->wn", counted, arp.reshape(WORLDS, moments, count))
    seen = np.einsum("wncj,wnj->wnc", corners - points[:, :, None], normals).max(axis=2) > 0.0
    assert 0 < seen.sum() < seen.size
    np.testing.assert_allclose(load, mean * areas * seen, rtol=1e-6)

    # Runs of 1 to 3 points, more of them in a part than there are lanes
    starts = np.unique([0, 40, 90, *random.integers(1, 90, 60)])
    first = np.searchsorted(starts, [0, 40, 90])
    assert np.diff(first).max() > resultants.LANES
    order, origins = (
        np.concatenate([random.permutation(40), 40 + random.permutation(50)]),
        random.normal(size=(2, 2, 3)),
    )
    inputs = [given(load, wp.float64), *surface, given(order, wp.int32), given(starts, wp.int32)]
    inputs += [given(parts[starts[:-1]], wp.int32), given(origins, wp.vec3d)]
    runs = len(starts) - 1
    [sums] = ran(resultants.sums_of_runs, (WORLDS, runs), inputs, ((WORLDS, runs, 6), wp.float64))
    in_lanes = WORLDS, resultants.LANES, 2, 6
    inputs = [given(sums, wp.float64), given(first, wp.int32)]
    [lanes] = ran(resultants.sums_of_parts, in_lanes, inputs, (in_lanes, wp.float64))
    [found] = ran(resultants.sums_of_lanes, (WORLDS, 2, 6), [given(lanes, wp.float64)], ((WORLDS, 2, 6), wp.float64))
    pushes = -load[..., None] * normals
    for part in range(2):
        own = parts == part
        turning = np.cross(points[:, own] - origins[:, part, None], pushes[:, own]).sum(axis=1)
        expected = np.concatenate([pushes[:, own].sum(axis=1), turning], axis=1)
        np.testing.assert_allclose(found[:, part], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("keys", [{"arp_peak_Pa": 5.0}, {"control_rate_Hz": 2500.0}], ids=["level", "ticks"])
def test_transducers_ring_along_a_path_as_in_numpy(keys):
    circle = {"focus_m": (0.01, 0.0, 0.15), "path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 170.0}
    am = {"modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": 200.0, "am_depth": 0.5}
    config = StimulusConfig(**circle | am | keys)
    arrays = PhasedArray([ArrayInstance(ArrayConfig(layout="uhev1"), HERE)], [HERE], "cpu")
    count, everything = len(arrays), np.arange(len(arrays), dtype=np.int32)
    drive = ArrayDrive(arrays, everything, config.arp_peak_Pa, config.drive_amplitude, BOARDS["ideal"])
    place, moments = FocalPoints(IDENTITY), substep_moments((config,), 0.0013, 1.25e-4, 8)
    pole = Pole(np.full(count, 40.2e3), np.full(count, 25.0), 40e3)
    response = TransducerResponse(True, NONE, NONE, 0.0, pole, flight_delays(drive, np.array([0.01, 0.0, 0.15])))
    lags, group = delays_now(config, drive, place)
    points, factors = frames_at(config, np.append(moments.times[:, None] - lags, 0.0013))
    begun, weights = 0.3 * np.exp(0.1j * np.arange(count)), mean_weights(moments)
    counted = np.flatnonzero(weights)
    size, foci = len(moments.times), len(points)
    rows = {"load": size + 1, "force": len(counted), "now": 1}
    parts = PathMemory.inputs(size, foci, count) | PathMemory.results(foci, count)
    parts |= {f"path_{name}": ((number, count), wp.vec2) for name, number in rows.items()}
    block, path = SharedBlock(parts, "cpu"), PathDrives(drive, Transducers(arrays, "cpu"), response.stepper)
    hosts = block.hosts
    hosts["path_counts"][0] = foci, len(lags)
    hosts["path_group"][0], hosts["path_foci"][0], hosts["path_aims"][0] = group, points, path.aim
    hosts["path_targets"][0] = [*np.sqrt(factors[:-1]), 1.0, np.sqrt(factors[-1])]
    hosts["path_ring"].view(np.complex128)[..., 0] = path.ring(moments)
    hosts["path_begun"].view(np.complex128)[0, :, 0] = begun
    hosts["path_pushes"][:] = push_rows(weights)
    for call in path.calls(PathMemory(*(block.arrays[f"path_{name}"] for name in PathMemory._fields))):
        call()
    course = emitted_over(config, drive, response, begun, place, moments)
    found = {name: hosts[f"path_{name}"].view(np.complex64)[..., 0] for name in rows}
    strengths = arrays.parts[0].p0_Pa_m * course.units
    close = {"rtol": 1e-6, "atol": 1e-6 * np.abs(strengths).max()}
    np.testing.assert_allclose(found["load"][:-1], strengths, **close)
    np.testing.assert_allclose(found["force"], strengths[counted], **close)
    np.testing.assert_allclose(found["now"][0], arrays.parts[0].p0_Pa_m * begun, **close)
    assert not found["load"][-1].any() and len(lags) > 2
    np.testing.assert_allclose(hosts["path_end"].view(np.complex128)[0, :, 0], course.end, atol=1e-12)
