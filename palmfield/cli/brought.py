"""Commands that other distributions bring, by entry points of group `palmfield.commands`.

An entry point has the command's name and leads to a function with Typer's annotations and a docstring, its help. In it
`context.obj` is True where only warnings, errors and JSON are to be printed.
"""

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import typer
import typer.main

from palmfield.errors import PalmfieldError

GROUP = "palmfield.commands"
APART = {"papers": ("palmfield-papers", "Reproduce four papers, and print each number next to the published one")}
"""Commands in folders of palmfield's repository that are distributions of their own: which, and what they do."""
CLONE = Path(__file__).resolve().parents[2]


def commands() -> dict[str, Any]:
    """Typer's commands by name.

    One that is not installed or can't be loaded takes any arguments and says so.
    """
    absent = {name: _absent(name) for name in APART}
    return absent | {entry.name: _loaded(entry) for entry in entry_points(group=GROUP)}


def _loaded(entry: EntryPoint) -> Any:
    try:
        return _made(entry.name, entry.load())
    except Exception as error:  # another's fault must not cost `palmfield --help`
        where = f" of {entry.dist.name}" if entry.dist is not None else ""
        said = f"`palmfield {entry.name}`{where} cannot be loaded: {type(error).__name__}: {error}"
        return _refused(entry.name, "Cannot be loaded", said)


def _absent(name: str) -> Any:
    distribution, does = APART[name]
    there = (CLONE / name / "pyproject.toml").is_file()
    install = f"pip install -e {CLONE / name}" if there else f"pip install {distribution}"
    said = f"`palmfield {name}` belongs to a separate distribution, which is not installed; install it: {install}"
    return _refused(name, f"{does} (not installed)", said)


def _refused(name: str, does: str, said: str) -> Any:
    def refuse() -> None:
        raise PalmfieldError(said)

    takes_all = {"ignore_unknown_options": True, "allow_extra_args": True}
    return _made(name, refuse, help=f"{does}.\n\n{said}", context_settings=takes_all)


def _made(name: str, function: Callable[..., None], **settings: Any) -> Any:
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(name, **settings)(function)
    return typer.main.get_command(alone)
