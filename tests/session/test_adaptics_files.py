"""Patterns of Adaptics out of scenes and into them: what is exported comes back, and a board plays what is imported."""

import json
import math

import numpy as np
import pytest
from adaptics_patterns import frame, jump, pattern, written
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.errors import SceneError
from palmfield.hardware.decode import decode
from palmfield.hardware.play import Target, play_scene
from palmfield.session.stimulus_export import export_stimulus, exported
from palmfield.session.stimulus_import import import_stimulus
from palmfield.stimulus.adaptics import Sampling, read_adaptics
from palmfield.stimulus.focus_table_file import focus_table, write_focus_table

pytestmark = pytest.mark.usefixtures("kept_operators")

NO_AM = dict.fromkeys(("modulation", "am_quantity", "am_frequency_Hz", "am_depth"))
CIRCLE = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 70}


def back(result, path):
    """Export, read and evaluate at the same rate: notes, keyframes, and positions and intensities of both."""
    notes = export_stimulus(result, path)
    table = read_adaptics(path, Sampling(rate_Hz=result.table.rate_Hz))
    every = np.arange(result.table.length_samples) / table.rate_Hz
    assert table.length_s == pytest.approx(result.table.length_s)
    both = [(one.positions_at(every)[:, 0], one.intensities_at(every)[:, 0]) for one in (result.table, table)]
    return notes, json.loads(path.read_text())["keyframes"], both


@pytest.mark.parametrize(
    ("keys", "brush", "most"),
    [
        ({}, "circle", 2),
        (CIRCLE, "circle", 2),
        (CIRCLE | {"frame": "centre", "focus_m": "0 0 0"}, "lissajous", 2),
        ({"path": "line", "path_width_m": 0.02, "path_rate_Hz": 40}, "circle", 16),
        ({"path": "lm", "path_width_m": 0.004, "path_rate_Hz": 30, "path_direction_deg": 30}, "circle", 16),
        ({"path": "square", "path_width_m": 0.02, "path_speed_m_s": 3}, "circle", 26),
    ],
)  # fmt: skip
@pytest.mark.parametrize("am", [True, False])
def test_points_circles_and_corners_are_exact(small_scene, tmp_path, keys, brush, most, am):
    scene = small_scene(stimulus=keys | ({"am_quantity": "amplitude", "am_depth": 1} if am else NO_AM), duration_s=0.15)
    notes, frames, ((places, loud), (places_2, loud_2)) = back(
        exported(scene, rate_Hz=4000.0, quantity="amplitude"), tmp_path / "a.adaptics"
    )
    assert np.abs(places - places_2).max() < 1e-6
    assert len(frames) <= most and notes[0] == f"{len(frames)} keyframes with linear transitions, brush {brush}"
    if am:
        # The AM of Adaptics begins a quarter of a period, here 5 samples, earlier
        assert np.abs(loud[5:] - loud_2[:-5]).max() < 1e-6 and "a quarter of a period earlier" in notes[1]
    else:
        assert np.abs(loud - loud_2).max() < 1e-6 and len(notes) == 1


@pytest.mark.parametrize(
    "keys",
    [
        {"path": "lissajous", "path_width_m": 0.02, "path_height_m": 0.01, "path_rate_Hz": 20},
        CIRCLE | {"start_s": 0.01},
        {"path": "line", "path_width_m": 0.02, "path_rate_Hz": 40, "path_end": "jump"},
        {"am_depth": 0.5},
        {"ramp_s": 0.02},
    ],
)
def test_all_else_is_sampled(small_scene, tmp_path, keys):
    scene = small_scene(stimulus={"am_quantity": "amplitude", "am_depth": 1} | keys, duration_s=0.1)
    notes, frames, ((places, loud), (places_2, loud_2)) = back(
        exported(scene, rate_Hz=2000.0, quantity="amplitude"), tmp_path / "a.adaptics"
    )
    assert np.abs(places - places_2).max() < 1e-6 and notes[0].startswith(f"{len(frames)} keyframes with linear")
    if len(notes) == 1:
        assert np.abs(loud - loud_2).max() < 1e-6
    assert 100 < len(frames) <= 201


