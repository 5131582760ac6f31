"""Values of keys that are given on the command line, option --set."""

import logging
from pathlib import Path

from palmfield.errors import SceneError

LOG = logging.getLogger("palmfield.cli")
UNSET = "unset"
"""A value that takes the scene's own out, so that the key's default counts."""


def given_keys(keys: list[str] | None) -> dict[str, str]:
    """Keys as `palmfield.load` takes them; a file that is in the current folder is taken from there, and told.

    Other files are relative to the scene. Empty for a key that is taken out, by the word `unset`.
    Raises SceneError for a key without a value, and for one given twice.
    """
    result: dict[str, str] = {}
    for text in keys or ():
        name, equals, value = text.partition("=")
        if not equals:
            raise SceneError(f"--set {text} has no value; write INSTANCE.KEY=VALUE, e.g. stimulus.path_speed_m_s=11")
        if not value.strip():
            raise SceneError(
                f"--set {text} has no value behind the =; write INSTANCE.KEY=VALUE, INSTANCE.KEY={UNSET} to take the "
                "key out, or leave it out for what the scene has"
            )
        if name in result:
            raise SceneError(f"--set gives {name} twice, '{result[name]}' and '{value}'; allowed: each key once")
        result[name] = "" if value.strip() == UNSET else _file(name, value)
    return result


def _file(name: str, value: str) -> str:
    """The value of a key, a file's whole path where it names one in the current folder."""
    from palmfield.session.open_scene import FILES

    if name.rpartition(".")[2] not in {key for keys in FILES.values() for key in keys}:
        return value
    here = Path(value).expanduser()
    if here.is_absolute() or not here.is_file():
        return value
    LOG.info(f"--set {name}: {here.resolve()}, of the current folder")
    return str(here.resolve())


def offered_plugins(incomplete: str) -> list[str]:
    """Short names of the plugins that begin so."""
    from palmfield.config import CONFIGS

    short = (config.plugin.removeprefix("palmfield.") for config in CONFIGS)
    return [name for name in short if name.startswith(incomplete.removeprefix("palmfield."))]


def offered_settings(incomplete: str) -> list[str]:
    """Keys, as `--set` takes them, that begin so; after a whole key its values, where they are words."""
    from palmfield.config import CONFIGS, allowed

    name, equals, _ = incomplete.partition("=")
    offered = []
    for config in CONFIGS:
        for key in config.model_fields:
            full = f"{config.plugin.removeprefix('palmfield.')}.{key}"
            words = allowed(config, key).split(" | ") if equals and full == name else []
            offered += [f"{full}={word}" for word in words if len(words) > 1] if equals else [f"{full}="]
    return [text for text in offered if text.startswith(incomplete)]
