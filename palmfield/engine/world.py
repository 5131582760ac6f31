"""What a module sees of MuJoCo's model and data inside a callback: names, poses, time, forces."""

import ctypes
from typing import Any, Literal

import mujoco
import numpy as np

from palmfield.engine.structs import Plugin, library, mirror
from palmfield.errors import SceneError
from palmfield.types import Float, Int

Kind = Literal["body", "site", "geom"]
_OBJECT = {"body": mujoco.mjtObj.mjOBJ_BODY, "site": mujoco.mjtObj.mjOBJ_SITE, "geom": mujoco.mjtObj.mjOBJ_GEOM}


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
        count = getattr(self.raw, f"n{kind}")
        found = (library().mj_id2name(self.address, int(_OBJECT[kind]), i) for i in range(count))
        return [name.decode() for name in found if name]

    def numeric(self, name: str, default: float) -> float:
        """First number of a custom numeric, or the default where the scene has none of that name."""
        number = library().mj_name2id(self.address, int(mujoco.mjtObj.mjOBJ_NUMERIC), name.encode())
        return default if number < 0 else float(self.raw.numeric_data[self.raw.numeric_adr[number]])

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
