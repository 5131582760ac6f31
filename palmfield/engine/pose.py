"""Where a body and the arrays are, seen from the first array."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmfield.emitter import Placement
from palmfield.types import Float


@dataclass(frozen=True)
class Pose:
    """Frame of the skin's body, seen from the first array: x_array = turn @ x_body + shift [m].

    arrays: placement of every array, seen from the first
    """

    shift: Float
    turn: Float
    arrays: tuple[Placement, ...]

    @staticmethod
    def between(
        arrays: Sequence[tuple[Float, Float]], body: tuple[Float, Float], sites: Sequence[tuple[Float, Float]]
    ) -> "Pose":
        """From the world poses (position, rotation) of arrays and body; sites: see `placements`."""
        return Pose(*relative(arrays[0], body), placements(arrays, sites))

    def points(self, x: Float) -> Float:
        """Body positions in the array frame, shape (n, 3)."""
        return x @ self.turn.T + self.shift

    def same(self, other: "Pose") -> bool:
        """Exactly equal: only then may a field be used again."""
        equal = np.array_equal(self.shift, other.shift) and np.array_equal(self.turn, other.turn)
        return equal and self.arrays == other.arrays


def relative(seen_from: tuple[Float, Float], pose: tuple[Float, Float]) -> tuple[Float, Float]:
    """Position [m] and rotation of a pose in the frame of another, both given in world axes."""
    return seen_from[1].T @ (pose[0] - seen_from[0]), seen_from[1].T @ pose[1]


def placements(arrays: Sequence[tuple[Float, Float]], sites: Sequence[tuple[Float, Float]]) -> tuple[Placement, ...]:
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
