"""Pictures of a run: what is in them, against what the run was made of."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

from palmfield.acoustics import layout
from palmfield.acoustics.focus import focus as focus_on
from palmfield.acoustics.reference import pressure64
from palmfield.config.array import ArrayConfig
from palmfield.config.stimulus import StimulusConfig
from palmfield.errors import OutputError
from palmfield.outputs.frames import drive_frames, loudest
from palmfield.outputs.pictures.draw import draw_pictures
from palmfield.outputs.pictures.kinds import KINDS, Kind
from palmfield.outputs.pictures.options import Options, parse_options
from palmfield.outputs.pictures.sheet import draw_sheet
from palmfield.outputs.schema import instances
from palmfield.outputs.style import save
from palmfield.types import Air

SINE_Hz = 200.0
"""Of the waves of the synthetic run (tests/outputs/conftest.py)."""
SPEED_m_s = 5.0
NEW = ("transducer_direction", "transducer_p0", "transducer_phase", "piston_radius", "off_axis_angle", "off_axis_level")
"""What a result tells of transducers since it tells all."""


def colour_values(figure, axes=0):
    """What a map or a mesh of a figure shows, flat."""
    return np.asarray(figure.axes[axes].collections[0].get_array()).ravel()


def test_a_map_of_motion_shows_the_normal_component_at_the_time(result):
    skin = instances(result, "skin")["palm"]
    index = 7
    figure = KINDS["motion"].draw(result, Options(time_s=float(skin["time"].values[index]), skin="palm"))
    normal = np.einsum("vi,vi->v", skin["displacement"].values[index], skin["rest_normal"].values)
    np.testing.assert_allclose(colour_values(figure), 1e6 * normal, rtol=1e-5, atol=1e-6)
    low, high = figure.axes[0].collections[0].get_clim()
    assert low == -high == pytest.approx(-1e6 * np.abs(normal).max(), rel=1e-5)


def test_a_map_of_the_rms_is_the_root_of_the_mean_square(result):
    skin = instances(result, "skin")["palm"]
    figure = KINDS["rms"].draw(result, Options(skin="palm", quantity="velocity"))
    normal = np.einsum("tvi,vi->tv", skin["velocity"].values.astype(float), skin["rest_normal"].values)
    np.testing.assert_allclose(colour_values(figure), 1e6 * np.sqrt((normal**2).mean(axis=0)), rtol=1e-4)


def test_the_course_is_that_of_the_vertex_nearest_to_the_place(result):
    skin = instances(result, "skin")["palm"]
    place = (0.01, 0.005, 0.15)
    figure = KINDS["course"].draw(result, Options(places=(place,), skin="palm"))
    rest = skin["rest_position"].values + np.array([0.0, 0.0, 0.15])
    vertex = int(np.linalg.norm(rest - place, axis=1).argmin())
    normal = skin["displacement"].values[:, vertex] @ skin["rest_normal"].values[vertex]
    [line] = figure.axes[0].lines
    np.testing.assert_allclose(line.get_ydata(), 1e6 * normal, rtol=1e-5, atol=1e-6)


def test_the_spectrum_has_its_line_where_the_skin_was_driven(result):
    figure = KINDS["spectrum"].draw(result, Options(skin="palm"))
    at, size = figure.axes[0].lines[0].get_data()
    assert at[np.argmax(size)] == pytest.approx(SINE_Hz, abs=at[0])


def test_the_spectrogram_of_a_sine_is_one_line_from_its_first_window_to_its_last(result):
    mesh = KINDS["spectrogram"].draw(result, Options(skin="palm")).axes[0].collections[0]
    level, corners = np.asarray(mesh.get_array()), np.asarray(mesh.get_coordinates())
    frequencies = 0.5 * (corners[1:, 0, 1] + corners[:-1, 0, 1])
    assert level.shape[1] > 10
    assert (level[np.abs(frequencies - SINE_Hz) < 30.0].max(axis=0) > -1.0).all()
    assert level[np.abs(frequencies - SINE_Hz) > 150.0].max() < -40.0


def test_wavefronts_run_at_the_speed_of_the_waves(result):
    figure = KINDS["wavefronts"].draw(result, Options(skin="palm", quantity="velocity"))
    mesh = figure.axes[0].collections[0]
    values = mesh.get_array().reshape(mesh.get_coordinates().shape[0] - 1, -1)
    corners = mesh.get_coordinates()
    along = 0.5e-3 * (corners[1:, 0, 1] + corners[:-1, 0, 1])
    times = 0.5e-3 * (corners[0, 1:, 0] + corners[0, :-1, 0])
    spectrum = (values * np.exp(2j * np.pi * SINE_Hz * times)).sum(axis=1)
    side = (along > 0.003) & (along < 0.025)
    phase = np.unwrap(np.angle(spectrum[side]))
    slope = np.polyfit(along[side], phase, 1)[0]
    assert 2.0 * np.pi * SINE_Hz / abs(slope) == pytest.approx(SPEED_m_s, rel=0.05)


@pytest.fixture
def with_keys(result):
    """The run with the keys of an array and of a stimulus, as `palmfield run` writes them."""
    tree = result.copy()
    tree["array/below"].attrs["config"] = ArrayConfig(layout="uhev1").model_dump_json()
    keys = {"modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": SINE_Hz, "am_depth": 1.0}
    for name in instances(tree, "stimulus"):
        tree[f"stimulus/{name}"].attrs["config"] = StimulusConfig(**keys).model_dump_json()
    return tree


def test_levels_are_told_for_what_repeats_and_refused_else(with_keys, result):
    figure = KINDS["levels"].draw(with_keys, Options(skin="palm", observer="bolanowski_1988"))
    assert colour_values(figure).max() > 0.0
    still = result.copy()
    for name in instances(still, "stimulus"):
        still[f"stimulus/{name}"].attrs["config"] = StimulusConfig().model_dump_json()
    with pytest.raises(OutputError, match="does not repeat"):
        KINDS["levels"].draw(still, Options(skin="palm"))
    with pytest.raises(OutputError, match=r"no map of observer morioka_griffin_2006: it applies to 20 cm2 or more"):
        KINDS["levels"].draw(with_keys, Options(skin="palm", observer="morioka_griffin_2006"))
    with pytest.raises(OutputError, match=r"--observer has value 'bolanowski'.*bolanowski_1988"):
        KINDS["levels"].draw(with_keys, Options(observer="bolanowski"))


def test_all_kinds_draw_what_the_run_holds_and_say_what_it_does_not(result, tmp_path):
    files, missing = draw_pictures(result, tmp_path)
    assert set(files) | set(missing) == set(KINDS)
    assert {"pressure", "motion", "rms", "course", "spectrum", "wavefronts"} <= set(files)
    for path in files.values():
        assert imread(path).shape[0] > 600
    assert all(missing.values())


def test_a_sheet_has_a_small_picture_of_each_kind_and_says_what_is_missing(result, tmp_path):
    missing = draw_sheet(result, tmp_path / "plots" / "kinds.png")
    assert "field" in missing and "motion" not in missing
    sheet = imread(tmp_path / "plots" / "kinds.png")
    assert sheet.shape[1] > 1000 and np.ptp(sheet[..., :3]) > 0.9
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        draw_sheet(result, tmp_path / "file" / "kinds.png")


@pytest.mark.parametrize("suffix", ["svg", "pdf"])
def test_other_formats_keep_their_text(result, tmp_path, suffix):
    files, _ = draw_pictures(result, tmp_path, ["course"], suffix=suffix)
    data = files["course"].read_bytes()
    assert data.startswith(b"%PDF") if suffix == "pdf" else b"Motion of the skin" in data


def test_bad_questions_are_refused_with_what_is_allowed(result, tmp_path):
    for options, words in (
        (("x", None), r"--place has value 'x'"),
        ((None, "2,1"), r"--limits has value '2,1'"),
    ):
        with pytest.raises(OutputError, match=words):
            parse_options(None, [options[0]] if options[0] else [], options[1], None, "displacement", None)
    with pytest.raises(OutputError, match=r"displacment.*displacement"):
        parse_options(None, [], None, None, "displacment", None)
    with pytest.raises(OutputError, match=r"--time has value 9000 ms"):
        KINDS["motion"].draw(result, Options(time_s=9.0))
    with pytest.raises(OutputError, match=r"--place has value 0, 0, 300 mm, 1[0-9]+ mm from skin 'palm'"):
        KINDS["course"].draw(result, Options(places=((0.0, 0.0, 0.3),), skin="palm"))
    with pytest.raises(OutputError, match=r"--skin has value 'pa'"):
        KINDS["rms"].draw(result, Options(skin="pa"))
    with pytest.raises(OutputError, match=r"picture 'motions'.*motion"):
        draw_pictures(result, tmp_path, ["motions"])
    with pytest.raises(OutputError, match="'gif' is not a picture format"):
        save(KINDS["rms"].draw(result, Options()), tmp_path / "a.gif")
    assert loudest(instances(result, "skin")["palm"]).arp_Pa > 0.0


def made_known(tree, name, array):
    """A result whose array has these transducers, as many as it had."""
    changed = (
        tree[f"array/{name}"]
        .to_dataset()
        .assign(
            transducer_position=(("transducer", "xyz"), array.positions),
            transducer_direction=(("transducer", "xyz"), array.normals),
            transducer_p0=(
                "transducer",
                array.p0_Pa_m * (np.ones(len(array)) if array.gain is None else abs(array.gain)),
            ),
            transducer_phase=("transducer", np.zeros(len(array)) if array.gain is None else np.angle(array.gain)),
            piston_radius=array.piston_radius_m,
        )
    )
    if array.directivity_table is not None:
        angles, levels = array.directivity_table.T
        changed = changed.assign(off_axis_angle=("off_axis", angles), off_axis_level=("off_axis", levels))
    tree[f"array/{name}"] = xr.DataTree(changed)


def focused(tree, own, focus):
    """The same with array `below` alone sounding, at a focus."""
    drive = focus_on(own, Air(), focus)
    shape = tree["array/below"]["drive_amplitude"].shape
    tree["array/below"]["drive_amplitude"].values[:] = np.broadcast_to(np.abs(drive), shape)
    tree["array/below"]["drive_phase"].values[:] = np.broadcast_to(np.angle(drive), shape)
    tree["array/beside"]["drive_amplitude"].values[:] = 0.0
    for name in instances(tree, "stimulus"):
        tree[f"stimulus/{name}"]["foci"].values[:] = focus
        tree[f"stimulus/{name}"]["sounding"].values[:] = True
    return drive


def peak_of(figure):
    """Where the slice is largest [m], and how much it is [Pa]."""
    mesh = figure.axes[0].collections[0]
    corners = mesh.get_coordinates()
    size = mesh.get_array().reshape(corners.shape[0] - 1, -1)
    row, column = np.unravel_index(size.argmax(), size.shape)
    x = 0.5e-3 * (corners[row, column, 0] + corners[row, column + 1, 0])
    z = 0.5e-3 * (corners[row, column, 1] + corners[row + 1, column, 1])
    return x, z, size.max()


def calibrated_array():
    """A board whose transducers are out of place, tilted, unlike, dead, the other way round, and no pistons."""
    rng, plain = np.random.default_rng(5), layout("uhev1")
    gain = rng.uniform(0.7, 1.3, len(plain)) * np.exp(1j * rng.normal(0.0, 0.3, len(plain)))
    gain[:5], gain[5:9] = 0.0, -gain[5:9]
    tilted = plain.normals + rng.normal(0.0, 0.05, plain.normals.shape)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    moved = plain.positions + rng.normal(0.0, 3e-4, plain.positions.shape)
    table = np.array([[0.0, 1.0], [45.0, 0.7], [90.0, 0.5]])
    return replace(plain, positions=moved, normals=tilted, p0_Pa_m=0.9, gain=gain, directivity_table=table)


@pytest.mark.parametrize("board", ["plain", "calibrated", "earlier"])
def test_a_slice_has_its_peak_near_the_focus_and_the_pressure_of_the_field(with_keys, board):
    """earlier: a result that doesn't tell its transducers, whose keys name a layout"""
    tree = with_keys.copy(deep=True)
    focus = np.array([0.01, 0.0, 0.15])
    own = calibrated_array() if board == "calibrated" else layout("uhev1")
    if board == "earlier":
        known = tree["array/below"].to_dataset()
        tree["array/below"] = xr.DataTree(known.drop_vars([name for name in known if name in NEW]))
    else:
        made_known(tree, "below", own)
    drive = focused(tree, own, focus)
    x, z, size = peak_of(KINDS["field"].draw(tree, Options()))
    assert abs(x - focus[0]) < 2e-3
    # The maximum lies nearer to the array than the focus does
    assert focus[2] - 0.015 < z <= focus[2] + 1e-3
    there = pressure64(np.array([[x, 0.0, z]]), own, drive, Air())[0]
    assert size == pytest.approx(abs(there[0]), rel=1e-3)


