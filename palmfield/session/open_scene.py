"""Make MuJoCo's model and data from a scene file, an MjSpec or a compiled model. Keys may be changed."""

import logging
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypedDict, Unpack

import mujoco
import numpy as np

from palmfield.config import CONFIGS, Config, allowed, known_keys, unknown_key
from palmfield.data import folder as data_folder
from palmfield.engine.host import compiling, pop_compile_error, world_of
from palmfield.engine.motion_plugin import place
from palmfield.errors import PalmfieldError, SceneError, did_you_mean
from palmfield.session.scene_text import Instance, SceneText, read_scene_text, sensors_without_objtype
from palmfield.simulation.scene_reader import DEVICE

LOG = logging.getLogger("palmfield.session")
SKIN = "palmfield.skin"
OF_PLUGINS: dict[str, type[Config]] = {config.plugin: config for config in CONFIGS}
"""Configuration models by the name of their plugin."""

Source: TypeAlias = str | Path | mujoco.MjSpec | mujoco.MjModel


class Options(TypedDict, total=False):
    """Settings that replace those of a scene. None leaves a setting unchanged.

    device: device of the fields (auto, cpu, cuda:N); accuracy: target relative error of the displacement of
        all skins; board: board that plays the drive, with its layout and rate (`palmfield.session.other_board`)
    keys: changed keys by INSTANCE.key, or PLUGIN.key for all instances of a plugin, such as {"stimulus.focus_m": (0, 0,
        0.19)}. Values are numbers, text, sequences and arrays; None, "" or () removes a key
    """

    device: str | None
    accuracy: float | None
    board: str | None
    keys: Mapping[str, object] | None


def changes_any(options: Options) -> bool:
    """Return whether options change any value of a scene."""
    return any(value is not None and value != {} for value in options.values())


def compiled(source: Source, **options: Unpack[Options]) -> tuple[str, mujoco.MjModel, mujoco.MjData]:
    """Return the name of a scene, the MuJoCo model, and data at time 0 with hands placed by their motions.

    source: MJCF file, MjSpec (not changed), or a compiled model, whose keys cannot change; options: see `Options`
    Raises SceneError or DeviceError. The message is one line with element, key, value and allowed values.
    """
    device = options.get("device")
    if device is not None and not re.fullmatch(r"auto|cpu|cuda:\d+", device):
        raise SceneError(f"device '{device}' is unknown; allowed: auto, cpu or cuda:N")
    pop_compile_error()
    if isinstance(source, mujoco.MjModel):
        if changes_any(options):
            raise SceneError(
                "the scene is compiled (MjModel), so its keys cannot be changed: give its file or its MjSpec with "
                "the keys, or the model without keys"
            )
        data = fresh_data(source, "model")
        _check_sensor_places(data, "model", None)
        return "model", source, data
    started = time.perf_counter()
    scene = opened(source)
    with _restored(scene.spec):
        model = _compiled_with(scene, options)
    data = fresh_data(model, scene.name, scene.text)
    _check_sensor_places(data, scene.name, scene.text)
    LOG.debug("opened %s in %.2f s", scene.name, time.perf_counter() - started)
    return scene.name, model, data


