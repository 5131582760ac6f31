"""One mjData with its plugins, stepped by MuJoCo itself."""

import copy

import mujoco
import numpy as np

from palmfield.engine.host import raise_errors, world_of
from palmfield.engine.motion_plugin import place
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import SceneError
from palmfield.simulation.step import Steps
from palmfield.types import Float


class OneWorld:
    """One world of a scene, with the methods of `palmfield.engine.worlds.SceneWorlds`.

    data: the only mjData; runtimes: the `SceneRuntime` objects that step it
    """

    def __init__(self, data: mujoco.MjData, name: str):
        """Raises SceneError for a scene without skins. name: name of the scene"""
        world = world_of(data)
        if world is None or world.scene is None:
            raise SceneError(f"{name} has no plugin 'palmfield.skin', so it is a plain MuJoCo model; add the plugin")
        world.quiet = True
        self.data, self.mujoco_model, self.name = (data,), data.model, name
        self.runtimes: list[SceneRuntime] = [world.scene]

    @property
    def steps(self) -> Steps:
        """Return the Steps object that steps sound and skins."""
        return self.runtimes[0].steps

    @property
    def forces(self) -> Float:
        """Return the mean force of the sound over the last step [N], world axes, shape (1, bodies, 3)."""
        return np.array([self.runtimes[0].applied])

    def step(self) -> None:
        """Run one MuJoCo step. Raises the error of a plugin, if one occurred in the step."""
        mujoco.mj_step(self.mujoco_model, self.data[0])
        raise_errors(self.data[0])

    def several(self, most: int) -> int:
        """Run up to `most` MuJoCo steps, and return their number.

        Forces and sensors are computed only for the last one. If forces affect the motion, or sensors are read, it is
        one step. Raises like `step`.
        """
        runtime = self.runtimes[0]
        count = most if most > 1 and runtime.may_gather else 1
        if count > 1:
            runtime.gathers = True
            try:
                for _ in range(count - 1):
                    self.step()
            finally:
                runtime.gathers = False
                runtime.settle()
        self.step()
        return count

    def restart(self, time_s: float | None = None) -> None:
        """Reset to rest at a time [s], 0 by default, with hands in the pose of their motions at that time."""
        mujoco.mj_resetData(self.mujoco_model, self.data[0])
        if time_s is not None:
            self.data[0].time = time_s
        place(self.data[0])
        self.look()

    def look(self) -> None:
        """Compute forces and sensors at the present time without a step."""
        mujoco.mj_forward(self.mujoco_model, self.data[0])
        raise_errors(self.data[0])

    def settle(self) -> None:
        """Do nothing, because this class never defers work."""

    def copy(self) -> "OneWorld":
        """Return another world in the same state."""
        return OneWorld(copy.copy(self.data[0]), self.name)