def test_a_slice_goes_through_a_focus_of_its_array_and_not_between_those_of_two(with_keys):
    tree = with_keys.copy(deep=True)
    own, focus = layout("uhev1"), np.array([0.01, 0.0, 0.15])
    made_known(tree, "below", own)
    focused(tree, own, focus)
    tree["stimulus/pair"].attrs["arrays"] = ["beside"]
    tree["stimulus/pair"]["foci"].values[:] += (0.2, 0.1, 0.0)
    x, z, _ = peak_of(KINDS["field"].draw(tree, Options()))
    assert abs(x - focus[0]) < 2e-3 and focus[2] - 0.015 < z <= focus[2] + 1e-3


def test_a_slice_of_an_earlier_calibrated_result_is_refused(with_keys):
    tree = with_keys.copy(deep=True)
    known = tree["array/below"].to_dataset()
    keys = json.loads(known.attrs["config"]) | {"calibration": "board.toml"}
    tree["array/below"] = xr.DataTree(
        known.drop_vars([name for name in known if name in NEW]).assign_attrs(config=json.dumps(keys))
    )
    focused(tree, layout("uhev1"), np.array([0.01, 0.0, 0.15]))
    with pytest.raises(OutputError, match=r"'below' has calibration 'board.toml'.*run the scene again"):
        KINDS["field"].draw(tree, Options())


