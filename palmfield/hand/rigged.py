"""A mesh with its joints and skinning weights."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.types import Float, Int, Surface

INFLUENCES = 4


@dataclass(frozen=True)
class Joints:
    """Joints of a mesh. names: as in the file, or joint_0, ...; parents: indices, -1 for none, shape (j,), int32;
    rest: frame of each joint in the frame and unit of the vertices, shape (j, 4, 4), float64
    """

    names: tuple[str, ...]
    parents: Int
    rest: Float


@dataclass(frozen=True)
class RiggedMesh:
    """A mesh on joints. surface: closed mesh [m]; joints: joints with rest frames [m]; weights: shape (n, 4), rows add
    up to 1; indices: joint of each weight, shape (n, 4), int32
    """

    surface: Surface
    joints: Joints
    weights: Float
    indices: Int


@dataclass(frozen=True)
class SkinRig:
    """Joints in the unit of the file, and the weight of each joint at each vertex, shape (n, j)."""

    joints: Joints
    weights: sparse.csr_array


def strongest(weights: sparse.csr_array) -> tuple[Float, Int]:
    """Return the four largest weights of each row, scaled to a sum of 1, and their columns, each of shape (n, 4)."""
    dense = weights.toarray()
    if dense.shape[1] < INFLUENCES:
        dense = np.pad(dense, ((0, 0), (0, INFLUENCES - dense.shape[1])))
    columns = np.argsort(-dense, axis=1, kind="stable")[:, :INFLUENCES]
    largest = np.take_along_axis(dense, columns, axis=1)
    # Weights of zero refer to joint 0, so that all indices are valid
    columns = np.where(largest > 0.0, columns, 0)
    return largest / largest.sum(axis=1, keepdims=True), columns.astype(np.int32)


def scaled(joints: Joints, metres: float) -> Joints:
    """Return joints with positions multiplied by `metres` and axes of unit length."""
    rest = joints.rest.copy()
    rest[:, :3, 3] *= metres
    rest[:, :3, :3] /= np.linalg.norm(rest[:, :3, :3], axis=1, keepdims=True)
    return Joints(joints.names, joints.parents, rest)


def joint_of_body(body: str, joints: Joints) -> tuple[int, str]:
    """Return the number of the joint of a body named `[prefix]joint` in a scene, and the prefix.

    Raises SceneError if the name does not end with the name of a joint.
    """
    matches = [name for name in joints.names if body.endswith(name)]
    if not matches:
        raise SceneError(
            f"'{body}' does not end with the name of a joint; allowed with shape 'rigged': [prefix] and joint: "
            f"{', '.join(joints.names)}"
        )
    name = max(matches, key=len)
    return joints.names.index(name), body.removesuffix(name)