def _compiled_with(scene: "Opened", options: Options) -> mujoco.MjModel:
    """Return the model of a scene, see `compiled`. The changed keys stay in the spec of the scene."""
    name, spec, folder, text = scene
    device, accuracy, board = options.get("device"), options.get("accuracy"), options.get("board")
    _check_plugins(spec, name)
    _check_sensors(spec, name)
    if text is not None:
        _check_names(text)
    if device is not None:
        device_text = next((text for text in spec.texts if text.name == DEVICE), None) or spec.add_text(name=DEVICE)
        device_text.data = device
    changes = _changes(spec, options.get("keys") or {})
    plugins = [Instance(plugin.name, plugin.plugin_name, dict(plugin.config)) for plugin in spec.plugins]
    for _, plugin_name, config in plugins:
        if plugin_name == SKIN and accuracy is not None:
            config["accuracy"] = as_text(accuracy)
    for instance, _, config in plugins:
        for key, value in changes.get(instance, {}).items():
            written = "" if value is None else as_text(value)
            if written:
                config[key] = written
            else:
                config.pop(key, None)
    if board is not None:
        from palmfield.session.other_board import exchange_board

        for change in exchange_board(name, plugins, board, spec.option.timestep):
            LOG.info("board %s: %s", board, change)
    for plugin, (_, _, config) in zip(spec.plugins, plugins, strict=True):
        _check_keys(plugin, config, scene)
        for key in OF_PLUGINS.get(plugin.plugin_name, Config).files:
            if config.get(key) and folder is not None and not Path(config[key]).is_absolute():
                config[key] = str(folder / config[key])
        plugin.config = config
    try:
        with compiling():
            return spec.compile()
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        raise _explained(error, name, text) from None


@contextmanager
def _restored(spec: mujoco.MjSpec) -> Iterator[None]:
    """Restore keys and device of a spec at the end of the block.

    A copy of the spec is not possible: MuJoCo 4.0 drops plugins to which no element refers, as most of palmfield's.
    """
    configs = [(plugin, dict(plugin.config)) for plugin in spec.plugins]
    devices = [text.data for text in spec.texts if text.name == DEVICE]
    try:
        yield
    finally:
        for plugin, config in configs:
            plugin.config = config
        for text in list(spec.texts):
            if text.name == DEVICE and devices:
                text.data = devices[0]
            elif text.name == DEVICE:
                spec.delete(text)


def as_text(value: object) -> str:
    """Return the value of a key as MJCF text: numbers with all digits, sequences and arrays separated by spaces."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, str):
        return value
    if isinstance(value, float | np.floating):
        return repr(float(value))
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, np.ndarray):
        return " ".join(as_text(part) for part in value.ravel())
    if isinstance(value, list | tuple):
        return " ".join(as_text(part) for part in value)
    return str(value)


class Opened(NamedTuple):
    """A scene that has been read but not compiled. name: name for messages

    folder: folder to which its file names are relative; text: files of the scene, None for an MjSpec
    """

    name: str
    spec: mujoco.MjSpec
    folder: Path | None
    text: SceneText | None


def opened(source: str | Path | mujoco.MjSpec) -> Opened:
    """Read the spec and the files of a scene. Raises SceneError if that fails."""
    if isinstance(source, mujoco.MjSpec):
        folder = Path(source.modelfiledir).resolve() if source.modelfiledir else None
        return Opened(source.modelname or "the spec", source, folder, None)
    if not isinstance(source, str | PathLike):
        raise SceneError(f"scene is {source!r}; allowed: the path of a file, an MjSpec or an MjModel")
    path = Path(source)
    if not path.is_file():
        raise SceneError(no_scene(path))
    text = read_scene_text(path)
    for sensor in sensors_without_objtype(text):
        raise _without_objtype(sensor.where, sensor.attributes.get("name", ""), sensor.attributes.get("plugin", ""))
    try:
        return Opened(str(path), mujoco.MjSpec.from_file(str(path)), path.resolve().parent, text)
    # MuJoCo's binding raises RuntimeError for other errors, such as a lack of memory
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        raise SceneError(_in_words(error, str(path), text)) from None


def no_scene(path: Path) -> str:
    """Return the error for a missing scene. It lists similar names in the same folder or among palmfield's scenes."""
    if path.is_dir():
        return f"scene {path} is a folder; allowed: the path of an MJCF file, for example {path / 'scene.xml'}"
    shipped = data_folder("mjcf") / "scenes"
    # Compare names without their suffix, which would make any two short names similar
    places = {file.stem: str(file) for where in (shipped, path.parent) for file in sorted(where.glob("*.xml"))}
    near = did_you_mean(path.stem, places)
    for name, file in places.items():
        near = near.replace(f"'{name}'", f"'{file}'")
    return f"scene {path} does not exist{near}; `palmfield new NAME` writes one to start from"


