"""Where a body, its bones, what stands in the way and the arrays are, seen from the first array."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmfield.emitter import Placement
from palmfield.types import Float

World = tuple[Float, Float]
"""Position [m], shape (3,), and rotation, shape (3, 3), in world axes."""


@dataclass(frozen=True)
class Pose:
    """Frame of the skin's body, seen from the first array: x_array = turn @ x_body + shift [m].

    arrays: placement of every array, seen from the first
    bones: origins [m], shape (b, 3), and rotations, shape (b, 3, 3), of an articulated hand's bones in the body's
        frame, then those of bodies that may stand in the way
    """

    shift: Float
    turn: Float
    arrays: tuple[Placement, ...]
    bones: tuple[Float, Float] = (np.zeros((0, 3)), np.zeros((0, 3, 3)))

    @staticmethod
    def between(
        arrays: Sequence[World], body: World, sites: Sequence[tuple[Float, Float]], bones: Sequence[World] = ()
    ) -> "Pose":
        """From the world poses of arrays, body and bones; sites: see `placements`."""
        return Pose(*relative(arrays[0], body), placements(arrays, sites), seen_from(body, bones))

    def points(self, x: Float) -> Float:
        """Body positions in the array frame, shape (n, 3)."""
        return x @ self.turn.T + self.shift

    def same(self, other: "Pose") -> bool:
        """Exactly equal: only then may a field be used again."""
        equal = np.array_equal(self.shift, other.shift) and np.array_equal(self.turn, other.turn)
        return equal and self.arrays == other.arrays and self.same_bones(other)

    def same_bones(self, other: "Pose") -> bool:
        """Whether bones and obstacles stand exactly alike to the body: only then is its surface the same."""
        return all(np.array_equal(a, b) for a, b in zip(self.bones, other.bones, strict=True))


def relative(seen_from: World, pose: World) -> World:
    """Position [m] and rotation of a pose in the frame of another, both given in world axes."""
    return seen_from[1].T @ (pose[0] - seen_from[0]), seen_from[1].T @ pose[1]


def seen_from(body: World, others: Sequence[World]) -> tuple[Float, Float]:
    """Positions [m], shape (b, 3), and rotations, shape (b, 3, 3), of some poses in the frame of a body."""
    found = [relative(body, other) for other in others]
    return (
        np.array([position for position, _ in found]).reshape(-1, 3),
        np.array([turn for _, turn in found]).reshape(-1, 3, 3),
    )


def placements(arrays: Sequence[World], sites: Sequence[tuple[Float, Float]]) -> tuple[Placement, ...]:
    """Placement of every array in the frame of the first, from world poses.

    sites: for every array the world positions [m] and emitting directions of its transducers, shapes (n, 3), where
        they are sites; else n is 0
    """
    found = []
    for pose, (where, facing) in zip(arrays, sites, strict=True):
        shift, turn = relative(arrays[0], pose)
        own = zip(((where - pose[0]) @ pose[1]).tolist(), (facing @ pose[1]).tolist(), strict=True)
        transducers = tuple((tuple(position), tuple(direction)) for position, direction in own)
        found.append(Placement(tuple(shift.tolist()), tuple(turn.ravel().tolist()), transducers))
    return tuple(found)
