"""What a terminal shows: how wide tables may be, what becomes of words that are wider, and bars of progress."""

import io
import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column, Table
from rich.text import Text

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


def table(rows: Iterable[Sequence[str]], heads: Sequence[str] | None = None, **looks: Any) -> Table:
    """Rows of two or more cells, in which a word that is too long goes on in the next line: half a key's name is none.

    heads: of the columns, None for two columns without; looks: further options of rich's Table
    """
    grid = Table(*(Column(name, overflow="fold") for name in heads or ("", "")), show_header=heads is not None, **looks)
    for row in rows:
        grid.add_row(*row)
    return grid


def printed(*parts: Table | str, most: int) -> str:
    """What a terminal shows of tables and lines, one below the other, in `columns(most)`."""
    stream = io.StringIO()
    console = Console(file=stream, width=columns(most))
    for part in parts:
        console.print(part, highlight=False)
    return stream.getvalue()


class TimeLeft(TimeRemainingColumn):
    """The time left of a task; where its parts are not counted, the expected time (`expected_s`) less what went."""

    def render(self, task: Task) -> Text:
        """Of one task; what rich says once it takes longer than expected."""
        left = task.fields.get("expected_s", 0.0) - (task.elapsed or 0.0)
        return super().render(task) if task.total is not None or left <= 0.0 else Text(f"about {left:.0f} s left")


def bars(show: bool = True, *more: ProgressColumn) -> Progress:
    """Bars on a terminal's standard error, with more columns and the time spent and left; nothing unless watched."""
    columns = TextColumn("{task.description}"), BarColumn(), *more, TimeElapsedColumn(), TimeLeft()
    console = Console(stderr=True)
    # In a pipe, bars would leave an empty line before an error; rich before 14 does so even where they are disabled
    console.quiet = not (show and console.is_terminal)
    return Progress(*columns, console=console, disable=console.quiet, transient=True)
