import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.image import imread

from palmfield.errors import OutputError
from palmfield.hardware.decode import draw_foci
from palmfield.outputs.camera import look_along_emission
from palmfield.outputs.frames import arrays_of, bodies, loudest, pose_at, posed, to_local, to_world
from palmfield.outputs.plots import plot_displacement, plot_pressure, pressure_picture
from palmfield.outputs.render import COLOURS, render_scene
from palmfield.outputs.schema import instances, tree

poses = st.tuples(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.integers(0, 2**32 - 1))


def _pose(drawn):
    position, seed = drawn
    quaternion = np.random.default_rng(seed).normal(size=4)
    return np.concatenate([position, quaternion / np.linalg.norm(quaternion)])


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


def test_bones_carry_the_skin_and_the_pose_of_the_nearest_step_counts(result):
    body, skin = instances(result, "body")["tip"], instances(result, "skin")["tip"]
    rest = skin["rest_position"].values
    # A quarter of each point goes with the second bone, which rises by 2 mm in 0.1 s.
    np.testing.assert_allclose(posed(skin, body, 0.05) - rest, np.tile([0, 0, 0.25e-3], (len(rest), 1)), atol=1e-7)
    np.testing.assert_allclose(posed(skin, body, 0.05004), posed(skin, body, 0.05), atol=1e-12)
    np.testing.assert_allclose(pose_at(body, 0.05)[:3], [0.08, 0.0, 0.14])
    assert pose_at(None, 0.0).tolist() == [0, 0, 0, 1, 0, 0, 0]


def test_the_loudest_instant_of_a_run_cut_off_early_is_found_in_its_arp(whole, result):
    skin = instances(result, "skin")["palm"]
    cut = skin.drop_vars(["loudest_arp", "loudest_pressure", "loudest_time"])
    arp = whole["/skin/palm"]["arp"]
    assert loudest(skin).time_s == 0.0026 and loudest(skin).place == 13
    assert (loudest(cut).place, loudest(cut).arp_Pa) == (arp.max(axis=1).argmax(), arp.max())


def test_skins_of_one_body_and_arrays_of_one_stimulus(whole, result):
    assert bodies(result) == {"hand": ["palm"], "finger": ["tip"]}
    assert bodies(tree(whole)) == {"palm": ["palm"], "tip": ["tip"]}
    assert bodies(tree(whole, {f"/body/{n}": {"body": "hand"} for n in ("palm", "tip")})) == {"hand": ["palm", "tip"]}
    stimuli = instances(result, "stimulus")
    assert arrays_of(stimuli["pulse"], ["below", "beside"]) == ["below"]
    assert arrays_of(stimuli["pair"], ["below", "beside"]) == ["below", "beside"]
    assert arrays_of(stimuli["pair"].assign_attrs(arrays='["beside"]'), ["below", "beside"]) == ["beside"]


def _picture(path, size):
    image = imread(path)[:, :, :3]
    assert image.shape[:2] == (size[1], size[0])
    assert image.std() > 0.03
    return image


def test_figures_of_one_skin(tmp_path, one_skin):
    plot_pressure(one_skin, tmp_path / "pressure.png")
    plot_displacement(one_skin, tmp_path / "displacement.png")
    _picture(tmp_path / "pressure.png", (1410, 660))
    _picture(tmp_path / "displacement.png", (1200, 900))


def test_figures_have_a_panel_a_skin(tmp_path, result):
    plot_pressure(result, tmp_path / "pressure.png")
    plot_displacement(result, tmp_path / "displacement.png")
    _picture(tmp_path / "pressure.png", (1410, 1320))
    _picture(tmp_path / "displacement.png", (2400, 900))


def _only_load_at(whole, keep, x_above):
    """One skin whose pressure is 1 where x is large."""
    one = keep(whole, ("palm",), ("below",), ())
    skin = {k: v for k, v in one["/skin/palm"].items() if k not in ("arp", "loudest_arp")}
    x = skin["rest_position"][:, 0]
    return tree({**one, "/skin/palm": skin | {"loudest_pressure": np.where(x > x_above, 1.0, 0.0).astype(np.float32)}})


