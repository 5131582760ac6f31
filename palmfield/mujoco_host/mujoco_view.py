"""Access MuJoCo's model and data in a callback of a plugin: names, poses, time, state, forces."""

import ctypes
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np

from palmfield.config import Config, known_keys, parse
from palmfield.errors import SceneError, did_you_mean
from palmfield.mujoco_host.structs import Plugin, library, mirror
from palmfield.transforms import Transform, rotation_matrix
from palmfield.types import Float

SOLIDS = ("box", "capsule", "cylinder", "ellipsoid", "sphere")
Geom = tuple[str, tuple[Any, ...], tuple[float, ...], tuple[float, ...]]
"""Kind of a geom, size [m] as in MJCF (for a mesh its vertices and faces), position [m], quaternion (w, x, y, z)."""
Kind = Literal["body", "site", "geom", "joint", "actuator"]
Field = Literal["ctrl", "qpos", "qvel", "mocap_pos", "mocap_quat"]
Write = tuple[Field, list[int], Float]
"""Values to write to an array of mjData: its name, their indices, and the values, shape (n,)."""
_OBJECT = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
}
_COUNT = {"joint": "njnt", "actuator": "nu"}


class ModelView:
    """Read-only view of the mjModel at an address.

    complete: False while MuJoCo compiles the model and requests state sizes; custom numbers and texts are then missing
    """

    def __init__(self, address: int, complete: bool = True):
        self.address, self.complete = address, complete
        self.raw = mirror("mjModel").from_address(address)

    @property
    def timestep(self) -> float:
        """MuJoCo's step [s]."""
        return float(self.raw.opt.timestep)

    def find(self, kind: Kind, name: str, element: str) -> int:
        """Return the number of a named object. Raises SceneError with `element` if no object has that name."""
        number = library().mj_name2id(self.address, int(_OBJECT[kind]), name.encode())
        if number < 0:
            names = self.names(kind)
            near = did_you_mean(name, names)
            raise SceneError(f"{element}: the scene has no {kind} '{name}'{near}; it has: {', '.join(names)}")
        return number

    def names(self, kind: Kind) -> list[str]:
        """Return the names of all objects of a kind."""
        count = getattr(self.raw, _COUNT.get(kind, f"n{kind}"))
        texts = (library().mj_id2name(self.address, int(_OBJECT[kind]), i) for i in range(count))
        return [name.decode() for name in texts if name]

    def custom(self) -> list[tuple[str, str, int]]:
        """Return kind ("numeric", "text" or "tuple"), name and length of each element of <custom>."""
        kinds = {"numeric": mujoco.mjtObj.mjOBJ_NUMERIC, "text": mujoco.mjtObj.mjOBJ_TEXT}
        kinds["tuple"] = mujoco.mjtObj.mjOBJ_TUPLE
        result = []
        for kind, number in kinds.items():
            sizes = getattr(self.raw, f"{kind}_size")
            for i in range(getattr(self.raw, f"n{kind}")):
                name = library().mj_id2name(self.address, int(number), i)
                result.append((kind, name.decode() if name else "", int(sizes[i])))
        return result

    def numeric(self, name: str, default: float) -> float:
        """Return the first number of a custom numeric, or the default if no custom numeric has that name."""
        number = library().mj_name2id(self.address, int(mujoco.mjtObj.mjOBJ_NUMERIC), name.encode())
        return default if number < 0 else float(self.raw.numeric_data[self.raw.numeric_adr[number]])

    def text(self, name: str, default: str) -> str:
        """Return a custom text, or the default if no custom text has that name."""
        number = library().mj_name2id(self.address, int(mujoco.mjtObj.mjOBJ_TEXT), name.encode())
        if number < 0:
            return default
        start = int(self.raw.text_adr[number])
        size = int(self.raw.text_size[number]) - 1
        return b"".join(self.raw.text_data[start + i] for i in range(size)).decode()

    def ancestors(self, body: int) -> set[int]:
        """Return the numbers of a body and all its ancestors except the world."""
        result = set()
        while body > 0:
            result.add(body)
            body = int(self.raw.body_parentid[body])
        return result

    def can_move(self, body: int) -> bool:
        """Return whether a body has joints or is a mocap body."""
        return bool(self.raw.body_dofnum[body] > 0 or self.raw.body_mocapid[body] >= 0)

    def geoms(self, body: int, element: str) -> tuple[Geom, ...]:
        """Return the solid shapes of a body for `palmfield.hand.collision_shapes.Obstacle`.

        Raises SceneError with `element` for kinds of geom that are not solids.
        """
        raw, geoms = self.raw, []
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
                raise SceneError(
                    f"{element}: a geom of type '{kind}' is not a solid; allowed: mesh, {', '.join(SOLIDS)}"
                )
            position = tuple(raw.geom_pos[3 * geom : 3 * geom + 3])
            geoms.append((kind, size, position, tuple(raw.geom_quat[4 * geom : 4 * geom + 4])))
        return tuple(geoms)

    def site_body(self, site: int) -> int:
        """Return the number of the body of a site."""
        return int(self.raw.site_bodyid[site])

    def site_position(self, site: int) -> Float:
        """Return the position of a site in its body's frame [m], shape (3,)."""
        return np.array(self.raw.site_pos[3 * site : 3 * site + 3])

    def sphere_m(self, site: int) -> float | None:
        """Return the radius of a site [m], None if it is not a sphere."""
        sphere = int(self.raw.site_type[site]) == int(mujoco.mjtGeom.mjGEOM_SPHERE)
        return float(self.raw.site_size[3 * site]) if sphere else None

    def reference_pose(self, kind: Literal["body", "site"], number: int) -> Transform:
        """Return the frame of a body or site in the world, in the reference configuration qpos0."""
        position, turn = np.zeros(3), np.eye(3)
        if kind == "site":
            position = self.site_position(number)
            turn = rotation_matrix(np.array(self.raw.site_quat[4 * number : 4 * number + 4]))
            number = self.site_body(number)
        while number > 0:
            parent = rotation_matrix(np.array(self.raw.body_quat[4 * number : 4 * number + 4]))
            position = np.array(self.raw.body_pos[3 * number : 3 * number + 3]) + parent @ position
            turn = parent @ turn
            number = int(self.raw.body_parentid[number])
        return Transform(position, turn)

    def instances(self) -> list[tuple[int, str, str]]:
        """Return all plugin instances as (number, plugin name, instance name)."""
        lib = library()
        lib.mjp_getPluginAtSlot.restype = ctypes.c_void_p
        result = []
        for i in range(self.raw.nplugin):
            plugin = Plugin.from_address(lib.mjp_getPluginAtSlot(self.raw.plugin[i]))
            name = lib.mj_id2name(self.address, int(mujoco.mjtObj.mjOBJ_PLUGIN), i)
            result.append((i, plugin.name.decode(), name.decode() if name else ""))
        return result

    def values(self, instance: int, keys: list[str]) -> dict[str, str]:
        """Return the texts of the keys that the scene sets for a plugin instance."""
        texts = {key: library().mj_getPluginConfig(self.address, instance, key.encode()) for key in keys}
        return {key: text.decode() for key, text in texts.items() if text}

    def keys(self, config: type[Config], instance: int) -> Any:
        """Return the typed keys of a plugin instance. Raises SceneError like `palmfield.config.parse`."""
        _, plugin, name = self.instances()[instance]
        return parse(config, self.values(instance, known_keys(config)), f"plugin '{plugin}' instance '{name}'")


