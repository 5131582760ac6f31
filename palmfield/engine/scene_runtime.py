"""A scene in one mjData: reads poses, stores the state in MuJoCo's plugin state, and calls the simulation."""

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from operator import methodcaller
from typing import TYPE_CHECKING, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from palmfield.drive.transducer_response import EmittedCourse
from palmfield.errors import SceneError
from palmfield.mujoco_host.mujoco_view import DataView, ForceOutlet, PluginSensor
from palmfield.simulation.backend import Frames, serves
from palmfield.simulation.build import model_of
from palmfield.simulation.cached import Bool
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, PoseLayout, posed_scene
from palmfield.simulation.scene_reader import read_scene
from palmfield.simulation.sensors import SensorPlace, channels, check_site, sensor_place
from palmfield.simulation.state import HapticState, stepper_of
from palmfield.simulation.step import Steps
from palmfield.simulation.validate import check_clear
from palmfield.simulation.workspace import Workspace
from palmfield.skin.stepper import SkinStepper
from palmfield.types import Complex, Float

if TYPE_CHECKING:
    from rich.progress import Progress

AS_BYTES = methodcaller("tobytes")
HERE: Bool = np.ones(1, dtype=bool)
RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
PASSIVE = int(mujoco.mjtDisableBit.mjDSBL_SPRING) | int(mujoco.mjtDisableBit.mjDSBL_DAMPER)
"""MuJoCo flags. If all of them are set, MuJoCo omits all passive forces."""


