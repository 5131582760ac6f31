"""The command line: the program, its groups of commands, and its handling of errors and Ctrl-C.

Each command has its own file with its options. It imports other modules inside functions, so that --help is quick.
"""

import gc
import os
import re
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from palmfield.cli import brought
from palmfield.cli.bench import bench
from palmfield.cli.board import board
from palmfield.cli.boards import boards
from palmfield.cli.cache import cache
from palmfield.cli.calibrate import calibrate
from palmfield.cli.compare import compare
from palmfield.cli.decode import decode
from palmfield.cli.drive import drive
from palmfield.cli.experiment import experiment
from palmfield.cli.hand import hand
from palmfield.cli.info import info
from palmfield.cli.keys import keys
from palmfield.cli.messages import LEVELS, print_message, show_log
from palmfield.cli.migrate import migrate
from palmfield.cli.new import new
from palmfield.cli.plan import plan
from palmfield.cli.plot import plot
from palmfield.cli.prepare import prepare
from palmfield.cli.recover import recover
from palmfield.cli.render import render
from palmfield.cli.replay import replay
from palmfield.cli.run import run
from palmfield.cli.safety import safety
from palmfield.cli.stimulus import stimulus
from palmfield.cli.sweep import sweep
from palmfield.cli.track import track
from palmfield.cli.trial import trial
from palmfield.cli.usd import usd
from palmfield.cli.view import view
from palmfield.cli.why import why
from palmfield.errors import PalmfieldError, SceneError

GROUPS: dict[str, tuple[Callable[..., None] | typer.Typer, ...]] = {
    "Begin": (new, info, keys, stimulus, hand),
    "Simulate": (plan, prepare, run, view, recover),
    "Look at results": (plot, render, usd),
    "Play on hardware": (boards, board, why, safety, drive, decode, replay, calibrate, track, trial),
    "Study": (sweep, compare, experiment),
    "Maintain": (migrate, cache, bench),
}
"""Commands by heading of `palmfield --help`. A function is a command with its name; a Typer has subcommands."""
OF_OTHERS = "From other distributions"
INTERRUPTED_CODE = 130
"""Exit code after Ctrl-C."""
USUAL_THRESHOLDS = gc.get_threshold()
WITHOUT_DASK = ("run", "recover", "plot", "render", "usd")
"""Commands that run without dask. If dask is installed, xarray imports it, which takes 0.25 s; only sweeps need it."""
OBJECTS_AT_START = 300_000
"""Number of new objects before the first garbage collection.

It is slightly more than the number of objects that imports and a scene make. All of these stay in use, and searching
them would take a fifth of the start-up time.
"""
ANYWHERE = {"-v": 0, "--verbose": 0, "-q": 0, "--quiet": 0, "--log-level": 1}
"""Options of the whole program that may also follow a command, with the number of values of each option."""


