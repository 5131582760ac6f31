"""Convert MuJoCo's bodies, geoms and joints to plain arrays of a result. A USD scene needs them for its physics."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from palmfield.types import Float


def mujoco_arrays(model: mujoco.MjModel) -> dict[str, NDArray[Any]]:
    """Return the bodies of a model as variables of group /mujoco/scene, without empty variables.

    Elements without a name are named body_N, geom_N and joint_N.
    """
    made: dict[str, NDArray[Any]] = {
        "body_name": _names(model, mujoco.mjtObj.mjOBJ_BODY, "body", model.nbody),
        "body_parent": model.body_parentid.astype(np.int32),
        "body_frame": np.column_stack([model.body_pos, model.body_quat]).astype(np.float64),
        "body_mass": model.body_mass.astype(np.float64),
        "body_inertia": model.body_inertia.astype(np.float64),
        "body_inertial_frame": np.column_stack([model.body_ipos, model.body_iquat]).astype(np.float64),
        "body_held": model.body_weldid == 0,
        "body_placed": model.body_mocapid >= 0,
    }
    if model.ngeom:
        made |= {
            "geom_name": _names(model, mujoco.mjtObj.mjOBJ_GEOM, "geom", model.ngeom),
            "geom_body": model.geom_bodyid.astype(np.int32),
            "geom_type": np.array([mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
                                   for kind in model.geom_type]),
            "geom_size": model.geom_size.astype(np.float64),
            "geom_frame": np.column_stack([model.geom_pos, model.geom_quat]).astype(np.float64),
            "geom_rgba": _colours(model),
            "geom_collides": (model.geom_contype != 0) | (model.geom_conaffinity != 0),
            "geom_friction": model.geom_friction[:, 0].astype(np.float64),
            "geom_mesh": np.where(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH, model.geom_dataid, -1).astype(
                np.int32
            ),
        }  # fmt: skip
    if model.nmesh:
        owners = np.arange(model.nmesh, dtype=np.int32)
        made |= {
            "mesh_vertex": model.mesh_vert.astype(np.float64),
            "mesh_vertex_owner": np.repeat(owners, model.mesh_vertnum),
            "mesh_face": model.mesh_face.astype(np.int32),
            "mesh_face_owner": np.repeat(owners, model.mesh_facenum),
        }
    if model.njnt:
        made |= {
            "joint_name": _names(model, mujoco.mjtObj.mjOBJ_JOINT, "joint", model.njnt),
            "joint_type": np.array([mujoco.mjtJoint(kind).name.removeprefix("mjJNT_").lower()
                                    for kind in model.jnt_type]),
            "joint_body": model.jnt_bodyid.astype(np.int32),
            "joint_position": model.jnt_pos.astype(np.float64),
            "joint_axis": model.jnt_axis.astype(np.float64),
            "joint_range": model.jnt_range.astype(np.float64),
            "joint_limited": model.jnt_limited.astype(bool),
            "joint_reference": model.qpos0[model.jnt_qposadr].astype(np.float64),
        }  # fmt: skip
    return made


def body_poses(data: mujoco.MjData) -> Float:
    """Return the poses of all bodies in the world: positions [m] and unit quaternions, shape (bodies, 7)."""
    return np.column_stack([data.xpos, data.xquat]).astype(np.float64)


def _names(model: mujoco.MjModel, kind: mujoco.mjtObj, otherwise: str, count: int) -> NDArray[Any]:
    return np.array([mujoco.mj_id2name(model, kind, k) or f"{otherwise}_{k}" for k in range(count)])


def _colours(model: mujoco.MjModel) -> Float:
    """Return the colours of geoms, shape (geoms, 4). If a geom has a material, the colour is that of the material."""
    own = model.geom_rgba.astype(np.float64)
    chosen = model.geom_matid >= 0
    own[chosen] = model.mat_rgba[model.geom_matid[chosen]]
    return own
