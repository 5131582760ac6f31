"""Translate MuJoCo's messages about a scene to three parts: position, error and remedy."""

import re
from collections.abc import Callable, Sequence
from functools import cache

import mujoco

from palmfield.errors import did_you_mean
from palmfield.session.scene_text import Element, SceneText

AT = re.compile(r"\bElement(?: name)? '(?P<name>[^']*)'(?:, id -?\d+)?(?:, line (?P<line>\d+))?\s*$")
"""Position at the end of a message: tag of the element (error in parsing) or its name (error in compilation)."""


def in_words(message: str, scene: str, text: SceneText | None, plugins: Sequence[str]) -> str:
    """Return one line: file and line if available, element, error, and allowed values.

    message: message of MuJoCo
    scene: name of the scene
    text: files of the scene, if it has any
    plugins: names of the plugins that palmfield registers
    """
    cause, name, line = _parts(message)
    element = None if text is None else _element(cause, name, line, text)
    where, tag = scene, f"element '{name}' " if name else ""
    if element is not None:
        where, tag = element.where, f"<{element.tag}> "
    elif line:
        where = f"{scene}, line {line}"
    for pattern, words in FAULTS:
        found = re.search(pattern, cause)
        if found and not isinstance(words, str):
            return f"{where}: {tag}{words(found, element, text, plugins)}"
        if found and isinstance(words, str):
            value = _value(found[1], element) if "{value}" in words else ""
            return f"{where}: {tag}{found.expand(words).replace('{value}', value)}"
    return f"{where}: {tag}cannot be compiled by MuJoCo: {cause}"


def _parts(message: str) -> tuple[str, str, int]:
    """Return MuJoCo's message, its element (tag in parsing, name in compilation), and its line.

    The line is 0 if MuJoCo gives no line, as for included files.
    """
    plain = " ".join(message.split())
    while plain.startswith(("XML Error: ", "Error: ")):
        plain = plain.partition(": ")[2]
    place = AT.search(plain)
    if place is None:
        return plain, "", 0
    return plain[: place.start()].strip(), place["name"], int(place["line"] or 0)


def _element(cause: str, name: str, line: int, text: SceneText) -> Element | None:
    """Return the element to which a message refers.

    MuJoCo gives no lines in included files, so all files are searched.
    """
    if line:
        return text.at(text.file, line, name)
    twice = re.search(r"repeated name '([^']*)' in plugin", cause)
    if twice:
        return text.last("instance", twice[1])
    for file in text.included:
        try:
            spec = mujoco.MjSpec.from_file(str(file))
            if not spec.plugins:
                spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            again, name_again, line_again = _parts(str(error))
            if again == cause and line_again:
                return text.at(file, line_again, name_again)
    return None


Words = Callable[[re.Match[str], Element | None, SceneText | None, Sequence[str]], str]


def _unknown_element(found: re.Match[str], element: Element | None, text: object, plugins: object) -> str:
    holder = None if element is None else element.parent
    inside = children(holder.tag) if holder is not None else ()
    if element is None or holder is None or not inside:
        return "is not an element that MuJoCo allows here; remove it, or move it to its place"
    near = did_you_mean(element.tag, inside)
    return f"is unknown inside <{holder.tag}>{near}; allowed: {', '.join(inside)}"


def _unknown_attribute(found: re.Match[str], element: Element | None, text: object, plugins: object) -> str:
    names = () if element is None else attributes(element.tag)
    near = did_you_mean(found[1], names)
    return f"has no attribute '{found[1]}'{near}" + (f"; allowed: {', '.join(names)}" if names else "; drop it")


def _value(attribute: str, element: Element | None) -> str:
    value = None if element is None else element.attributes.get(attribute)
    return f"attribute '{attribute}'" + ("" if value is None else f" has value '{value}',")


def _unknown_word(found: re.Match[str], element: Element | None, text: object, plugins: object) -> str:
    names = [] if element is None else [key for key, own in element.attributes.items() if own == found[1]]
    attribute = f"attribute '{names[0]}'" if names else "an attribute"
    return f"{attribute} has value '{found[1]}'; give one of the words that the MuJoCo XML reference lists for it"


def _unknown_plugin(found: re.Match[str], element: object, text: object, plugins: Sequence[str]) -> str:
    if found[1] in plugins:
        return (
            f"plugin '{found[1]}' is unknown to MuJoCo, which finds only plugins of installed packages, but this "
            "Python imports palmfield from a folder: install it (pip install FOLDER, or pip install -e FOLDER)"
        )
    near = did_you_mean(found[1], plugins)
    return f"plugin '{found[1]}' is not installed{near}; palmfield provides: {', '.join(plugins)}"


