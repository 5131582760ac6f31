"""The scene's keys as text and as the page docs/keys.md, from the configuration models."""

import io

from rich.console import Console
from rich.table import Table

from palmfield.config import CONFIGS, renamed_table, table
from palmfield.errors import SceneError

HEADINGS = ("key", "unit", "allowed", "default", "meaning")


def as_text(plugin: str | None = None) -> str:
    """Tables for the terminal, of one module or of all. Raises SceneError for an unknown module."""
    chosen = [c for c in CONFIGS if plugin in (None, c.plugin)]
    if not chosen:
        raise SceneError(f"there is no plugin '{plugin}'; allowed: {', '.join(c.plugin for c in CONFIGS)}")
    stream = io.StringIO()
    console = Console(file=stream, width=130)
    for config in chosen:
        grid = Table(*HEADINGS, title=f"{config.plugin}: {config.about}", title_justify="left")
        for row in table(config):
            grid.add_row(*row)
        console.print(grid)
    return stream.getvalue()


def as_markdown() -> str:
    """The page docs/keys.md."""
    lines = ["# Keys of a scene", "", "Made by `palmfield keys --markdown`; do not edit.", ""]
    for config in CONFIGS:
        lines += [f"## {config.plugin}", "", config.about, ""]
        lines += ["| " + " | ".join(HEADINGS) + " |", "|" + "---|" * len(HEADINGS)]
        lines += [_line(row) for row in table(config)]
        lines.append("")
    renamed = [(f"`{c.plugin}` {old}", use) for c in CONFIGS for old, use in renamed_table(c)]
    if renamed:
        lines += ["## Renamed", "", "Since the last version; a scene that has these is told what to use.", ""]
        lines += ["| was | use |", "|---|---|", *(_line(row) for row in renamed), ""]
    return "\n".join(lines)


def _line(row: tuple[str, ...]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
