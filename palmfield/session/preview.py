"""A scene to be looked at and not stepped: its model and poses, without the matrices of its skins."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco

from palmfield.engine.host import world_of
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import SceneError
from palmfield.session.load import Source, compiled
from palmfield.session.simulation import Simulation


@dataclass(frozen=True)
class Preview:
    """A scene as plans, descriptions and players take it.

    name: for messages; duration_s: of a run [s]; data: MuJoCo's, which must live as long as the runtime
    """

    name: str
    duration_s: float
    runtime: SceneRuntime
    data: mujoco.MjData


def preview(
    scene: Source | Simulation,
    *,
    device: str | None = None,
    accuracy: float | None = None,
    board: str | None = None,
    keys: Mapping[str, object] | None = None,
) -> Preview:
    """Open a scene, or take a simulation as it stands.

    Arguments and errors as `palmfield.session.load.compiled`; a simulation's keys can't be changed (SceneError).
    """
    if isinstance(scene, Simulation):
        if keys or any(value is not None for value in (device, accuracy, board)):
            raise SceneError("a simulation's keys can't be changed any more: give them to Simulation(...)")
        return Preview(scene.name, scene.duration_s, scene.runtime, scene.data)
    name, model, data = compiled(scene, device=device, accuracy=accuracy, board=board, keys=keys)
    world = world_of(data)
    if world is None or world.scene is None:
        raise SceneError(f"{name} has no plugin 'palmfield.skin'; it is a plain MuJoCo model")
    # Frames alone: mj_forward would read the sensors, which needs the skins' factorised matrices.
    mujoco.mj_kinematics(model, data)
    return Preview(name, world.scene.spec.duration_s, world.scene, data)
