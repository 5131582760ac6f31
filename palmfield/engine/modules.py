"""The four modules of palmfield as MuJoCo plugins. They read the scene; `palmfield.chain` does the work."""

from typing import Any, ClassVar

import numpy as np

from palmfield.config import ArrayConfig, Config, DriverConfig, SkinConfig, StimulusConfig
from palmfield.engine.host import Module, settings_of
from palmfield.engine.world import ModelView, World
from palmfield.errors import SceneError
from palmfield.types import Float, Int

DURATION = "palmfield_duration_s"
"""Custom numeric of a scene: how long `palmfield run` runs it [s]."""
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
        from palmfield.chain import Chain
        from palmfield.engine.pose import Pose

        super().__init__(settings, world, instance)
        model = world.model
        self._between = Pose.between
        self.rig = rig_of(settings, model)
        self.body = model.find("body", settings.body, _element(self))
        self.sites = [_array_site(board.config, model) for board in self.rig.boards]
        self.transducers = [_transducer_sites(board.config, model) for board in self.rig.boards]
        self.frame = _frame_site(self.rig.stimulus, model)
        self.chain = Chain(self.rig)
        _ = self.rig.choice
        self.chain.check_clear(
            Pose.between(
                [model.reference_pose("site", site) for site in self.sites],
                model.reference_pose("body", self.body),
                [_reference_sites(numbers, model) for numbers in self.transducers],
            )
        )
        self._probes: dict[int, Any] = {}
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
        )
        return self.chain.skin.settled(found)

    def to_array(self, point: Float) -> Float:
        """A position in the stimulus's frame [m], shape (3,), in the frame of the first array."""
        if self.frame is None:
            return point
        frame, array = self.world.pose("site", self.frame), self.world.pose("site", self.sites[0])
        return array[1].T @ (frame[0] + frame[1] @ point - array[0])

    def now(self) -> tuple[Any, float]:
        """The sound at MuJoCo's present time and its factor; (None, 0) while silent."""
        return self.chain.now(self.world.state(self.instance), self.world.time, self.to_array, self.pose())

    def body_force(self) -> tuple[Float, Float]:
        """Force [N] and torque about the body's origin [N m] of the ARP, world axes, shapes (3,).

        The mean over the MuJoCo step that begins now, with the focus at its beginning: a modulation faster than the
        step gives the right impulse.
        """
        from palmfield.stimulus import frame_at

        start, pose = self.world.time, self.pose()
        factor = self.chain.mean_factor(self.world.state(self.instance), start, self.to_array, pose)
        if factor == 0.0:
            return np.zeros(3), np.zeros(3)
        sound = self.chain.sound(self.to_array(frame_at(self.rig.stimulus, start).focus), pose)
        turn = factor * self.world.pose("body", self.body)[1]
        force, torque = self.chain.resultant(sound)
        return turn @ force, turn @ torque

    def forces(self) -> None:
        """Apply the ARP's resultant to the body."""
        force, torque = self.body_force()
        self.applied = force
        self.world.apply(self.body, force, torque, self.world.pose("body", self.body)[0])

    def sense(self) -> None:
        """Fill the sensors from the state at the present time."""
        sound, factor = self.now()
        state = self.world.state(self.instance)
        for number, kind, target, data in self.world.sensors(self.instance):
            if number not in self._probes:
                self._probes[number] = self._probe(kind, target)
            probe = self._probes[number]
            data[:3] = self.body_force()[0]
            data[3:5] = self.chain.skin.read(state, probe.operator)[:, 0]
            data[5] = 0.0
            if sound is not None:
                data[5] = factor * self.chain.arp_at(probe.closest, probe.normals, sound.pose, sound.drive)[0][0]

    def _probe(self, kind: str, target: int) -> Any:
        model = self.world.model
        if kind != "site" or model.site_body(target) != self.body:
            raise SceneError(
                f"{_element(self)}: its sensor needs objtype='site' and a site of body '{self.rig.skin.body}'"
            )
        return self.chain.probe(model.site_position(target))

    def advance(self) -> None:
        """Carry the skin over MuJoCo's last step, with the pose at its beginning."""
        start = self.world.time - self.world.model.timestep
        self.chain.advance(self.world.state(self.instance), start, self.to_array, self.pose())


MODULES: tuple[type[Module], ...] = (ArrayModule, StimulusModule, DriverModule, SkinModule)


def _element(module: Module) -> str:
    name = next(n for i, _, n in module.world.model.instances() if i == module.instance)
    return f"plugin '{module.name}' instance '{name}'"


