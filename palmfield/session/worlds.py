"""Several worlds of one scene, which differ in what their stimuli do and where hands are, stepped together."""

import copy
from collections.abc import Callable, Mapping
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from palmfield.config import StimulusConfig, known_keys
from palmfield.drive.transducer_response import rows
from palmfield.engine.host import world_of
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.engine.worlds import SceneWorlds, plain_model
from palmfield.errors import SceneError
from palmfield.interrupts import interrupts_held
from palmfield.session.duration import check_duration, check_steps, check_time, step_count
from palmfield.session.open_scene import Source, compiled, fresh_data, opened
from palmfield.session.skin import Skin, chosen_name
from palmfield.session.world_keys import split_keys, world_specs
from palmfield.simulation.build_worlds import Shared, build_worlds
from palmfield.simulation.step_together import TogetherStep
from palmfield.types import Complex, Float, Float32, Int


class Worlds:
    """Worlds of one scene, loaded and ready to step: what `palmfield.Simulation(scene, worlds=n)` gives.

    sim = palmfield.Simulation("scene.xml", worlds=2, keys={"stimulus.focus_m": [(0, 0, 0.19), (0, 0.01, 0.19)]})
    sim.run(0.1)
    print(sim.skin("palm").displacement[1])

    model: MuJoCo's, data: MuJoCo's of each world, for those who set controls or forces there; mj_step is not for them
    name: of the scene, for messages; path: its file, or None; duration_s: how long the scene runs by default [s]
    """

    def __init__(
        self,
        scene: Source,
        worlds: int,
        *,
        device: str | None = None,
        accuracy: float | None = None,
        board: str | None = None,
        keys: Mapping[str, object] | None = None,
        poses: Mapping[str, ArrayLike] | None = None,
        base: Mapping[str, object] | None = None,
        shared: Shared | None = None,
    ):
        """worlds: how many

        keys: as `palmfield.session.open_scene.compiled` takes them; a key of a stimulus may have one axis more than its
            own, of length `worlds`, with a value for each
        poses: by name of a mocap body, its position [m] and quaternion (w, x, y, z) in each step of MuJoCo's, shape
            (worlds, steps, 7); after the last step it stays
        base: keys with which MuJoCo's model is made, in place of the first world's; then all of `keys` differ
        shared: layers and solvers that these worlds share with others which are not stepped with them
        The other arguments are those of `compiled`, as are the errors. SceneError too for another number of worlds,
        keys or poses of another shape and keys that can't differ.
        """
        check_count(worlds)
        plugins = _plugins(scene)
        split = split_keys(keys or {}, worlds, plugins)
        common = split.common if base is None else base
        self.name, self.model, first = compiled(scene, device=device, accuracy=accuracy, board=board, keys=common)
        self.path = Path(scene) if isinstance(scene, str | Path) else None
        world = world_of(first)
        if world is None or world.scene is None:
            raise SceneError(f"{self.name} has no plugin 'palmfield.skin'; it is a plain MuJoCo model")
        spec = world.scene.spec
        specs = world_specs(spec, stimulus_texts(world.scene), split, worlds)
        plain = plain_model(self.model)
        models = build_worlds(specs, None if base is None else spec, shared)
        led = {_mocap(self.model, body): _poses(body, given, worlds) for body, given in (poses or {}).items()}
        if plain is self.model:
            data = [first, *(fresh_data(self.model, self.name) for _ in range(worlds - 1))]
        else:
            self.model, data = plain, [mujoco.MjData(plain) for _ in range(worlds)]
        self._attach(SceneWorlds(first, data, models, led))
        with interrupts_held():
            self._scenes.place()
            self._scenes.look()

    def _attach(self, scenes: SceneWorlds) -> None:
        self._scenes, self.data = scenes, scenes.data
        self.duration_s = scenes.runtimes[0].spec.duration_s
        self._skins: dict[str, WorldsSkin] = {}

    def __repr__(self) -> str:
        return f"<{self.count} worlds of {self.name}>"

    @property
    def count(self) -> int:
        """Of worlds."""
        return len(self.data)

    @property
    def runtimes(self) -> list[SceneRuntime]:
        """What carries each world."""
        self._scenes.settle()
        return self._scenes.runtimes

    @property
    def together(self) -> TogetherStep:
        """The steps that worlds take together."""
        return self._scenes.together

    # -- stepping ------------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time, the same in all worlds [s]."""
        return float(self.data[0].time)

    def step(self, count: int = 1) -> None:
        """`count` of MuJoCo's steps in all worlds. Raises what a plugin raised in them, with the world's number.

        Ctrl-C waits for the end of the step in which it comes: after the KeyboardInterrupt the states are whole, those
        of an earlier time, and the simulation can go on.
        """
        check_steps(count)
        # Made here, and not in the first step: it can take minutes, and Ctrl-C needn't wait for it
        for lazies in dict.fromkeys(model.begin for model in self._scenes.models):
            for lazy in lazies:
                _ = lazy.value
        with interrupts_held() as check:
            for _ in range(count):
                self._scenes.step()
                check()

    def run(self, duration_s: float) -> None:
        """As many steps as come nearest to a duration [s], at least one; see `step`.

        Raises SceneError for one that is not > 0.
        """
        check_duration(duration_s)
        self.step(step_count(duration_s, self.model.opt.timestep))

    def reset(self) -> None:
        """Back to time 0, with everything at rest and hands where their motions begin."""
        with interrupts_held():
            self._scenes.restart()

    def start_at(self, time_s: float) -> None:
        """As `reset`, but at another time [s], with hands where their motions have them then; the skin is at rest.

        Raises SceneError for a time that is not 0 or more.
        """
        check_time(time_s)
        with interrupts_held():
            self._scenes.restart(time_s)

    def copy(self) -> "Worlds":
        """As many worlds again in the same state, which go on by themselves; model and matrices are shared."""
        twin = object.__new__(Worlds)
        twin.name, twin.path, twin.model = self.name, self.path, self.model
        with interrupts_held():
            scenes = self._scenes
            scenes.settle()
            data = [copy.copy(one) for one in scenes.data]
            twin._attach(SceneWorlds(scenes.template, data, scenes.models, scenes.poses, scenes.state.copy()))
            twin._scenes.adopt(scenes)
        return twin

    def __copy__(self) -> "Worlds":
        """As `copy`: two simulations can't share MuJoCo's data."""
        return self.copy()

    def __deepcopy__(self, memo: dict[int, object]) -> "Worlds":
        """As `copy`; models never change."""
        return self.copy()

    # -- what there is to see ------------------------------------------------------------------------------------------

    @property
    def skins(self) -> tuple[str, ...]:
        """Instance names of the skins."""
        return tuple(skin.spec.name for skin in self._scenes.models[0].skins)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that the sound pushes, in the order of `forces`."""
        return tuple(body.name for body in self._scenes.models[0].bodies)

    def skin(self, name: str | None = None) -> "WorldsSkin":
        """A skin by its instance name; the only one without. Raises SceneError for one that the scene has not."""
        names = self.skins
        name = chosen_name(names, name)
        if name not in self._skins:
            skins = [Skin(runtime, names.index(name)) for runtime in self._scenes.runtimes]
            self._skins[name] = WorldsSkin(skins, self._scenes.settle)
        return self._skins[name]

    @property
    def drive(self) -> Complex:
        """What the transducers are told now: complex amplitudes relative to full drive, e^{-iwt}, shape (worlds, N)."""
        now = np.array([self.time])
        drives = [one.work.emission.commanded(one.posed, now)[0] for one in self._scenes.runtimes]
        return np.array(drives)

    @property
    def emitted(self) -> Complex:
        """What the transducers emit now, after their ring-up, shape (worlds, N)."""
        result = np.zeros((self.count, len(self._scenes.models[0].arrays)), np.complex128)
        for row, runtime in zip(result, self.runtimes, strict=True):
            _, course = runtime.now()
            if course.emitted is not None or course.unit is not None:
                row[:] = rows(course)[0]
        return result

    @property
    def forces(self) -> Float:
        """Mean force of the sound on each of `bodies` over the last step [N], world axes, (worlds, bodies, 3).

        Before the first step, that over the step to come.
        """
        return self._scenes.forces.copy()

    @property
    def sensors(self) -> Float:
        """MuJoCo's sensordata of each world, shape (worlds, numbers): of the last step's beginning, as MuJoCo's are."""
        return np.array([one.sensordata for one in self.data])

    def sensor(self, name: str) -> Float:
        """One sensor by its name, shape (worlds, its numbers). Raises SceneError for one that the scene has not."""
        names = [self.model.sensor(number).name for number in range(self.model.nsensor)]
        if name not in names:
            raise SceneError(f"the scene has no sensor '{name}'; it has: {', '.join(names)}")
        return np.array([one.sensor(name).data for one in self.data])


