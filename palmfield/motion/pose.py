"""Pose of a hand at a moment, and the type of a motion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import SceneError
from palmfield.hand.articulated import ArticulatedHand, checked_angles
from palmfield.types import Float


@dataclass(frozen=True)
class HandPose:
    """A hand in the world.

    position: position of the hand frame, the frame of the hand at rest (that of mocap body `hand_target` in
        an articulated hand) [m], shape (3,)
    quaternion: orientation of the hand frame, w first, unit length, shape (4,)
    angles_deg: joint angles by name [deg]; other joints are at rest
    """

    position: Float
    quaternion: Float
    angles_deg: dict[str, float]


PoseCourse = Callable[[float], HandPose]
"""Function from time [s] to pose.

palmfield's own functions have `span_s` (first and last time), and are constant outside.
"""


def checked_pose(pose: HandPose, where: str, hand: ArticulatedHand | None = None) -> HandPose:
    """Return the pose with numbers as arrays and a unit quaternion.

    where: prefix of error messages. Raises SceneError for a wrong shape, a number that is not finite, a quaternion of
    length 0, and, if `hand` is not None, an unknown joint or an angle outside its range.
    """
    position = numbers(pose.position, (3,), f"{where}: position")
    quaternion = unit_quaternions(pose.quaternion, (4,), f"{where}: quaternion")
    if not isinstance(pose.angles_deg, Mapping):
        raise SceneError(f"{where}: angles_deg is {pose.angles_deg!r}; give angles [deg] by name of the joint")
    names = list(pose.angles_deg)
    angles = numbers([pose.angles_deg[name] for name in names], (len(names),), f"{where}: angles_deg")
    angles_deg = dict(zip(names, angles.tolist(), strict=True))
    if hand is not None:
        try:
            checked_angles(hand, angles_deg)
        except SceneError as error:
            raise SceneError(f"{where}: {error}") from None
    return HandPose(position, quaternion, angles_deg)


def numbers(values: ArrayLike, shape: tuple[int, ...], what: str) -> Float:
    """Return the values as float64. Raises SceneError, with prefix `what`, unless they are finite and of this shape."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(f"{what} is {values!r}; give numbers of shape {shape}") from None
    if array.shape != shape:
        raise SceneError(f"{what} has shape {array.shape}; give shape {shape}")
    if not np.isfinite(array).all():
        raise SceneError(f"{what} is {array.tolist()}; give finite numbers")
    return array


def unit_quaternions(values: ArrayLike, shape: tuple[int, ...], what: str) -> Float:
    """Return `numbers` scaled to unit length along the last axis. Raises SceneError also for a length of 0."""
    array = numbers(values, shape, what)
    length = np.linalg.norm(array, axis=-1, keepdims=True)
    if np.any(length < 1e-6):
        raise SceneError(f"{what} has length {length.min():g}; give w, x, y, z of a rotation, such as 1, 0, 0, 0")
    return array / length
