"""One scene that is stepped: MuJoCo's model and data, and what sound and skin do in them."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from palmfield.drive.transducer_response import rows
from palmfield.engine.host import raise_errors, world_of
from palmfield.engine.motion_plugin import place
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import SceneError
from palmfield.interrupts import interrupts_held
from palmfield.session.duration import check_duration, check_steps, check_time, step_count
from palmfield.session.open_scene import Source, compiled
from palmfield.session.skin import Skin, chosen_name
from palmfield.session.worlds import Worlds
from palmfield.types import Complex, Float


class Simulation:
    """A scene, loaded and ready to step.

    sim = palmfield.Simulation("scene.xml", keys={"stimulus.focus_m": (0, 0, 0.19)})
    sim.run(0.1)
    print(sim.skin("palm").displacement)

    With `worlds` it is many of them, stepped together, whose results have a leading axis: see
    `palmfield.session.worlds.Worlds`.

    model, data: MuJoCo's, for those who call mj_step themselves (then `palmfield.raise_errors(data)` raises what went
        wrong inside a plugin)
    name: of the scene, for messages; path: its file, or None
    duration_s: how long `palmfield.run` runs it by default [s]
    """

    def __new__(
        cls,
        scene: Source,
        *,
        worlds: int | None = None,
        poses: Mapping[str, ArrayLike] | None = None,
        **others: Any,
    ) -> Any:
        """worlds: a number of them, which are stepped together: `palmfield.session.worlds.Worlds`, also for `poses`."""
        if worlds is not None:
            return Worlds(scene, worlds, poses=poses, **others)
        if poses is not None:
            raise SceneError("poses are given without worlds; allowed: both, or poses of a scene by `palmfield.motion`")
        return object.__new__(cls)

    def __init__(
        self,
        scene: Source,
        *,
        device: str | None = None,
        accuracy: float | None = None,
        board: str | None = None,
        keys: Mapping[str, object] | None = None,
        worlds: None = None,
        poses: None = None,
    ):
        """See `palmfield.session.open_scene.compiled` for the arguments and what is raised."""
        self.name, self.model, self.data = compiled(scene, device=device, accuracy=accuracy, board=board, keys=keys)
        self.path = Path(scene) if isinstance(scene, str | Path) else None
        self._attach()
        with interrupts_held():
            mujoco.mj_forward(self.model, self.data)
            raise_errors(self.data)

    def _attach(self) -> None:
        world = world_of(self.data)
        if world is None or world.scene is None:
            raise SceneError(f"{self.name} has no plugin 'palmfield.skin'; it is a plain MuJoCo model")
        world.quiet = True
        self.runtime: SceneRuntime = world.scene
        self.duration_s = self.runtime.spec.duration_s
        self._skins: dict[str, Skin] = {}

    # -- stepping ------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self.data.time)

    def step(self, count: int = 1) -> None:
        """`count` of MuJoCo's steps. Raises what a plugin raised in them (SceneError, DeviceError).

        Ctrl-C waits for the end of the step in which it comes: after the KeyboardInterrupt the state is whole, that of
        an earlier time, and the simulation can go on. SceneError for a count that is no whole number of 0 or more.
        """
        check_steps(count)
        # Made here, and not in the first step: it can take a minute, and Ctrl-C needn't wait for it
        for lazy in self.runtime.model.begin:
            _ = lazy.value
        with interrupts_held() as check:
            for _ in range(count):
                mujoco.mj_step(self.model, self.data)
                raise_errors(self.data)
                check()

    def run(self, duration_s: float) -> None:
        """As many steps as come nearest to a duration [s], at least one; see `step`.

        Raises SceneError for one that is not > 0.
        """
        check_duration(duration_s)
        self.step(step_count(duration_s, self.model.opt.timestep))

    def reset(self) -> None:
        """Back to time 0, with everything at rest and hands where their motions begin."""
        self._restart(None)

    def start_at(self, time_s: float) -> None:
        """As `reset`, but at another time [s], with hands where their motions have them then; the skin is at rest.

        Raises SceneError for a time that is not 0 or more.
        """
        check_time(time_s)
        self._restart(time_s)

    def _restart(self, time_s: float | None) -> None:
        with interrupts_held():
            mujoco.mj_resetData(self.model, self.data)
            if time_s is not None:
                self.data.time = time_s
            place(self.data)
            mujoco.mj_forward(self.model, self.data)
            raise_errors(self.data)

    def copy(self) -> "Simulation":
        """A second simulation in the same state, which goes on by itself; model and matrices are shared."""
        twin = object.__new__(Simulation)
        twin.name, twin.path, twin.model = self.name, self.path, self.model
        with interrupts_held():
            twin.data = copy.copy(self.data)
        twin._attach()
        return twin

    def __copy__(self) -> "Simulation":
        """As `copy`: two simulations can't share MuJoCo's data."""
        return self.copy()

    def __deepcopy__(self, memo: dict[int, object]) -> "Simulation":
        """As `copy`; models never change."""
        return self.copy()

    # -- what there is to see ------------------------------------------------------------------------------------

    @property
    def skins(self) -> tuple[str, ...]:
        """Instance names of the skins."""
        return tuple(skin.name for skin in self.runtime.spec.skins)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that the sound pushes, in the order of `forces`."""
        return tuple(body.name for body in self.runtime.model.bodies)

    def skin(self, name: str | None = None) -> "Skin":
        """A skin by its instance name; the only one without. Raises SceneError for one that the scene has not."""
        names = self.skins
        name = chosen_name(names, name)
        if name not in self._skins:
            self._skins[name] = Skin(self.runtime, names.index(name))
        return self._skins[name]

    @property
    def drive(self) -> Complex:
        """What the transducers are told now: complex amplitudes relative to full drive, e^{-iwt}, shape (N,).

        N counts the transducers of all arrays, array after array.
        """
        posed = self.runtime.posed
        return self.runtime.work.emission.commanded(posed, np.array([self.time]))[0]

    @property
    def emitted(self) -> Complex:
        """What the transducers emit now, after their ring-up, shape (N,)."""
        _, course = self.runtime.now()
        if course.emitted is None and course.unit is None:
            return np.zeros(len(self.runtime.model.arrays), np.complex128)
        return np.array(rows(course)[0])

    @property
    def forces(self) -> Float:
        """Mean force of the sound on each of `bodies` over the last step [N], world axes, shape (bodies, 3).

        Before the first step, that over the step to come.
        """
        return np.array(self.runtime.applied)


def load(
    path: Source,
    *,
    device: str | None = None,
    accuracy: float | None = None,
    board: str | None = None,
    keys: Mapping[str, object] | None = None,
) -> Simulation:
    """Read and check a scene; see Simulation, whose arguments these are."""
    return Simulation(path, device=device, accuracy=accuracy, board=board, keys=keys)