def test_the_pressure_figure_shows_x_to_the_right(tmp_path, whole, keep):
    """A load at +x alone lights the right half of the panel, as for one who looks onto the array with y up."""
    plot_pressure(_only_load_at(whole, keep, 0.01), tmp_path / "p.png")
    image = _picture(tmp_path / "p.png", (750, 660))
    panel = image[120:560, 80:600]
    bright = (panel.sum(axis=2) > 2.4) & (panel[:, :, 2] < 0.9)
    columns = np.nonzero(bright)[1]
    dark = np.nonzero(panel.sum(axis=2) < 0.1)[1]
    assert len(columns) > 1000
    assert columns.mean() > dark.mean()


def test_side_lobes_are_told_from_silence(whole, keep):
    """A fifth of the largest pressure has a colour nearer to the middle of the map than to its end."""
    figure = pressure_picture(_only_load_at(whole, keep, 0.01))
    norm = figure.axes[0].collections[0].norm
    assert 0.4 < norm(0.22) < 0.6 and norm(0.0) == 0.0 and norm(1.0) == 1.0


def test_a_displacement_without_even_times_is_drawn_without_spectrum(tmp_path, one_skin):
    gap = one_skin.isel(time=np.r_[0:100, 200:500])
    plot_displacement(gap, tmp_path / "gap.png")
    _picture(tmp_path / "gap.png", (1200, 900))


def test_figures_say_what_is_missing(tmp_path, result, static_arrays):
    bare = {
        path: {k: v for k, v in variables.items() if not k.startswith("loudest")}
        for path, variables in static_arrays.items()
    }
    for draw in (plot_pressure, plot_displacement):
        with pytest.raises(OutputError, match="at least one step"):
            draw(tree(bare), tmp_path / "x.png")
    with pytest.raises(OutputError, match="no surface with loudest_pressure"):
        render_scene(tree(bare), tmp_path / "x.png")
    without = {path: v for path, v in static_arrays.items() if not path.startswith("/array")}
    for draw in (plot_pressure, render_scene):
        with pytest.raises(OutputError, match="no array"):
            draw(tree(without), tmp_path / "x.png")
    (tmp_path / "file").touch()
    for draw in (plot_pressure, plot_displacement, render_scene):
        with pytest.raises(OutputError, match="Not a directory; choose"):
            draw(result, tmp_path / "file" / "x.png")


def _silent(arrays, names):
    return {
        path: v | {"loudest_pressure": 0 * v["loudest_pressure"]} if path in names else v for path, v in arrays.items()
    }


SCENE = np.s_[50:, :390]


@pytest.mark.usefixtures("drawn_as_for_users")
def test_render_shows_the_pressure(tmp_path, whole, keep):
    # Without the focus, whose guide lines are drawn over the spot.
    loud = keep(whole, ("palm",), ("below",), ())
    render_scene(tree(loud), tmp_path / "hot.png", (480, 360))
    render_scene(tree(_silent(loud, ["/surface/palm"])), tmp_path / "cold.png", (480, 360))
    hot, cold = (_picture(tmp_path / f"{name}.png", (480, 360)) for name in ("hot", "cold"))
    changed = np.abs(hot[SCENE] - cold[SCENE]).max(axis=2) > 0.2
    # The spot is 12 mm wide on a hand of 180 mm: some hundred pixels, not the whole picture.
    assert 50 < changed.sum() < 0.05 * changed.size
    # What is silent has the hue of the colour map's start in both, the spot that of its dark end.
    blue_over_red = hot[SCENE][changed][:, 2] / np.maximum(hot[SCENE][changed][:, 0], 1e-3)
    end = np.asarray(COLOURS.colors)[-1]
    assert blue_over_red.max() > 0.5 * end[2] / end[0]
    assert (cold[SCENE][changed][:, 2] < cold[SCENE][changed][:, 0]).all()


