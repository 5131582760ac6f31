"""Step a scene: MuJoCo's model and data, with the states of sound and skin."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from palmfield.drive.transducer_response import rows
from palmfield.engine.one_world import OneWorld
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import SceneError
from palmfield.interrupts import interrupts_delayed
from palmfield.session.duration import check_duration, check_steps, check_time, step_count
from palmfield.session.open_scene import Options, Source, compiled
from palmfield.simulation.build import load_for_sound, make_surfaces
from palmfield.simulation.step import Steps
from palmfield.types import Complex, Float

if TYPE_CHECKING:  # loaded only for several worlds and when a skin is read
    from palmfield.engine.worlds import SceneWorlds
    from palmfield.session.skin import Skin
    from palmfield.session.worlds import WorldsSkin

GATHERED = 64
"""Largest number of MuJoCo steps that `Simulation.step` computes together."""


class Simulation:
    """A scene, loaded and ready to step.

    sim = palmfield.Simulation("scene.xml", keys={"stimulus.focus_m": (0, 0, 0.19)})
    sim.run(0.1)
    print(sim.skin("palm").displacement)

    With `worlds`, several copies of the scene are stepped together. Results then have a leading axis for the worlds:
    sim = palmfield.Simulation("scene.xml", worlds=2, keys={"stimulus.focus_m": [(0, 0, 0.19), (0, 0.01, 0.19)]})

    model, data: MuJoCo model and data. After mj_step on them, call `palmfield.raise_errors(data)` to raise errors of
        plugins. With several worlds data is a list; set controls or forces in it, but only `step` may step it
    name: name of the scene, for messages; path: file of the scene, or None
    worlds: number of worlds, None if results have no axis for worlds
    duration_s: default duration of `palmfield.run` [s]
    """

    def __init__(
        self,
        scene: Source,
        *,
        device: str | None = None,
        accuracy: float | None = None,
        board: str | None = None,
        keys: Mapping[str, object] | None = None,
        worlds: int | None = None,
        poses: Mapping[str, ArrayLike] | None = None,
    ):
        """Open a scene. See `palmfield.session.open_scene` for arguments (`Options`) and errors (`compiled`).

        worlds: number of worlds, which are stepped together. A key of a stimulus may then have an additional first axis
            of this length, with one value for each world
        poses: for each named mocap body its position [m] and quaternion (w, x, y, z) in each MuJoCo step, shape
            (worlds, steps, 7). The pose is constant after the last step
        """
        options: Options = {"device": device, "accuracy": accuracy, "board": board, "keys": keys}
        if worlds is not None:
            from palmfield.session.worlds import open_worlds

            self._attach(*open_worlds(scene, worlds, poses=poses, **options), scene, worlds)
            return
        if poses is not None:
            raise SceneError("poses are given without worlds; allowed: both, or poses of a scene by `palmfield.motion`")
        name, _, data = compiled(scene, **options)
        self._attach(name, OneWorld(data, name), scene, None)
        load_for_sound(self.runtime.model)
        make_surfaces(self.runtime.model)
        with interrupts_delayed():
            self._scenes.look()

    @classmethod
    def of_worlds(cls, name: str, scenes: "SceneWorlds") -> "Simulation":
        """Return a simulation of several worlds that `palmfield.session.worlds.open_worlds` has opened."""
        made = object.__new__(cls)
        made._attach(name, scenes, None, len(scenes.data))
        return made

    def _attach(self, name: str, scenes: "OneWorld | SceneWorlds", scene: object, worlds: int | None) -> None:
        self.name, self._scenes, self.worlds, self.model = name, scenes, worlds, scenes.mujoco_model
        self.path = Path(scene) if isinstance(scene, str | Path) else None
        self.data: Any = scenes.data[0] if worlds is None else scenes.data
        self.duration_s = scenes.runtimes[0].spec.duration_s
        self._skins: dict[str, Skin | WorldsSkin] = {}
        self._made = False

    def __repr__(self) -> str:
        return f"<{self.count} worlds of {self.name}>"

    @property
    def count(self) -> int:
        """Number of worlds."""
        return len(self._scenes.data)

    @property
    def runtimes(self) -> list[SceneRuntime]:
        """The runtime of each world."""
        self._scenes.settle()
        return self._scenes.runtimes

    @property
    def runtime(self) -> SceneRuntime:
        """The runtime of the scene. Raises SceneError for a simulation with `worlds`."""
        if self.worlds is not None:
            raise SceneError(f"{self.name} is open as {self.count} worlds; allowed here: a simulation without `worlds`")
        return self._scenes.runtimes[0]

    @property
    def steps(self) -> Steps:
        """The object that steps sound and skins."""
        return self._scenes.steps

    # -- stepping ------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time, the same in all worlds [s]."""
        return float(self._scenes.data[0].time)

    def step(self, count: int = 1) -> None:
        """Run `count` MuJoCo steps. Raises errors of plugins (SceneError, DeviceError) with the number of the world.

        If the sound moves no body and no sensor is read between steps, up to GATHERED steps are computed together.
        Forces and sensors are then those of the last step. They equal those of `mj_step` except for rounding. Ctrl-C
        takes effect at the end of these steps. After the KeyboardInterrupt the state is consistent, and the simulation
        can continue. Raises SceneError for a count that is not a whole number >= 0.
        """
        check_steps(count)
        # Build steppers here, where Ctrl-C is not delayed, because this can take minutes
        if not self._made:
            for lazies in dict.fromkeys(runtime.model.begin for runtime in self._scenes.runtimes):
                for lazy in lazies:
                    _ = lazy.value
            self._made = True
        with interrupts_delayed() as check:
            while count > 0:
                count -= self._scenes.several(min(count, GATHERED))
                check()

    def run(self, duration_s: float) -> None:
        """Run the number of steps closest to a duration [s], at least one; see `step`.

        Raises SceneError for a duration that is not > 0.
        """
        check_duration(duration_s)
        self.step(step_count(duration_s, self.model.opt.timestep))

    def reset(self) -> None:
        """Return to time 0, with everything at rest and hands at the beginning of their motions."""
        with interrupts_delayed():
            self._scenes.restart()

    def start_at(self, time_s: float) -> None:
        """Reset to a time [s], with hands placed by their motions at that time and the skin at rest.

        Raises SceneError for a time that is not 0 or more.
        """
        check_time(time_s)
        with interrupts_delayed():
            self._scenes.restart(time_s)

    def copy(self) -> "Simulation":
        """Return a second, independent simulation in the same state; model and matrices are shared."""
        twin = object.__new__(Simulation)
        with interrupts_delayed():
            twin._attach(self.name, self._scenes.copy(), self.path, self.worlds)
        return twin

    def __copy__(self) -> "Simulation":
        """Return `copy`. A shallow copy would share MuJoCo's data, which is not possible."""
        return self.copy()

    def __deepcopy__(self, memo: dict[int, object]) -> "Simulation":
        """Return `copy`. The model is shared, because models never change."""
        return self.copy()

    # -- results; with a leading axis if there are `worlds` ----------------------------------------

    def _of(self, values: Sequence[Any] | Float) -> Any:
        """Stack the values of the worlds in one array; without `worlds`, return the value itself."""
        return np.array(values[0] if self.worlds is None else values)

    @property
    def skins(self) -> tuple[str, ...]:
        """Names of the instances of the skins."""
        return tuple(skin.spec.name for skin in self._scenes.runtimes[0].model.skins)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies on which the sound acts, in the order of `forces`."""
        return tuple(body.name for body in self._scenes.runtimes[0].model.bodies)

    def skin(self, name: str | None = None) -> Any:
        """Return a skin by the name of its instance, or the only skin. Raises SceneError for an unknown name.

        The type is `palmfield.session.Skin`, or `palmfield.session.WorldsSkin` with worlds.
        """
        from palmfield.session.skin import Skin, chosen_name

        names = self.skins
        name = chosen_name(names, name)
        if name not in self._skins:
            skins = [Skin(runtime, names.index(name)) for runtime in self._scenes.runtimes]
            if self.worlds is None:
                self._skins[name] = skins[0]
            else:
                from palmfield.session.worlds import WorldsSkin

                self._skins[name] = WorldsSkin(skins, self._scenes.settle)
        return self._skins[name]

    @property
    def drive(self) -> Complex:
        """Commanded drive of the transducers: complex amplitudes relative to full drive, e^{-iwt}, shape (N,).

        N counts the transducers of all arrays, array after array.
        """
        now = np.array([self.time])
        return self._of([one.work.emission.commanded(one.posed, now)[0] for one in self._scenes.runtimes])

    @property
    def emitted(self) -> Complex:
        """Present emission of the transducers, after their ring-up, shape (N,)."""
        return self._of([rows(runtime.now()[1])[0] for runtime in self.runtimes])

    @property
    def forces(self) -> Float:
        """Mean force of the sound on each of `bodies` over the last step [N], world axes, shape (bodies, 3).

        Before the first step, it is the mean over the coming step.
        """
        return self._of(self._scenes.forces)

    @property
    def sensors(self) -> Float:
        """MuJoCo's sensordata at the beginning of the last step."""
        return self._of([one.sensordata for one in self._scenes.data])

    def sensor(self, name: str) -> Float:
        """Return the values of one sensor by its name. Raises SceneError for an unknown name."""
        names = [self.model.sensor(number).name for number in range(self.model.nsensor)]
        if name not in names:
            raise SceneError(f"the scene has no sensor '{name}'; it has: {', '.join(names)}")
        return self._of([one.sensor(name).data for one in self._scenes.data])


def load(
    path: Source,
    *,
    device: str | None = None,
    accuracy: float | None = None,
    board: str | None = None,
    keys: Mapping[str, object] | None = None,
) -> Simulation:
    """Read and check a scene. The arguments are those of Simulation."""
    return Simulation(path, device=device, accuracy=accuracy, board=board, keys=keys)
