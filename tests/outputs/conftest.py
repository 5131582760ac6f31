"""A synthetic run: 16 x 16 array below, a flattened sphere as hand, a disc of skin under it with waves on it."""

import numpy as np
import pytest
import trimesh
import xarray as xr

from palmfield.outputs.schema import dataset

HEIGHT_M = 0.15
SINE_HZ = 200.0
STEP_S = 2e-4


def _disc(radius=0.03, rings=12):
    points = [[0.0, 0.0]]
    for ring in range(1, rings + 1):
        angle = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
        points += list(radius * ring / rings * np.column_stack([np.cos(angle), np.sin(angle)]))
    flat = np.array(points)
    from scipy.spatial import Delaunay

    # Clockwise in x and y is counter-clockwise seen from below, where the outside is.
    faces = Delaunay(flat).simplices
    a, b, c = (flat[faces[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces[area > 0] = faces[area > 0][:, ::-1]
    return np.column_stack([flat, np.zeros(len(flat))]), faces.astype(np.int32)


@pytest.fixture(scope="session")
def static_arrays():
    skin, faces = _disc()
    hand = trimesh.creation.icosphere(subdivisions=3)
    vertices = hand.vertices * [0.045, 0.09, 0.015] + [0.0, 0.0, 0.0151]
    squared = (vertices[:, :2] ** 2).sum(axis=1)
    pressure = np.where(vertices[:, 2] < 0.015, 1500.0 * np.exp(-squared / (2 * 0.006**2)), 0.0)
    grid = (np.arange(16) - 7.5) * 0.0105
    x, y = np.meshgrid(grid, grid)
    return {
        "skin_position": skin,
        "skin_faces": faces,
        "skin_depth": np.full(len(skin), 0.01),
        "skin_pressure": (1500.0 * np.exp(-(skin[:, :2] ** 2).sum(axis=1) / (2 * 0.006**2))).astype(np.float32),
        "surface_vertices": np.asarray(vertices),
        "surface_faces": np.asarray(hand.faces, dtype=np.int32),
        "surface_pressure": pressure.astype(np.float32),
        "surface_arp": (pressure**2 / 1.4e5).astype(np.float32),
        "transducer_position": np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]),
        "array_pose": np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
    }


@pytest.fixture(scope="session")
def block_arrays(static_arrays):
    """Function (first step, number of steps) -> arrays of a block; a wave of 200 Hz runs outwards at 5 m/s."""
    radius = np.linalg.norm(static_arrays["skin_position"], axis=1)

    def make(start, count):
        time = STEP_S * (start + np.arange(count))
        wave = np.cos(2 * np.pi * SINE_HZ * (time[:, None] - radius / 5.0)) * np.exp(-radius / 0.01)
        load = 16.0 * np.exp(-((radius / 0.008) ** 2)) * (1 - np.cos(2 * np.pi * SINE_HZ * time))[:, None]
        pose = np.array([0.0, 0.0, HEIGHT_M, 1.0, 0.0, 0.0, 0.0])
        return {
            "time": time,
            "normal_displacement": (-4e-6 * np.exp(-radius / 0.01) + 5e-6 * wave).astype(np.float32),
            "normal_velocity": (5e-6 * wave).astype(np.float32),
            "arp": load.astype(np.float32),
            "focus": np.tile([0.0, 0.0, HEIGHT_M], (count, 1)),
            "step_time": time,
            "body_pose": np.tile(pose, (count, 1)),
            "arp_force": np.tile([0.0, 0.0, 0.003], (count, 1)),
            "frame_time": time,
            "drive_amplitude": np.ones((count, 256), np.float32),
            "drive_phase": np.zeros((count, 256), np.float32),
        }

    return make


@pytest.fixture(scope="session")
def static(static_arrays) -> xr.Dataset:
    return dataset(**static_arrays)


@pytest.fixture(scope="session")
def result(static_arrays, block_arrays) -> xr.Dataset:
    """0.1 s of a whole run, as the runner hands it on."""
    return dataset(**static_arrays, **block_arrays(0, 500))