def _check_plugins(spec: mujoco.MjSpec, name: str) -> None:
    if SKIN not in [plugin.plugin_name for plugin in spec.plugins]:
        raise SceneError(
            f"{name} has no plugin '{SKIN}', which a simulation needs; `palmfield new NAME` writes a scene with a "
            "skin; for sound only use palmfield.acoustics (examples/01_pressure_at_a_focus.py)"
        )


def _check_names(text: SceneText) -> None:
    """Raise SceneError for palmfield instances without a name. Keys and results refer to instances by name."""
    for one in text.elements:
        holder = one.within("plugin") if one.tag == "instance" else None
        plugin = "" if holder is None else holder.attributes.get("plugin", "")
        if plugin in OF_PLUGINS and not one.attributes.get("name", "").strip():
            raise SceneError(
                f"{one.where}: <instance> of plugin '{plugin}' has name '{one.attributes.get('name', '')}'; "
                "allowed: a unique, non-empty name, which keys and results use"
            )


def _check_sensors(spec: mujoco.MjSpec, name: str) -> None:
    """Raise SceneError for a plugin sensor without objtype, on which MuJoCo 4.0 crashes during compilation."""
    for sensor in spec.sensors:
        plugged = sensor.type == mujoco.mjtSensor.mjSENS_PLUGIN
        if plugged and sensor.objtype == mujoco.mjtObj.mjOBJ_UNKNOWN:
            raise _without_objtype(name, sensor.name, sensor.plugin.plugin_name)


def _check_sensor_places(data: mujoco.MjData, name: str, text: SceneText | None) -> None:
    """Check sensors, and bones if key inertia is on. name, text: of the scene.

    Raises SceneError, with file and line, for a sensor that is not on its skin, and for a bone whose acceleration
    cannot be used.
    """
    world = world_of(data)
    if world is None or world.scene is None:
        return
    try:
        world.scene.check_sensors()
        driven = [number for number, skin in enumerate(world.scene.model.skins) if skin.spec.config.inertia == "on"]
        if driven:
            from palmfield.engine.inertia import bone_accelerations

            for number in driven:
                bone_accelerations(world, number)
    except SceneError as error:
        error.about = (_place(str(error), name, text), *error.about)
        raise


def _without_objtype(scene: str, sensor: str, plugin: str) -> SceneError:
    return SceneError(
        f"{scene}: sensor '{sensor}' of plugin '{plugin}' has no objtype; give objtype='site' and objname, a site of "
        "the skin's body"
    )


def _changes(spec: mujoco.MjSpec, keys: Mapping[str, object]) -> dict[str, dict[str, object]]:
    """Return the changed values by instance name. Raises SceneError for unknown instances, plugins and keys."""
    result: dict[str, dict[str, object]] = {}
    set_by: dict[tuple[str, ...], str] = {}
    instances = {plugin.name for plugin in spec.plugins}
    # A value for one instance overrides that for all instances of its plugin
    for dotted, value in sorted(keys.items(), key=lambda item: item[0].rpartition(".")[0] in instances):
        owner, _, key = dotted.rpartition(".")
        own = [plugin for plugin in spec.plugins if plugin.name == owner]
        if not own:
            full = f"palmfield.{owner.removeprefix('palmfield.')}"
            own = [plugin for plugin in spec.plugins if plugin.plugin_name == full]
        if not own:
            names = sorted({plugin.name for plugin in spec.plugins} | {p.plugin_name for p in spec.plugins})
            short = [name.removeprefix("palmfield.") for name in names]
            near = did_you_mean(owner.removeprefix("palmfield."), short)
            raise SceneError(
                f"key '{dotted}' belongs to no instance or plugin of this scene{near}; it has: {', '.join(names)}"
            )
        other = set_by.setdefault((key, *(plugin.name for plugin in own)), dotted)
        if other != dotted:
            raise SceneError(
                f"keys '{other}' and '{dotted}' both set {key} of instance '{own[0].name}', to '{keys[other]}' and "
                f"'{value}'; give one of them"
            )
        for plugin in own:
            config = OF_PLUGINS.get(plugin.plugin_name)
            if config is not None and key not in known_keys(config):
                raise SceneError(f"plugin '{plugin.plugin_name}' instance '{plugin.name}': {unknown_key(config, key)}")
            result.setdefault(plugin.name, {})[key] = value
    return result


