"""A plan as tables to be read."""

import io
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.table import Table

from palmfield import terminal
from palmfield.planning.rows import Row

WIDTH = 130
"""Columns of the tables where the terminal is no narrower."""


def as_text(scene: str, parts: Mapping[str, Sequence[Row]], warnings: Sequence[str], seconds: float) -> str:
    """The expected wall time [s], a table for each part, by its title, and the warnings."""
    stream = io.StringIO()
    console = Console(file=stream, width=terminal.columns(WIDTH))
    console.print(f"Plan for {scene}. Expected time on two CPU cores: {seconds:.0f} s", highlight=False)
    every = [row for rows in parts.values() for row in rows]
    # One of each kind needs no names.
    named = any("," in row.instance for row in every) or (
        len({(row.what, row.instance) for row in every}) > len({row.what for row in every})
    )
    for title, rows in parts.items():
        columns = ("what", "of", "size", "why") if named else ("what", "size", "why")
        grid = Table(*terminal.folded(columns), title=title, title_justify="left")
        for row in rows:
            grid.add_row(*((row.what, row.instance) if named else (row.what,)), row.size, row.why)
        console.print(grid)
    for warning in warnings:
        console.print(f"Warning: {warning}", highlight=False)
    return stream.getvalue()
