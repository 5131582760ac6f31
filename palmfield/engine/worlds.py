"""Several mjData of one model that are stepped together: bodies each by itself, sound and skins in one go.

A step is mj_step in two halves. After mj_step1 all poses are known; the forces that follow from them are added to the
passive ones before mj_step2 integrates, so that nothing lags behind what a plain mj_step does.
"""

import copy
from collections.abc import Mapping, Sequence
from operator import is_

import mujoco
import numpy as np
from numpy.typing import NDArray

from palmfield.engine.host import raise_errors, world_of
from palmfield.engine.many_data import ManyData
from palmfield.engine.modules import MODULES
from palmfield.engine.motion_plugin import MotionModule, place
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.engine.skin_plugin import SkinModule
from palmfield.engine.world_poses import WorldPoses
from palmfield.errors import SceneError, explaining, naming_world
from palmfield.mujoco_host.mujoco_view import DataView, ModelView, PluginSensor, Write, mocap_offsets
from palmfield.mujoco_host.structs import mirror
from palmfield.simulation.model import HapticModel
from palmfield.simulation.moving_worlds import MovingWorlds
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import channels_of_worlds
from palmfield.simulation.state import HEADER, HapticState, new_state
from palmfield.simulation.step import Workspace
from palmfield.simulation.step_together import TogetherStep
from palmfield.types import Float


