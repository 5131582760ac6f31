"""A synthetic run: two arrays below, a flattened sphere and a small ball as bodies, a disc of skin under each with
waves on it. The small body has two bones."""

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay

from palmfield.outputs.schema import sensor_channels, tree
from palmfield.session.mujoco_scene import body_poses, mujoco_arrays

HEIGHT_M = 0.15
SINE_HZ = 200.0
STEP_S = 2e-4
MJCF = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.02 0 0  0 0.02 0  0 0 0.02"/>
    <material name="red" rgba="1 0 0 1"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.1"/>
    <body name="board"><geom type="box" size="0.08 0.08 0.002" contype="0" conaffinity="0"/></body>
    <body name="target" mocap="true" pos="0 0 0.3"/>
    <body name="hand" pos="0 0 0.15">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1" range="-0.01 0.02" limited="true"/>
      <geom name="palm" type="ellipsoid" size="0.04 0.08 0.01" density="1000"/>
      <body name="finger" pos="0 0.08 0">
        <joint name="flexion" axis="1 0 0" pos="0 0.001 0" range="-10 80" ref="5" limited="true"/>
        <joint name="abduction" axis="0 0 1" pos="0 0.001 0"/>
        <geom type="capsule" size="0.008 0.02" friction="0.7 0.005 0.0001" mass="0.02"/>
        <body name="tip" pos="0 0.03 0"><geom type="sphere" size="0.007" material="red"/></body>
        <body name="nail" pos="0 0.03 0.01" quat="0.9238795 0.3826834 0 0">
          <joint name="hinge" axis="0 1 0" range="-20 40" limited="true"/>
          <geom type="mesh" mesh="wedge" mass="0.001"/>
        </body>
      </body>
    </body>
    <body name="ball" pos="0.1 0 0.2"><freejoint/><geom type="cylinder" size="0.01 0.02" rgba="0 1 0 0.5"/></body>
  </worldbody>
