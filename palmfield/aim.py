"""From what a stimulus asks for to places in the frame of the first array."""

from typing import TYPE_CHECKING

import numpy as np

from palmfield.engine.pose import Pose
from palmfield.types import Float

if TYPE_CHECKING:
    from palmfield.rig import Rig


class Aim:
    """Where the stimulus's points are while body, arrays and the stimulus's frame keep still.

    frame: position [m] and rotation of the stimulus's frame in that of the first array
    """

    def __init__(self, rig: "Rig", frame: tuple[Float, Float], pose: Pose):
        self.rig, self.pose = rig, pose
        self.shift, self.turn = frame
        self.offsets = np.reshape(rig.setting.stimulus.foci_m, (-1, 3))

    def __call__(self, point: Float) -> Float:
        """Foci [m], shape (3,), or (m, 3) for several at once; point: `palmfield.stimulus.schedule.Frame.focus`, shape
        (3,)."""
        if len(self.offsets):
            return self.shift + (point + self.offsets) @ self.turn.T
        return self.course(point[None])[0]

    def course(self, points: Float) -> Float:
        """The focus, or the middle of several, for many points, shape (n, 3) [m]."""
        path = self.rig.skin_path
        if path is None:
            return self.shift + points @ self.turn.T
        body = self.rig.posed(self.pose)
        return self.pose.points(path.positions(points[:, 0], body.vertices, self.rig.closed_surface[1]))
