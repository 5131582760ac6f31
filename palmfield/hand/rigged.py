"""A mesh with its joints and skinning weights."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.types import Float, Int, Surface

INFLUENCES = 4


@dataclass(frozen=True)
class Joints:
    """names: as in the file, or joint_0, ...; parents: index of each one's parent, -1 for none, shape (j,), int32;
    rest: each joint's frame in the frame of the vertices, lengths in their unit, shape (j, 4, 4), float64
    """

    names: tuple[str, ...]
    parents: Int
    rest: Float


@dataclass(frozen=True)
class RiggedMesh:
    """surface: closed mesh [m]; joints: with rest frames [m]; weights: shape (n, 4), rows add up to 1; indices: the
    joint of each weight, shape (n, 4), int32
    """

    surface: Surface
    joints: Joints
    weights: Float
    indices: Int


@dataclass(frozen=True)
class SkinRig:
    """Joints in the file's unit and the weight of each joint at each vertex, shape (n, j)."""

    joints: Joints
    weights: sparse.csr_array


def strongest(weights: sparse.csr_array) -> tuple[Float, Int]:
    """Return the four largest weights of each row, scaled to a sum of 1, and their columns, each shape (n, 4)."""
    dense = weights.toarray()
    if dense.shape[1] < INFLUENCES:
        dense = np.pad(dense, ((0, 0), (0, INFLUENCES - dense.shape[1])))
    columns = np.argsort(-dense, axis=1, kind="stable")[:, :INFLUENCES]
    kept = np.take_along_axis(dense, columns, axis=1)
    # A weight of zero refers to joint 0, so that no index is out of range.
    columns = np.where(kept > 0.0, columns, 0)
    return kept / kept.sum(axis=1, keepdims=True), columns.astype(np.int32)


def scaled(joints: Joints, metres: float) -> Joints:
    """Return joints with positions multiplied by `metres`; their axes are made unit vectors."""
    rest = joints.rest.copy()
    rest[:, :3, 3] *= metres
    rest[:, :3, :3] /= np.linalg.norm(rest[:, :3, :3], axis=1, keepdims=True)
    return Joints(joints.names, joints.parents, rest)


def joint_of_body(body: str, joints: Joints) -> tuple[int, str]:
    """Return the number of the joint for a scene's body of the name `[prefix]joint`, and the prefix.

    Raises SceneError if the name ends with no joint's.
    """
    matches = [name for name in joints.names if body.endswith(name)]
    if not matches:
        raise SceneError(
            f"'{body}' ends with the name of no joint; allowed with shape 'rigged': [prefix] and a joint of the mesh: "
            f"{', '.join(joints.names)}"
        )
    name = max(matches, key=len)
    return joints.names.index(name), body.removesuffix(name)