def test_render_shows_every_body(tmp_path, whole, keep):
    """Each body's sound darkens another place of the picture."""
    everything = keep(whole, ("palm", "tip"), ("below", "beside"), ())
    spots = []
    for quiet in ([], ["/surface/palm"], ["/surface/tip"]):
        render_scene(tree(_silent(everything, quiet)), tmp_path / "x.png", (480, 360))
        spots.append(_picture(tmp_path / "x.png", (480, 360))[SCENE])
    places = [np.argwhere(np.abs(other - spots[0]).max(axis=2) > 0.2) for other in spots[1:]]
    assert min(len(place) for place in places) > 30
    assert np.linalg.norm(places[0].mean(axis=0) - places[1].mean(axis=0)) > 40


def test_skins_on_one_body_are_drawn_on_one_surface(tmp_path, whole, keep):
    """The second skin's own loudest instant shows beside the first's, and the body is drawn once."""
    one = keep(whole, ("palm",), ("below",), ())
    other = {path.replace("palm", "second"): v for path, v in one.items() if path.endswith("palm")}
    moved = np.roll(other["/surface/second"]["loudest_pressure"], 100)
    other["/surface/second"] = other["/surface/second"] | {"loudest_pressure": moved}
    pictures = []
    for arrays in (one, one | other):
        attributes = {path: {"body": "hand"} for path in arrays if path.startswith("/body")}
        render_scene(tree(arrays, attributes), tmp_path / "x.png", (480, 360))
        pictures.append(_picture(tmp_path / "x.png", (480, 360))[SCENE])
    darker = (pictures[0] - pictures[1]).max(axis=2)
    assert darker.max() > 0.2
    # Nothing got lighter, as where two surfaces lie in each other.
    assert (pictures[1] - pictures[0]).max() < 0.1


def test_obstacles_are_drawn(tmp_path, whole, keep):
    one = keep(whole, ("palm",), ("below",), ())
    ball = trimesh.creation.icosphere(radius=0.02)
    ball.apply_translation([0.12, 0.0, 0.1])
    obstacle = {"obstacle_position": ball.vertices, "obstacle_face": ball.faces.astype(np.int32)}
    render_scene(tree(one | {"/surface/palm": one["/surface/palm"] | obstacle}), tmp_path / "x.png", (480, 360))
    image = _picture(tmp_path / "x.png", (480, 360))[SCENE]
    bluish = (image[..., 2] - image[..., 0] > 0.08) & (image[..., 2] > 0.3)
    assert bluish.sum() > 200


@pytest.mark.usefixtures("drawn_as_for_users")
def test_render_takes_a_few_seconds(tmp_path, result, yardsticks):
    render_scene(result, tmp_path / "small.png", (64, 48))
    assert yardsticks(lambda: render_scene(result, tmp_path / "scene.png")) < 1000.0


def test_render_does_without_motion_focus_or_steps(tmp_path, still):
    render_scene(still, tmp_path / "still.png", (240, 180))
    _picture(tmp_path / "still.png", (240, 180))


def test_pictures_of_a_silent_run(tmp_path, whole):
    quiet = {
        path: {k: 0 * v if k in ("loudest_arp", "loudest_pressure", "arp", "displacement") else v
               for k, v in variables.items()}
        for path, variables in whole.items()
    }  # fmt: skip
    for stimulus in ("pulse", "pair"):
        quiet[f"/stimulus/{stimulus}"] = quiet[f"/stimulus/{stimulus}"] | {"sounding": np.zeros(500, bool)}
    for draw in (plot_pressure, plot_displacement, render_scene):
        draw(tree(quiet), tmp_path / "x.png")


def test_places_of_what_rests_have_axes_of_one_scale(tmp_path, recwarn):
    """A focus at rest has no extent, and one that is silent no place."""
    for foci in (np.tile([0.0, 0.0, 0.15], (2, 1)), np.array([[0.0, 0.0, 0.15]]), np.full((2, 3), np.nan)):
        draw_foci(range(len(foci)), foci, tmp_path / "foci.png")
        assert imread(tmp_path / "foci.png").shape[0] > 100
    assert not recwarn.list
