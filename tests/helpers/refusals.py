"""Scenes that are refused: what tests of bad input share."""

from pathlib import Path

import pytest

import palmfield
from palmfield.errors import PalmfieldError


def refused(scene: object, *expected: str, **arguments: object) -> str:
    """The one line that says why; it has all of the expected texts."""
    with pytest.raises(PalmfieldError) as caught:
        palmfield.load(scene, **arguments)
    text = str(caught.value)
    assert "\n" not in text
    for part in expected:
        assert part in text, text
    return text


def changed(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path
