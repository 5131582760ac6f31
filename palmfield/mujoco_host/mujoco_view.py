"""What a module sees of MuJoCo's model and data inside a callback: names, poses, time, forces."""

import ctypes
from typing import Any, Literal

import mujoco
import numpy as np

from palmfield.errors import SceneError
from palmfield.mujoco_host.structs import Plugin, library, mirror
from palmfield.types import Float, Int

SOLIDS = ("box", "capsule", "cylinder", "ellipsoid", "sphere")
Geom = tuple[str, tuple[Any, ...], tuple[float, ...], tuple[float, ...]]
"""Kind, size [m] as in MJCF (of a mesh its vertices and faces), position [m] and quaternion (w, x, y, z)."""
Kind = Literal["body", "site", "geom", "joint", "actuator"]
_OBJECT = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
}
_COUNT = {"joint": "njnt", "actuator": "nu"}


def rotation(quaternion: Float) -> Float:
    """Rotation matrix, shape (3, 3), of a unit quaternion (w, x, y, z)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, dtype=np.float64))
    return matrix.reshape(3, 3)


class ModelView:
    """Read-only view of an mjModel by its address."""

    def __init__(self, address: int):
        self.address = address
        self.raw = mirror("mjModel").from_address(address)

    @property
    def timestep(self) -> float:
        """MuJoCo's step [s]."""
        return float(self.raw.opt.timestep)

    def find(self, kind: Kind, name: str, element: str) -> int:
        """Number of a named object; SceneError, naming the asking `element`, where the scene has none of that name."""
        number = library().mj_name2id(self.address, int(_OBJECT[kind]), name.encode())
        if number < 0:
            raise SceneError(f"{element}: the scene has no {kind} '{name}'; it has: {', '.join(self.names(kind))}")
        return number

    def names(self, kind: Kind) -> list[str]:
        """Names of all objects of a kind."""
        count = getattr(self.raw, _COUNT.get(kind, f"n{kind}"))
        found = (library().mj_id2name(self.address, int(_OBJECT[kind]), i) for i in range(count))
        return [name.decode() for name in found if name]

    def numeric(self, name: str, default: float) -> float:
        """First number of a custom numeric, or the default where the scene has none of that name."""
        number = library().mj_name2id(self.address, int(mujoco.mjtObj.mjOBJ_NUMERIC), name.encode())
        return default if number < 0 else float(self.raw.numeric_data[self.raw.numeric_adr[number]])

    def ancestors(self, body: int) -> set[int]:
        """A body and all those that carry it, the world left out."""
        found = set()
        while body > 0:
            found.add(body)
            body = int(self.raw.body_parentid[body])
        return found

    def can_move(self, body: int) -> bool:
        """Whether a body has joints of its own or is a mocap body."""
        return bool(self.raw.body_dofnum[body] > 0 or self.raw.body_mocapid[body] >= 0)

    def geoms(self, body: int, element: str) -> tuple[Geom, ...]:
        """Solid shapes of a body as `palmfield.obstacle.Obstacle` takes them.

        Raises SceneError, naming the asking `element`, for kinds of geom that are no solids.
        """
        raw, found = self.raw, []
        for geom in range(raw.body_geomadr[body], raw.body_geomadr[body] + raw.body_geomnum[body]):
            kind = mujoco.mjtGeom(raw.geom_type[geom]).name.removeprefix("mjGEOM_").lower()
            size: tuple[Any, ...] = tuple(raw.geom_size[3 * geom : 3 * geom + 3])
            if kind == "mesh":
                mesh = int(raw.geom_dataid[geom])
                first, count = raw.mesh_vertadr[mesh], raw.mesh_vertnum[mesh]
                corner, faces = raw.mesh_faceadr[mesh], raw.mesh_facenum[mesh]
                size = (
                    tuple(raw.mesh_vert[3 * first : 3 * (first + count)]),
                    tuple(raw.mesh_face[3 * corner : 3 * (corner + faces)]),
                )
            elif kind not in SOLIDS:
                raise SceneError(f"{element}: a geom of kind '{kind}' is no solid; allowed: mesh, {', '.join(SOLIDS)}")
            position = tuple(raw.geom_pos[3 * geom : 3 * geom + 3])
            found.append((kind, size, position, tuple(raw.geom_quat[4 * geom : 4 * geom + 4])))
        return tuple(found)

    def site_body(self, site: int) -> int:
        """Body that carries a site."""
        return int(self.raw.site_bodyid[site])

    def site_position(self, site: int) -> Float:
        """Position of a site in its body's frame [m], shape (3,)."""
        return np.array(self.raw.site_pos[3 * site : 3 * site + 3])

    def reference_pose(self, kind: Literal["body", "site"], number: int) -> tuple[Float, Float]:
        """World position [m], shape (3,), and rotation, shape (3, 3), in the reference configuration qpos0."""
        position, turn = np.zeros(3), np.eye(3)
        if kind == "site":
            position = self.site_position(number)
            turn = rotation(np.array(self.raw.site_quat[4 * number : 4 * number + 4]))
            number = self.site_body(number)
        while number > 0:
            parent = rotation(np.array(self.raw.body_quat[4 * number : 4 * number + 4]))
            position = np.array(self.raw.body_pos[3 * number : 3 * number + 3]) + parent @ position
            turn = parent @ turn
            number = int(self.raw.body_parentid[number])
        return position, turn

    def instances(self) -> list[tuple[int, str, str]]:
        """All plugin instances as (number, plugin name, instance name)."""
        lib = library()
        lib.mjp_getPluginAtSlot.restype = ctypes.c_void_p
        found = []
        for i in range(self.raw.nplugin):
            plugin = Plugin.from_address(lib.mjp_getPluginAtSlot(self.raw.plugin[i]))
            name = lib.mj_id2name(self.address, int(mujoco.mjtObj.mjOBJ_PLUGIN), i)
            found.append((i, plugin.name.decode(), name.decode() if name else ""))
        return found

    def values(self, instance: int, keys: list[str]) -> dict[str, str]:
        """Texts of the keys that the scene sets for a plugin instance."""
        texts = {key: library().mj_getPluginConfig(self.address, instance, key.encode()) for key in keys}
        return {key: text.decode() for key, text in texts.items() if text}