@pytest.mark.parametrize("between", ["held", "linear"])
def test_tables_come_back(small_scene, tmp_path, between):
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.006, 0.006, (12, 1, 3)) * [1, 1, 0.5] + [0.0, 0.0, 0.12]
    samples = np.cumsum(rng.integers(1, 5, 12)) - 1
    samples -= samples[0]
    table = focus_table(samples / 1e3, places, rng.uniform(0.2, 1.0, (12, 1)), rate_Hz=1e3, between=between,
                        quantity="amplitude")  # fmt: skip
    write_focus_table(tmp_path / "in.csv", table)
    done = import_stimulus(tmp_path / "in.csv", small_scene())
    notes, _, ((places, loud), (places_2, loud_2)) = back(exported(done.scene), tmp_path / "a.adaptics")
    assert f"{'step' if between == 'held' else 'linear'} transitions" in notes[0]
    assert np.abs(places - places_2).max() < 1e-6 and np.abs(loud - loud_2).max() < 1e-6


def test_what_the_format_cannot_hold(small_scene, tmp_path):
    file = tmp_path / "a.adaptics"
    two = small_scene(stimulus=NO_AM | {"foci_m": "0 0 0 0.02 0 0"})
    with pytest.raises(SceneError, match=r"a.adaptics: foci 2, frame array; allowed in Adaptics: foci 1, frame array"):
        export_stimulus(exported(two), file)
    wide = small_scene(stimulus=NO_AM | {"focus_m": "0.12 0 0.12"})
    with pytest.raises(SceneError, match=r"x is 120 mm at 0 s; allowed in Adaptics: x and y from -100 to 100 mm"):
        export_stimulus(exported(wide), file)
    on_skin = small_scene(stimulus=NO_AM | {"frame": "centre", "focus_m": "0 0 0"})
    with pytest.raises(SceneError, match="foci 1, frame skin"):
        export_stimulus(exported(on_skin, frame="skin"), file)
    assert not file.exists()


def test_a_pattern_plays_on_a_virtual_board(small_scene, tmp_path):
    """To bytes and back: a circle of 4 mm, 100 turns a second, with a jump and a parameter."""
    circle = "circle", {"radius": "size", "am_freq": 0, "stm_freq": 100}
    frames = [
        frame(0, (0, 0, 0), intensity=1, brush=circle),
        frame(10, (20, 0, 0), intensity=0.5, jumps=[jump("size", "gt", 3, 16)]),
        frame(16, (0, 10, 0), intensity=0.5),
        frame(24, kind="stop"),
    ]
    file = written(tmp_path / "in.adaptics", pattern(frames, translate=(0, 0, 120), size=(1, 0, 9)))
    scene, log = small_scene(array={"layout": "autd3"}), tmp_path / "sent.jsonl"
    done = CliRunner().invoke(
        app, ["stimulus", "import", str(file), "--scene", str(scene), "--set-parameter", "size=4", "--rate", "500"]
    )
    assert done.exit_code == 0 and "0.018 s at 500 Hz" in done.output, done.output
    play_scene(scene.with_name("small_in.xml"), "autd3", Target(record=tmp_path / "sent.bin", log=log), 0.022)
    seen = [focus for focus in decode(log).foci if focus.sounding]
    for focus in seen:
        row = int((focus.time_s - seen[0].time_s + 1e-6) * 500.0)
        along, across, level = (4.0 * row, 0.0, 1.0 - 0.1 * row) if row < 5 else (0.0, 10.0, 0.5)
        turn = 2.0 * math.pi * 0.2 * row
        wanted = [along + 4.0 * math.cos(turn), across + 4.0 * math.sin(turn), 120.0]
        assert 1e3 * np.array(focus.focus) == pytest.approx(wanted, abs=1.0) and focus.level == pytest.approx(
            level, abs=0.005
        )
    assert {int((focus.time_s - seen[0].time_s + 1e-6) * 500.0) for focus in seen} == set(range(9))


def test_options_of_patterns_are_refused_for_others(small_scene, tmp_path):
    scene = small_scene()
    export_stimulus(exported(scene), tmp_path / "a.csv")
    lines = [
        (["import", "a.csv", "--rate", "1000"], "--rate, --duration and --set-parameter apply only to .adaptics"),
        (["import", "a.adaptics", "--set-parameter", "size"], "--set-parameter has value size; allowed: NAME=NUMBER"),
        (["import", "a.adaptics"], "a.adaptics: cannot be read"),
    ]
    for (command, file, *more), told in lines:
        done = CliRunner().invoke(app, ["stimulus", command, str(tmp_path / file), "--scene", str(scene), *more])
        assert told in str(done.exception), done.output
    out = CliRunner().invoke(app, ["stimulus", "export", str(scene), str(tmp_path / "b.adaptics"), "--rate", "4000"])
    assert out.exit_code == 0 and "intensities of amplitude" in out.output and "keyframes with linear" in out.output
