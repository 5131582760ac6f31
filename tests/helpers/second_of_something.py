"""Scenes with more than one of something, and the loudest moment of a simulation."""

from collections.abc import Callable
from pathlib import Path

import pytest

from palmfield.drive.transducer_response import present_drive
from palmfield.session.loudest_moment import LoudestMoment
from palmfield.session.simulation import Simulation

OTHER_PAD = '<body name="other" pos="{place}" quat="0 1 0 0"><site name="middle" size="0.001"/></body>'
ARRAY = (
    '<plugin plugin="palmfield.array"><instance name="{name}"><config key="site" value="{name}"/>{keys}</instance>'
    "</plugin>"
)


def with_second_skin(path: Path, place: str) -> Path:
    """The scene with a second disc like the first one, as instance `second`, at a place in the world."""
    plain = path.with_name("plain.xml")
    plain.write_text(plain.read_text().replace("</worldbody>", OTHER_PAD.format(place=place) + "</worldbody>"))
    text = path.read_text()
    begin = text.index('<instance name="skin">')
    end = text.index("</instance>", begin) + len("</instance>")
    twin = text[begin:end].replace('name="skin"', 'name="second"').replace('value="pad"', 'value="other"')
    path.write_text(text[:end] + twin + text[end:])
    return path


def with_second_array(path: Path, keys: str = "", name: str = "second") -> Path:
    """The scene with a second array, 0.3 m beside the first one, its keys as MJCF."""
    plain = path.with_name("plain.xml")
    site = f'<site name="{name}" pos="0.3 0 0"/>'
    plain.write_text(plain.read_text().replace("<worldbody>", f"<worldbody>{site}", 1))
    path.write_text(path.read_text().replace("<extension>", "<extension>" + ARRAY.format(name=name, keys=keys), 1))
    return path


def now(simulation: Simulation) -> LoudestMoment:
    """The present moment, as the loudest one."""
    posed, course = simulation.runtime.now()
    drive, factor = present_drive(course)
    assert drive is not None
    return LoudestMoment(simulation.time, posed, drive.copy(), factor)


@pytest.fixture
def add_skin() -> Callable[..., Path]:
    return with_second_skin


@pytest.fixture
def add_array() -> Callable[..., Path]:
    return with_second_array


@pytest.fixture
def moment() -> Callable[[Simulation], LoudestMoment]:
    return now
