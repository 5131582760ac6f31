"""Tables of foci: files, what is refused with line and column, and what lies between the rows."""

import numpy as np
import pytest

from palmfield.config import StimulusConfig
from palmfield.errors import SceneError
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.focus_table_file import focus_table, focus_table_text, read_focus_table, write_focus_table
from palmfield.stimulus.resolved import resolved
from palmfield.stimulus.schedule import frame_rates, frames_at, main_frequencies, path_end_s, substep_moments
from palmfield.transforms import IDENTITY

HEAD = """# palmfield_stimulus: 1
# frame: array
# rate_Hz: 100
# quantity: arp
# units: s, m
# between: held
"""
GOOD = HEAD + "t,x,y,z,intensity\n0,0,0,0.2,1\n0.01,0.01,0,0.2,0.5\n"


def at(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text)
    return path


def random_table(rng, foci=1, rows=40, **more):
    samples = np.append(0, np.cumsum(rng.integers(1, 4, rows - 1)))
    places = rng.uniform(-0.1, 0.2, (rows, foci, 3))
    return focus_table(samples / 7000.0, places, rng.random((rows, foci)), rate_Hz=7000.0, **more)


def playing(table, **keys):
    return resolved(StimulusConfig(path="file", path_file="table.csv", **keys), focus_table=table)


# -- files ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("foci", [1, 3])
@pytest.mark.parametrize("between", ["held", "linear"])
def test_a_table_comes_back_bit_for_bit(tmp_path, foci, between):
    table = random_table(np.random.default_rng(foci), foci, between=between, quantity="amplitude", frame="skin")
    write_focus_table(tmp_path / "a.csv", table)
    back = read_focus_table(tmp_path / "a.csv")
    assert back == table and back.times.tobytes() == table.times.tobytes()
    assert focus_table_text(back) == focus_table_text(table)
    assert focus_table_text(random_table(np.random.default_rng(9), foci)) != focus_table_text(table)


def test_units_order_of_columns_and_remarks(tmp_path):
    text = (
        HEAD.replace("s, m", "ms, mm") + "# taken on a Monday\nz,t,intensity,y,x\n200,0,1,-5,2.5\n\n201,20,0.25,0,0\n"
    )
    table = read_focus_table(at(tmp_path, text))
    assert table.times.tolist() == [0.0, 0.02]
    assert table.positions.tolist() == [[[0.0025, -0.005, 0.2]], [[0.0, 0.0, 0.201]]]
    assert table.intensities.tolist() == [[1.0], [0.25]] and table.length_s == 0.03