class SceneRuntime:
    """Model, state and workspace of one mjData.

    outlets: objects that apply the force of the sound to the parts of each body
    frames_read: numbers of the MuJoCo sites and bodies whose frames are read, and the rows in which they are stored
    skins_rest: whether steps omit the skins; the force of the sound still acts on the bodies
    gathers: whether steps are only recorded, and computed together later without forces and sensors; see `settle`
    """

    def __init__(self, view: DataView, like: "SceneRuntime | None" = None):
        """like: the runtime of the same scene in another mjData; used if this is one of several worlds, see `join`

        Raises SceneError or DeviceError for an inconsistent scene.
        """
        self.view = view
        if like is None:
            self.spec, self.binding = read_scene(view.model)
            self.model = model_of(self.spec)
            self.work = Workspace(self.model)
        else:
            self.spec, self.binding, self.model, self.work = like.spec, like.binding, like.model, like.work
        self.layout = PoseLayout(self.model)
        bound = self.binding.skins
        firsts = [bound[number] for number in self.model.first_skins]
        self.parts = [first.bones or (first.body,) for first in firsts]
        self.outlets = [ForceOutlet(view, parts) for parts in self.parts]
        binding = self.binding
        transducers = [site for sites in binding.transducer_sites for site in sites]
        sites = np.array([*binding.array_sites, *binding.frame_sites, *transducers], dtype=np.int64)
        bodies = [number for first in firsts for number in (first.body, *first.bones)]
        obstacles = [number for skin in bound for number in skin.obstacles]
        moving, count = np.array([*bodies, *obstacles], dtype=np.int64), len(sites) + len(bodies) + len(obstacles)
        self.frames_read: tuple[tuple[Literal["site", "body"], NDArray[np.int64], slice], ...]
        self.frames_read = ("site", sites, slice(0, len(sites))), ("body", moving, slice(len(sites), None))
        self._positions, self._matrices = np.zeros((count, 3)), np.zeros((count, 9))
        self._reading = self.reading(self._positions, self._matrices)
        self._to_step = Frames(self._positions[None], self._matrices[None], self._posed_in)
        self.skins_rest = False
        self.gathers = False
        self._gathered: tuple[PosedScene, float, int] | None = None
        self._posed: PosedScene = self.work.reference
        self._numbers = b""
        self._begun: tuple[float, bytes, bytes, bytes] | None = None
        self._places: dict[str, SensorPlace] = {}
        self.check_options()
        if like is None:
            check_clear(self.work.reference)

    @property
    def frames(self) -> int:
        """Return the number of world frames on which sound and skins depend."""
        return len(self._positions)

    def join(
        self,
        model: HapticModel,
        state: HapticState,
        work: Workspace,
        frames: tuple[Float, Float],
        beside: "SceneRuntime | None" = None,
    ) -> None:
        """Make this one of several worlds, whose state is stored outside mjData. All stored results are dropped.

        model: model of the same bodies and arrays, with the stimuli of the world
        state: the part of the common state that belongs to the world, as views
        frames: output arrays of the world frames: positions [m] and matrices, shapes (frames, 3) and (frames, 9)
        beside: the runtime of another world with sensors at the same places; None for the first world
        """
        self._places = {} if beside is None else beside._places
        self.model, self.work = model, work
        self._positions, self._matrices = frames
        self._reading = self.reading(*frames)
        self.__dict__["state"] = state
        self.forget()

    def forget(self) -> None:
        """Drop the stored pose, so that the next call reads it again."""
        self._posed, self._numbers, self._begun = self.work.reference, b"", None

    def reading(self, positions: Float, matrices: Float) -> list[Callable[[], object]]:
        """Return functions that copy the present world frames into arrays of shapes (frames, 3) and (frames, 9)."""
        calls: list[Callable[[], object]] = []
        for kind, chosen, rows in self.frames_read:
            for values, result in zip(self.view.frames[kind], (positions, matrices), strict=True):
                # Mode "clip", because other modes use a buffer
                calls.append(partial(values.take, chosen, 0, result[rows], "clip"))
        return calls

    def prepare(self, bar: "Progress") -> None:
        """Make the steppers of the skins that do not have one yet; a progress bar shows the expected time."""
        if all(lazy.made for lazy in self.model.begin):
            return
        expected_s = sum(skin.choice.seconds for skin in self.model.skins)
        task = bar.add_task("preparing the skin layers", total=None, expected_s=expected_s)
        for lazy in self.model.begin:
            _ = lazy.value
        bar.remove_task(task)

    @cached_property
    def state(self) -> HapticState:
        """Return views of the plugin state of MuJoCo."""
        view, binding = self.view, self.binding
        return HapticState(
            tuple(view.state(instance).reshape(1, -1) for instance in binding.array_instances),
            tuple(view.state(skin.instance).reshape(1, -1) for skin in binding.skins),
            tuple(view.state(instance).reshape(1, -1) for instance in binding.region_instances),
        )

    @cached_property
    def steps(self) -> Steps:
        """Return the Steps of this mjData."""
        steps = Steps([self.model], [self.work], self.state)
        if steps.in_graph:
            for skin, bound in enumerate(self.binding.skins):
                for sensor in self.view.sensors(bound.instance):
                    steps.watch(skin, self.place(skin, sensor))
        return steps

    @property
    def applied_parts(self) -> list[tuple[Float, Float]]:
        """Return mean forces on the parts of each body over the step [N], and torques about their origins [N m],
        world axes, shapes (b, 3).
        """
        return [(force[0, 0], force[0, 1]) for force in self.steps.forces]

    @property
    def applied(self) -> list[Float]:
        """Return the mean force on each body over the present step [N], world axes, shape (3,) each."""
        return [np.add.reduce(force[0, 0], axis=0) for force in self.steps.forces]

    @property
    def posed(self) -> PosedScene:
        """Return the PosedScene of MuJoCo's present poses; the same object while nothing moves.

        Raises SceneError if a body reaches into an array.
        """
        for read in self._reading:
            read()
        return self._posed_in(HERE)[0]

    def _posed_in(self, here: Bool) -> dict[int, PosedScene]:
        """Return the PosedScene for the frames that were read last, in the selected worlds; here: shape (1,)."""
        if not here[0]:
            return {}
        last, numbers = self._posed, self._positions.tobytes() + self._matrices.tobytes()
        if numbers != self._numbers:
            rotations = self._matrices.reshape(-1, 3, 3)
            posed = posed_scene(self.model, self.layout, self._positions, rotations, last, self.work.reference)
            if posed.bodies != last.bodies or posed.arrays.serial != last.arrays.serial:
                check_clear(posed)
            self._posed, self._numbers = posed, numbers
        return {0: self._posed}

    def _begin(self, t0: float, anew: bool) -> None:
        """Begin the step at t0 [s] with the present pose and state; a begun step is repeated only if `anew`."""
        for read in self._reading:
            read()
        steps, now = self.steps, (round(t0, 12), self._positions.tobytes(), self._matrices.tobytes())
        if not anew and self._begun == (*now, b"".join(map(AS_BYTES, steps.inputs))):
            return
        steps.begin(self._to_step, t0)
        self._begun = *now, b"".join(map(AS_BYTES, steps.inputs))

    @property
    def amplitudes(self) -> Complex:
        """Return the present emission of all transducers, shape (N,)."""
        return self.state.emission()[0]

    def skin_states(self) -> list[tuple[SkinStepper, Float]]:
        """Return the stepper of each skin and its state, a view of shape (1, state_size)."""
        return [stepper_of(self.model, self.state, number) for number in range(len(self.model.skins))]

    def now(self) -> tuple[PosedScene, EmittedCourse]:
        """Return pose and emission at the present MuJoCo time."""
        posed = self.posed
        return posed, self.work.emission.now(posed, self.amplitudes, self.view.raw.time)

    def body_forces(self) -> list[tuple[Float, Float]]:
        """Return `applied_parts` for the step that begins now."""
        self._begin(self.view.raw.time, anew=True)
        return self.applied_parts

    def push(self) -> None:
        """Add the forces of the sound to the passive forces of MuJoCo."""
        if self.gathers:
            self._note()
            return
        self._begin(self.view.raw.time, anew=True)
        for outlet, force in zip(self.outlets, self.steps.forces, strict=True):
            outlet.forces[:], outlet.torques[:] = force[0]
            outlet.apply()

    def _note(self) -> None:
        """Record the start of a step. If the pose has changed, the steps recorded before are computed first."""
        posed, now, step_s = self.posed, self.view.raw.time, self.spec.timestep_s
        if self._gathered is not None:
            before, begin, count = self._gathered
            if abs(now - begin - count * step_s) > 0.5 * step_s:
                # MuJoCo has reset an unstable model together with its state
                self._gathered = None
            elif before.serial != posed.serial or count >= self.steps.together:
                self.settle()
        if self._gathered is None:
            self._gathered = posed, now, 0

    def settle(self) -> None:
        """Compute the recorded steps."""
        gathered, self._gathered, self._begun = self._gathered, None, None
        if gathered is not None and gathered[2] > 0:
            self.steps.over(*gathered, not self.skins_rest)

    @cached_property
    def feedback(self) -> str:
        """Return why steps are not gathered: the force of the sound moves a body, or sensors may be read; else ""."""
        model = self.view.model
        if serves(self.model):
            return "a graph on a GPU computes each separately"
        for body in dict.fromkeys(number for parts in self.parts for part in parts for number in model.ancestors(part)):
            if model.raw.body_dofnum[body] > 0:
                return f"body '{model.names('body')[body]}' has degrees of freedom, on which the sound acts"
        return f"plugin '{self._others[0]}' may read sensors" if self._others else ""

    @cached_property
    def _others(self) -> list[str]:
        """Return the plugins of other packages in the scene."""
        return sorted({plugin for _, plugin, _ in self.view.model.instances() if not plugin.startswith("palmfield.")})

    @property
    def unseen(self) -> bool:
        """Return whether no other code can read the state in a step: no other plugin, and no MuJoCo callback."""
        names = "control", "passive", "sensor", "act_bias", "act_gain", "act_dyn"
        return not (self._others or any(getattr(mujoco, f"get_mjcb_{name}")() for name in names))

    @property
    def may_gather(self) -> bool:
        """Whether steps may be gathered now: they move no body, and no sensor or other code reads them."""
        steps, watched = self.steps, any(one is not None for one in self.work.observe)
        return self.unseen and not (self.feedback or watched or steps.observer is not None or steps.in_graph)

    def advance(self) -> None:
        """Advance transducers and skins by the last MuJoCo step, in the pose at the beginning of that step."""
        end = self.view.raw.time
        self.check_options()
        if self.gathers and self._gathered is not None:
            posed, begin, count = self._gathered
            self._gathered = posed, begin, count + 1
            return
        begin = end - self.spec.timestep_s
        self._begin(begin, anew=False)
        self.steps.advance(begin, end, not self.skins_rest)

    def check_options(self) -> None:
        """Raise SceneError for MuJoCo options with which the forces of the sound would be wrong or missing.

        These options are a time step that differs from the step of the skins, and an integrator that evaluates forces
        within a step (RK4). MuJoCo also omits all passive forces if springs and dampers are both disabled.
        """
        option = self.view.model.raw.opt
        now_s = option.timestep
        if option.integrator == RK4:
            raise SceneError(
                "option 'integrator' has value 'RK4', which evaluates forces four times per step, but the sound "
                "is computed once per step; allowed: Euler | implicit | implicitfast"
            )
        if option.disableflags & PASSIVE == PASSIVE:
            raise SceneError(
                "option 'flag' disables both 'spring' and 'damper', with which MuJoCo skips all passive forces, "
                "including those of the sound; allowed: disable one of them"
            )
        if now_s != self.spec.timestep_s:
            raise SceneError(
                f"option 'timestep' has value {now_s:g}, but was {self.spec.timestep_s:g} when the scene was "
                "loaded and its skins were built: load the scene again with the new value"
            )

    def adopt(self, other: "SceneRuntime") -> None:
        """Copy data for the coming steps, which MuJoCo's state does not contain, from the runtime of a copied mjData.

        These are the points of the stimuli at the last control tick, and the loads computed in advance.
        """
        if other.model is self.model:
            self.adopt_pose(other)
            self.steps.adopt(other.steps)
        else:
            self.work.emission.held = list(other.work.emission.held)
            self.steps.forces = [force.copy() for force in other.steps.forces]

    def adopt_pose(self, other: "SceneRuntime") -> None:
        """Use the PosedScene of another runtime of the same model. This is safe, because it is immutable."""
        self._posed, self._numbers = other._posed, other._numbers

    def exchange(self, model: HapticModel) -> None:
        """Continue with another model that has the same arrays, bodies and skins. Reset the state after this call.

        The steppers of the skins are kept, so they must also be valid for the loads of the new stimuli.
        """
        self.model, self.spec, self.work = model, model.spec, Workspace(model)
        self.__dict__.pop("steps", None)
        self.forget()

    def sense(self, skin: int, sensors: Sequence[PluginSensor]) -> None:
        """Fill the sensors of a skin from the state at the present time."""
        if self.gathers:
            return
        time_s = self.view.raw.time
        self._begin(time_s, anew=False)
        force = np.add.reduce(self.steps.forces[self.model.skins[skin].body][:, 0], axis=1)
        for sensor in sensors:
            place = self._places.get(sensor.name) or self.place(skin, sensor)
            arp, motion = self.steps.sense(skin, place)
            sensor.data[:] = channels(force, motion, arp)[0]

    def rates(self, region: int) -> Float:
        """Return the rates of spikes in a region at the present time [1/s], see `palmfield.simulation.rates`."""
        return self.model.rates[region].read(self.state.regions[region])[0]

    def place(self, skin: int, sensor: PluginSensor) -> SensorPlace:
        """Return the place of a sensor, cached. Raises SceneError for a site of another body or far from the skin."""
        place = self._places.get(sensor.name)
        if place is None:
            place = self._places[sensor.name] = sensor_place(self.model.skins[skin], *self._site(skin, sensor))
        return place

    def check_sensors(self) -> None:
        """Check all sensors before the run. Raises SceneError like `place` for a sensor without a valid place."""
        for skin, bound in enumerate(self.binding.skins):
            for sensor in self.view.sensors(bound.instance):
                check_site(self.model.skins[skin], *self._site(skin, sensor))

    def _site(self, skin: int, sensor: PluginSensor) -> tuple[Float, str]:
        """Return the site of a sensor, body at rest (body frame [m], shape (3,)), and its name in messages."""
        bound, part = self.binding.skins[skin], self.model.skins[skin]
        element = f"{part.spec.element}: sensor '{sensor.name}'"
        owners = (bound.body, *bound.bones)
        model = self.view.model
        if sensor.kind != "site" or model.site_body(sensor.target) not in owners:
            raise SceneError(
                f"{element} needs objtype='site' and a site of body '{part.spec.config.body}'"
                + (" or of one of its bones" if bound.bones else "")
            )
        site = model.site_position(sensor.target)
        if bound.bones:
            site = site + part.carrier.rest_origins[bound.bones.index(model.site_body(sensor.target))]
        return site, element