def test_what_is_asked_is_heeded_or_refused(result, tmp_path):
    for kinds, options, words in (
        (["rms"], Options(time_s=0.01), r"--time has no effect on rms; allowed with: pressure, field, drives, motion"),
        (["pressure"], Options(limits=(0.0, 1.0)), r"--limits has no effect on pressure"),
        (["drives"], Options(skin="palm"), r"--skin has no effect on drives"),
        (["motion", "field"], Options(limits=(0.0, 1.0)), r"--limits would apply to several units"),
        ([], Options(limits=(0.0, 1.0)), r"--limits would apply to several units"),
    ):
        with pytest.raises(OutputError, match=words):
            draw_pictures(result, tmp_path, kinds, options)
    assert Kind(KINDS["rms"].draw, "one of a user's own").heeds >= {"time_s", "places", "limits"}
    for kind, options, words in (
        ("pressure", Options(time_s=9.0), "--time has value 9000 ms"),
        ("pressure", Options(skin="pa"), "--skin has value 'pa'"),
        ("drives", Options(time_s=9.0), "--time has value 9000 ms"),
        ("spectrum", Options(limits=(-1.0, 1.0)), "above 0"),
        ("motion", Options(places=((0.5, 0.0, 0.15),), skin="palm"), "--place has value 500, 0, 150 mm"),
        ("wavefronts", Options(places=((0.01, 0.0, 0.15),) * 2, skin="palm"), "same nearest vertex"),
    ):
        with pytest.raises(OutputError, match=words):
            KINDS[kind].draw(result, options)


