"""What a terminal shows: how wide tables may be, what becomes of words that are wider, and bars of progress."""

import os
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column

LEAST = 60
"""Columns below which tables could not be read any more."""


def columns(most: int) -> int:
    """Width of a table: that of the terminal, and no more than `most`, which counts where there is no terminal.

    The variable COLUMNS comes first, as for shells. A pipe has no width; it mostly ends in the terminal that warnings
    and progress go to.
    """
    told = os.environ.get("COLUMNS", "")
    if told.isdecimal() and int(told) > 0:
        return max(LEAST, min(most, int(told)))
    for stream in (sys.__stdout__, sys.__stderr__):
        try:
            if stream is not None and (wide := os.get_terminal_size(stream.fileno()).columns) > 0:
                return max(LEAST, min(most, wide))
        except (OSError, ValueError):  # no terminal, or a stream that was closed
            continue
    return most


def folded(names: Sequence[str]) -> list[Column]:
    """Columns of a table in which a word that is too long goes on in the next line: half a key's name is none."""
    return [Column(name, overflow="fold") for name in names]


def bars(show: bool = True) -> Progress:
    """Bars on a terminal's standard error, with the time spent and left; nothing where nobody watches."""
    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    console = Console(stderr=True)
    # In a pipe, bars would leave an empty line before an error
    return Progress(*columns, console=console, disable=not (show and console.is_terminal), transient=True)
