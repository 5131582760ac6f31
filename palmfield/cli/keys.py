"""`palmfield keys`: list the keys of scenes, or print the page docs/keys.md.

Both come from the configuration models.
"""

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import UNSET, AsJson, offered_plugins
from palmfield.errors import SceneError, did_you_mean

if TYPE_CHECKING:
    from palmfield.config import Config

HEADINGS = ("key", "unit", "allowed", "default", "meaning")
SHORT = re.compile(r"finite number (?=[<>])|finite (number)")
RENAMED = "These keys were renamed since the last version. A scene with an old name gets an error with the new name."
SCENE = "Keys of the scene are elements of MJCF's <custom>: numeric name=KEY data=VALUE, or text name=KEY data=VALUE."
SCENE_KEYS = (
    ("palmfield_duration_s", "s", "numeric, finite number > 0", "0.1", "duration of `palmfield run`"),
    ("palmfield_device", "", "text, auto | cpu | cuda:N", "auto", "compute device of the fields; auto: the first GPU"),
)
"""Keys of a scene outside its plugins; read by palmfield.simulation.scene_reader."""


def keys(
    plugin: Annotated[
        str | None,
        typer.Argument(
            help="plugin to list, e.g. skin for palmfield.skin", metavar="[PLUGIN]", autocompletion=offered_plugins
        ),
    ] = None,
    markdown: Annotated[bool, typer.Option(help="print the page docs/keys.md")] = False,
    as_json: AsJson = False,
) -> None:
    """List every key that a scene can set, with unit, allowed values, default and meaning.

    Example: palmfield keys stimulus
    """
    if as_json and markdown:
        raise SceneError("--json and --markdown exclude each other; give one of them")
    if as_json:
        print_json(as_dict(plugin))
    else:
        print(as_markdown() if markdown else as_text(plugin), end="")


def as_text(plugin: str | None = None) -> str:
    """Return tables for the terminal, of one plugin or of all.

    plugin: its name, with or without `palmfield.`. Raises SceneError for an unknown one.
    """
    from palmfield.config import table as rows_of
    from palmfield.terminal import printed, table

    chosen = chosen_configs(plugin)
    tables = [
        table(rows_of(config), HEADINGS, title=f"{config.plugin}: {config.about}", title_justify="left")
        for config in chosen
    ]
    if plugin is None:
        tables.append(table(SCENE_KEYS, HEADINGS, title=SCENE, title_justify="left"))
    if renamed := _renamed(chosen):
        title = "Renamed since the last version"
        tables.append(table(renamed, ("was", "use"), title=title, title_justify="left", min_width=40))
    return printed(*tables, most=130)


def as_dict(plugin: str | None = None) -> dict[str, Any]:
    """Return the keys of one plugin or of all for JSON; units are texts. Errors as in `as_text`."""
    from palmfield.config import renamed_table, table

    chosen = chosen_configs(plugin)
    plugins = [
        {
            "plugin": config.plugin,
            "about": config.about,
            "keys": [dict(zip(HEADINGS, row, strict=True)) for row in table(config)],
            "renamed": [{"was": old, "use": use} for old, use in renamed_table(config)],
        }
        for config in chosen
    ]
    if plugin is not None:
        return {"plugins": plugins}
    return {"plugins": plugins, "scene_keys": [dict(zip(HEADINGS, row, strict=True)) for row in SCENE_KEYS]}


def chosen_configs(plugin: str | None) -> list[type["Config"]]:
    """Return the configuration model of one plugin, named with or without `palmfield.`, or of all.

    Raises SceneError for an unknown one.
    """
    from palmfield.config import CONFIGS

    names = {config.plugin.removeprefix("palmfield."): config for config in CONFIGS}
    if plugin is None:
        return list(CONFIGS)
    short = plugin.removeprefix("palmfield.")
    if short not in names:
        raise SceneError(f"there is no plugin '{plugin}'{did_you_mean(short, names)}; allowed: {', '.join(names)}")
    return [names[short]]


def as_markdown() -> str:
    """Return the page docs/keys.md."""
    from palmfield.config import CONFIGS, table

    lines = ["# Keys of a scene", "", "For authors of scenes. Made by `palmfield keys --markdown`; do not edit.", ""]
    about = "In `--set` and `keys=` a key is INSTANCE.key, or PLUGIN.key for all instances. A name ends with its unit. "
    lines += [f"{about}`--set INSTANCE.key={UNSET}`, or None in `keys=`, removes a key.", ""]
    for config in CONFIGS:
        lines += _section(config.plugin, config.about, table(config))
    lines += _section("The scene", SCENE.replace("<custom>", "`<custom>`"), SCENE_KEYS)
    renamed = _renamed(CONFIGS)
    if renamed:
        lines += ["## Renamed", "", RENAMED, ""]
        lines += ["| was | use |", "|---|---|", *(_line((f"`{old}`", use)) for old, use in renamed), ""]
    return "\n".join(lines)


def _renamed(configs: Sequence[type["Config"]]) -> list[tuple[str, str]]:
    from palmfield.config import renamed_table

    return [(f"{config.plugin} {old}", use) for config in configs for old, use in renamed_table(config)]


def _section(title: str, about: str, rows: Sequence[tuple[str, ...]]) -> list[str]:
    lines = [_line((key, _limits(limits), *rest)) for key, _, limits, *rest in [HEADINGS, *rows]]
    return [f"## {title}", "", about, "", lines[0], "|---|---|---|---|", *lines[1:], ""]


def _limits(limits: str) -> str:
    """Return the allowed values of a key in a short form for the page, e.g.

    `> 0, <= 20` for `finite number > 0 and <= 20`.
    """
    return SHORT.sub(r"\1", limits).replace(" and <", ", <").replace(" | ", ", ")


def _line(row: tuple[str, ...]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
