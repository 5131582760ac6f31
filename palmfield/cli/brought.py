"""Load commands of other distributions, by entry points of group `palmfield.commands`.

The name of an entry point is that of the command. It refers to a function with Typer's annotations, whose docstring is
the help. `context.obj` is True if the command must print only warnings, errors and JSON.
"""

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import typer
import typer.main

from palmfield.errors import PalmfieldError

GROUP = "palmfield.commands"
SEPARATE = {"papers": ("palmfield-papers", "Reproduce four papers, and print each number next to the published one")}
"""Commands in separate distributions of the palmfield repository: name -> distribution and description."""
CLONE = Path(__file__).resolve().parents[2]


def commands() -> dict[str, Any]:
    """Return Typer's commands by name.

    If a command is not installed or cannot be loaded, a replacement accepts any arguments and reports the reason.
    """
    absent = {name: _absent(name) for name in SEPARATE}
    return absent | {entry.name: _loaded(entry) for entry in entry_points(group=GROUP)}


def _loaded(entry: EntryPoint) -> Any:
    try:
        return _made(entry.name, entry.load())
    except Exception as error:  # an error in another distribution must not affect `palmfield --help`
        where = f" of {entry.dist.name}" if entry.dist is not None else ""
        message = f"`palmfield {entry.name}`{where} cannot be loaded: {type(error).__name__}: {error}"
        return _refused(entry.name, "Cannot be loaded", message)


def _absent(name: str) -> Any:
    distribution, does = SEPARATE[name]
    there = (CLONE / name / "pyproject.toml").is_file()
    install = f"pip install -e {CLONE / name}" if there else f"pip install {distribution}"
    message = f"`palmfield {name}` belongs to a separate distribution, which is not installed; install it: {install}"
    return _refused(name, f"{does} (not installed)", message)


def _refused(name: str, does: str, message: str) -> Any:
    def refuse() -> None:
        raise PalmfieldError(message)

    any_arguments = {"ignore_unknown_options": True, "allow_extra_args": True}
    return _made(name, refuse, help=f"{does}.\n\n{message}", context_settings=any_arguments)


def _made(name: str, function: Callable[..., None], **settings: Any) -> Any:
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(name, **settings)(function)
    return typer.main.get_command(alone)