class SceneWorlds:
    """Several worlds of one scene.

    data: MuJoCo's, one for each world; models: of the same bodies, with each world's own stimuli; state: of all worlds
    poses: by number of a mocap body, where it is in each world in each step, position [m] and quaternion (w, x, y, z),
        shape (worlds, steps, 7); it stays at the last
    forces: mean force of the sound over the present step [N], world axes, shape (worlds, bodies, 3)
    """

    def __init__(
        self,
        template: mujoco.MjData,
        data: Sequence[mujoco.MjData],
        models: Sequence[HapticModel],
        poses: Mapping[int, Float],
        state: HapticState | None = None,
    ):
        """template: data of the scene with its plugins; data: of each world, which have them or, if there are only
        palmfield's own, come from `plain_model`: then nothing calls Python in a step"""
        self.template, self.data, self.models, self.poses = template, tuple(data), tuple(models), dict(poses)
        self.mujoco_model: mujoco.MjModel = data[0].model
        count = len(self.data)
        self.state = new_state(models[0], count) if state is None else state
        self.forces: Float = np.zeros((count, len(models[0].bodies), 3))
        led = world_of(template)
        assert led is not None
        self._worlds = [world for one in self.data if (world := world_of(one)) is not None]
        own = [] if self._worlds else led.modules.values()
        self._scripts = [module for module in own if isinstance(module, MotionModule)]
        for world in self._worlds:
            world.quiet = True
            for module in world.modules.values():
                if isinstance(module, SkinModule):
                    module.hand_over()
        like: SceneRuntime = led.scene
        views = [DataView(self.mujoco_model._address, one._address) for one in self.data]
        self.many = ManyData(views, bool(self._worlds))
        self.runtimes = [SceneRuntime(view, like) for view in views]
        frames = like.frames
        positions, matrices = np.zeros((count, frames, 3)), np.zeros((count, frames, 9))
        works: list[Workspace] = []
        self._sensors: list[list[list[PluginSensor]]] = []
        for number, (view, runtime, model) in enumerate(zip(views, self.runtimes, models, strict=True)):
            works.append(Workspace(model, works[0] if works else None))
            beside = self.runtimes[0] if number else None
            runtime.join(model, self.state.world(number), works[-1], (positions[number], matrices[number]), beside)
            self._sensors.append([view.sensors(skin.instance) for skin in runtime.binding.skins])
        self.together = TogetherStep(models, works, self.state)
        self.moving = MovingWorlds(models, works, self.state)
        self._watched: list[list[int]] = []  # numbers of the sensors' places, by skin
        self._poses, self._frames = WorldPoses(self.runtimes, self.many, positions, matrices), (positions, matrices)
        # The ARP of the unit drives at a sensor, by skin and number, with the poses for which it holds
        self._probed: dict[tuple[int, int], tuple[bytes, list[PosedScene], Float]] = {}

    # -- stepping ------------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """One step of MuJoCo's in all worlds. Raises what a plugin or the step raised, with the world's number."""
        self.runtimes[0].check_options()
        t0 = self._common_time()
        with explaining():
            self._lead(t0)
            self._each("mj_step1")
            posed = self._push(t0)
            self._sense(posed, t0)
            self._each("mj_step2")
            t1 = self._common_time()
            for module in self._scripts:
                self._put(module.due(t1))
            self._advance(t1)

    def restart(self, time_s: float | None = None) -> None:
        """All worlds at rest at a time [s], at 0 without, with hands where their motions have them then."""
        for one in self.data:
            mujoco.mj_resetData(self.mujoco_model, one)
            if time_s is not None:
                one.time = time_s
        self.place()
        self.moving.forget()
        for part in (*self.state.arrays, *self.state.skins):
            part[:] = 0.0
        for runtime in self.runtimes:
            runtime.forget()
            runtime.work.emission.forget()
            runtime.work.begin_run()
        self._poses.forget()
        self.together.forget()
        self.look()

    def look(self) -> None:
        """Forces and sensors at the present time, without a step."""
        t0 = self._common_time()
        self._lead(t0)
        self._each("mj_step1")
        with explaining():
            self._sense(self._push(t0), t0)
        for one in self.data:
            mujoco.mj_forwardSkip(self.mujoco_model, one, int(mujoco.mjtStage.mjSTAGE_VEL), 0)

    def place(self) -> None:
        """Put hands where their motions have them now."""
        time_s = self.data[0].time
        for module in self._scripts:
            self._put(module.due(time_s, at_once=True))
        for one in self.data:
            place(one)
        self.many.call("mj_kinematics")

    def adopt(self, other: "SceneWorlds") -> None:
        """Go on as the other would, whose data and state are copied already."""
        self.forces[:] = other.forces
        for runtime, origin in zip(self.runtimes, other.runtimes, strict=True):
            runtime.adopt(origin)
        self.together.adopt(other.together)

    def copy(self) -> "SceneWorlds":
        """As many worlds again in the same state."""
        self.settle()
        data = [copy.copy(one) for one in self.data]
        twin = SceneWorlds(self.template, data, self.models, self.poses, self.state.copy())
        twin.adopt(self)
        return twin

    # -- the parts of a step -------------------------------------------------------------------------------------------

    def _each(self, call: str) -> None:
        """Let MuJoCo do something in every world."""
        self.many.call(call)
        for number, world in enumerate(self._worlds):
            if world.error is not None:
                with naming_world(number):
                    raise_errors(self.data[number])

    def _put(self, writes: Sequence[Write]) -> None:
        """Write the same numbers, or those of each world, into all of them."""
        for write in writes:
            self.many.put(*write)

    def _common_time(self) -> float:
        """MuJoCo's time [s]. Raises SceneError for worlds at different times."""
        times = self.many.times()
        if (times != times[0]).any():
            number = int(np.argmax(times != times[0]))
            raise SceneError(
                f"world {number} is at {times[number]:g} s and world 0 at {times[0]:g} s, but worlds share their time: "
                "nobody else may set or step one, and MuJoCo resets a world that has become unstable (then make "
                "option 'timestep' smaller)"
            )
        return float(times[0])

    def _lead(self, t0: float) -> None:
        """Put the bodies that `poses` lead where they are in the step that begins at t0 [s]."""
        for mocap, poses in self.poses.items():
            row = min(max(round(t0 / self.mujoco_model.opt.timestep), 0), poses.shape[1] - 1)
            place, turn = mocap_offsets(mocap)
            self._put([("mocap_pos", place, poses[:, row, :3]), ("mocap_quat", turn, poses[:, row, 3:])])

    def settle(self) -> None:
        """Bring the state up to date, where a device has what is newer."""
        self.moving.fetch()

    def _watch(self) -> None:
        """Have the places of all sensors watched, once: before a state has been given to a device."""
        if not self._watched and self.moving.some:
            for skin, sensors in enumerate(self._sensors[0]):
                places = [self.runtimes[0].place(skin, sensor) for sensor in sensors]
                self._watched.append([self.moving.watch(skin, place) for place in places])

    def _push(self, t0: float) -> dict[int, PosedScene]:
        """Poses of worlds that nothing else carries; the sound's forces are added to MuJoCo's passive ones."""
        self._watch()
        self._poses.take()
        together, first = self.together, self.runtimes[0].work
        watched = any(operator is not None for operator in first.observe) or first.observer is not None
        self.moving.begin(*self._frames, t0, watched or together.observer is not None)
        alone = np.ones(len(self.data), dtype=bool)
        alone[self.moving.joined] = False
        posed = self._poses.now(alone)
        together.begin(posed, t0)
        if together.apart:
            for number in together.apart:
                with naming_world(number):
                    self.runtimes[number].push()
                self.forces[number] = self.runtimes[number].applied
        self._apply(together.joined, together.mean_forces(t0))
        self._apply(self.moving.joined, self.moving.mean_forces())
        return posed

    def _apply(self, worlds: NDArray[np.intp], forces: Sequence[tuple[Float, Float]]) -> None:
        """Push the bodies of some worlds: forces on the parts of each and torques about their origins, (g, b, 3)."""
        for body, own in enumerate(forces):
            self.forces[worlds, body] = np.add.reduce(own[0], axis=1)
            self.many.push(self.runtimes[0].parts[body], worlds, *own)

    def _sense(self, posed: Mapping[int, PosedScene], t0: float) -> None:
        """Fill the sensors of all worlds."""
        together = self.together
        for number in together.apart:
            for skin, sensors in enumerate(self._sensors[number]):
                if sensors:
                    with naming_world(number):
                        self.runtimes[number].sense(skin, sensors)
        if len(self.moving.joined):
            for skin, numbers in enumerate(self._watched):
                for which, number in enumerate(numbers):
                    arp, motion = self.moving.sensed(number)
                    self._tell(skin, which, self.moving.joined, motion, arp)
        worlds = together.joined
        if len(worlds) == 0 or not any(self._sensors[0]):
            return
        factors = together.present_factors(t0)
        where = [posed[world] for world in worlds.tolist()]
        for skin, sensors in enumerate(self._sensors[0]):
            for which in range(len(sensors)):
                motion = self._motion_at(skin, which, worlds)
                self._tell(skin, which, worlds, motion, factors * self._probe(skin, which, worlds, where))

    def _tell(self, skin: int, which: int, worlds: NDArray[np.intp], motion: Float, arp: Float) -> None:
        """Fill a sensor in some worlds: displacement [m] and velocity [m/s], shape (g, 2), and ARP [Pa], shape (g,)."""
        read = channels_of_worlds(self.forces[worlds, self.models[0].skins[skin].body], motion, arp)
        if len(worlds) == len(self.data):
            self.many.put("sensordata", self._sensors[0][skin][which].offsets, read)
            return
        for world, row in zip(worlds.tolist(), read, strict=True):
            self._sensors[world][skin][which].data[:] = row

    def _motion_at(self, skin: int, which: int, worlds: NDArray[np.intp]) -> Float:
        """Displacement [m] and velocity [m/s] of the skin at a sensor in some worlds, shape (g, 2)."""
        part, result = self.state.skins[skin], np.zeros((len(self.data), 2))
        begun = part[worlds, 0] != 0.0
        for stepper, own in self.together.groups(skin, worlds[begun]):
            reader = self.runtimes[own[0]].place(skin, self._sensors[own[0]][skin][which]).reader(stepper)
            numbers = part[own, HEADER : HEADER + stepper.state_size]
            result[own] = stepper.read(numbers, reader)[..., 0]
        return result[worlds]

    def _probe(self, skin: int, which: int, worlds: NDArray[np.intp], where: list[PosedScene]) -> Float:
        """The ARP of the unit drives at a sensor in some worlds [Pa], shape (g,); where: their poses."""
        known = self._probed.get((skin, which))
        if known is not None and known[0] == worlds.tobytes() and all(map(is_, known[1], where)):
            return known[2]
        result = np.zeros(len(worlds))
        for i, (world, posed) in enumerate(zip(worlds.tolist(), where, strict=True)):
            runtime = self.runtimes[world]
            place = runtime.place(skin, self._sensors[world][skin][which])
            body = posed.bodies[self.models[world].skins[skin].body]
            points, normals = body.moved(place.probe.closest, place.probe.normals, place.binding)
            unit = self.together.unit(world)
            result[i] = runtime.work.radiation.at(posed, skin, "probe", points, normals, unit).arp[0]
        self._probed[skin, which] = worlds.tobytes(), where, result
        return result

    def _advance(self, t1: float) -> None:
        """Carry transducers and skins of all worlds over MuJoCo's last step, with the poses at its beginning."""
        self.moving.advance()
        self.together.advance(t1 - self.models[0].spec.timestep_s, t1)
        for number in self.together.apart:
            with naming_world(number):
                self.runtimes[number].advance()


def plain_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy without plugins, whose data take a step without Python; the model itself where others than palmfield's
    are among them. Sensors keep their places."""
    view = ModelView(model._address)
    if any(plugin not in {module.name for module in MODULES} for _, plugin, _ in view.instances()):
        return model
    plain = copy.copy(model)
    raw = mirror("mjModel").from_address(plain._address)
    raw.nplugin = raw.npluginstate = raw.npluginattr = 0
    return plain