def mocap_offsets(mocap: int) -> tuple[list[int], list[int]]:
    """Return the indices of position and quaternion (w, x, y, z) of a mocap body in mocap_pos and mocap_quat."""
    return [*range(3 * mocap, 3 * mocap + 3)], [*range(4 * mocap, 4 * mocap + 4)]


class DataView:
    """One mjData with its model. Arrays are views of the present values in MuJoCo.

    Only arrays in the fixed buffer of mjData have views, because the arena of mjData moves from step to step.
    """

    def __init__(self, model: int, data: int):
        self.model = ModelView(model)
        self.address = data
        self.raw = mirror("mjData").from_address(data)
        counts = self.model.raw
        self.frames = {
            "body": (self._view("xpos", counts.nbody, 3), self._view("xmat", counts.nbody, 9)),
            "site": (self._view("site_xpos", counts.nsite, 3), self._view("site_xmat", counts.nsite, 9)),
        }
        """World positions [m], shape (n, 3), and row-major rotation matrices, shape (n, 9), of bodies and of sites."""
        sizes = {"ctrl": counts.nu, "qpos": counts.nq, "qvel": counts.nv}
        sizes |= {"mocap_pos": 3 * counts.nmocap, "mocap_quat": 4 * counts.nmocap}
        self._fields = {name: self._view(name, size, 1)[:, 0] for name, size in sizes.items()}

    def _view(self, name: str, rows: int, columns: int) -> Float:
        if rows == 0:
            return np.zeros((0, columns))
        return np.ctypeslib.as_array(getattr(self.raw, name), shape=(int(rows), columns))

    @property
    def time(self) -> float:
        """MuJoCo's time [s]."""
        return float(self.raw.time)

    def put(self, writes: "list[Write]") -> None:
        """Write numbers into arrays of mjData."""
        for field, offsets, values in writes:
            self._fields[field][offsets] = values

    def state(self, instance: int) -> Float:
        """Return the plugin state of an instance, shape (n,). MuJoCo copies, resets and saves it with mjData."""
        count = int(self.model.raw.plugin_statenum[instance])
        if count == 0:
            return np.zeros(0)
        start = int(self.model.raw.plugin_stateadr[instance])
        whole = np.ctypeslib.as_array(self.raw.plugin_state, shape=(int(self.model.raw.npluginstate),))
        return whole[start : start + count]

    def sensors(self, instance: int) -> list["PluginSensor"]:
        """Return the sensors of an instance, with views of their data."""
        raw = self.model.raw
        kinds = {int(mujoco.mjtObj.mjOBJ_SITE): "site", int(mujoco.mjtObj.mjOBJ_BODY): "body"}
        result = []
        for i in range(raw.nsensor):
            if raw.sensor_plugin[i] == instance:
                whole = np.ctypeslib.as_array(self.raw.sensordata, shape=(int(raw.nsensordata),))
                offsets = [*range(raw.sensor_adr[i], raw.sensor_adr[i] + raw.sensor_dim[i])]
                data = whole[offsets[0] : offsets[-1] + 1]
                name = library().mj_id2name(self.model.address, int(mujoco.mjtObj.mjOBJ_SENSOR), i)
                kind, target = kinds.get(raw.sensor_objtype[i], ""), int(raw.sensor_objid[i])
                result.append(PluginSensor(name.decode() if name else f"sensor_{i}", kind, target, offsets, data))
        return result


