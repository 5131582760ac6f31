"""Migrate scenes of the previous version: rewrite renamed keys, and leave everything else unchanged."""

from pathlib import Path
from typing import NamedTuple

from palmfield.config import CONFIGS, Config
from palmfield.errors import OutputError, SceneError
from palmfield.outputs.store import write_whole
from palmfield.session.open_scene import no_scene
from palmfield.session.scene_edit import Edit, edited, indent_of, tag_of, with_attribute, without
from palmfield.session.scene_text import Element, elements_of, read_scene_text

MOVED = {("palmfield.array", "compute"): "palmfield_device"}
"""Keys that have become a custom text of the whole scene."""


class Migrated(NamedTuple):
    """A scene file with the names of this version.

    text: text of the file
    changes: one sentence for each change
    others: included files that contain old names
    """

    text: bytes
    changes: tuple[str, ...]
    others: tuple[Path, ...]


def migrated(path: Path) -> Migrated:
    """Return the file of a scene with new names of keys and values; comments and layout are unchanged.

    Raises SceneError for a file that cannot be read, or in which keys contradict each other.
    """
    if not path.is_file():
        raise SceneError(no_scene(path))
    elements = elements_of(path)
    data = path.read_bytes()
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        raise SceneError(f"{path} is not in UTF-8; save it in UTF-8, and try again") from None
    edits, changes, moved = [], [], dict[str, tuple[str, Element]]()
    for config, element in _keys(elements):
        key, value = element.attributes["key"], element.attributes.get("value", "")
        to = MOVED.get((config.plugin, key))
        if to is not None:
            first = moved.setdefault(to, (value, element))
            if first[0] != value:
                raise SceneError(
                    f"{element.where}: key '{key}' has value '{value}' here and '{first[0]}' in line "
                    f"{first[1].line}, but is now one text '{to}' of the whole scene; make the values equal first"
                )
            edits.append(without(data, element))
            continue
        new_key, new_value = _renamed(config, key, value)
        if (new_key, new_value) == (key, value):
            continue
        edits += [with_attribute(data, element, "key", new_key)] if new_key != key else []
        edits += [with_attribute(data, element, "value", new_value)] if new_value != value else []
        was, now = (f"key '{key}'", f"'{new_key}'") if new_key != key else (f"{key} '{value}'", f"'{new_value}'")
        if new_key != key and new_value != value:
            now += f", with value '{new_value}' for '{value}'"
        changes.append(f"line {element.line}: {was} of '{config.plugin}' is now {now}")
    for name, (value, element) in moved.items():
        there = next((e for e in elements if e.tag == "text" and e.attributes.get("name") == name), None)
        what = f"line {element.line}: key '{element.attributes['key']}' is now the scene's text '{name}'"
        if there is None:
            edits.append(_custom_text(data, elements, name, value))
        else:
            what = f"{what}, which line {there.line} already sets to '{there.attributes.get('data', '')}'"
        changes.append(what)
    included = dict.fromkeys(e.file for e in read_scene_text(path).elements if e.file != path)
    others = tuple(file for file in included if any(_is_old(*one) for one in _keys(elements_of(file))))
    return Migrated(edited(data, edits), tuple(changes), others)


def migrate(path: Path, out: Path | None = None, *, overwrite: bool = False) -> Migrated:
    """Write a scene file with the names of this version. If it has no old names, no file is written.

    out: file to write, default the file itself
    overwrite: whether an existing file may be replaced
    Raises SceneError like `migrated`, OutputError if a file may not be replaced or cannot be written.
    """
    result = migrated(path)
    target = path if out is None else out
    if not result.changes:
        return result
    if target.exists() and not overwrite:
        raise OutputError(
            f"{target} exists and would be replaced ({'; '.join(result.changes)}); give another file by --out, or "
            "--overwrite"
        )
    write_whole(target, result.text)
    return result


def _keys(elements: list[Element]) -> list[tuple[type[Config], Element]]:
    """Return the elements that set keys of palmfield's plugins, each with the configuration model of the plugin."""
    configs = {config.plugin: config for config in CONFIGS}
    result = []
    for element in elements:
        plugin = element.within("plugin") if element.tag == "config" else None
        config = configs.get(plugin.attributes.get("plugin", "")) if plugin is not None else None
        if config is not None and "key" in element.attributes:
            result.append((config, element))
    return result


def _is_old(config: type[Config], element: Element) -> bool:
    key, value = element.attributes["key"], element.attributes.get("value", "")
    return (config.plugin, key) in MOVED or _renamed(config, key, value) != (key, value)


def _renamed(config: type[Config], key: str, value: str) -> tuple[str, str]:
    """Return a key and its value with their present names."""
    use = config.renamed.get(key)
    if use in config.model_fields:
        key = str(use)
    return key, config.renamed.get(f"{key}={value}", value)


def _custom_text(data: bytes, elements: list[Element], name: str, value: str) -> Edit:
    """Return the edit that adds a custom text: to the existing <custom>, or to a new one before the plugins."""
    quoted = value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    text = f'<text name="{name}" data="{quoted}"/>'.encode()
    custom = next((e for e in elements if e.tag == "custom"), None)
    if custom is None:
        extension = next(e for e in elements if e.tag == "extension")
        indent = indent_of(data, extension)
        return Edit(extension.offset, extension.offset, b"<custom>" + text + b"</custom>" + (indent or b"\n"))
    tag = tag_of(data, custom)
    if tag[0].endswith(b"/>"):
        return Edit(tag.end() - 2, tag.end(), b">" + text + b"</custom>")
    child = next((e for e in elements if e.parent is custom), None)
    return Edit(tag.end(), tag.end(), (indent_of(data, child) if child is not None else b"") + text)
