"""The four modules of palmfield as MuJoCo plugins. They read the scene; `palmfield.chain` does the work."""

from typing import Any, ClassVar

import numpy as np

from palmfield.config import ArrayConfig, Config, DriverConfig, SkinConfig, StimulusConfig
from palmfield.engine.host import Module
from palmfield.engine.motion import MotionModule
from palmfield.engine.reading import (
    array_site,
    bones_of,
    frame_site,
    obstacles_of,
    reference_sites,
    rig_of,
    transducer_sites,
)
from palmfield.errors import SceneError
from palmfield.mujoco_host.mujoco_view import ModelView, World
from palmfield.types import Float

SENSOR_REACH_M = 0.01
"""A sensor's site may lie so far from the skin layer."""
SENSOR_CHANNELS = (
    "arp_force_x_N", "arp_force_y_N", "arp_force_z_N", "normal_displacement_m", "normal_velocity_m_s", "arp_Pa",
)  # fmt: skip


class ArrayModule(Module):
    """Holds the keys of one array; the skin module evaluates all of them together."""

    name: ClassVar[str] = ArrayConfig.plugin
    config: ClassVar[type[Config]] = ArrayConfig


class StimulusModule(Module):
    """Holds the stimulus's keys."""

    name: ClassVar[str] = StimulusConfig.plugin
    config: ClassVar[type[Config]] = StimulusConfig


class DriverModule(Module):
    """Holds the device's keys."""

    name: ClassVar[str] = DriverConfig.plugin
    config: ClassVar[type[Config]] = DriverConfig