def _unknown_name(found: re.Match[str], element: Element | None, text: SceneText | None, plugins: object) -> str:
    name = found[1]
    if element is None or text is None:
        return f"the scene has no object named '{name}' ({found[2]}); give an existing name"
    # The name of an element may equal that of an element it refers to
    fitting = [key for key, value in element.attributes.items() if value == name]
    attribute = next((key for key in fitting if key != "name"), "".join(fitting[:1]))
    kind = element.attributes.get("objtype", "site") if attribute == "objname" else attribute.rstrip("0123456789")
    names = text.named(kind)
    kind = "plugin instance" if kind == "instance" else kind
    has = f"; it has: {', '.join(names)}" if names else "; give an existing name"
    return f"attribute '{attribute}': the scene has no {kind} '{name}'{did_you_mean(name, names)}{has}"


FAULTS: tuple[tuple[str, str | Words], ...] = (
    (r"Schema violation: unrecognized element", _unknown_element),
    (r"Schema violation: unrecognized attribute: '([^']*)'", _unknown_attribute),
    (r"Schema violation: unique element", "occurs here a second time; allowed: once; merge both into one"),
    (
        r"(?:bad format in|problem reading) attribute '([^']*)'",
        "{value} not all of which are numbers; allowed: numbers separated by spaces, without units",
    ),
    (r"attribute '([^']*)' has too much data", "{value} more numbers than it takes; give fewer"),
    (r"attribute '([^']*)' does not have enough data", "{value} fewer numbers than it takes; give more"),
    (r"invalid keyword: '([^']*)'", _unknown_word),
    (r"required attribute missing: '([^']*)'", "lacks the attribute '\\1'; add \\1=\"...\""),
    (r"repeated name '([^']*)' in (\w+)", r"name '\1' is given twice (\2); give each its own"),
    (
        r"Error opening file '([^']*)'",
        r"file '\1' does not exist or cannot be read; give a path relative to the folder of the scene",
    ),
    (r"duplicate config key: (\S+)", r"gives key '\1' twice; allowed: each key once in an instance"),
    (r"plugin '?([\w.]+?)'? not found", _unknown_plugin),
    (r"unrecognized name '([^']*)' (?:of|for) ([\w ]+)", _unknown_name),
    (r"neither 'plugin' nor 'instance' is specified", "has no plugin; add plugin=... and instance=..."),
    (r"File '([^']*)' already included", r"file '\1' is included twice; include it once"),
    (r"World body cannot have joints", "is in the world body, which does not move; put it into a <body>"),
    (r"axis too small in joint", "has an axis of length 0; give attribute 'axis' a direction"),
    (
        r"mass and inertia of moving bodies must be larger than mjMINVAL",
        "moves and has no mass; give the body a geom, an <inertial>, or no joint",
    ),
)
r"""MuJoCo's messages, with their translation and allowed values. \1 is a group; {value} is the attribute in group 1."""


@cache
def _schema() -> dict[str, tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the attributes and children of each MuJoCo element, by tag. A tag with several places has all of them."""
    parts: dict[str, tuple[list[str], list[str]]] = {}
    holders: list[tuple[int, str]] = []
    tag = ""
    for line in mujoco.mj_printSchema(False, False).splitlines():
        head = re.match(r"( *)(?:\(world\))?(\w+) \(.\)\s*(.*)$", line)
        words = line.split() if head is None else head[3].split()
        if head is not None:
            depth, tag = len(head[1]), head[2]
            holders = [holder for holder in holders if holder[0] < depth]
            parts.setdefault(tag, ([], []))
            if holders:
                parts[holders[-1][1]][1].append(tag)
            holders.append((depth, tag))
        if tag:
            parts[tag][0].extend(words)
    parts["body"][1].append("body")
    parts["worldbody"] = ([], parts["body"][1])
    parts["mujoco"][1][parts["mujoco"][1].index("body")] = "worldbody"
    for tag in ("frame", "replicate"):
        parts.setdefault(tag, ([], []))[1].extend(parts["body"][1])
    for _, inside in parts.values():
        # These elements are allowed everywhere
        inside.extend(["include", "frame", "replicate"] if "geom" in inside else ["include"])
    unique = dict.fromkeys
    return {tag: (tuple(unique(own)), tuple(unique(inside))) for tag, (own, inside) in parts.items()}


def attributes(tag: str) -> tuple[str, ...]:
    """Return the attributes that MuJoCo accepts in an element."""
    return _schema().get(tag, ((), ()))[0]


def children(tag: str) -> tuple[str, ...]:
    """Return the elements that MuJoCo accepts inside an element."""
    return _schema().get(tag, ((), ()))[1]
