"""A scene file, loaded: MuJoCo's model with the modules' settings."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco

from palmfield.engine.host import compiling, take_compile_error, world_of
from palmfield.engine.modules import MODULES, SkinModule
from palmfield.engine.motion import place
from palmfield.engine.reading import DURATION
from palmfield.errors import PalmfieldError, SceneError

FILES = {"palmfield.skin": ("mesh",), "palmfield.motion": ("keyframes", "trajectory", "tracking")}
"""Keys that name files, relative to the scene."""


@dataclass(frozen=True)
class Scene:
    """A compiled scene.

    path: the MJCF file; model: MuJoCo's model; data: a fresh mjData at time 0, poses computed
    skin: the scene's skin module, which holds rig and chain
    duration_s: how long `palmfield run` runs it by default
    """

    path: Path
    model: mujoco.MjModel
    data: mujoco.MjData
    skin: SkinModule
    duration_s: float


def load(
    path: str | Path,
    *,
    device: str | None = None,
    accuracy: float | None = None,
    board: str | None = None,
    keys: Mapping[str, object] | None = None,
) -> Scene:
    """Read and check a scene.

    path: MJCF file; device: overrides where field kernels run (auto, cpu, cuda:N)
    accuracy: overrides the wanted relative error of the skin displacement; board: overrides the device of the drive
    keys: overrides any other key, such as {"stimulus.path_speed_m_s": 4}; None takes a key out
    Raises SceneError (or DeviceError) with a one-line message that names element, key, value and what is allowed.
    """
    path = Path(path)
    if device is not None and not re.fullmatch(r"auto|cpu|cuda:\d+", device):
        raise SceneError(f"device '{device}' is not known; allowed: auto, cpu or cuda:N")
    if not path.is_file():
        raise SceneError(f"scene {path} does not exist; `palmfield new NAME` writes one to start from")
    take_compile_error()
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise SceneError(f"{path}: {_with_choices(_one_line(error))}") from None
    names = [plugin.plugin_name for plugin in spec.plugins]
    if SkinModule.name not in names:
        raise SceneError(f"{path} has no plugin '{SkinModule.name}'; it is a plain MuJoCo scene (see `palmfield new`)")
    overrides: dict[str, dict[str, object]] = {
        "palmfield.array": {"compute": device},
        "palmfield.skin": {"accuracy": accuracy},
        "palmfield.driver": {"device": board},
    }
    asked = _by_plugin(keys or {}, names)
    for plugin in spec.plugins:
        changes = {k: str(v) for k, v in overrides.get(plugin.plugin_name, {}).items() if v is not None}
        wanted = asked.get(plugin.plugin_name, {})
        plugin.config = {k: v for k, v in plugin.config.items() if wanted.get(k, v) is not None}
        changes |= {k: str(v) for k, v in wanted.items() if v is not None}
        for key in FILES.get(plugin.plugin_name, ()):
            name = changes.get(key, plugin.config.get(key))
            if name and not Path(name).is_absolute():
                changes[key] = str(path.resolve().parent / name)
        plugin.config = {**plugin.config, **changes}
    if board is not None and "palmfield.driver" not in names:
        raise SceneError(f"{path} has no plugin 'palmfield.driver', so there is no device to replace by '{board}'")
    try:
        with compiling():
            model = spec.compile()
        data = mujoco.MjData(model)
    except (ValueError, mujoco.FatalError) as error:
        cause = take_compile_error()
        if isinstance(cause, PalmfieldError):
            raise type(cause)(f"{path}: {cause}") from None
        if cause is not None:
            raise cause from None
        raise SceneError(f"{path}: {_with_choices(_one_line(error))}") from None
    world = world_of(data)
    assert world is not None
    place(data)
    skins = [module for module in world.modules.values() if isinstance(module, SkinModule)]
    if len(skins) != 1:
        raise SceneError(f"{path} has {len(skins)} instances of '{SkinModule.name}'; exactly one is needed")
    return Scene(path, model, data, skins[0], _duration(path, model))


def _by_plugin(keys: Mapping[str, object], names: list[str]) -> dict[str, dict[str, object]]:
    """Overrides by plugin. Raises SceneError for a plugin that the scene has not and a key that the plugin has not."""
    found: dict[str, dict[str, object]] = {}
    configs = {module.name: module.config for module in MODULES}
    for given, value in keys.items():
        short, _, key = given.rpartition(".")
        plugin = f"palmfield.{short.removeprefix('palmfield.')}"
        if plugin not in names or plugin not in configs:
            raise SceneError(f"key '{given}' is not of a plugin of this scene; it has: {', '.join(sorted(set(names)))}")
        if key not in configs[plugin].model_fields:
            raise SceneError(
                f"plugin '{plugin}': unknown key '{key}'; allowed: {', '.join(configs[plugin].model_fields)}"
            )
        found.setdefault(plugin, {})[key] = value
    return found


def _duration(path: Path, model: mujoco.MjModel) -> float:
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, DURATION)
    if number < 0:
        return 0.1
    value = float(model.numeric_data[model.numeric_adr[number]])
    if not value > 0:
        raise SceneError(f"{path}: numeric '{DURATION}' has value {value:g}; allowed: seconds > 0")
    return value


def _with_choices(message: str) -> str:
    """MuJoCo's message about a plugin or key that it doesn't know, with those there are."""
    known = {module.name: module.config for module in MODULES}
    key = re.search(r"unrecognized attribute 'plugin:(\w+)' for plugin (\S+?)'", message)
    if key and key[2] in known:
        return f"{message}: plugin '{key[2]}' has no key '{key[1]}'; allowed: {', '.join(known[key[2]].model_fields)}"
    if re.search(r"plugin \S+ not found", message):
        return f"{message}; palmfield's are: {', '.join(known)}"
    return message


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()).removeprefix("Error: ")
