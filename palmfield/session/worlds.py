"""Open several worlds of one scene, with different stimuli, keys and hand positions, which are stepped together."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from palmfield.config import CONFIGS, Config, StimulusConfig, known_keys, parse
from palmfield.engine.host import world_of
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.engine.worlds import SceneWorlds, plain_model
from palmfield.errors import SceneError, naming_world
from palmfield.interrupts import interrupts_delayed
from palmfield.session.open_scene import Options, Source, as_text, compiled, fresh_data, opened
from palmfield.session.skin import Skin
from palmfield.simulation.build import make_surfaces
from palmfield.simulation.build_worlds import Shared, build_worlds
from palmfield.simulation.scene_reader import am_table_of, focus_table_of, with_files_found
from palmfield.simulation.spec import SceneSpec, StimulusSpec
from palmfield.types import Float, Float32, Int

BY_PLUGIN: dict[str, type[Config]] = {config.plugin: config for config in CONFIGS}
BOUND = ("arrays", "frame", "path_on", "on_skin", "path_sites")
"""Keys of a stimulus that name parts of the scene."""
OF_TABLES = ("modulation", "am_file", "am_frequency_Hz", "path", "path_file")
"""Keys that determine which files of waveforms or foci are read."""
SHARED = {
    "palmfield.array": "all worlds share the arrays",
    "palmfield.skin": "all worlds share the skin's mesh and matrices",
    "palmfield.driver": "all worlds share the board",
    "palmfield.afferents": "all worlds share the regions",
    "palmfield.motion": "different poses are given by `poses`",
}
"""Reasons why the keys of a plugin cannot differ between worlds."""


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
    base: keys of the MuJoCo model that replace those of the first world; all of `keys` then differ
    shared: layers and solvers that these worlds share with worlds that are stepped separately
    Raises the errors of `palmfield.session.open_scene.compiled`. Raises SceneError for an invalid number of worlds, for
    keys or poses of a wrong shape, and for keys that cannot differ.
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
    """Return a property of `Skin` whose value is the same in all worlds."""
    return property(lambda self: own.fget(self._skins[0]), doc=own.__doc__)


class WorldsSkin:
    """One skin in all worlds at their present time. Each array is computed on access."""

    def __init__(self, skins: list[Skin], settle: Callable[[], None]):
        """skins: skin of each world; settle: function that updates the state before it is read"""
        self._all, self._settle = skins, settle

    @property
    def _skins(self) -> list[Skin]:
        self._settle()
        return self._all

    @property
    def solver(self) -> tuple[str, ...]:
        """Solver that the skin uses or will use, in each world."""
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


@dataclass(frozen=True)
class WorldKeys:
    """Keys of a simulation.

    common: all keys, with the values of the first world
    differing: the keys that differ, with a value for each world
    """

    common: dict[str, object]
    differing: dict[str, dict[str, tuple[object, ...]]]


def split_keys(keys: Mapping[str, object], worlds: int, plugins: Mapping[str, str]) -> WorldKeys:
    """Separate keys with one common value from keys with one value for each world. The latter have one more axis.

    keys: as in `palmfield.session.open_scene.compiled`
    plugins: instance of the scene -> name of its plugin
    Raises SceneError if the number of values is not the number of worlds, for a wrong shape, and for a key that cannot
    differ.
    """
    common: dict[str, object] = dict(keys)
    differing: dict[str, dict[str, tuple[object, ...]]] = {}
    for dotted, value in keys.items():
        owner, _, key = dotted.rpartition(".")
        plugin = plugins.get(owner, f"palmfield.{owner.removeprefix('palmfield.')}")
        config = BY_PLUGIN.get(plugin)
        if config is None or key not in config.model_fields or _depth(value) <= axes_of(config, key):
            continue  # one value for all worlds, or unknown, which `compiled` reports
        values = _by_world(dotted, value, worlds, config, key)
        if plugin != StimulusConfig.plugin:
            raise SceneError(
                f"key '{dotted}' has a value for each world, but {SHARED[plugin]}; allowed: one value for all"
            )
        if key in BOUND:
            raise SceneError(
                f"key '{dotted}' has a value for each world, but it names parts of the scene, which all worlds "
                f"share; keys that may differ: all keys of a stimulus except {', '.join(BOUND)}"
            )
        common[dotted] = values[0]
        for instance in [owner] if owner in plugins else [name for name, one in plugins.items() if one == plugin]:
            # A value for one instance overrides that for all instances of its plugin
            if instance == owner or f"{instance}.{key}" not in keys:
                differing.setdefault(instance, {})[key] = values
    return WorldKeys(common, differing)


def world_specs(
    spec: SceneSpec, texts: Mapping[str, Mapping[str, str]], keys: WorldKeys, worlds: int
) -> list[SceneSpec]:
    """Return the spec of the scene in each world.

    spec: spec of the first world
    texts: texts of the keys of stimuli in the first world, by instance
    Raises SceneError, with the world, for an invalid value of a key.
    """
    specs = []
    for world in range(worlds):
        stimuli = []
        for stimulus in spec.stimuli:
            own = dict(texts[stimulus.name])
            for key, values in keys.differing.get(stimulus.name, {}).items():
                own.pop(key, None)
                if values[world] is not None:
                    own[key] = as_text(values[world])
            with naming_world(world):
                stimuli.append(with_texts(stimulus, own, stimulus.element))
        specs.append(replace(spec, stimuli=tuple(stimuli)))
    return specs


def with_texts(stimulus: StimulusSpec, texts: Mapping[str, str], element: str) -> StimulusSpec:
    """Return a stimulus with changed keys. Keys in BOUND are not changed.

    texts: texts of all its keys
    element: name of the stimulus in messages
    Raises SceneError for an invalid value of a key.
    """
    config: Any = with_files_found(parse(StimulusConfig, dict(texts), element), element)
    table, foci = stimulus.am_table, stimulus.focus_table
    if any(getattr(config, key) != getattr(stimulus.config, key) for key in OF_TABLES):
        table, foci = am_table_of(config, element), focus_table_of(config, element)
    return replace(stimulus, config=config, am_table=table, focus_table=foci)


def axes_of(config: type[Config], key: str) -> int:
    """Return the number of axes of one value of a key: 1 for lists and vectors, 0 for numbers and texts."""
    return int(_schema(config, key).get("type") == "array")


@functools.cache
def _schema(config: type[Config], key: str) -> dict[str, Any]:
    schema = config.model_json_schema()["properties"][key]
    option: dict[str, Any] = next(o for o in schema.get("anyOf", [schema]) if o.get("type") != "null")
    return option


def _depth(value: object) -> int:
    """Return the number of axes of an array or of nested sequences."""
    if isinstance(value, np.ndarray):
        return value.ndim
    if isinstance(value, Sequence) and not isinstance(value, str):
        return 1 + max((_depth(part) for part in value), default=0)
    return 0


def _by_world(dotted: str, value: Any, worlds: int, config: type[Config], key: str) -> tuple[object, ...]:
    """Return one value for each world. Raises SceneError for a wrong shape."""
    axes, length = axes_of(config, key), _schema(config, key).get("maxItems")
    longs = {len(part) for part in value} if axes and _depth(value) > 1 else set()
    if len(value) == worlds and _depth(value) == axes + 1 and (length is None or longs == {length}):
        return tuple(value)
    shape = value.shape if isinstance(value, np.ndarray) else (len(value), *(longs if len(longs) == 1 else "?" * axes))
    own = (length or "n",) * axes
    raise SceneError(
        f"key '{dotted}' has shape {_text(shape)}; allowed with {worlds} worlds: {_text(own)}, the same for all, or "
        f"{_text((worlds, *own))} with a value for each"
    )


def _text(shape: tuple[object, ...]) -> str:
    """Return a shape as text. It may contain a letter where any number is allowed."""
    return f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