BAD = {
    "nan": (GOOD.replace("0.01,0,0.2,0.5", "nan,0,0.2,0.5"), "line 9, column x: nan; give a finite number"),
    "text": (GOOD.replace("0.2,0.5", "far,0.5"), "line 9, column z: 'far' is not a number"),
    "falling": (GOOD + "0.005,0,0,0.2,1\n", "line 10, column t: 0.005 after 0.01; allowed: rising times"),
    "late": (GOOD.replace("\n0,0,0,0.2,1", ""), "line 8, column t: 0.01; the first row must be at 0"),
    "between samples": (GOOD + "0.013,0,0,0.2,1\n", "line 10, column t: 0.013 s is sample 1.3 at rate_Hz 100"),
    "unit": (GOOD.replace("s, m", "s, inch"), "line 5, column 10: units has value 's, inch'; allowed: of t (s"),
    "millimetres": (GOOD.replace("0.01,0.01,0,0.2", "0.01,10,0,200"), "line 9, column z: a focus at 10 0 200 m, which"),
    "frame": (GOOD.replace("array", "room"), "line 2, column 10: frame has value 'room'; allowed: array | skin"),
    "quantity": (GOOD.replace("arp", "force"), "quantity has value 'force'; allowed: duty | amplitude | arp"),
    "rate": (GOOD.replace("100", "fast"), "line 3, column 12: rate_Hz has value 'fast'; allowed: a number above 0"),
    "version": (GOOD.replace("stimulus: 1", "stimulus: 2"), "palmfield_stimulus has value '2'; allowed: 1"),
    "no head": (GOOD.replace("# between: held\n", ""), "line 1: head line '# between: ...' is missing"),
    "stray head": (HEAD + "# units_of_x: m\n" + GOOD, "line 7, column 3: head line 'units_of_x' is unknown"),
    "twice": (HEAD + GOOD, "line 7: head line 'palmfield_stimulus' occurs twice, first in line 1"),
    "column": (GOOD.replace("intensity", "level"), "line 7: column 'level' is unknown; allowed: t, x, y, z"),
    "missing": (GOOD.replace(",z,", ","), "line 7: column 'z' is missing"),
    "short row": (GOOD + "0.02,0,0,0.2\n", "line 10 has 4 values for 5 columns"),
    "loud": (GOOD.replace("0.2,0.5", "0.2,1.5"), "line 9, column intensity: 1.5; allowed: 0 (silent) to 1"),
    "silent": (GOOD.replace("0.2,1", "0.2,0").replace("0.2,0.5", "0.2,0"), "line 8, column intensity: all values"),
    "no row": (HEAD + "t,x,y,z,intensity\n", "there are no rows below line 7"),
    "empty": ("", "the line of column names is missing"),
    "duty of two": (
        HEAD.replace("arp", "duty") + "t,x1,y1,z1,intensity1,x2,y2,z2,intensity2\n0,0,0,0.2,1,0.02,0,0.2,1\n",
        "quantity is 'duty' with 2 simultaneous foci",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_table_is_refused_with_its_place(tmp_path, name):
    text, told = BAD[name]
    with pytest.raises(SceneError) as error:
        read_focus_table(at(tmp_path, text))
    assert told in str(error.value)


def test_the_good_one_that_the_bad_ones_are_made_of_is_taken(tmp_path):
    assert len(read_focus_table(at(tmp_path, GOOD)).times) == 2
    with pytest.raises(SceneError, match="cannot be read"):
        read_focus_table(tmp_path / "none.csv")


# -- over time -----------------------------------------------------------------------------------------------------


def test_held_rows_begin_at_their_sample_and_the_last_lasts_one():
    places = np.array([[[0.0, 0.0, 0.2]], [[0.01, 0.0, 0.2]], [[0.02, 0.0, 0.2]]])
    table = focus_table(np.array([0, 1, 4]) / 3.0, places, np.array([[1.0], [0.25], [0.0]]), rate_Hz=3.0)
    config, points = playing(table, start_s=0.5), FocalPoints(IDENTITY, table=table)
    times = 0.5 + np.array([-0.01, 0.0, 0.33, 1.0 / 3.0, 1.2, 4.0 / 3.0, 5.0 / 3.0 - 1e-6, 5.0 / 3.0])
    asked, factors = frames_at(config, times)
    assert points.along(asked)[:, 0].tolist() == [0.0, 0.0, 0.0, 0.01, 0.01, 0.02, 0.02, 0.02]
    assert factors.tolist() == [0.0, 1.0, 1.0, 0.25, 0.25, 0.0, 0.0, 0.0]
    assert path_end_s(config) == pytest.approx(0.5 + 5.0 / 3.0, abs=1e-12)
    assert frame_rates(config) == pytest.approx([3.0]) and points.at(asked[0]).shape == (3,)


def test_straight_lines_lead_from_row_to_row():
    """Against np.interp, through the last row, and from the first one again where path_end says jump."""
    rng = np.random.default_rng(4)
    table = random_table(rng, between="linear", quantity="amplitude")
    times = np.sort(rng.uniform(0.0, table.length_s, 200))
    wanted = np.array([np.interp(times, table.times, table.positions[:, 0, axis]) for axis in range(3)]).T
    loud = np.interp(times, table.times, table.intensities[:, 0]) ** 2
    for config, later in ((playing(table), 0.0), (playing(table, path_end="jump"), 3.0 * table.length_s)):
        asked, factors = frames_at(config, times + later)
        assert FocalPoints(IDENTITY, table=table).along(asked) == pytest.approx(wanted, abs=1e-9)
        assert factors == pytest.approx(loud, abs=1e-7)
    assert not frame_rates(config) and frames_at(playing(table), np.array([table.length_s + 1e-6]))[1] == 0.0


@pytest.mark.parametrize(
    ("quantity", "factor"), [("arp", 0.3), ("amplitude", 0.09), ("duty", np.sin(0.15 * np.pi) ** 1.5)]
)
def test_the_arp_follows_the_quantity(quantity, factor):
    table = focus_table(np.zeros(1), np.zeros((1, 1, 3)) + 0.1, np.full((1, 1), 0.3), rate_Hz=10.0, quantity=quantity)
    config = StimulusConfig(path="file", path_file="a.csv")
    config = resolved(config, focus_table=table, duty_exponent=1.5)
    assert frames_at(config, np.zeros(1))[1] == pytest.approx([factor], rel=1e-12)


def test_steps_are_cut_where_held_rows_begin():
    """A row that begins inside a step has its share of the step's impulse."""
    table = focus_table(
        np.array([0.0, 1.0 / 300.0]), np.zeros((2, 1, 3)) + 0.1, np.array([[0.0], [1.0]]), rate_Hz=300.0
    )
    config = playing(table)
    moments = substep_moments((config,), 0.0, 0.01, 1)
    mean = moments.first @ frames_at(config, moments.times)[1]
    assert mean == pytest.approx([1.0 / 3.0], abs=1e-9)


def test_frequencies_of_a_level_and_of_foci_that_pass():
    """A level of 60 Hz at one place; a focus of 10.3 mm that passes at 2 m/s, whose Gaussian has 99 % below 133 Hz."""
    times = np.arange(1000) / 1000.0
    still = np.tile(np.array([0.0, 0.0, 0.2]), (1000, 1, 1))
    beats = focus_table(times, still, 0.5 + 0.5 * np.sin(2 * np.pi * 60.0 * times)[:, None], rate_Hz=1000.0)
    assert main_frequencies(playing(beats))[0] == pytest.approx(60.0, abs=0.5)
    passing = still + np.array([1.0, 0.0, 0.0]) * (2.0 * times)[:, None, None]
    table = focus_table(times, passing, np.ones((1000, 1)), rate_Hz=1000.0, between="linear")
    found = main_frequencies(playing(table))
    # |spectrum|^2 of exp(-4 ln 2 (v t / w)^2) is a Gaussian of standard deviation v sqrt(ln 2) / (pi w)
    deviation = 2.0 * np.sqrt(np.log(2.0)) / (np.pi * 0.0103)
    assert found[-1] == pytest.approx(2.576 * deviation, rel=0.1)
    rest = focus_table(times, still, np.ones((1000, 1)), rate_Hz=1000.0)
    assert main_frequencies(playing(rest)) == []


def test_repeats_can_be_left_out_and_mean_the_same():
    table = random_table(np.random.default_rng(1))
    every = np.arange(table.length_samples) / table.rate_Hz
    full = focus_table(every, table.positions_at(every), table.intensities_at(every), rate_Hz=table.rate_Hz)
    assert full.without_repeats() == table and len(full.samples) > len(table.samples)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"focus_m": (0, 0, 0.2)}, "focus_m does not apply to path 'file'"),
        ({"path_rate_Hz": 3.0}, "path_rate_Hz does not apply to path 'file'"),
        ({"path_end": "back"}, "path_end is 'back'; allowed with path 'file': stop, jump"),
        ({"path_file": None}, "path 'file' needs path_file"),
        ({"path": "circle", "path_diameter_m": 0.03, "path_rate_Hz": 5}, "path_file does not apply to path 'circle'"),
    ],
)
def test_keys_that_do_not_go_with_a_table(keys, told):
    with pytest.raises(ValueError, match=told):
        StimulusConfig(**({"path": "file", "path_file": "a.csv"} | keys))
