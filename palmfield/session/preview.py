"""Open a scene only for inspection: model and poses, without the matrices of its skins."""

import copy
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Unpack

import mujoco

from palmfield.drive.playback import ON_STEP
from palmfield.engine.host import raise_errors, world_of
from palmfield.engine.motion_plugin import place
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import SceneError
from palmfield.session.open_scene import Options, Source, changes_any, compiled
from palmfield.session.simulation import Simulation
from palmfield.simulation.posed_scene import PosedScene


@dataclass(frozen=True)
class Preview:
    """A scene for plans, descriptions and players.

    name: name for messages
    duration_s: duration of a run [s]
    data: MuJoCo data, which must exist as long as the runtime
    """

    name: str
    duration_s: float
    runtime: SceneRuntime
    data: mujoco.MjData

    def poses(self, count: int) -> Iterator[PosedScene]:
        """Yield only the poses of `moments`."""
        return (posed for _, posed in self.moments(count))

    def moments(self, count: int) -> Iterator[tuple[float, PosedScene]]:
        """Yield the present time [s] and pose. If a script moves a part, also yield `count` others during the run.

        Poses in which a body reaches into an array are skipped, because the run itself reports them.
        """
        yield float(self.data.time), self.runtime.posed
        if not any(skin.moves for skin in self.runtime.spec.skins):
            return
        # Sampled on a copy, so that the simulation does not change
        data = copy.copy(self.data)
        world = world_of(data)
        assert world is not None
        for number in range(1, count + 1):
            data.time = self.data.time + number * self.duration_s / count
            place(data)
            try:
                yield float(data.time), world.scene.posed
            except SceneError:
                continue

    def posed_at(self, times: Iterable[float]) -> Iterator[tuple[float, SceneRuntime, PosedScene]]:
        """Yield each of some rising times [s], with the runtime and the pose of the MuJoCo step at this time.

        If a part moves, a copy of the scene without its skins is stepped. Raises the errors of modules in a step.
        """
        if not self.moves:
            yield from ((time_s, self.runtime, self.runtime.posed) for time_s in times)
            return
        data = copy.copy(self.data)
        world = world_of(data)
        assert world is not None and world.scene is not None
        runtime: SceneRuntime = world.scene
        runtime.skins_rest, world.quiet = True, True
        step_s = runtime.spec.timestep_s
        for time_s in times:
            while data.time + (1.0 - ON_STEP) * step_s <= time_s:
                mujoco.mj_step(data.model, data)
                raise_errors(data)
                mujoco.mj_kinematics(data.model, data)
            yield time_s, runtime, runtime.posed

    @property
    def moves(self) -> bool:
        """Whether bodies or arrays may move."""
        spec, model = self.runtime.spec, self.data.model
        return model.nv > 0 or model.nmocap > 0 or any(skin.moves for skin in spec.skins)


def preview(scene: Source | Simulation, **options: Unpack[Options]) -> Preview:
    """Open a scene for inspection, or use a simulation in its present state.

    Arguments and errors are those of `palmfield.session.open_scene.compiled`. Keys of a simulation are fixed
    (SceneError).
    """
    if isinstance(scene, Simulation):
        if changes_any(options):
            raise SceneError("the keys of a simulation cannot be changed: give them to Simulation(...)")
        return Preview(scene.name, scene.duration_s, scene.runtime, scene.data)
    name, _, data = compiled(scene, **options)
    world = world_of(data)
    if world is None or world.scene is None:
        raise SceneError(f"{name} has no plugin 'palmfield.skin', so it is a plain MuJoCo model; add the plugin")
    return Preview(name, world.scene.spec.duration_s, world.scene, data)