class _Program(TyperGroup):
    """The whole program. It expands `~` in arguments, and adds the commands of other distributions."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, [_expanded(argument) for argument in args])

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands in the order of GROUPS, then those of other distributions."""
        self._add_others()
        return list(dict.fromkeys((*GROUP_OF, *self.commands)))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.commands:
            self._add_others()
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section of help for each group, with equal column widths."""
        rows: dict[str, list[tuple[str, str]]] = {group: [] for group in (*GROUPS, OF_OTHERS)}
        names = self.list_commands(ctx)
        width = max(map(len, names))
        for name in names:
            about = self.get_command(ctx, name).get_short_help_str(formatter.width - 6 - width)
            rows[GROUP_OF.get(name, OF_OTHERS)].append((f"{name:<{width}}", about))
        for group, listed in rows.items():
            if listed:
                with formatter.section(group):
                    formatter.write_dl(listed)

    def _add_others(self) -> None:
        """Add commands of other distributions. This is done only when needed, because each command loads a module."""
        for name, command in brought.commands().items():
            self.commands.setdefault(name, command)


def _expanded(argument: str) -> str:
    """Expand `~` in an argument. Shells do not expand it after `=` and inside quotes.

    Raises SceneError for a Windows path on another system.
    """
    name, equals, value = argument.partition("=") if argument.startswith("--") else ("", "", argument)
    if value == "~" or value.startswith("~/"):
        return name + equals + os.path.expanduser(value)
    if os.name == "posix" and (drive := re.match(r"([A-Za-z]):[\\/]", value)):
        raise SceneError(
            f"'{value}' is a Windows path, but this system has no drive letters; give a path with /, in WSL "
            f"/mnt/{drive[1].lower()}/{value[3:].replace(chr(92), '/')}"
        )
    return argument


app = typer.Typer(
    cls=_Program,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Ultrasonic mid-air haptics: from the drive of an array to radiation pressure on a hand, skin waves and "
    "perception.\n\nStart with `palmfield new first` and `palmfield run first/first.xml`.\n\n--install-completion "
    "lets the shell complete commands, options, plugins and keys after TAB.",
)
GROUP_OF: dict[str, str] = {}
"""Group of each command of palmfield, by name."""
for _group, _members in GROUPS.items():
    for _member in _members:
        if isinstance(_member, typer.Typer):
            app.add_typer(_member)
            GROUP_OF[str(_member.info.name)] = _group
        else:
            app.command()(_member)
            GROUP_OF[_member.__name__] = _group


@app.callback(invoke_without_command=True)
def program(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="print the version and exit")] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="print only warnings, errors and the output of --json")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="same as --log-level debug")] = False,
    log_level: Annotated[
        str | None,
        typer.Option(
            help=f"lowest level of log messages to show: {', '.join(LEVELS)} [default: info]", metavar="LEVEL"
        ),
    ] = None,
) -> None:
    if version:
        import palmfield

        print(f"palmfield {palmfield.__version__}")
        raise typer.Exit()
    if quiet and verbose:
        raise SceneError("--quiet and --verbose exclude each other; give one of them")
    show_log(log_level or ("debug" if verbose else "warning" if quiet else "info"))
    context.obj = quiet


def main() -> None:
    """Run the command line. An error of the user is printed as one line on standard error, with exit code 2."""
    try:
        app(_anywhere(sys.argv[1:]), standalone_mode=True)
    except PalmfieldError as error:
        print_message(str(error))
        sys.exit(2)
    except (KeyboardInterrupt, SystemExit, Exception) as error:
        if isinstance(error, SystemExit) and not _silent(error):
            raise
        if not _from_ctrl_c(error):
            raise
        print_message("interrupted")
        sys.exit(INTERRUPTED_CODE)


def start() -> None:
    """Run `main` without garbage collection during the start and at the end."""
    gc.callbacks.append(_before_garbage)
    gc.set_threshold(OBJECTS_AT_START)
    if next((word for word in sys.argv[1:] if not word.startswith("-")), "") in WITHOUT_DASK:
        sys.modules["dask"] = None  # type: ignore[assignment]
    try:
        main()
    finally:
        gc.freeze()


def _before_garbage(phase: str, info: dict[str, int]) -> None:
    """Exclude all present objects from garbage collection, before the first collection.

    Later collections are as usual.
    """
    gc.callbacks.remove(_before_garbage)
    gc.freeze()
    gc.set_threshold(*USUAL_THRESHOLDS)


def _silent(error: SystemExit) -> bool:
    """Return whether Typer ended the program after Ctrl-C without a message.

    Commands themselves raise Exit from None.
    """
    ended = error.__context__
    return error.code == INTERRUPTED_CODE and ended is not None and isinstance(ended.__cause__, KeyboardInterrupt)


def _from_ctrl_c(error: BaseException) -> bool:
    """Return whether Ctrl-C caused an error. Libraries raise errors of their own if Ctrl-C interrupts an import."""
    causes = (error.__cause__, error.__context__)
    return isinstance(error, KeyboardInterrupt) or any(_from_ctrl_c(cause) for cause in causes if cause is not None)


def _anywhere(arguments: list[str]) -> list[str]:
    """Return the arguments with the options of the whole program moved before the command."""
    first, rest, waiting = [], [], 0
    for argument in arguments:
        name, equals, _ = argument.partition("=")
        if waiting or name in ANYWHERE:
            first.append(argument)
            waiting = waiting - 1 if waiting else ANYWHERE[name] * (not equals)
        else:
            rest.append(argument)
    return first + rest
