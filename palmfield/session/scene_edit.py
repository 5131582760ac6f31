"""Change single elements of a scene file. All other bytes, comments and the layout stay unchanged."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from palmfield.session.scene_text import Element

TAG = re.compile(rb"""<(?:[^<>"']|"[^"]*"|'[^']*')*>""")
"""Start tag of an element. Character > may be part of a value."""


class Edit(NamedTuple):
    """Replacement of the bytes from start to end."""

    start: int
    end: int
    new: bytes


def with_attribute(data: bytes, element: Element, name: str, new: str) -> Edit:
    """Return the edit that sets an attribute of an element."""
    tag = tag_of(data, element)
    found = re.compile(rb"\b" + name.encode() + rb"\s*=\s*([\"'])(.*?)\1", re.DOTALL).search(tag[0])
    assert found is not None
    return Edit(tag.start() + found.start(2), tag.start() + found.end(2), new.encode())


def tag_of(data: bytes, element: Element) -> re.Match[bytes]:
    """Return the start tag of an element in its file."""
    tag = TAG.match(data, element.offset)
    assert tag is not None
    return tag


def without(data: bytes, element: Element) -> Edit:
    """Return the edit that removes an element. If the line then has no other content, the line is removed too."""
    tag = tag_of(data, element)
    start, end = tag.start(), tag.end()
    if not tag[0].endswith(b"/>"):
        end = data.index(b">", data.index(b"</" + element.tag.encode(), end)) + 1
    line_start = data.rfind(b"\n", 0, start) + 1
    line_end = data.find(b"\n", end)
    if line_end >= 0 and not data[line_start:start].strip() and not data[end:line_end].strip():
        start, end = line_start, line_end + 1
    return Edit(start, end, b"")


def indent_of(data: bytes, element: Element) -> bytes:
    """Return the line break and the spaces before an element that begins a line; empty for other elements."""
    start = data.rfind(b"\n", 0, element.offset)
    before = data[start + 1 : element.offset]
    if before.strip():
        return b""
    return (b"\r\n" if data[start - 1 : start] == b"\r" else b"\n") + before


def edited(data: bytes, edits: Sequence[Edit]) -> bytes:
    """Return the bytes of a file after some edits. The edits must not overlap."""
    for edit in sorted(edits, reverse=True):
        data = data[: edit.start] + edit.new + data[edit.end :]
    return data