def test_the_pressure_at_a_time_is_the_record_then(result):
    skin = instances(result, "skin")["tip"]
    index = 7
    figure = KINDS["pressure"].draw(result, Options(time_s=float(skin["time"].values[index]), skin="tip"))
    np.testing.assert_allclose(colour_values(figure), skin["pressure"].values[index], rtol=1e-6)


def test_a_map_marks_places_with_what_is_there(result):
    skin = instances(result, "skin")["palm"]
    vertex, index = 40, 7
    place = skin["rest_position"].values[vertex] + np.array([0.0, 0.0, 0.15])
    options = Options(time_s=float(skin["time"].values[index]), places=(tuple(place),), skin="palm")
    (words,) = KINDS["motion"].draw(result, options).axes[0].get_legend().get_texts()
    normal = 1e6 * skin["displacement"].values[index, vertex] @ skin["rest_normal"].values[vertex]
    assert words.get_text().endswith(f" mm: {normal:.3g} µm")


def test_white_stays_zero_with_limits_of_ones_own(result):
    drawn = KINDS["motion"].draw(result, Options(limits=(-4.0, 1.0), skin="palm")).axes[0].collections[0]
    blue, white, red = (drawn.cmap(drawn.norm(value))[:3] for value in (-3.9, 0.0, 0.9))
    assert min(white) > 0.95
    # As far from white as the value from 0
    assert blue[0] < 0.2 and red[2] > 0.6


def test_a_drive_holds_until_the_next_begins():
    starts = np.array([0.0, 0.001, 0.002])
    assert drive_frames(starts, np.array([0.0, 0.0009, 0.001, 0.0019, 0.5])).tolist() == [0, 0, 1, 1, 2]