class WorldsSkin:
    """One skin in all worlds at their present time. Each array is computed when it is asked for.

    The skin at rest is the same in all worlds: `rest_position`, `rest_normal` and `faces` are as `Skin` has them.
    """

    def __init__(self, skins: list[Skin], settle: Callable[[], None]):
        """settle: brings the state up to date"""
        self._all, self._settle = skins, settle

    @property
    def _skins(self) -> list[Skin]:
        self._settle()
        return self._all

    @property
    def name(self) -> str:
        """Of its plugin instance."""
        return self._skins[0].name

    @property
    def solver(self) -> tuple[str, ...]:
        """What steps it now in each world, or will."""
        return tuple(skin.solver for skin in self._skins)

    @property
    def rest_position(self) -> Float:
        """Surface nodes at rest, body frame [m], shape (S, 3)."""
        return self._skins[0].rest_position

    @property
    def rest_normal(self) -> Float:
        """Their unit outward normals at rest, shape (S, 3)."""
        return self._skins[0].rest_normal

    @property
    def faces(self) -> Int:
        """Triangles over the surface nodes, shape (f, 3)."""
        return self._skins[0].faces

    @property
    def position(self) -> Float:
        """Where body and bones have taken the surface nodes, world [m], (worlds, S, 3); without displacement."""
        return np.array([skin.position for skin in self._skins])

    @property
    def displacement(self) -> Float:
        """Of the surface nodes, in the resting body's axes [m], shape (worlds, S, 3)."""
        return np.array([skin.displacement for skin in self._skins])

    @property
    def velocity(self) -> Float:
        """Of the surface nodes, in the resting body's axes [m/s], shape (worlds, S, 3)."""
        return np.array([skin.velocity for skin in self._skins])

    @property
    def normal_displacement(self) -> Float:
        """Along the outward normal [m], shape (worlds, S): a push is negative."""
        return np.array([skin.normal_displacement for skin in self._skins])

    @property
    def arp(self) -> Float32:
        """Acoustic radiation pressure at the surface nodes [Pa], positive inwards, shape (worlds, S)."""
        return np.array([skin.arp for skin in self._skins])


