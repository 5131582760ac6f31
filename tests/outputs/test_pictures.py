import time

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.image import imread
from scipy.spatial.transform import Rotation

from palmfield.errors import OutputError
from palmfield.outputs.camera import look_along_emission
from palmfield.outputs.frames import to_local, to_world
from palmfield.outputs.plots import plot_displacement, plot_pressure
from palmfield.outputs.render import COLOURS, render_scene
from palmfield.outputs.schema import dataset

poses = st.tuples(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.integers(0, 2**32 - 1))


def _pose(drawn):
    position, seed = drawn
    return np.concatenate([position, np.roll(Rotation.random(rng=np.random.default_rng(seed)).as_quat(), 1)])


@given(poses)
def test_poses_agree_with_trimesh(drawn):
    pose = _pose(drawn)
    points = np.random.default_rng(0).normal(size=(5, 3))
    matrix = trimesh.transformations.quaternion_matrix(pose[3:])
    matrix[:3, 3] = pose[:3]
    world = to_world(points, pose)
    np.testing.assert_allclose(world, trimesh.transform_points(points, matrix), atol=1e-12)
    np.testing.assert_allclose(to_local(world, pose), points, atol=1e-12)


@settings(deadline=None)
@given(poses)
def test_the_camera_sees_everything_from_the_side_that_the_sound_reaches(drawn):
    pose = _pose(drawn)
    points = np.random.default_rng(1).uniform(-0.1, 0.1, (200, 3)) * [1, 1, 0.2]
    points = to_world(np.vstack([points, points + np.array([0, 0, 0.2])]), pose)
    camera = look_along_emission(points, pose, (0.0, 60.0, 800.0, 600.0))
    emission = to_world(np.array([[0.0, 0.0, 1.0]]), pose)[0] - pose[:3]
    assert camera.forward @ emission > 0.5
    seen = camera.project(points)
    assert seen[:, 0].min() > 0 and seen[:, 0].max() < 800
    assert seen[:, 1].min() > 60 and seen[:, 1].max() < 660
    # It fills the window in one direction at least.
    spans = np.ptp(seen, axis=0) / [800, 600]
    assert 0.85 < spans.max() < 0.95


def _picture(path, size):
    image = imread(path)[:, :, :3]
    assert image.shape[:2] == (size[1], size[0])
    assert image.std() > 0.03
    return image


def test_figures_are_drawn(tmp_path, result):
    plot_pressure(result, tmp_path / "pressure.png")
    plot_displacement(result, tmp_path / "displacement.png")
    _picture(tmp_path / "pressure.png", (1410, 660))
    _picture(tmp_path / "displacement.png", (1200, 900))


def test_the_pressure_figure_shows_x_to_the_left(tmp_path, result):
    """A load at +x alone lights the left half of the panel, since the array looks along +z with y up."""
    one_sided = result.copy()
    x = one_sided["skin_position"].values[:, 0]
    one_sided["skin_pressure"] = one_sided["skin_pressure"] * 0 + np.where(x > 0.01, 1.0, 0.0).astype(np.float32)
    plot_pressure(one_sided.drop_vars(["arp", "focus"]), tmp_path / "p.png")
    image = _picture(tmp_path / "p.png", (750, 660))
    panel = image[120:560, 80:600]
    bright = (panel.sum(axis=2) > 2.4) & (panel[:, :, 2] < 0.9)
    columns = np.nonzero(bright)[1]
    dark = np.nonzero(panel.sum(axis=2) < 0.1)[1]
    assert len(columns) > 1000
    assert columns.mean() < dark.mean()


def test_a_displacement_without_even_times_is_drawn_without_spectrum(tmp_path, result):
    gap = result.isel(time=np.r_[0:100, 200:500])
    plot_displacement(gap, tmp_path / "gap.png")
    _picture(tmp_path / "gap.png", (1200, 900))


def test_figures_say_what_is_missing(tmp_path, static, result):
    for draw in (plot_pressure, plot_displacement):
        with pytest.raises(OutputError, match="at least one step"):
            draw(static.drop_vars("skin_pressure"), tmp_path / "x.png")
    with pytest.raises(OutputError, match="lacks surface_pressure"):
        render_scene(static.drop_vars("surface_pressure"), tmp_path / "x.png")
    (tmp_path / "file").touch()
    for draw in (plot_pressure, plot_displacement, render_scene):
        with pytest.raises(OutputError, match="Not a directory; choose"):
            draw(result, tmp_path / "file" / "x.png")


def test_render_shows_the_pressure(tmp_path, result):
    # Without the focus, whose guide lines are drawn over the spot.
    loud = result.drop_vars("focus")
    render_scene(loud, tmp_path / "hot.png", (480, 360))
    quiet = loud.copy()
    quiet["surface_pressure"] = quiet["surface_pressure"] * 0
    render_scene(quiet, tmp_path / "cold.png", (480, 360))
    hot, cold = (_picture(tmp_path / f"{name}.png", (480, 360)) for name in ("hot", "cold"))
    scene = np.s_[50:, :390]
    changed = np.abs(hot[scene] - cold[scene]).max(axis=2) > 0.2
    # The spot is 12 mm wide on a hand of 180 mm: some hundred pixels, not the whole picture.
    assert 50 < changed.sum() < 0.05 * changed.size
    # What is silent has the hue of the colour map's start in both, the spot that of its dark end.
    blue_over_red = hot[scene][changed][:, 2] / np.maximum(hot[scene][changed][:, 0], 1e-3)
    end = np.asarray(COLOURS.colors)[-1]
    assert blue_over_red.max() > 0.5 * end[2] / end[0]
    assert (cold[scene][changed][:, 2] < cold[scene][changed][:, 0]).all()


def test_render_takes_less_than_five_seconds(tmp_path, result):
    render_scene(result, tmp_path / "small.png", (64, 48))
    start = time.process_time()
    render_scene(result, tmp_path / "scene.png")
    assert time.process_time() - start < 5.0


def test_render_does_without_motion_focus_or_steps(tmp_path, static_arrays):
    render_scene(dataset(**static_arrays), tmp_path / "still.png", (240, 180))
    _picture(tmp_path / "still.png", (240, 180))