def _check_keys(plugin: mujoco.MjsPlugin, config: Mapping[str, str], scene: Opened) -> None:
    """Raise SceneError for unknown keys, and for empty values, which MuJoCo does not distinguish from missing keys."""
    model = OF_PLUGINS.get(plugin.plugin_name)
    if model is None:
        return
    for key, value in config.items():
        wrong = ""
        if key not in known_keys(model):
            wrong = unknown_key(model, key)
        elif not value.strip() and key in model.model_fields:
            wrong = f"key '{key}' has no value; allowed: {allowed(model, key)}, or remove the key"
        if wrong:
            message = f"plugin '{plugin.plugin_name}' instance '{plugin.name}': {wrong}"
            raise SceneError(f"{_place(message, scene.name, scene.text)}: {message}")


def fresh_data(model: mujoco.MjModel, name: str, text: SceneText | None = None) -> mujoco.MjData:
    """Return data at time 0 with hands placed by their motions.

    name, text: name and text of the scene, for errors as in `compiled`
    """
    try:
        data = mujoco.MjData(model)
    except (ValueError, mujoco.FatalError) as error:
        raise _explained(error, name, text) from None
    place(data)
    return data


def _explained(error: Exception, name: str, text: SceneText | None) -> BaseException:
    """Return the error to show: that of a module with its position, or MuJoCo's error in translation."""
    cause = pop_compile_error()
    if isinstance(cause, PalmfieldError):
        place = _place(str(cause), name, text)
        if text is not None and " renamed: use " in str(cause):
            cause.args = (f"{cause.args[0]} (`palmfield migrate {name}` rewrites it)",)
        cause.about = (place, *cause.about)
        return cause
    return cause or SceneError(_in_words(error, name, text))


def _in_words(error: Exception, name: str, text: SceneText | None) -> str:
    from palmfield.session.mujoco_messages import in_words

    return in_words(str(error), name, text, list(OF_PLUGINS))


def _place(message: str, name: str, text: SceneText | None) -> str:
    """Return the file and line of the key, instance or setting with which a message begins.

    If the line is unknown, return the name of the scene.
    """
    named = re.match(r"plugin '([^']+)' instance '([^']*)'(?:: (?:unknown )?key '(\w+)')?", message)
    element = text.key(named[1], named[2], named[3] or "") if named and text is not None else None
    sensor = re.search(r"instance '[^']*': sensor '([^']*)'", message)
    if sensor and text is not None:
        element = text.last("plugin", sensor[1]) or element
    whole = re.match(r"(option|numeric|text|tuple) '([^']+)'", message)
    if whole and text is not None:
        element = text.last(whole[1], None if whole[1] == "option" else whole[2])
    return name if element is None else element.where


def instances_of(source: str | Path, keys: Mapping[str, object]) -> tuple[list[Instance], dict[str, dict[str, object]]]:
    """Return the plugin instances of a scene, and its changed keys by instance (see `compiled`), without compilation.

    Raises SceneError for a scene that cannot be read, and for unknown instances, plugins and keys.
    """
    name, spec, _, _ = opened(source)
    _check_plugins(spec, name)
    listed = [Instance(plugin.name, plugin.plugin_name, dict(plugin.config)) for plugin in spec.plugins]
    return listed, _changes(spec, keys)
