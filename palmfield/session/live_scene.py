"""Let the caller, instead of a script, place the hand of a scene."""

import copy
from collections.abc import Callable, Mapping

import mujoco

from palmfield.engine.host import world_of
from palmfield.engine.motion_plugin import MotionModule
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import SceneError
from palmfield.hand.articulated import ArticulatedHand
from palmfield.motion.pose import HandPose
from palmfield.motion.source import HandMotion
from palmfield.session.preview import Preview
from palmfield.simulation.posed_scene import PosedScene


class LiveScene:
    """A copy of a scene that has exactly one moving hand.

    runtime: runtime of the copy
    hand: joints of the hand
    script: scripted motion of the hand
    motion: name of its instance
    """

    def __init__(self, view: Preview) -> None:
        """Copy a scene. Raises SceneError if the scene moves no hand, or several hands."""
        self._data = copy.copy(view.data)
        world = world_of(self._data)
        assert world is not None and world.scene is not None
        self.runtime: SceneRuntime = world.scene
        self.motion, self._module = the_articulated(scripts(self._data), view.name)
        script = self._module.motion
        assert script.hand is not None
        self.hand: ArticulatedHand = script.hand
        self.script: Callable[[float], HandPose] = script.at

    def posed(self, pose: HandPose) -> PosedScene:
        """Return the scene with the hand in a pose. Raises SceneError if the hand reaches into an array."""
        self._module.motion = HandMotion(self.hand, lambda _: pose)
        self._module.place()
        mujoco.mj_kinematics(self._data.model, self._data)
        return self.runtime.posed


def scripts(data: mujoco.MjData) -> dict[str, MotionModule]:
    """Return, by instance, the modules that move bodies by script.

    A new value of their `motion` takes effect at once.
    """
    world = world_of(data)
    assert world is not None
    names = {number: name for number, _, name in world.model.instances()}
    return {names[number]: one for number, one in world.modules.items() if isinstance(one, MotionModule)}


def the_articulated(modules: Mapping[str, MotionModule], name: str) -> tuple[str, MotionModule]:
    """Return the only module that moves an articulated hand, and its instance. Raises SceneError if there is none or
    there are several; name: name of the scene."""
    moving = [one for one in modules.items() if one[1].motion.hand is not None]
    if len(moving) != 1:
        raise SceneError(
            f"{name} has {len(moving)} instances of plugin 'palmfield.motion' with key hand; a live hand needs one"
        )
    return moving[0]