</mujoco>"""
"""A scene of all kinds of geoms and joints that the synthetic run is said to be of."""
ATTRIBUTES = {
    "/": {"scene": "synthetic"},
    "/body/palm": {"body": "hand"},
    "/body/tip": {"body": "finger"},
    "/stimulus/pulse": {"arrays": ["below"]},
}


def disc(radius, rings):
    points = [[0.0, 0.0]]
    for ring in range(1, rings + 1):
        angle = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
        points += list(radius * ring / rings * np.column_stack([np.cos(angle), np.sin(angle)]))
    flat = np.array(points)
    # Clockwise in x and y is counter-clockwise seen from below, where the outside is.
    faces = Delaunay(flat).simplices
    a, b, c = (flat[faces[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces[area > 0] = faces[area > 0][:, ::-1]
    return np.column_stack([flat, np.zeros(len(flat))]), faces.astype(np.int32)


def _spot(points, width):
    return np.exp(-(points[:, :2] ** 2).sum(axis=1) / (2 * width**2))


def _skin(radius, rings, width):
    points, faces = disc(radius, rings)
    normals = np.tile([0.0, 0.0, -1.0], (len(points), 1))
    pressure = 1500.0 * _spot(points, width)
    return {
        "rest_position": points,
        "rest_normal": normals,
        "face": faces,
        "depth": np.full(len(points), 0.01),
        "loudest_time": np.array(0.0026),
        "loudest_pressure": pressure.astype(np.float32),
        "loudest_arp": (pressure**2 / 1.4e5).astype(np.float32),
    }


def _surface(size, width):
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices = ball.vertices * size + [0.0, 0.0, size[2] + 1e-4]
    pressure = np.where(vertices[:, 2] < size[2], 1500.0 * _spot(vertices, width), 0.0)
    return {
        "rest_position": np.asarray(vertices),
        "face": np.asarray(ball.faces, dtype=np.int32),
        "loudest_time": np.array(0.0026),
        "loudest_pressure": pressure.astype(np.float32),
        "loudest_arp": (pressure**2 / 1.4e5).astype(np.float32),
    }


def _bones(count):
    share = np.tile(np.float32([0.75, 0.25]), (count, 1))
    return {"bone_index": np.tile(np.int32([0, 1]), (count, 1)), "bone_weight": share}


def _array(count):
    grid = (np.arange(count) - 0.5 * (count - 1)) * 0.0105
    x, y = np.meshgrid(grid, grid)
    return {
        "transducer_position": np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]),
        "transducer_direction": np.tile([0.0, 0.0, 1.0], (x.size, 1)),
        "transducer_p0": np.full(x.size, 1.5),
        "transducer_phase": np.zeros(x.size),
        "piston_radius": np.array(4.5e-3),
    }


def bodies_at_rest():
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(MJCF))
    mujoco.mj_forward(data.model, data)
    return body_poses(data)


@pytest.fixture(scope="session")
def static_arrays():
    """What is known before the first step, and the loudest instant's."""
    groups = {
        "/array/below": _array(16),
        "/array/beside": _array(8)
        | {"off_axis_angle": np.array([0.0, 45.0, 90.0]), "off_axis_level": np.array([1.0, 0.7, 0.5])},
        "/skin/palm": _skin(0.03, 12, 0.006),
        "/skin/tip": _skin(0.008, 6, 0.003),
        "/surface/palm": _surface(np.array([0.045, 0.09, 0.015]), 0.006),
        "/surface/tip": _surface(np.array([0.012, 0.02, 0.010]), 0.003),
        "/body/tip": {"bone": np.array(["proximal", "distal"]), "bone_rest": np.array([[0, 0, 0], [0, 0.01, 0.0]])},
        "/forces/tip": {"bone": np.array(["proximal", "distal"])},
        "/mujoco/scene": mujoco_arrays(mujoco.MjModel.from_xml_string(MJCF)),
        "/sensors/nose": sensor_channels(["normal_displacement", "arp"], ["m", "Pa"]),
    }
    groups["/skin/tip"] |= {"afferent_class": np.array(["sa1", "ra1", "pc"]), "afferent_position": np.zeros((3, 3))}
    for kind in ("skin", "surface"):
        groups[f"/{kind}/tip"] |= _bones(len(groups[f"/{kind}/tip"]["rest_position"]))
    return groups


