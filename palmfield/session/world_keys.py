"""Separate keys whose values differ between the worlds of a simulation, and apply the values of each world."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palmfield.config import CONFIGS, Config, StimulusConfig, parse
from palmfield.errors import SceneError, naming_world
from palmfield.session.open_scene import as_text
from palmfield.simulation.scene_reader import am_table_of, focus_table_of, with_files_found
from palmfield.simulation.spec import SceneSpec, StimulusSpec

BY_PLUGIN: dict[str, type[Config]] = {config.plugin: config for config in CONFIGS}
BOUND = ("arrays", "frame", "path_on", "on_skin", "path_sites")
"""Keys of a stimulus that name parts of the scene."""
OF_TABLES = ("modulation", "am_file", "am_frequency_Hz", "path", "path_file")
"""Keys that determine which files of waveforms and foci are read."""
SHARED = {
    "palmfield.array": "all worlds share the arrays",
    "palmfield.skin": "all worlds share the skin's mesh and matrices",
    "palmfield.driver": "all worlds share the board",
    "palmfield.afferents": "all worlds share the regions",
    "palmfield.motion": "different poses are given by `poses`",
}
"""Reasons why the keys of a plugin cannot differ."""


@dataclass(frozen=True)
class WorldKeys:
    """Keys of a simulation.

    common: all keys, with the values of the first world. differing: the keys that differ, with a value for each world
    """

    common: dict[str, object]
    differing: dict[str, dict[str, tuple[object, ...]]]


def split_keys(keys: Mapping[str, object], worlds: int, plugins: Mapping[str, str]) -> WorldKeys:
    """Separate keys with one value from keys with one value for each world; the latter have one more axis.

    keys: as in `palmfield.session.open_scene.compiled`; plugins: name of the plugin, by instance of the scene
    Raises SceneError for a number of values that is not that of worlds, a wrong shape, and a key that cannot differ.
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
    """Return the scene in each world. spec, texts of keys of stimuli by instance: those of the first world.

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
    """Return a stimulus with changed keys, except BOUND ones.

    texts: texts of all its keys; element: its name in messages. Raises SceneError for an invalid value of a key.
    """
    config: Any = with_files_found(parse(StimulusConfig, dict(texts), element), element)
    table, foci = stimulus.am_table, stimulus.focus_table
    if any(getattr(config, key) != getattr(stimulus.config, key) for key in OF_TABLES):
        table, foci = am_table_of(config, element), focus_table_of(config, element)
    return replace(stimulus, config=config, am_table=table, focus_table=foci)


def axes_of(config: type[Config], key: str) -> int:
    """Return the number of axes of a single value: 1 for lists and vectors, 0 for numbers and texts."""
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
    """Return a shape as text; it may contain letters for any number."""
    return f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
