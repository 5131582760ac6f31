"""Velocities and accelerations of a hand and of its bones, computed from the derivatives of a scripted motion."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from palmfield.hand.articulated import ArticulatedHand
from palmfield.transforms import Transform
from palmfield.types import Float

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Products of two components of the angular velocity that `FrameRates.numbers` contains."""


class FrameRates(NamedTuple):
    """Motion of a frame relative to the world, expressed in the axes of the frame.

    spin: angular velocity [rad/s], shape (3,)
    spin_rate: angular acceleration [rad/s^2], shape (3,)
    acceleration: acceleration of the origin [m/s^2], shape (3,)
    """

    spin: Float
    spin_rate: Float
    acceleration: Float

    @classmethod
    def at_rest(cls) -> "FrameRates":
        return cls(np.zeros(3), np.zeros(3), np.zeros(3))

    def at(self, point: Float) -> Float:
        """Return the acceleration [m/s^2], shape (3,), of a point [m], shape (3,), that is fixed in the frame."""
        spin = np.cross(self.spin, np.cross(self.spin, point))
        return np.asarray(self.acceleration + np.cross(self.spin_rate, point) + spin)

    def fixed(self, frame: Transform) -> "FrameRates":
        """Return the motion of another frame that is fixed in this one."""
        into = frame.rotation.T
        return FrameRates(into @ self.spin, into @ self.spin_rate, into @ self.at(frame.position))

    def hinge(self, axis: Float, angles: Sequence[float], pivot: Float) -> "FrameRates":
        """Return the motion of a frame that rotates relative to this frame about a fixed axis through a point.

        axis: shape (3,); its length scales the angles
        angles: angle and its first two derivatives, in units of 1, 1/s and 1/s^2 times the length of the axis [rad]
        pivot: the point [m], shape (3,)
        At angle 0 both frames coincide.
        """
        angle, speed, rate = angles
        into = Rotation.from_rotvec(angle * axis).inv()
        spin = into.apply(self.spin)
        spin_rate = into.apply(self.spin_rate) + speed * np.cross(spin, axis) + rate * axis
        turned = FrameRates(spin + speed * axis, spin_rate, into.apply(self.at(pivot)))
        return turned._replace(acceleration=turned.at(-pivot))

    def numbers(self) -> Float:
        """Return the accelerations and the products PAIRS of the angular velocities, shape (12,)."""
        products = [self.spin[i] * self.spin[j] for i, j in PAIRS]
        return np.concatenate([self.acceleration, self.spin_rate, products])


@dataclass(frozen=True)
class HandRates:
    """Derivatives of a hand pose.

    frame: motion of the hand frame
    angles_deg, speeds_deg_s, accelerations_deg_s2: of the joints by name; a joint without an entry is at rest
    """

    frame: FrameRates
    angles_deg: Mapping[str, float]
    speeds_deg_s: Mapping[str, float]
    accelerations_deg_s2: Mapping[str, float]

    def bones(self, hand: ArticulatedHand) -> list[FrameRates]:
        """Return the motion of the frame of each bone.

        Its origin is where the origin of the resting hand frame moves.
        """
        moved = [self.frame] * len(hand.bones)
        for joint, (bone, before) in zip(hand.joints, hand.turns_from, strict=True):
            angle = self.angles_deg.get(joint.name, joint.rest_deg) - joint.rest_deg
            rates = (of.get(joint.name, 0.0) for of in (self.speeds_deg_s, self.accelerations_deg_s2))
            angles = np.deg2rad([angle, *rates]).tolist()
            moved[bone] = moved[before].hinge(joint.axis, angles, joint.pivot)
        return moved


RateCourse = Callable[[float], HandRates]
"""Function from time [s] to the derivatives of a motion whose accelerations are continuous."""
