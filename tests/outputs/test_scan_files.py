"""Files of scans come back as they went out, and what is wrong in them is named."""

import numpy as np
import pytest

from palmfield.errors import MeasurementError, OutputError
from palmfield.instruments.scan import Scan
from palmfield.outputs.scan_files import read_scan, write_scan

GOOD = """# quantity: velocity
# unit: mm/s
time_s,P1,P2
x_m,0,0.005
y_m,0,0
z_m,0,0
""" + "".join(f"{0.001 * n:g},{n},{-n}\n" for n in range(16))


def scan(quantity="velocity", sights=True, count=5):
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.05, 0.05, (count, 3))
    towards = np.array([0.0, 0.3, 0.5]) - points
    return Scan(quantity, np.arange(64) / 12_800, points, rng.normal(0, 1e-4, (64, count)), towards if sights else None)


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
@pytest.mark.parametrize("sights", [True, False])
def test_csv_comes_back_to_the_last_digit(tmp_path, quantity, sights):
    one = scan(quantity, sights)
    write_scan(tmp_path / "scan.csv", one)
    back = read_scan(tmp_path / "scan.csv")
    assert back.quantity == quantity and back.name == "scan.csv"
    for name in ("times_s", "points", "values"):
        assert np.array_equal(getattr(back, name), getattr(one, name))
    assert (back.sights is None) != sights and (not sights or back.sights == pytest.approx(one.sights, abs=1e-15))


def test_units_become_si(tmp_path):
    (tmp_path / "a.csv").write_text(GOOD)
    found = read_scan(tmp_path / "a.csv")
    assert found.values[3] == pytest.approx([3e-3, -3e-3]) and found.rate_Hz == pytest.approx(1e3)
    assert found.points[1] == pytest.approx([0.005, 0, 0])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("# quantity: velocity\n", "", "has no line '# quantity"),
        ("quantity: velocity", "quantity: velocty", r"quantity is 'velocty' \(did you mean 'velocity'\?\); allowed"),
        ("unit: mm/s", "unit: inch/s", "unit of velocity is 'inch/s'; allowed: m/s, mm/s, um/s"),
        ("time_s,P1,P2", "t,P1,P2", "begins with 't'"),
        ("y_m,0,0\n", "", "has no line 'y_m"),
        ("z_m,0,0\n", "z_m,0,0\nsight_x,1,1\n", "has no line 'sight_y"),
        ("0.003,3,-3", "0.003,3", "line 10 has 2 values for 3 columns"),
        ("0.003,3,-3", "0.003,x,-3", "line 10, column P1: 'x' is not a number"),
        ("0.003,3,-3", "0.003,nan,-3", "line 10, column P1: nan; give a finite number"),
        ("0.003,3,-3", "0.001,3,-3", "times must rise"),
        ("0.003,3,-3", "0.0033,3,-3", "not evenly spaced"),
        ("0.015,15,-15\n", "", "at least 16"),
    ],
)
def test_what_is_wrong_in_a_csv_is_named(tmp_path, old, new, words):
    assert old in GOOD
    (tmp_path / "a.csv").write_text(GOOD.replace(old, new))
    with pytest.raises(MeasurementError, match=words):
        read_scan(tmp_path / "a.csv")


def test_files_of_other_kinds_and_places_are_refused(tmp_path):
    with pytest.raises(MeasurementError, match=r"the file's kind is '.xlsx'; allowed: .csv"):
        read_scan(tmp_path / "a.xlsx")
    with pytest.raises(MeasurementError, match="cannot be read"):
        read_scan(tmp_path / "none.csv")
    with pytest.raises(OutputError, match=r"kind is '.xlsx'"):
        write_scan(tmp_path / "a.xlsx", scan())
    with pytest.raises(OutputError, match="cannot be written"):
        write_scan(tmp_path / "no" / "a.csv", scan())


def test_a_scan_is_checked_when_it_is_made():
    one = scan()
    with pytest.raises(MeasurementError, match="quantity is 'force'"):
        Scan("force", one.times_s, one.points, one.values)
    with pytest.raises(MeasurementError, match="points"):
        Scan("velocity", one.times_s, one.points[:2], one.values)
    with pytest.raises(MeasurementError, match="give directions"):
        Scan("velocity", one.times_s, one.points, one.values, 0.0 * one.points)
    few = one.at_points(np.array([0, 2]))
    assert few.values.shape == (64, 2) and few.sights.shape == (2, 3)
