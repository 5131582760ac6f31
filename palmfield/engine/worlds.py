"""Several mjData of one model, stepped together. Bodies are stepped one by one, sound and skins in one operation.

A step is an mj_step in two halves. After mj_step1 all poses are known. The forces of the sound at these poses are
added to the passive forces before mj_step2 integrates. So the forces have no delay, as in a plain mj_step.
"""

import copy
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from palmfield.config import CONFIGS
from palmfield.engine.afferents_plugin import AfferentsModule
from palmfield.engine.host import raise_errors, world_of
from palmfield.engine.many_data import Field, ManyData
from palmfield.engine.motion_plugin import MotionModule, place
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.engine.skin_plugin import SkinModule
from palmfield.errors import SceneError, explaining, naming_world
from palmfield.mujoco_host.mujoco_view import DataView, ModelView, PluginSensor, Write, mocap_offsets
from palmfield.mujoco_host.structs import mirror
from palmfield.simulation.backend import Frames
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, settled_worlds
from palmfield.simulation.sensors import channels
from palmfield.simulation.state import HapticState, new_state
from palmfield.simulation.step import Steps
from palmfield.simulation.workspace import Workspace
from palmfield.types import Float


class SceneWorlds:
    """Several worlds of one scene.

    data: one mjData per world
    models: models of the same bodies, with the stimuli of each world
    state: state of all worlds
    poses: number of a mocap body -> its pose in each world and step, position [m] and quaternion (w, x, y, z),
        shape (worlds, steps, 7); after the last of these steps the body stays in its last pose
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
        """template: data of the scene with its plugins
        data: one mjData for each world, with plugins. If all plugins belong to palmfield, make these data from
            `plain_model`; their steps then need no Python
        """
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
                if isinstance(module, SkinModule | AfferentsModule):
                    module.hand_over()
        like: SceneRuntime = led.scene
        views = [DataView(self.mujoco_model._address, one._address) for one in self.data]
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
        self._rates = [views[0].sensors(instance) for instance in like.binding.region_instances]
        self.steps = Steps(models, works, self.state, alone=True)
        # By address of the sensor, because the model without plugins does not apply them
        sensors = self.mujoco_model.sensor_adr.tolist(), self.mujoco_model.sensor_cutoff.tolist()
        self._cutoffs: dict[int, float] = dict(zip(*sensors, strict=True))
        self._watched = False
        # Parts of the worlds with their data: a graph computes one part while MuJoCo moves the bodies of another
        owns = [backend.own for backend in self.steps.backends[:-1]] or [slice(0, count)]
        self._parts = [(own, ManyData(views[own], bool(self._worlds))) for own in owns]
        self._poses = WorldPoses(self.runtimes, positions, matrices)
        self._frames = Frames(positions, matrices, self._poses.now)

    # -- stepping ------------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """Run one MuJoCo step in all worlds.

        Raises the error of a plugin or of the step, with the number of the world.
        """
        self.runtimes[0].check_options()
        t0 = self._common_time()
        with explaining():
            self._lead(t0)
            self._begin(t0, moves=True)
            t1 = self._common_time()
            for module in self._scripts:
                self._put(module.due(t1))
            self._advance(t1)

    def several(self, most: int) -> int:
        """Run one step; see `OneWorld.several`."""
        self.step()
        return 1

    def restart(self, time_s: float | None = None) -> None:
        """Reset all worlds to rest at a time [s], default 0, with hands in the pose of their motions at that time."""
        for one in self.data:
            mujoco.mj_resetData(self.mujoco_model, one)
            if time_s is not None:
                one.time = time_s
        self.place()
        for part in (*self.state.arrays, *self.state.skins, *self.state.regions):
            part[:] = 0.0
        for runtime in self.runtimes:
            runtime.forget()
            runtime.work.emission.forget()
            runtime.work.begin_run()
        self._poses.forget()
        self.steps.forget()
        self.look()

    def look(self) -> None:
        """Compute forces and sensors at the present time without a step."""
        t0 = self._common_time()
        self._lead(t0)
        with explaining():
            self._begin(t0, moves=False)
        for one in self.data:
            mujoco.mj_forwardSkip(self.mujoco_model, one, int(mujoco.mjtStage.mjSTAGE_VEL), 0)

    def place(self) -> None:
        """Set all hands to the pose of their motions at the present time."""
        time_s = self.data[0].time
        for module in self._scripts:
            self._put(module.due(time_s, at_once=True))
        for one in self.data:
            place(one)
        for part in range(len(self._parts)):
            self._each(part, "mj_kinematics")

    def adopt(self, other: "SceneWorlds") -> None:
        """Continue from another SceneWorlds, whose data and state are already copied."""
        self.forces[:] = other.forces
        for runtime, origin in zip(self.runtimes, other.runtimes, strict=True):
            runtime.adopt_pose(origin)
        self.steps.adopt(other.steps)

    def copy(self) -> "SceneWorlds":
        """Return the same number of worlds in the same state."""
        self.settle()
        data = [copy.copy(one) for one in self.data]
        twin = SceneWorlds(self.template, data, self.models, self.poses, self.state.copy())
        twin.adopt(self)
        return twin

    # -- the parts of a step -------------------------------------------------------------------------------------------

    def _each(self, part: int, call: str) -> None:
        """Call a MuJoCo function in every world of a part."""
        own, many = self._parts[part]
        if not self.runtimes[0].unseen:
            # The bindings of MuJoCo pass on errors of callbacks and of other plugins, which would end a process in C
            for one in self.data[own]:
                getattr(mujoco, call)(self.mujoco_model, one)
        else:
            many.call(call)
        for number, world in enumerate(self._worlds[own], own.start):
            if world.error is not None:
                with naming_world(number):
                    raise_errors(self.data[number])

    def _put(self, writes: Sequence[Write]) -> None:
        """Write numbers into all worlds: the same set for all worlds, or one set per world."""
        for field, offsets, values in writes:
            each = np.asarray(values)
            for own, many in self._parts:
                many.put(field, offsets, each[own] if each.ndim > 1 else each)

    def _common_time(self) -> float:
        """Return the time of MuJoCo [s]. Raises SceneError for worlds at different times."""
        times = np.concatenate([many.times() for _, many in self._parts])
        if (times != times[0]).any():
            number = int(np.argmax(times != times[0]))
            raise SceneError(
                f"world {number} is at {times[number]:g} s and world 0 at {times[0]:g} s, but all worlds share one "
                "time: do not set or step single worlds; if MuJoCo reset an unstable world, set option 'timestep' "
                "smaller"
            )
        return float(times[0])

    def _lead(self, t0: float) -> None:
        """Set the mocap bodies named in `poses` to their pose for the step that begins at t0 [s]."""
        for mocap, poses in self.poses.items():
            row = min(max(round(t0 / self.mujoco_model.opt.timestep), 0), poses.shape[1] - 1)
            place, turn = mocap_offsets(mocap)
            self._put([("mocap_pos", place, poses[:, row, :3]), ("mocap_quat", turn, poses[:, row, 3:])])

    def settle(self) -> None:
        """Copy the state from the device, if the device has a newer one."""
        self.steps.fetch()

    def _begin(self, t0: float, moves: bool) -> None:
        """Compute poses, forces and sensors at the start of a step; moves: whether MuJoCo then moves the bodies."""
        if not self._watched and self.steps.in_graph:
            for skin, sensors in enumerate(self._sensors[0]):
                for sensor in sensors:
                    self.steps.watch(skin, self.runtimes[0].place(skin, sensor))
        self._watched, parts, late = True, range(len(self._parts)), list[int]()
        graphs = len(self.steps.backends) - 1
        for part in parts:
            own, many = self._parts[part]
            self._each(part, "mj_step1")
            self._poses.read(many, own)
            if part < graphs:
                self.steps.start(part, self._frames, t0)
        for part in parts:
            if part < graphs and self.steps.ready(part) and len(parts) > 1:
                self._push(part)
                if moves:
                    self._each(part, "mj_step2")
            else:
                late.append(part)
        try:
            self.steps.rest(self._frames, t0)
        except Exception:
            # All worlds have the same time
            for part in late if moves and len(late) < len(parts) else ():
                self._each(part, "mj_step2")
            raise
        for part in late:
            self._push(part)
        self._sense()
        for part in late if moves else ():
            self._each(part, "mj_step2")

    def _push(self, part: int) -> None:
        """Add the forces of the sound to the passive forces of MuJoCo."""
        own, many = self._parts[part]
        for body, forces in enumerate(self.steps.forces):
            self.forces[own, body] = np.add.reduce(forces[own, 0], axis=1)
            many.push(self.runtimes[0].parts[body], forces[own, 0], forces[own, 1])

    def _sense(self) -> None:
        """Fill the sensors of all worlds."""
        for skin, sensors in enumerate(self._sensors[0]):
            force = self.forces[:, self.models[0].skins[skin].body]
            for sensor in sensors:
                arp, motion = self.steps.sense(skin, self.runtimes[0].place(skin, sensor))
                read = channels(force, motion, arp)
                self._fill(sensor, read)
        for region, sensors in enumerate(self._rates):
            for sensor in sensors:
                self._fill(sensor, self.models[0].rates[region].read(self.state.regions[region]))

    def _fill(self, sensor: PluginSensor, read: Float) -> None:
        """Write the data of a sensor, shape (worlds, channels)."""
        if (cutoff := self._cutoffs[sensor.offsets[0]]) > 0.0:
            read = np.clip(read, -cutoff, cutoff)
        for own, many in self._parts:
            many.put("sensordata", sensor.offsets, read[own])

    def _advance(self, t1: float) -> None:
        """Advance transducers and skins of all worlds by the last MuJoCo step, with the poses at its beginning."""
        self.steps.advance(t1 - self.models[0].spec.timestep_s, t1)


def plain_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model without plugins, whose steps need no Python. Sensors keep their places.

    A model with plugins of other packages is returned unchanged.
    """
    view = ModelView(model._address)
    if any(plugin not in {config.plugin for config in CONFIGS} for _, plugin, _ in view.instances()):
        return model
    plain = copy.copy(model)
    raw = mirror("mjModel").from_address(plain._address)
    raw.nplugin = raw.npluginstate = raw.npluginattr = 0
    return plain


