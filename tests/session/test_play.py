"""A scene's frames are what its simulation emits."""

from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.drive.boards import BOARDS
from palmfield.session.play import Target, play_focus, play_scene, scene_frames
from palmfield.session.preview import preview

CIRCLE = Path(__file__).parents[2] / "mjcf" / "scenes" / "palm_circle_sonicsurface.xml"


def test_frames_are_what_the_simulation_tells_the_transducers():
    """Bytes, decoded by the board's virtual twin, against the drive of the scene that is stepped."""
    view = preview(CIRCLE)
    frames = list(scene_frames(view, 0.03))
    assert len(frames) == 3
    emission, posed = view.runtime.work.emission, view.runtime.posed
    for time_s, data in frames:
        told = emission.commanded(posed, np.array([time_s + 1e-4]))[0]
        np.testing.assert_allclose(BOARDS["sonicsurface"].decode(data)[-1], told, atol=1e-9)


def test_an_error_of_the_scene_comes_before_the_file(tmp_path, small_scene):
    with pytest.raises(palmfield.DeviceError, match="sonicsurface gives"):
        play_scene(small_scene(), "sonicsurface", Target(record=tmp_path / "x.bin"))
    assert not list(tmp_path.glob("x.bin*"))


def test_neither_port_nor_file_is_refused():
    with pytest.raises(palmfield.DeviceError, match="give the port"):
        play_focus((0.0, 0.0, 0.15), "sonicsurface", Target(), 1.0)
