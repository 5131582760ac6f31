"""Open several worlds of one scene, with different stimuli and hand positions, which are stepped together."""

from collections.abc import Callable, Mapping
from typing import Any, Unpack

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from palmfield.config import StimulusConfig, known_keys
from palmfield.engine.host import world_of
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.engine.worlds import SceneWorlds, plain_model
from palmfield.errors import SceneError
from palmfield.interrupts import interrupts_delayed
from palmfield.session.open_scene import Options, Source, compiled, fresh_data, opened
from palmfield.session.skin import Skin
from palmfield.session.world_keys import split_keys, world_specs
from palmfield.simulation.build import make_surfaces
from palmfield.simulation.build_worlds import Shared, build_worlds
from palmfield.types import Float, Float32, Int


def open_worlds(
    scene: Source,
    worlds: int,
    *,
    poses: Mapping[str, ArrayLike] | None = None,
    base: Mapping[str, object] | None = None,
    shared: Shared | None = None,
    **options: Unpack[Options],
) -> tuple[str, SceneWorlds]:
    """Return the name of a scene for messages, and its worlds, ready to step.

    scene, worlds, poses, options: as in `palmfield.Simulation`
    base: keys of the MuJoCo model instead of those of the first world; then all of `keys` differ
    shared: layers and solvers that these worlds share with worlds that are stepped separately
    Raises the errors of `palmfield.session.open_scene.compiled`, and SceneError for an invalid number of worlds, keys
    or poses of a wrong shape, and keys that cannot differ.
    """
    check_count(worlds)
    plugins = _plugins(scene)
    split = split_keys(options.get("keys") or {}, worlds, plugins)
    options["keys"] = split.common if base is None else base
    name, model, first = compiled(scene, **options)
    world = world_of(first)
    if world is None or world.scene is None:
        raise SceneError(f"{name} has no plugin 'palmfield.skin', so it is a plain MuJoCo model; add the plugin")
    spec = world.scene.spec
    specs = world_specs(spec, stimulus_texts(world.scene), split, worlds)
    plain = plain_model(model)
    models = build_worlds(specs, None if base is None else spec, shared)
    led = {_mocap(model, body): _poses(body, values, worlds) for body, values in (poses or {}).items()}
    if plain is model:
        data = [first, *(fresh_data(model, name) for _ in range(worlds - 1))]
    else:
        model, data = plain, [mujoco.MjData(plain) for _ in range(worlds)]
    scenes = SceneWorlds(first, data, models, led)
    make_surfaces(models[0])
    with interrupts_delayed():
        scenes.place()
        scenes.look()
    return name, scenes


def _in_each(name: str, about: str) -> Any:
    return property(lambda self: np.array([getattr(skin, name) for skin in self._skins]), doc=about)


def _shared(own: Any) -> Any:
    """Return a property of `Skin` that is equal in all worlds."""
    return property(lambda self: own.fget(self._skins[0]), doc=own.__doc__)


class WorldsSkin:
    """One skin in all worlds at their present time. Each array is computed on access."""

    def __init__(self, skins: list[Skin], settle: Callable[[], None]):
        """settle: function that updates the state"""
        self._all, self._settle = skins, settle

    @property
    def _skins(self) -> list[Skin]:
        self._settle()
        return self._all

    @property
    def solver(self) -> tuple[str, ...]:
        """Present or future solver in each world."""
        return tuple(skin.solver for skin in self._skins)

    name: str = _shared(Skin.name)
    rest_position: Float = _shared(Skin.rest_position)
    rest_normal: Float = _shared(Skin.rest_normal)
    faces: Int = _shared(Skin.faces)
    position: Float = _in_each(
        "position",
        "Positions of the surface nodes moved with body and bones, world [m], (worlds, S, 3); without displacement.",
    )
    displacement: Float = _in_each(
        "displacement", "Displacement of the surface nodes, in the resting body's axes [m], shape (worlds, S, 3)."
    )
    velocity: Float = _in_each(
        "velocity", "Velocity of the surface nodes, in the resting body's axes [m/s], shape (worlds, S, 3)."
    )
    normal_displacement: Float = _in_each(
        "normal_displacement", "Displacement along the outward normal [m], shape (worlds, S); negative into the skin."
    )
    arp: Float32 = _in_each(
        "arp", "Acoustic radiation pressure at the surface nodes [Pa], positive inwards, shape (worlds, S)."
    )


def stimulus_texts(runtime: SceneRuntime) -> dict[str, dict[str, str]]:
    """Return the keys of the stimuli of a scene in the MuJoCo model, by instance and key."""
    model = runtime.view.model
    instances = {name: number for number, _, name in model.instances()}
    return {part.name: model.values(instances[part.name], known_keys(StimulusConfig)) for part in runtime.spec.stimuli}


def check_count(worlds: object) -> None:
    """Raise SceneError for a number of worlds that is not a whole number >= 1."""
    if isinstance(worlds, bool) or not isinstance(worlds, int | np.integer) or worlds < 1:
        raise SceneError(f"worlds is {worlds!r}; allowed: a whole number of 1 or more")


def _plugins(scene: Source) -> dict[str, str]:
    """Return the name of the plugin of each instance."""
    if isinstance(scene, mujoco.MjModel):
        return {}
    spec = opened(scene).spec
    return {plugin.name: plugin.plugin_name for plugin in spec.plugins}


def _mocap(model: mujoco.MjModel, body: str) -> int:
    """Return the number of a mocap body. Raises SceneError for an unknown name."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
    mocap = -1 if number < 0 else int(model.body_mocapid[number])
    if mocap < 0:
        names = [model.body(i).name for i in range(model.nbody) if model.body_mocapid[i] >= 0]
        raise SceneError(
            f"poses are given for body '{body}'; allowed: a body with mocap='true': "
            f"{', '.join(names) or 'there is none'}"
        )
    return mocap


def _poses(body: str, values: ArrayLike, worlds: int) -> Float:
    """Return poses as float64. Raises SceneError for a wrong shape, and for invalid numbers or quaternions."""
    poses = np.array(values, dtype=np.float64)
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
