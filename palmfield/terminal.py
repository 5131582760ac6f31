"""Format tables and progress bars for a terminal."""

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
"""Smallest width of tables, in columns; narrower tables are not readable."""


def columns(most: int) -> int:
    """Return the width of a table: that of the terminal, but at most `most`. Without a terminal it is `most`.

    Environment variable COLUMNS has priority, as in shells. If standard output is a pipe, the terminal of standard
    error is used.
    """
    fixed = os.environ.get("COLUMNS", "")
    if fixed.isdecimal() and int(fixed) > 0:
        return max(LEAST, min(most, int(fixed)))
    for stream in (sys.__stdout__, sys.__stderr__):
        try:
            if stream is not None and (wide := os.get_terminal_size(stream.fileno()).columns) > 0:
                return max(LEAST, min(most, wide))
        except (OSError, ValueError):  # no terminal, or a closed stream
            continue
    return most


def table(rows: Iterable[Sequence[str]], heads: Sequence[str] | None = None, **looks: Any) -> Table:
    """Return a table of rows with two or more cells. Long words continue in the next line.

    heads: heads of the columns, None for no heads; looks: options of rich's Table
    """
    grid = Table(*(Column(name, overflow="fold") for name in heads or ("", "")), show_header=heads is not None, **looks)
    for row in rows:
        grid.add_row(*row)
    return grid


def printed(*parts: Table | str, most: int) -> str:
    """Return the text of tables and lines, one below the other, in the width of `columns(most)`."""
    stream = io.StringIO()
    console = Console(file=stream, width=columns(most))
    for part in parts:
        console.print(part, highlight=False)
    return stream.getvalue()


class TimeLeft(TimeRemainingColumn):
    """Column with the remaining time of a task.

    Without a count of parts: expected time (`expected_s`) minus elapsed time.
    """

    def render(self, task: Task) -> Text:
        """Return the text for one task. After the expected time, it is the text of rich."""
        rest = task.fields.get("expected_s", 0.0) - (task.elapsed or 0.0)
        return super().render(task) if task.total is not None or rest <= 0.0 else Text(f"about {rest:.0f} s left")


def bars(show: bool = True, *more: ProgressColumn) -> Progress:
    """Return progress bars on standard error, with elapsed and remaining time. Without a terminal they are disabled."""
    columns = TextColumn("{task.description}"), BarColumn(), *more, TimeElapsedColumn(), TimeLeft()
    console = Console(stderr=True)
    # In a pipe, bars would print an empty line before an error; rich before 14 does so even if they are disabled
    console.quiet = not (show and console.is_terminal)
    return Progress(*columns, console=console, disable=console.quiet, transient=True)
