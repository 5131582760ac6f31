"""Radiation pressure of coming drives, computed together while neither body nor arrays move.

A path needs a new field at every step of the skin. What will be emitted is known ahead, and on points that keep still
many drives cost little more than a few: see `palmfield.acoustics.transfer`.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.transfer import MATRIX_FROM, arp_frames
from palmfield.types import Complex, Float, Float32

if TYPE_CHECKING:
    from palmfield.chain import Pose

STEPS = 128
"""Steps of the skin that are looked ahead; a move throws away what was computed for them."""
SAME_DRIVE = 1e-9
"""Of full drive: MuJoCo adds up its time, so that what comes differs from what was foreseen in the last digits."""


class Foresight:
    """ARP for coming drives at points of a body.

    points: body frame [m], shape (n, 3); normals: unit outward, shape (n, 3); law: see `palmfield.acoustics.arp`
    until: simulated time up to which drives were foreseen [s]
    """

    def __init__(self, points: Float, normals: Float, law: str):
        self.points, self.normals, self.law = points, normals, law
        self.until = -math.inf
        self._pose: Pose | None = None
        self._drives: Complex = np.zeros((0, 0), complex)
        self._loads: Float32 = np.zeros((0, len(points)), np.float32)

    def knows(self, pose: "Pose", t: float) -> bool:
        """Whether drives at time t [s] were foreseen for this pose."""
        return self._pose is not None and t < self.until and self._pose.same(pose)

    def fill(self, pose: "Pose", until: float, evaluator: FieldEvaluator, drives: list[Complex]) -> None:
        """Compute what the drives until a time [s] will do; nothing where they are too few for that to pay."""
        self._pose, self.until = pose, until
        unlike = list({drive.tobytes(): drive for drive in drives}.values())
        self._drives = np.array(unlike if len(unlike) >= MATRIX_FROM else [])
        if len(self._drives):
            normals = self.normals @ pose.turn.T
            self._loads = arp_frames(evaluator, pose.points(self.points), normals, self._drives, law=self.law)

    def take(self, pose: "Pose", drive: Complex) -> Float32 | None:
        """ARP [Pa] for this drive, shape (n,), or None where it was not foreseen."""
        if self._pose is None or len(self._drives) == 0 or not self._pose.same(pose):
            return None
        away = np.abs(self._drives - drive).max(axis=1)
        row = int(away.argmin())
        return self._loads[row] if away[row] < SAME_DRIVE else None