class WorldPoses:
    """Reads the poses of some worlds, and stores the last poses.

    In most steps the bodies move so little from the reference pose that reduced models stay valid. This is checked for
    all worlds together. Only worlds with larger movements are checked one by one.

    positions, matrices: arrays in which the runtimes store the world frames, shapes (worlds, m, 3), (worlds, m, 9)
    """

    def __init__(self, runtimes: Sequence[SceneRuntime], positions: Float, matrices: Float):
        self.runtimes, self._positions, self._matrices = runtimes, positions, matrices
        first = runtimes[0]
        self._model, self._layout = first.model, first.layout
        fields: dict[str, tuple[Field, Field]] = {"body": ("xpos", "xmat"), "site": ("site_xpos", "site_xmat")}
        self._fields: list[tuple[Field, list[int], Float]] = []
        for kind, chosen, rows in first.frames_read:
            for field, result in zip(fields[kind], (positions, matrices), strict=True):
                own = result[:, rows]
                width = own.shape[2]
                offsets = (width * chosen[:, None] + np.arange(width)).ravel().tolist()
                flat = np.lib.stride_tricks.as_strided(own, (len(own), len(offsets)), (own.strides[0], own.strides[2]))
                self._fields.append((field, offsets, flat))
        # Rows of arrays, frames of stimuli and transducers: the pose is new if any of them moves at all
        self._fixed = max([self._layout.frames.stop, *(rows.stop for rows in self._layout.transducers)])
        self._posed: list[PosedScene] = [runtime.work.reference for runtime in runtimes]
        self.forget()

    def forget(self) -> None:
        """Drop the last poses."""
        count = len(self.runtimes)
        self._resting: NDArray[np.bool_] = np.zeros(count, dtype=bool)
        self._where: Float = np.zeros((count, self._fixed, 12))

    def read(self, many: ManyData, own: slice) -> None:
        """Read the world frames of some worlds; many: their data."""
        for field, offsets, result in self._fields:
            many.gather(field, offsets, result[own])

    def now(self, some: NDArray[np.bool_]) -> dict[int, PosedScene]:
        """Return the poses of the selected worlds, for the frames that `read` has read. some: shape (worlds,).

        Raises SceneError, with the number of the world, if a body reaches into an array.
        """
        # All worlds share this object; in a copy it is that of the original
        reference = self.runtimes[0].work.reference
        fixed = np.concatenate((self._positions[:, : self._fixed], self._matrices[:, : self._fixed]), axis=2)
        same = self._resting & some & np.logical_and.reduce(fixed == self._where, axis=(1, 2))
        if np.logical_or.reduce(same):
            turns = self._matrices.reshape(*self._positions.shape, 3)
            same &= settled_worlds(self._model, self._layout, self._positions, turns, reference)
        for world in (some & ~same).nonzero()[0].tolist():
            with naming_world(world):
                posed = self._posed[world] = self.runtimes[world].posed
            self._where[world] = fixed[world]
            self._resting[world] = (
                posed.bodies == reference.bodies
                and posed.skins == reference.skins
                and posed.arrays.serial == self._model.arrays.serial
            )
        return {world: self._posed[world] for world in some.nonzero()[0].tolist()}