class SkinModule(Module):
    """Pushes the body with the ARP's resultant and carries the skin layer's motion in the plugin state.

    `applied` is the mean force over the present step [N], world axes. The sensor, on a site of the body, reads
    SENSOR_CHANNELS: that force, and at the skin point nearest to the site the displacement and velocity along the
    outward normal and the ARP. As all of MuJoCo's sensors it belongs to the step's beginning: after mj_step it is one
    timestep older than data.time, until mj_forward.
    """

    name: ClassVar[str] = SkinConfig.plugin
    config: ClassVar[type[Config]] = SkinConfig
    sensor: ClassVar[bool] = True

    def __init__(self, settings: Any, world: World, instance: int):
        # Imported here: MuJoCo registers the plugins in every process, and Warp takes half a second to load.
        from palmfield.aim import Aim
        from palmfield.chain import Chain
        from palmfield.engine.pose import Pose, relative

        super().__init__(settings, world, instance)
        model = world.model
        self._between, self._relative, self._aim = Pose.between, relative, Aim
        self.rig = rig_of(settings, model)
        self.body = model.find("body", settings.body, _element(self))
        self.sites = [array_site(board.config, model) for board in self.rig.boards]
        self.transducers = [transducer_sites(board.config, model) for board in self.rig.boards]
        self.frame = frame_site(self.rig.stimulus, model)
        self.bones = bones_of(settings, model)
        self.others = self.bones + [number for _, number in obstacles_of(settings, model, self.bones)]
        self.chain = Chain(self.rig)
        _ = self.rig.choice
        self.chain.check_clear(
            Pose.between(
                [model.reference_pose("site", site) for site in self.sites],
                model.reference_pose("body", self.body),
                [reference_sites(numbers, model) for numbers in self.transducers],
                [model.reference_pose("body", number) for number in self.others],
            )
        )
        self._probes: dict[int, Any] = {}
        self._held: tuple[float, Any] | None = None
        self.applied = np.zeros(3)

    @classmethod
    def state_size(cls, settings: Any, model: ModelView) -> int:
        """Room for the whole layer's motion, of which a small model of it takes a part, and what is emitted."""
        return rig_of(settings, model).state_size

    @classmethod
    def sensor_size(cls, settings: Any, model: ModelView, sensor: int) -> int:
        """See SENSOR_CHANNELS."""
        return len(SENSOR_CHANNELS)

    def pose(self) -> Any:
        """Body and arrays in the frame of the first array, as MuJoCo has them now, see `SceneSkin.settled`."""
        found = self._between(
            [self.world.pose("site", site) for site in self.sites],
            self.world.pose("body", self.body),
            [self.world.sites(numbers) for numbers in self.transducers],
            [self.world.pose("body", number) for number in self.others],
        )
        return self.chain.skin.settled(found)

    def aim(self, pose: Any, time_s: float | None = None) -> Any:
        """Where the stimulus's points are, a `palmfield.aim.Aim`; between control ticks, where they were at the last.

        pose: of now; time_s: within the present step [s], now by default
        """
        now = self.world.time if time_s is None else time_s
        rate = self.rig.stimulus.control_rate_Hz
        if rate > 0.0 and self._held is not None:
            before, held = self._held
            # A nanosecond, as for ticks in `palmfield.stimulus`.
            if now >= before and int((now + 1e-9) * rate) == int((before + 1e-9) * rate):
                return held
        array = self.world.pose("site", self.sites[0])
        frame = array if self.frame is None else self.world.pose("site", self.frame)
        return self._aim(self.rig, self._relative(array, frame), pose)

    def to_array(self, point: Float) -> Float:
        """Where one of the stimulus's points, `Frame.focus`, is now in the frame of the first array [m]."""
        foci: Float = self.aim(self.pose())(point)
        return foci

    def now(self) -> tuple[Any, float]:
        """The sound at MuJoCo's present time and its factor; (None, 0) while silent."""
        pose = self.pose()
        return self.chain.now(self.world.state(self.instance), self.world.time, self.aim(pose), pose)

    def body_force(self) -> tuple[Float, Float]:
        """Force [N] of the ARP on the whole body and torque about its origin [N m], world axes; see `body_forces`."""
        forces, torques = self.body_forces()
        bodies = self.bones or [self.body]
        arms = [self.world.pose("body", bone)[0] - self.world.pose("body", self.body)[0] for bone in bodies]
        return forces.sum(axis=0), (torques + np.cross(arms, forces)).sum(axis=0)

    def body_forces(self) -> tuple[Float, Float]:
        """Force [N] of the ARP on the body or each of its bones, torque about its origin [N m], world axes, (b, 3).

        The mean over the MuJoCo step that begins now, with the focus at its beginning: a modulation faster than the
        step gives the right impulse.
        """
        from palmfield.stimulus.schedule import frame_at

        start, pose = self.world.time, self.pose()
        if self._held is not None and start <= self._held[0]:
            # The same moment again, or an earlier one after a reset: what was held then may lie elsewhere now.
            self._held = None
        aim = self.aim(pose)
        if self._held is None or self._held[1] is not aim:
            self._held = start, aim
        factor = self.chain.mean_factor(self.world.state(self.instance), start, aim, pose)
        if factor == 0.0:
            none = np.zeros((max(1, len(self.bones)), 3))
            return none, none
        sound = self.chain.sound(aim(frame_at(self.rig.stimulus, start).focus), pose)
        turn = factor * self.world.pose("body", self.body)[1]
        forces, torques = self.chain.resultants(sound)
        return forces @ turn.T, torques @ turn.T

    def forces(self) -> None:
        """Apply the ARP's resultant to the body, or to each bone its own."""
        forces, torques = self.body_forces()
        self.applied = forces.sum(axis=0)
        for body, force, torque in zip(self.bones or [self.body], forces, torques, strict=True):
            self.world.apply(body, force, torque, self.world.pose("body", body)[0])

    def sense(self) -> None:
        """Fill the sensors from the state at the present time."""
        sound, factor = self.now()
        state = self.world.state(self.instance)
        for number, kind, target, data in self.world.sensors(self.instance):
            if number not in self._probes:
                self._probes[number] = self._probe(kind, target)
            probe, bound = self._probes[number]
            data[:3] = self.body_force()[0]
            data[3:5] = self.chain.skin.read(state, probe.operator)[:, 0]
            data[5] = 0.0
            if sound is not None:
                points, normals = self.rig.posed(sound.pose).moved(probe.closest, probe.normals, bound)
                data[5] = factor * self.chain.arp_at(points, normals, sound.pose, sound.drive)[0][0]

    def _probe(self, kind: str, target: int) -> Any:
        model = self.world.model
        if kind != "site" or model.site_body(target) not in (self.body, *self.bones):
            raise SceneError(
                f"{_element(self)}: its sensor needs objtype='site' and a site of body '{self.rig.skin.body}'"
                + (" or of one of its bones" if self.bones else "")
            )
        place = model.site_position(target)
        if self.bones:
            assert self.rig.hand is not None
            place = place + self.rig.hand.bones[self.bones.index(model.site_body(target))].origin
        probe = self.chain.probe(place)
        if probe.distance[0] > max(SENSOR_REACH_M, 2.0 * self.rig.sizes[1]):
            raise SceneError(
                f"{_element(self)}: its site is {1e3 * probe.distance[0]:.0f} mm from the skin layer, whose rim "
                "it would read; put it on the layer, or patch_site nearer to it"
            )
        return probe, self.rig.bound(probe.closest)

    def advance(self) -> None:
        """Carry the skin over MuJoCo's last step, with the pose at its beginning."""
        start = self.world.time - self.world.model.timestep
        pose = self.pose()
        self.chain.advance(self.world.state(self.instance), start, self.aim(pose, start), pose)


MODULES: tuple[type[Module], ...] = (ArrayModule, StimulusModule, DriverModule, SkinModule, MotionModule)


def _element(module: Module) -> str:
    name = next(n for i, _, n in module.world.model.instances() if i == module.instance)
    return f"plugin '{module.name}' instance '{name}'"
