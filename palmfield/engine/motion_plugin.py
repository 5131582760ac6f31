"""The module that moves a hand by script."""

from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np

from palmfield.config import Config, MotionConfig
from palmfield.config.base import naming_keys
from palmfield.engine.host import Module, World, world_of
from palmfield.errors import SceneError
from palmfield.mujoco_host.mujoco_view import Write, mocap_offsets
from palmfield.transforms import rotation_matrix
from palmfield.types import Float

if TYPE_CHECKING:
    from palmfield.motion.pose import HandPose


class MotionModule(Module):
    """Moves a hand along its motion. After each step it sets the targets of the mocap body and of the joint servos.

    At the first step of the scene, and at every step with follow `exact`, it sets the hand itself to the pose and speed
    of the motion. The motion depends only on MuJoCo's time, so copies and saved states stay complete.
    """

    name: ClassVar[str] = MotionConfig.plugin
    config: ClassVar[type[Config]] = MotionConfig

    def __init__(self, settings: Any, world: World, instance: int):
        # Imported here: MuJoCo registers the plugins in every process, and Warp takes half a second to load.
        from palmfield.motion.source import motion_of
        from palmfield.simulation.scene_reader import check_rest, first_array_frame, with_files_found

        super().__init__(settings, world, instance)
        model = world.model
        names = {number: name for number, _, name in model.instances()}
        element = self.element = self.config.element(names[instance])
        found = with_files_found(settings, element)
        with naming_keys(element, found):
            self.motion = motion_of(found, first_array_frame(model))
        body = model.find("body", settings.body, f"{element}: key 'body'")
        self.mocap = int(model.raw.body_mocapid[body])
        if self.mocap < 0:
            raise SceneError(f"{element}: key 'body' has value '{settings.body}'; allowed: a body with mocap='true'")
        self._offsets = mocap_offsets(self.mocap)
        self._first_s = 1.5 * model.timestep
        self.servos: list[int] = []
        self.joints: list[int] = []
        self.root: int | None = None
        if self.motion.hand is not None:
            if not settings.body.endswith("hand_target"):
                raise SceneError(
                    f"{element}: key 'body' has value '{settings.body}'; allowed with key 'hand': [prefix]hand_target"
                )
            prefix, why = settings.body.removesuffix("hand_target"), f"{element}: key 'hand'"
            self._names = [joint.name for joint in self.motion.hand.joints]
            self._rest_deg = [joint.rest_deg for joint in self.motion.hand.joints]
            joints = [prefix + name for name in self._names]
            self.servos = [model.find("actuator", name, why) for name in joints]
            self.joints = [model.find("joint", name, why) for name in joints]
            self.root = model.find("joint", prefix + "hand_root", why)
            frame = model.reference_pose("body", model.find("body", prefix + "hand", why))
            for bone in self.motion.hand.bones:
                pose = model.reference_pose("body", model.find("body", prefix + bone.name, why))
                check_rest(bone, frame, pose, f"{why}: body '{prefix}{bone.name}'", "name the preset of that hand")
        rivals = [m for m in world.modules.values() if isinstance(m, MotionModule) and m.mocap == self.mocap]
        if rivals:
            raise SceneError(f"{element}: two instances move body '{settings.body}'; give each hand one")

    def place(self) -> None:
        """Set the mocap body, the servo targets and the hand itself to the pose of the motion at the present time."""
        self.world.put(self.due(self.world.time, at_once=True))

    def advance(self) -> None:
        """Set the targets for the end of the step."""
        self.world.put(self.due(self.world.raw.time))

    def due(self, time_s: float, at_once: bool = False) -> list[Write]:
        """Return values to write at a time [s] for mocap body and servo targets, and in some cases for the hand itself.

        These cases are `at_once`, the first step of the scene, and key follow = exact.
        """
        pose = self.motion.at(time_s)
        place, turn = self._offsets
        writes: list[Write] = [("mocap_pos", place, pose.position), ("mocap_quat", turn, pose.quaternion)]
        if self.servos:
            degrees = list(map(pose.angles_deg.get, self._names, self._rest_deg))
            writes.append(("ctrl", self.servos, np.deg2rad(degrees)))
        if at_once or time_s < self._first_s or self.settings.follow == "exact":
            writes += self._put(pose, time_s)
        return writes

    def _put(self, now: "HandPose", time_s: float) -> list[Write]:
        """Return the writes that set the hand itself to its pose and speed at a time [s]."""
        if self.root is None:
            return []
        model = self.world.model
        step = model.timestep
        before = self.motion.at(time_s - step)
        velocity = (now.position - before.position) / step
        turned = rotation_matrix(before.quaternion).T @ rotation_matrix(now.quaternion)
        spin = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
        angles = self._angles(now.angles_deg)
        speeds = (angles - self._angles(before.angles_deg)) / step
        first, speed = int(model.raw.jnt_qposadr[self.root]), int(model.raw.jnt_dofadr[self.root])
        places = [*range(first, first + 7), *(int(model.raw.jnt_qposadr[joint]) for joint in self.joints)]
        speeds_at = [*range(speed, speed + 6), *(int(model.raw.jnt_dofadr[joint]) for joint in self.joints)]
        return [
            ("qpos", places, np.concatenate([now.position, now.quaternion, angles])),
            ("qvel", speeds_at, np.concatenate([velocity, 0.5 * spin / step, speeds])),
        ]

    def _angles(self, angles_deg: dict[str, float]) -> Float:
        """Return the angles of all joints [rad]; joints without a named angle are at rest."""
        return np.deg2rad(list(map(angles_deg.get, self._names, self._rest_deg)))


def place(data: mujoco.MjData) -> None:
    """Set every scripted hand of an mjData to the pose of its motion at the time of the data, and update all positions.

    `palmfield.load` calls this function. Call it yourself after `mujoco.mj_resetData`, or after you set the time.
    Otherwise the first step has the hands in MuJoCo's reference configuration. Raises the SceneError of a motion.
    """
    world = world_of(data)
    if world is None:
        return
    for module in world.modules.values():
        if isinstance(module, MotionModule):
            module.place()
    mujoco.mj_kinematics(data.model, data)