class World:
    """One mjData with its model. Arrays are views: they show MuJoCo's present values.

    error: what a module could not raise through C; quiet: whether somebody will raise it, so that MuJoCo need not warn
    """

    def __init__(self, model: int, data: int):
        self.model = ModelView(model)
        self.address = data
        self.raw = mirror("mjData").from_address(data)
        self.modules: dict[int, Any] = {}
        self.error: Exception | None = None
        self.quiet = False
        counts = self.model.raw
        self._views = {
            "body": (self._view("xpos", counts.nbody, 3), self._view("xmat", counts.nbody, 9)),
            "site": (self._view("site_xpos", counts.nsite, 3), self._view("site_xmat", counts.nsite, 9)),
        }

    def _view(self, name: str, rows: int, columns: int) -> Float:
        if rows == 0:
            return np.zeros((0, columns))
        return np.ctypeslib.as_array(getattr(self.raw, name), shape=(rows, columns))

    @property
    def time(self) -> float:
        """MuJoCo's time [s]."""
        return float(self.raw.time)

    def pose(self, kind: Literal["body", "site"], number: int) -> tuple[Float, Float]:
        """World position [m], shape (3,), and rotation matrix, shape (3, 3), copied."""
        position, matrix = self._views[kind]
        return position[number].copy(), matrix[number].reshape(3, 3).copy()

    def sites(self, numbers: Int) -> tuple[Float, Float]:
        """World positions [m] and z axes of some sites, shapes (n, 3), copied."""
        position, matrix = self._views["site"]
        return position[numbers], matrix[numbers, 2::3]

    def put_mocap(self, mocap: int, position: Float, quaternion: Float) -> None:
        """Pose a mocap body in the world: position [m], quaternion (w, x, y, z)."""
        count = self.model.raw.nmocap
        self._view("mocap_pos", count, 3)[mocap] = position
        self._view("mocap_quat", count, 4)[mocap] = quaternion

    def controls(self) -> Float:
        """Controls of all actuators, shape (nu,), a view."""
        return self._view("ctrl", self.model.raw.nu, 1)[:, 0]

    def put_free(self, joint: int, position: Float, quaternion: Float, velocity: Float, spin: Float) -> None:
        """Put a free joint's body: world position [m] and velocity [m/s], quaternion, spin in its own axes [rad/s]."""
        first, speed = int(self.model.raw.jnt_qposadr[joint]), int(self.model.raw.jnt_dofadr[joint])
        self._view("qpos", self.model.raw.nq, 1)[first : first + 7, 0] = np.concatenate([position, quaternion])
        self._view("qvel", self.model.raw.nv, 1)[speed : speed + 6, 0] = np.concatenate([velocity, spin])

    def put_hinges(self, joints: list[int], angles: Float, speeds: Float) -> None:
        """Put hinges at angles [rad] with speeds [rad/s], shapes (n,)."""
        places = [int(self.model.raw.jnt_qposadr[joint]) for joint in joints]
        self._view("qpos", self.model.raw.nq, 1)[places, 0] = angles
        places = [int(self.model.raw.jnt_dofadr[joint]) for joint in joints]
        self._view("qvel", self.model.raw.nv, 1)[places, 0] = speeds

    def apply(self, body: int, force: Float, torque: Float, point: Float) -> None:
        """Add a force [N] and torque [N m], both shape (3,) in world axes, at a world point to the passive forces."""
        if self.model.raw.nv == 0:
            return
        f, t, p = (np.ascontiguousarray(x, dtype=np.float64) for x in (force, torque, point))
        numbers = ctypes.POINTER(ctypes.c_double)
        library().mj_applyFT(
            self.model.address, self.address, *(x.ctypes.data_as(numbers) for x in (f, t, p)), body,
            self.raw.qfrc_passive,
        )  # fmt: skip

    def state(self, instance: int) -> Float:
        """Plugin state of an instance, shape (n,): part of mjData, so that MuJoCo copies, resets and saves it."""
        count = int(self.model.raw.plugin_statenum[instance])
        if count == 0:
            return np.zeros(0)
        start = int(self.model.raw.plugin_stateadr[instance])
        whole = np.ctypeslib.as_array(self.raw.plugin_state, shape=(int(self.model.raw.npluginstate),))
        return whole[start : start + count]

    def sensors(self, instance: int) -> list[tuple[int, str, int, Float]]:
        """Sensors of an instance: (number, kind of object, object, view of its data)."""
        raw = self.model.raw
        kinds = {int(mujoco.mjtObj.mjOBJ_SITE): "site", int(mujoco.mjtObj.mjOBJ_BODY): "body"}
        found = []
        for i in range(raw.nsensor):
            if raw.sensor_plugin[i] == instance:
                size = raw.sensor_dim[i]
                whole = np.ctypeslib.as_array(self.raw.sensordata, shape=(int(raw.nsensordata),))
                data = whole[raw.sensor_adr[i] : raw.sensor_adr[i] + size]
                found.append((i, kinds.get(raw.sensor_objtype[i], ""), int(raw.sensor_objid[i]), data))
        return found