class PluginSensor(NamedTuple):
    """A sensor of a plugin instance. kind: kind of the object that carries it: "site", "body" or ""

    target: number of this object; data: view of the values, shape (channels,), at `offsets` in the sensor data
    """

    name: str
    kind: str
    target: int
    offsets: list[int]
    data: Float


class ForceOutlet:
    """Adds forces at the origins of some bodies to MuJoCo's passive forces. Its buffers are allocated once.

    forces [N], torques about the body origins [N m]: world axes, shapes (b, 3); set them before `apply`
    """

    def __init__(self, view: DataView, bodies: Sequence[int]):
        count = len(bodies)
        self.forces, self.torques = np.zeros((count, 3)), np.zeros((count, 3))
        self._origins, self._index = np.zeros((count, 3)), np.array(bodies, dtype=np.int64)
        self._positions = view.frames["body"][0]
        self._model, self._data, self._raw = view.model.address, view.address, view.raw
        self._moves = view.model.raw.nv > 0
        self._apply = library().mj_applyFT
        rows = [[self._row(array, i) for i in range(count)] for array in (self.forces, self.torques, self._origins)]
        self._arguments = list(zip(*rows, list(bodies), strict=True))

    @staticmethod
    def _row(array: Float, i: int) -> Any:
        return array[i].ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    def apply(self) -> None:
        """Add the forces at the bodies' present origins."""
        if not self._moves:
            return
        self._positions.take(self._index, 0, self._origins)
        for force, torque, origin, body in self._arguments:
            self._apply(self._model, self._data, force, torque, origin, body, self._raw.qfrc_passive)
