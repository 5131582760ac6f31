"""Options that several commands share, and their evaluation."""

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palmfield.errors import SceneError

if TYPE_CHECKING:
    from palmfield.motion.live_hand import Live

LOG = logging.getLogger("palmfield.cli")
UNSET = "unset"
"""Value of `--set` that removes a key from the scene, so that its default applies."""


def group(name: str, about: str) -> typer.Typer:
    """Return a group of subcommands. about: first part of its help"""
    return typer.Typer(name=name, no_args_is_help=True, rich_markup_mode=None, help=about)


def offered_plugins(incomplete: str) -> list[str]:
    """Return the short names of plugins that begin with `incomplete`."""
    from palmfield.config import CONFIGS

    short = (config.plugin.removeprefix("palmfield.") for config in CONFIGS)
    return [name for name in short if name.startswith(incomplete.removeprefix("palmfield."))]


def offered_settings(incomplete: str) -> list[str]:
    """Return keys for `--set` that begin with `incomplete`.

    After a complete key, return its values if they are words.
    """
    from palmfield.config import CONFIGS, allowed

    name, equals, _ = incomplete.partition("=")
    offered = []
    for config in CONFIGS:
        for key in config.model_fields:
            full = f"{config.plugin.removeprefix('palmfield.')}.{key}"
            words = allowed(config, key).split(" | ") if equals and full == name else []
            offered += [f"{full}={word}" for word in words if len(words) > 1] if equals else [f"{full}="]
    return [text for text in offered if text.startswith(incomplete)]


SceneFile = Annotated[Path, typer.Argument(help="MJCF scene with palmfield plugins", metavar="SCENE.xml")]
Device = Annotated[
    str | None,
    typer.Option(
        help="compute device of the fields: auto, cpu or cuda:N [default: palmfield_device of the scene, or auto]",
        metavar="DEVICE",
    ),
]
Align = Annotated[Path | None, typer.Option(help="with --live: pose of the tracker, file of `palmfield track align`")]
Accuracy = Annotated[
    float | None,
    typer.Option(help="target accuracy: relative error of the skin displacement, e.g. 0.05", metavar="REL"),
]
Keys = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="set a key of one instance, or of all instances of a plugin, e.g. stimulus.path_speed_m_s=11 (see "
        "`palmfield keys`); may be repeated. File names are first looked up in the current folder, then relative "
        "to the scene. The value unset removes a key",
        metavar="INSTANCE.KEY=VALUE",
        autocompletion=offered_settings,
    ),
]
BoardName = Annotated[
    str | None,
    typer.Option(
        help="board to use instead of that of the scene, with its layout and frame rate (see `palmfield boards`)",
        metavar="BOARD",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="print only JSON, with units in the names, for other programs")]
Duration = Annotated[float | None, typer.Option(help="simulated time [s] [default: from the scene]")]
RunFolder = Annotated[Path, typer.Argument(help="folder of a run, or its result.nc", metavar="DIR")]
From = Annotated[float | None, typer.Option("--from", help="begin [ms] [default: begin of the run]")]
To = Annotated[float | None, typer.Option("--to", help="end [ms] [default: end of the run]")]
SentFile = Annotated[Path, typer.Argument(help="file of --log, or raw bytes of --record", metavar="FILE")]
BoardOfBytes = Annotated[str | None, typer.Option("--board", help="for raw bytes: name of the board", metavar="BOARD")]


def check_duration(duration: float | None) -> None:
    """Raise SceneError for an invalid --duration."""
    if duration is not None and not 0 < duration < 3600:
        raise SceneError(f"--duration has value {duration:g}; allowed: seconds > 0 and < 3600")


def parsed_keys(keys: list[str] | None) -> dict[str, str]:
    """Return keys for `palmfield.load`.

    A file name is first looked up in the current folder; if it exists there, this is logged.

    Other file names are relative to the scene. The value of a removed key (`unset`) is empty.
    Raises SceneError for a key without a value, and for a repeated key.
    """
    result: dict[str, str] = {}
    for text in keys or ():
        name, equals, value = text.partition("=")
        if not equals:
            raise SceneError(f"--set {text} has no value; write INSTANCE.KEY=VALUE, e.g. stimulus.path_speed_m_s=11")
        if not value.strip():
            raise SceneError(
                f"--set {text} has no value after the =; write INSTANCE.KEY=VALUE, or INSTANCE.KEY={UNSET} to "
                "remove the key, or omit --set to keep the value of the scene"
            )
        if name in result:
            raise SceneError(f"--set gives {name} twice, '{result[name]}' and '{value}'; allowed: each key once")
        result[name] = "" if value.strip() == UNSET else _file(name, value)
    return result


def _file(name: str, value: str) -> str:
    """Return the value of a key, with the full path if it names a file in the current folder."""
    from palmfield.config import FILE_KEYS

    if name.rpartition(".")[2] not in FILE_KEYS:
        return value
    here = Path(value).expanduser()
    if here.is_absolute() or not here.is_file():
        return value
    LOG.info(f"--set {name}: {here.resolve()}, from the current folder")
    return str(here.resolve())


def listening_at(text: str | None, align: Path | None) -> "Live | None":
    """Return the source of samples that `--live` names. Raises SceneError for --align without it."""
    if text is None:
        if align is not None:
            raise SceneError("--align belongs to --live: a scene has key tracking_alignment of palmfield.motion")
        return None
    from palmfield.motion.live_hand import Live
    from palmfield.motion.replaying import address_by

    host, port, by = address_by(text)

    def show_address(host: str, port: int) -> None:
        print(f"listening for a tracker at {host}:{port} by {by}", file=sys.stderr, flush=True)

    return Live(host, port, by, align, on_listening=show_address)
