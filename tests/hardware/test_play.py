"""A scene's frames are what its simulation emits."""

from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.acoustics.air import sound_speed
from palmfield.drive.boards import BOARDS
from palmfield.drive.focus_fit import fitted_focus
from palmfield.hardware.play import Target, play_focus, play_scene, scene_frames
from palmfield.session.preview import preview

pytestmark = pytest.mark.usefixtures("kept_operators")

CIRCLE = Path(__file__).parents[2] / "mjcf" / "scenes" / "palm_circle_sonicsurface.xml"


def test_frames_are_what_the_simulation_tells_the_transducers():
    """Bytes, decoded by the board's virtual twin, against the drive of the scene that is stepped."""
    view = preview(CIRCLE)
    frames = list(scene_frames(view, 0.03))
    assert len(frames) == 3
    emission, posed = view.runtime.work.emission, view.runtime.posed
    for time_s, data, _ in frames:
        told = emission.commanded(posed, np.array([time_s + 1e-4]))[0]
        np.testing.assert_allclose(BOARDS["sonicsurface"].decode(data)[-1], told, atol=1e-9)


@pytest.mark.parametrize(
    ("board", "duration_s", "keys"),
    [("sonicsurface", 0.3, {"stimulus.modulation": "none"}), ("autd2018", 0.06, {})],
)
def test_foci_of_a_moving_scenes_bytes_are_the_simulated_ones_at_their_emission(board, duration_s, keys):
    """Frames through the twin, which tells when each is out, against a simulation stepped with all its sound."""
    scene = CIRCLE.with_name("follow_fingertip.xml")
    keys = {"skin.accuracy": 0.5, "motion.start_s": -0.2} | keys
    view = preview(scene, board=board, keys=keys, device="cpu")
    model = view.runtime.model
    begin_s = model.board.frame_time_s
    twin, decoded, near = model.board.twin(), [], None
    wavenumber = 2 * np.pi * 40e3 / sound_speed(model.arrays.air)
    for frame in scene_frames(view, duration_s):
        # As a player does: a frame's time on the line before it is due
        changes = [*twin.feed(frame.data, begin_s + frame.time_s - model.board.frame_time_s)]
        changes += twin.until(begin_s + frame.time_s + 1e-9)
        for change in changes:
            if np.abs(change.amplitudes).max() > 0.2:
                near, _ = fitted_focus(model.arrays.array.positions, change.amplitudes, wavenumber, near)
                decoded.append((change.time_s - begin_s, near))
    sim = palmfield.Simulation(scene, board=board, keys=keys, device="cpu")
    step_s, wanted = sim.model.opt.timestep, []
    for time_s, _ in decoded:
        while sim.time + (1 - 1e-6) * step_s <= time_s:
            sim.step()
        emission = sim.runtime.work.emission
        wanted.append(emission.foci(sim.runtime.posed, np.array([time_s]))[0][0, 0])
    off = np.array([place for _, place in decoded]) - np.array(wanted)
    assert len(decoded) > 20
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.3e-3
    assert np.abs(off[:, 2]).max() < 1e-3
    # What was sent before, the first pose for good, would be off by this
    assert np.linalg.norm(np.array(wanted) - wanted[0], axis=1).max() > 3e-3


def test_an_error_of_the_scene_comes_before_the_file(tmp_path, small_scene):
    with pytest.raises(palmfield.DeviceError, match="sonicsurface gives"):
        play_scene(small_scene(), "sonicsurface", Target(record=tmp_path / "x.bin"))
    assert not list(tmp_path.glob("x.bin*"))


def test_neither_port_nor_file_is_refused():
    with pytest.raises(palmfield.DeviceError, match="give the port"):
        play_focus((0.0, 0.0, 0.15), "sonicsurface", Target(), 1.0)