@pytest.fixture(scope="session")
def block_arrays(static_arrays):
    """Function (first step, number of steps) -> arrays of a block; a wave of 200 Hz runs outwards at 5 m/s."""

    def moving(path, time):
        skin = static_arrays[path]
        radius = np.linalg.norm(skin["rest_position"], axis=1)
        wave = np.cos(2 * np.pi * SINE_HZ * (time[:, None] - radius / 5.0)) * np.exp(-radius / 0.01)
        along = -4e-6 * np.exp(-radius / 0.01) + 5e-6 * wave
        load = 16.0 * np.exp(-((radius / 0.008) ** 2)) * (1 - np.cos(2 * np.pi * SINE_HZ * time))[:, None]
        return {
            "displacement": (along[..., None] * skin["rest_normal"] + [1e-6, 0, 0]).astype(np.float32),
            "normal_displacement": (along + 1e-6 * skin["rest_normal"][:, 0]).astype(np.float32),
            "pressure": np.sqrt(1.4e5 * load).astype(np.float32),
            "velocity": (5e-3 * wave[..., None] * skin["rest_normal"]).astype(np.float32),
            "arp": load.astype(np.float32),
        }

    def make(start, count):
        time = STEP_S * (start + np.arange(count))
        pose = {
            name: np.tile([x, 0.0, z, 1.0, 0.0, 0.0, 0.0], (count, 1))
            for name, x, z in (("palm", 0, HEIGHT_M), ("tip", 0.08, 0.14), ("below", 0, 0), ("beside", 0.16, 0))
        }
        bones = np.zeros((count, 2, 7))
        bones[:, :, 3] = 1.0
        bones[:, 1, 1] = 0.01
        bones[:, 1, 2] = 0.002 * time / 0.1
        groups = {
            "/": {"time": time, "step_time": time, "frame_time": time},
            "/body/palm": {"pose": pose["palm"]},
            "/body/tip": {"pose": pose["tip"], "bone_pose": bones},
            "/stimulus/pulse": {
                "foci": np.tile([0.0, 0.0, HEIGHT_M], (count, 1, 1)),
                "sounding": np.sin(2 * np.pi * SINE_HZ * time) != 0.0,
            },
            "/stimulus/pair": {
                "foci": np.tile([[0.078, 0.0, 0.14], [0.082, 0.0, 0.14]], (count, 1, 1)),
                "sounding": np.ones(count, bool),
            },
            "/sensors/nose": {"value": np.ones((count, 2))},
            "/mujoco/scene": {"pose": np.tile(bodies_at_rest(), (count, 1, 1))},
        }
        for name in ("palm", "tip"):
            groups[f"/skin/{name}"] = moving(f"/skin/{name}", time)
            if name == "tip":
                swing = 1e-6 * np.sin(2 * np.pi * SINE_HZ * time)[:, None] * [1.0, 2.0, 3.0]
                groups["/skin/tip"]["afferent_motion"] = swing.astype(np.float32)
            force = np.tile([0.0, 0.0, 0.003], (count, 1))
            groups[f"/forces/{name}"] = {"force": force, "torque": 0.01 * force}
            pressed = static_arrays[f"/surface/{name}"]["loudest_arp"][static_arrays[f"/surface/{name}"]["face"]]
            groups[f"/surface/{name}"] = {"face_arp": np.tile(pressed.mean(axis=1), (count, 1))}
        half = np.tile([0.0, 0.0, 0.0015], (count, 2, 1))
        groups["/forces/tip"] |= {"bone_force": half, "bone_torque": 0.01 * half}
        for name, transducers in (("below", 256), ("beside", 64)):
            groups[f"/array/{name}"] = {
                "drive_amplitude": np.ones((count, transducers), np.float32),
                "drive_phase": np.zeros((count, transducers), np.float32),
                "pose": pose[name],
            }
        return groups

    return make


def merged(*parts):
    """Groups of arrays, one over the other."""
    paths = dict.fromkeys(path for part in parts for path in part)
    return {path: {k: v for part in parts for k, v in part.get(path, {}).items()} for path in paths}


def only(arrays, skins, arrays_named, stimuli):
    """Less instances: names to keep."""
    kept = {"array": arrays_named, "stimulus": stimuli, "sensors": (), "mujoco": ("scene",)}
    return {p: v for p, v in arrays.items() if p == "/" or p.split("/")[2] in kept.get(p.split("/")[1], skins)}


@pytest.fixture(scope="session")
def mjcf():
    return MJCF


@pytest.fixture(scope="session")
def attributes():
    return ATTRIBUTES


@pytest.fixture(scope="session")
def merge():
    return merged


@pytest.fixture(scope="session")
def keep():
    return only


@pytest.fixture(scope="session")
def whole(static_arrays, block_arrays):
    """Arrays of a whole run of 0.1 s."""
    return merged(static_arrays, block_arrays(0, 500))


@pytest.fixture(scope="session")
def result(whole):
    """0.1 s of two skins under two arrays."""
    return tree(whole, ATTRIBUTES)


@pytest.fixture(scope="session")
def one_skin(whole):
    """The same with one skin, one array and one stimulus."""
    return tree(only(whole, ("palm",), ("below",), ("pulse",)), {"/": ATTRIBUTES["/"]})


@pytest.fixture(scope="session")
def still(static_arrays):
    """A run without steps."""
    return tree(static_arrays, ATTRIBUTES)