def _single(module: type[Module], model: ModelView) -> Any:
    found = [i for i, plugin, _ in model.instances() if plugin == module.name]
    if not found and module is DriverModule:
        return DriverConfig.model_validate({})
    if len(found) != 1:
        raise SceneError(
            f"plugin 'palmfield.skin': the scene has {len(found)} of '{module.name}'; exactly one is needed"
        )
    return settings_of(module, model, found[0])


def _frame_site(stimulus: StimulusConfig, model: ModelView) -> int | None:
    if stimulus.frame == "array":
        return None
    return model.find("site", stimulus.frame, "plugin 'palmfield.stimulus': key 'frame'")


def _array_site(config: ArrayConfig, model: ModelView) -> int:
    return model.find("site", config.site, "plugin 'palmfield.array': key 'site'")


def _boards(model: ModelView) -> tuple[Any, ...]:
    """The scene's arrays, in the reference pose; each has a site of its own, the first one's is the array frame."""
    from palmfield.emitter import Board
    from palmfield.engine.pose import placements

    found = [i for i, plugin, _ in model.instances() if plugin == ArrayModule.name]
    if not found:
        raise SceneError("plugin 'palmfield.skin': the scene has no 'palmfield.array'; at least one is needed")
    configs: list[Any] = [settings_of(ArrayModule, model, i) for i in found]
    for config in configs[1:]:
        for key in ("temperature_C", "humidity_percent", "pressure_Pa", "compute", "precision"):
            if getattr(config, key) != getattr(configs[0], key):
                raise SceneError(
                    f"plugin 'palmfield.array': key '{key}' has value {getattr(config, key)} at site '{config.site}' "
                    f"and {getattr(configs[0], key)} at site '{configs[0].site}'; allowed: the same for all arrays"
                )
    poses = [model.reference_pose("site", _array_site(config, model)) for config in configs]
    sites = [_reference_sites(_transducer_sites(config, model), model) for config in configs]
    return tuple(Board(*pair) for pair in zip(configs, placements(poses, sites), strict=True))


def _transducer_sites(config: ArrayConfig, model: ModelView) -> Int:
    """Numbers of the sites that are an array's transducers, shape (n,); none for another layout than `sites`.

    A site that a key names serves another purpose, however its name begins.
    """
    if config.sites is None:
        return np.zeros(0, np.int32)
    keys = ["site", "frame", "patch_site"]
    named = {config.site} | {text for i, _, _ in model.instances() for text in model.values(i, keys).values()}
    names = [name for name in model.names("site") if name.startswith(config.sites) and name not in named]
    if not names:
        raise SceneError(
            f"plugin 'palmfield.array': key 'sites' has value '{config.sites}'; allowed: how names of sites begin that "
            f"no key names; the scene has: {', '.join(model.names('site'))}"
        )
    element = "plugin 'palmfield.array': key 'sites'"
    return np.array([model.find("site", name, element) for name in names], dtype=np.int32)


def _reference_sites(numbers: Int, model: ModelView) -> tuple[Float, Float]:
    """World positions [m] and z axes of sites in the reference pose, shapes (n, 3)."""
    poses = [model.reference_pose("site", int(number)) for number in numbers]
    return (
        np.array([position for position, _ in poses]).reshape(-1, 3),
        np.array([turn[:, 2] for _, turn in poses]).reshape(-1, 3),
    )


def rig_of(skin: SkinConfig, model: ModelView) -> Any:
    """The rig of the scene that this skin instance stands in."""
    from palmfield.emitter import Placement
    from palmfield.engine.pose import relative
    from palmfield.rig import rig

    boards = _boards(model)
    stimulus, driver = (_single(m, model) for m in (StimulusModule, DriverModule))
    shift, turn = np.zeros(3), np.eye(3)
    frame = _frame_site(stimulus, model)
    if frame is not None:
        site = _array_site(boards[0].config, model)
        shift, turn = relative(model.reference_pose("site", site), model.reference_pose("site", frame))
    stimulus_frame = Placement(tuple(shift.tolist()), tuple(turn.ravel().tolist()))
    centre = np.zeros(3)
    if skin.patch_site is not None:
        number = model.find("site", skin.patch_site, "plugin 'palmfield.skin': key 'patch_site'")
        centre = model.site_position(number)
    body = relative(
        model.reference_pose("site", _array_site(boards[0].config, model)),
        model.reference_pose("body", model.find("body", skin.body, "plugin 'palmfield.skin': key 'body'")),
    )
    place = Placement(tuple(body[0].tolist()), tuple(body[1].ravel().tolist()))
    duration = model.numeric(DURATION, 0.1)
    return rig(
        boards, stimulus, skin, driver, model.timestep, stimulus_frame, tuple(centre.tolist()), place, duration
    )  # fmt: skip