def stimulus_texts(runtime: SceneRuntime) -> dict[str, dict[str, str]]:
    """The keys of a scene's stimuli as MuJoCo's model has them, by instance and key."""
    model = runtime.view.model
    instances = {name: number for number, _, name in model.instances()}
    return {part.name: model.values(instances[part.name], known_keys(StimulusConfig)) for part in runtime.spec.stimuli}


def check_count(worlds: object) -> None:
    """Raises SceneError for a number of worlds that is not a whole number of 1 or more."""
    if isinstance(worlds, bool) or not isinstance(worlds, int | np.integer) or worlds < 1:
        raise SceneError(f"worlds is {worlds!r}; allowed: a whole number of 1 or more")


def _plugins(scene: Source) -> dict[str, str]:
    """Name of the plugin of each instance."""
    if isinstance(scene, mujoco.MjModel):
        return {}
    spec = opened(scene).spec
    return {plugin.name: plugin.plugin_name for plugin in spec.plugins}


def _mocap(model: mujoco.MjModel, body: str) -> int:
    """Number of a mocap body. Raises SceneError for another."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
    mocap = -1 if number < 0 else int(model.body_mocapid[number])
    if mocap < 0:
        names = [model.body(i).name for i in range(model.nbody) if model.body_mocapid[i] >= 0]
        raise SceneError(
            f"poses are given for '{body}'; allowed: a body with mocap='true': {', '.join(names) or 'there is none'}"
        )
    return mocap


def _poses(body: str, given: ArrayLike, worlds: int) -> Float:
    """Poses as float64. Raises SceneError for another shape, numbers that are not finite, and no unit quaternion."""
    poses = np.array(given, dtype=np.float64)
    if poses.ndim != 3 or poses.shape[0] != worlds or poses.shape[2] != 7 or poses.shape[1] == 0:
        raise SceneError(
            f"poses of '{body}' have shape {poses.shape}; allowed: ({worlds}, steps, 7), position and quaternion "
            "(w, x, y, z), steps >= 1"
        )
    lengths = np.linalg.norm(poses[..., 3:], axis=2)
    wrong = np.argwhere(~np.isfinite(poses).all(axis=2) | ~(np.abs(lengths - 1.0) < 1e-3))
    if len(wrong):
        world, step = wrong[0].tolist()
        raise SceneError(
            f"pose of '{body}' in world {world}, step {step}, is {poses[world, step].tolist()}; allowed: finite "
            "numbers and a quaternion of length 1"
        )
    return poses
