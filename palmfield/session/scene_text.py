"""Read the files of a scene as text: elements with file and line, and descriptions of XML errors.

This is needed because MuJoCo's model does not store positions in files, and its parser suggests no remedy.
"""

import contextlib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from palmfield.errors import SceneError, did_you_mean
from palmfield.files import read_bytes, reading, regular

ROOTS = ("mujoco", "mujocoinclude", "robot")
"""Tags that MuJoCo accepts as root element: of a scene, of an included file, and of a URDF file."""

NAMES = ("name", "class", "file", "model", "prefix", "timestep")
"""Endings of attribute names whose values may be any word, and the attribute that palmfield itself reads."""
ASSETS = ("mesh", "hfield", "texture", "skin", "model", "flexcomp")
"""Elements whose attributes file, fileright, ... name files."""
MOST_COPIES, MOST_ELEMENTS = 10_000, 1_000_000
"""Limits: copies by <replicate> (7 s in MuJoCo); elements of a scene with its included and attached files."""
SIZES = {
    "flexcomp": {"count": 100_000}, "composite": {"count": 100_000}, "user": {"dim": 100_000},
    "numeric": {"size": 10**6}, "texture": {"width": 20_000, "height": 120_000},
    "hfield": {"nrow": 20_000, "ncol": 20_000}, "contact": {"num": 1000},
    "size": {"nuserdata": 10**7, "nkey": 10**4, **{f"nuser_{kind}": 1000 for kind in
             ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")}},
}  # fmt: skip
"""Upper limits of attributes that make MuJoCo allocate memory or create elements."""
OF_ALL_SENSORS = {"name", "class", "dim", "noise", "cutoff", "user", "needstage", "datatype", "nsample", "interp",
                  "delay", "interval", "plugin", "instance"}  # fmt: skip
"""Attributes of sensors that do not name an object."""
AMPERSAND = "\x7f"
"""Character that replaces & while a file is read. It is one byte that XML allows and files do not use."""


@dataclass
class Element:
    """An element in the files of a scene.

    offset: number of bytes before it in its file; parent: enclosing element, across included files; None for the root
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    offset: int
    parent: "Element | None" = field(default=None, repr=False)

    @property
    def where(self) -> str:
        """File and line, for messages."""
        return f"{self.file}, line {self.line}"

    def within(self, tag: str) -> "Element | None":
        """Return the nearest enclosing element of a tag."""
        holder = self.parent
        while holder is not None and holder.tag != tag:
            holder = holder.parent
        return holder


class Instance(NamedTuple):
    """A plugin instance of a scene. keys: keys that the scene sets, as texts; they may be changed in place"""

    name: str
    plugin: str
    keys: dict[str, str]


class SceneText(NamedTuple):
    """All elements in the files of a scene. Elements of an included file are at the place of its inclusion.

    file: file of the scene, as the user wrote it
    """

    file: Path
    elements: tuple[Element, ...]

    def named(self, tag: str) -> list[str]:
        """Return the names of all elements with a tag."""
        return [one.attributes["name"] for one in self.elements if one.tag == tag and one.attributes.get("name")]

    @property
    def included(self) -> list[Path]:
        """Included files, in the order of reading."""
        return list(dict.fromkeys(one.file for one in self.elements if one.file != self.file))

    def at(self, file: Path, line: int, word: str) -> Element | None:
        """Return the element in a line of a file; of several, that with `word` as tag or in an attribute."""
        here = [one for one in self.elements if one.file == file and one.line == line]
        with_word = [one for one in here if one.tag == word or (word and word in one.attributes.values())]
        return next(iter(with_word or here), None)

    def last(self, tag: str, name: str | None = None) -> Element | None:
        """Return the last element that has a tag and, if not None, a name."""
        fitting = (one for one in reversed(self.elements) if one.tag == tag)
        return next((one for one in fitting if name is None or one.attributes.get("name") == name), None)

    def instance(self, plugin: str, name: str) -> Element | None:
        """Return the element of a plugin instance."""
        for one in self.elements:
            if one.tag == "instance" and one.attributes.get("name") == name:
                holder = one.within("plugin")
                if holder is not None and holder.attributes.get("plugin") == plugin:
                    return one
        return None

    def key(self, plugin: str, name: str, key: str) -> Element | None:
        """Return the element that sets a key of an instance, or else the element of the instance."""
        instance = self.instance(plugin, name)
        own = (one for one in self.elements if one.parent is instance and one.attributes.get("key") == key)
        return next(own, instance)


def read_scene_text(path: Path) -> SceneText:
    """Read the elements of a scene and its included files. Missing files are left for MuJoCo to report.

    Like MuJoCo, this ignores errors in comments and unescaped ampersands.
    Raises SceneError, with file and line, for other invalid XML.
    """
    return _whole(path, ())[0]


def _whole(path: Path, above: tuple[Path, ...]) -> tuple[SceneText, int]:
    """Read a scene or an attached model, and count its elements together with those of all attached models.

    above: files that attach it. It must not attach them again, because MuJoCo 4.0 would overflow its stack
    """
    elements: list[Element] = []
    _read(path, path, None, elements, set(), set())
    if not elements:
        raise SceneError(f"{path}: the file has no element; allowed: one <mujoco> with the whole scene")
    for one in elements:
        _check_finite(one)
        _check_size(one)
    _check_copies(elements)
    total, models = len(elements), dict[str, int]()
    for one in elements:
        for file in _files(one, path, elements):
            if one.tag != "model":
                continue
            inside = file.resolve()
            if inside in (*above, path.resolve()):
                raise SceneError(f"{one.where}: model '{one.attributes['file']}' attaches itself; remove this <model>")
            models[one.attributes.get("name", "")] = _whole(file, (*above, path.resolve()))[1]
        total += models.get(one.attributes.get("model", ""), 0) if one.tag == "attach" else 0
        if total > MOST_ELEMENTS:
            raise SceneError(
                f"{one.where}: the model attached here makes the scene larger than {MOST_ELEMENTS} elements"
            )
    return SceneText(path, tuple(elements)), total


def _files(element: Element, scene: Path, elements: list[Element]) -> list[Path]:
    """Return the existing files that an element names. Raises SceneError for a path that is not a regular file."""
    if element.tag not in ASSETS:
        return []
    names = [value for name, value in element.attributes.items() if name.startswith("file") and value]
    dirs = [value for one in elements if one.tag == "compiler" for value in one.attributes.values()]
    folders = [scene.parent, element.file.parent]
    places = [
        folder / below / name
        for name in names
        for folder in folders
        for below in ("", *dirs)
        if "\0" not in below + name
    ]
    there = list(dict.fromkeys(place for place in places if place.exists()))
    for place in there:
        try:
            regular(place)
        except OSError as error:
            raise SceneError(f"{element.where}: <{element.tag}> file '{place}': {error.strerror}") from None
    return there[:1]


def _check_size(element: Element) -> None:
    """Raise SceneError for sizes that would exhaust the memory or make MuJoCo compile for hours."""
    for name, most in SIZES.get(element.tag, {}).items():
        try:
            count = math.prod(float(word) for word in element.attributes.get(name, "").split())
        except ValueError:
            continue  # MuJoCo reports this error
        if count > most:
            raise SceneError(
                f"{element.where}: <{element.tag}> attribute '{name}' has value '{element.attributes[name]}'; "
                f"allowed: a total of at most {most}"
            )


def _check_copies(elements: list[Element]) -> None:
    """Raise SceneError for more copies than MuJoCo can make, and for sensors in copies, which it would duplicate."""
    copies = 0.0
    for one in elements:
        count = 1.0
        holder: Element | None = one
        while holder is not None:
            if holder.tag == "replicate":
                with contextlib.suppress(ValueError):
                    count *= max(float(holder.attributes.get("count", "1")), 0.0)
            holder = holder.parent
        copies += count if one.tag == "replicate" else 0
        if copies > MOST_COPIES:
            raise SceneError(
                f"{one.where}: <replicate> with count '{one.attributes.get('count')}' makes a total of "
                f"{copies:.0f} copies; allowed: at most {MOST_COPIES}, because the time grows with the square"
            )
    bare = (one for one in elements if one.parent is not None and one.parent.tag == "sensor")
    free = next((one for one in bare if not one.attributes.keys() - OF_ALL_SENSORS), None)
    if copies and free is not None:
        raise SceneError(
            f"{free.where}: sensor <{free.tag}> has no object, and MuJoCo 4.0 doubles such a sensor with each of "
            f"the {copies:.0f} copies of <replicate>; give it objtype and objname, or write the copies explicitly"
        )


def _check_finite(element: Element) -> None:
    """Raise SceneError for infinite numbers or NaN, which MuJoCo accepts. Keys of palmfield are checked elsewhere."""
    for name, value in element.attributes.items():
        if name.endswith(NAMES) or element.tag in ("config", "text", "numeric") or not re.search(r"(?i)nan|inf", value):
            continue
        try:
            numbers = [float(word) for word in value.split()]
        except ValueError:
            continue
        if not all(map(math.isfinite, numbers)):
            raise SceneError(
                f"{element.where}: <{element.tag}> attribute '{name}' has value '{value}'; allowed: finite numbers"
            )


def _read(
    path: Path, scene: Path, holder: Element | None, elements: list[Element], above: set[Path], read: set[Path]
) -> None:
    """Add the elements of a file. holder: its including element; above: files being read; read: files that were read"""
    for one in elements_of(path):
        if one.parent is None and one.tag not in ROOTS:
            raise SceneError(
                f"{one.where}: the outermost element is <{one.tag}>{did_you_mean(one.tag, ROOTS)}; allowed: <mujoco>"
            )
        if one.parent is None and holder is not None:
            # Included elements replace the <include> element
            one.parent = holder.parent
        elements.append(one)
        if one.tag != "include" or not one.attributes.get("file"):
            continue
        # MuJoCo resolves names relative to the first file, or else to the including file
        places = [folder / one.attributes["file"] for folder in (scene.parent, path.parent)]
        included = next((place for place in places if place.is_file()), None)
        if included is None:
            continue
        resolved = included.resolve()
        if resolved in above or resolved == scene.resolve():
            raise SceneError(f"{one.where}: file '{one.attributes['file']}' includes itself; remove this <include>")
        if resolved in read:  # MuJoCo reports this without the position
            raise SceneError(f"{one.where}: file '{one.attributes['file']}' is included twice; include it once")
        read.add(resolved)
        _read(included, scene, one, elements, above | {resolved}, read)


def elements_of(path: Path) -> list[Element]:
    """Return the elements of one file in the order of their start tags. Raises SceneError for invalid XML."""
    with reading(path, SceneError, "a file that can be"):
        data = read_bytes(path)
    parser = expat.ParserCreate()
    elements: list[Element] = []
    open_elements: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        holder = open_elements[-1] if open_elements else None
        own = {name: value.replace(AMPERSAND, "&") for name, value in attributes.items()}
        elements.append(Element(tag, own, path, parser.CurrentLineNumber, parser.CurrentByteIndex, holder))
        open_elements.append(elements[-1])

    def end(tag: str) -> None:
        open_elements.pop()

    def between(stray: str) -> None:
        if stray.strip():
            raise SceneError(
                f"{path}, line {parser.CurrentLineNumber}: text '{stray.strip()[:40]}' between elements has no "
                "meaning; remove it, or make it an element or a comment"
            )

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = between
    try:
        parser.Parse(_as_mujoco_reads(data), True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        line = getattr(error, "lineno", 1)
        raise SceneError(f"{path}, line {line}: {_fault(error, open_elements)}") from None
    return elements


def _as_mujoco_reads(data: bytes) -> bytes:
    """Return XML without comments and unescaped &. All other text keeps its position."""
    bare = re.sub(rb"<!--.*?-->", lambda comment: re.sub(rb"[^\n]", b" ", comment[0]), data, flags=re.DOTALL)
    return re.sub(rb"&(?!#?\w+;)", AMPERSAND.encode(), bare)


def _fault(error: Exception, open_elements: list[Element]) -> str:
    """Describe an XML error and its remedy."""
    last = open_elements[-1] if open_elements else None
    code = getattr(error, "code", None)
    if code == expat.errors.codes[expat.errors.XML_ERROR_TAG_MISMATCH] and last is not None:
        return f"<{last.tag}> of line {last.line} is not closed before this; close it by </{last.tag}> or />"
    if code == expat.errors.codes[expat.errors.XML_ERROR_NO_ELEMENTS] and last is not None:
        return f"the file ends before <{last.tag}> of line {last.line} is closed; close it by </{last.tag}>"
    faults = {
        expat.errors.XML_ERROR_NO_ELEMENTS: "the file is empty; allowed: one <mujoco> with the whole scene",
        expat.errors.XML_ERROR_INVALID_TOKEN: "a character is not allowed here in XML; put values in quotes, "
        "write &lt; for <, and save the file in UTF-8",
        expat.errors.XML_ERROR_UNCLOSED_TOKEN: "an element or a text in quotes is not closed; add the missing > or "
        "quote",
        expat.errors.XML_ERROR_DUPLICATE_ATTRIBUTE: "an attribute is given twice; give it once",
        expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: "there is text after the end of the outermost element; put "
        "everything into one <mujoco>",
        expat.errors.XML_ERROR_SYNTAX: "there is text where an element should begin; allowed: one <mujoco> with "
        "the whole scene",
        expat.errors.XML_ERROR_UNDEFINED_ENTITY: "an entity is unknown; write &amp; for &",
    }
    remedy = next((words for name, words in faults.items() if code == expat.errors.codes[name]), None)
    return remedy or f"the file is not XML ({error}); correct it in an editor that checks XML"


def sensors_without_objtype(text: SceneText) -> Iterator[Element]:
    """Return plugin sensors on which MuJoCo 4.0 crashes during parsing."""
    for one in text.elements:
        holder = one.parent
        if one.tag == "plugin" and holder is not None and holder.tag == "sensor" and not one.attributes.get("objtype"):
            yield one
