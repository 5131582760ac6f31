"""Files of scans come back as they went out, and what is wrong in them is named."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

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
        ("x_m,0,0.005", "x_mm,0,5", r"line 4 begins with 'x_mm' \(did you mean 'x_m'\?\); allowed: a time, or x_m"),
        ("y_m,0,0\n", "y_m,0,0\ny_m,0,1\n", "line 6 repeats 'y_m'"),
        ("x_m,0,0.005", "x_m,0,0", r"points 0 and 1 have the same position, \(0, 0, 0\) mm"),
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
    with pytest.raises(MeasurementError, match=r"the kind of the file is '.xlsx'; allowed: .csv"):
        read_scan(tmp_path / "a.xlsx")
    with pytest.raises(MeasurementError, match="cannot be read"):
        read_scan(tmp_path / "none.csv")
    with pytest.raises(OutputError, match=r"kind of the file is '.xlsx'"):
        write_scan(tmp_path / "a.xlsx", scan())
    with pytest.raises(OutputError, match="cannot write"):
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


# -- UFF -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("sights", [True, False])
def test_uff_comes_back(tmp_path, binary, sights):
    pyuff = pytest.importorskip("pyuff")
    from palmfield.outputs.scan_files.uff import write_uff

    one = scan("displacement", sights, count=300)
    write_uff(tmp_path / "a.uff", one, binary=binary)
    back = read_scan(tmp_path / "a.uff")
    assert back.quantity == "displacement" and back.points == pytest.approx(one.points, abs=1e-12)
    assert back.times_s == pytest.approx(one.times_s, rel=1e-5)
    assert back.values == pytest.approx(one.values, rel=1e-6 if binary else 1e-10, abs=1e-15)
    assert (back.sights is None) != sights and (not sights or back.sights == pytest.approx(one.sights, abs=1e-8))
    # As other software reads it
    opened = pyuff.UFF(str(tmp_path / "a.uff"))
    kinds = list(opened.get_set_types())
    assert kinds[:2] == [164, 2411] and kinds.count(82) == 2 and kinds.count(58) == 300
    units, nodes, line, record = (opened.read_sets(n) for n in (0, 1, 2, 4))
    assert units["length"] == 1.0 and nodes["y"] == pytest.approx(one.points[:, 1], abs=1e-12)
    assert list(line["nodes"]) == list(range(1, 251))
    assert record["binary"] == int(binary) and record["rsp_node"] == 1 and record["ordinate_spec_data_type"] == 8
    assert record["data"] == pytest.approx(one.values[:, 0], rel=1e-6, abs=1e-15)
    text = (tmp_path / "a.uff").read_bytes()
    assert (b"    58b" in text) == binary


def test_uff_of_others_with_millimetres_single_nodes_and_turned_axes(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    times = np.arange(32) / 1e3
    record = np.sin(2 * np.pi * 100 * times)
    common = {"type": 58, "binary": 0, "func_type": 1, "ref_node": 0, "ref_dir": 0, "x": times, "data": record,
              "abscissa_spacing": 1, "abscissa_min": 0.0, "abscissa_inc": 1e-3, "abscissa_spec_data_type": 17,
              "ordinate_spec_data_type": 11, "orddenom_spec_data_type": 0}  # fmt: skip
    sets = [
        {"type": 164, "units_code": 5, "length": 1000.0, "force": 1000.0, "temp": 1.0, "temp_offset": 0.0},
        {"type": 15, "node_nums": np.array([7, 9]), "x": np.array([0.0, 5.0]), "y": np.zeros(2), "z": np.ones(2)},
        {**common, "rsp_node": 7, "rsp_dir": 3}, {**common, "rsp_node": 9, "rsp_dir": -3},
    ]  # fmt: skip
    pyuff.UFF(str(tmp_path / "b.uff")).write_sets(sets, mode="overwrite")
    back = read_scan(tmp_path / "b.uff")
    assert back.points == pytest.approx(np.array([[0, 0, 1e-3], [5e-3, 0, 1e-3]]))
    assert back.values[:, 0] == pytest.approx(1e-3 * record, abs=1e-8)
    assert back.values[:, 1] == pytest.approx(-1e-3 * record, abs=1e-8)
    sets[3]["rsp_node"] = 8
    pyuff.UFF(str(tmp_path / "b.uff")).write_sets(sets, mode="overwrite")
    with pytest.raises(MeasurementError, match="to node 8, which has no position"):
        read_scan(tmp_path / "b.uff")
    sets[3] |= {"rsp_node": 9, "rsp_dir": 1}
    pyuff.UFF(str(tmp_path / "b.uff")).write_sets(sets, mode="overwrite")
    with pytest.raises(MeasurementError, match="of node 9 has direction 1; allowed: 3 and -3"):
        read_scan(tmp_path / "b.uff")
    sets[3] |= {"rsp_node": 8, "rsp_dir": 3}
    sets[2]["ordinate_spec_data_type"] = 12
    pyuff.UFF(str(tmp_path / "b.uff")).write_sets(sets, mode="overwrite")
    with pytest.raises(MeasurementError, match="data types 11, 12; allowed: 8"):
        read_scan(tmp_path / "b.uff")


def test_uff_that_is_none_is_told(tmp_path):
    pytest.importorskip("pyuff")
    (tmp_path / "a.uff").write_text("not a universal file\n")
    with pytest.raises(MeasurementError, match=r"give a UFF file|cannot be read as UFF"):
        read_scan(tmp_path / "a.uff")
    with pytest.raises(MeasurementError, match="cannot be read: No such file"):
        read_scan(tmp_path / "none.uff")
    write_scan(tmp_path / "b.uff", scan())
    whole = (tmp_path / "b.uff").read_bytes()
    for cut in (whole[:-300], whole[:-7]):
        (tmp_path / "b.uff").write_bytes(cut)
        with pytest.raises(MeasurementError, match="ends within a data set; give the complete file"):
            read_scan(tmp_path / "b.uff")
    (tmp_path / "b.uff").write_bytes(whole + b"\r\n \n")
    assert read_scan(tmp_path / "b.uff").values.shape == scan().values.shape
    with pytest.raises(OutputError, match="cannot write"):
        write_scan(tmp_path / "no" / "a.uff", scan())


# -- MATLAB --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sights", [True, False])
def test_mat_comes_back_to_the_last_digit(tmp_path, sights):
    one = scan("displacement", sights)
    write_scan(tmp_path / "a.mat", one)
    back = read_scan(tmp_path / "a.mat")
    assert back.quantity == "displacement" and (back.sights is None) != sights
    for name in ("times_s", "points", "values"):
        assert np.array_equal(getattr(back, name), getattr(one, name))


def test_mat_of_version_7_3_is_hdf5(tmp_path):
    one = scan()
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, values in (("time_s", one.times_s[:, None]), ("points_m", one.points), ("velocity_m_s", one.values)):
            file[name] = values.T
    with (tmp_path / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    assert np.array_equal(read_scan(tmp_path / "a.mat").values, one.values)


def test_what_is_wrong_in_a_mat_is_named(tmp_path):
    one = scan()
    good = {"time_s": one.times_s, "points_m": one.points, "velocity_m_s": one.values}
    for change, words in (
        ({"velocity_m_s": None}, "has no values; give exactly one of velocity_m_s, displacement_m"),
        ({"displacement_m": one.values}, "has velocity_m_s and displacement_m"),
        ({"points_m": None}, "has no variable 'points_m'"),
        ({"points_m": one.points[:2]}, "give shapes"),
        ({"velocity_m_s": one.values + 1j}, "velocity_m_s has values that are not real numbers"),
    ):
        savemat(tmp_path / "a.mat", {name: value for name, value in (good | change).items() if value is not None})
        with pytest.raises(MeasurementError, match=words):
            read_scan(tmp_path / "a.mat")
    (tmp_path / "a.mat").write_bytes(b"no such thing")
    with pytest.raises(MeasurementError, match="cannot be read"):
        read_scan(tmp_path / "a.mat")


# -- Polytec's text ------------------------------------------------------------------------------------------------

# As files begin that public programs describe which read them
HEAD = "Source File Name:\tScan\nPoint Index:\t{}\nComponent:\tRoot\nSignal:\tTime - Vib Velocity - Samples\n\n"
TABLE = "Time\tTime Signal\n[ s ]\t[ mm/s ]\n"


def polytec(folder, count=3):
    """A folder of text files, one for each point, numbered from 5 on; returns times and values [mm/s]."""
    times = np.arange(20) / 8e3
    values = np.random.default_rng(4).normal(size=(20, count))
    for n in range(count):
        rows = "".join(f"{time:.9g}\t{value:.9g}\n" for time, value in zip(times, values[:, n], strict=True))
        (folder / f"scan_{n}.txt").write_text(HEAD.format(5 + n) + TABLE + rows, encoding="cp1252")
    lines = "".join(f"{5 + n},{0.001 * n},0,0\n" for n in reversed(range(count)))
    (folder / "places.csv").write_text("point,x_m,y_m,z_m\n" + lines)
    return times, values


def test_polytecs_text_files_are_a_scan_with_a_table_of_places(tmp_path):
    times, values = polytec(tmp_path)
    found = read_scan(tmp_path)
    assert found.quantity == "velocity" and found.sights is None and found.times_s == pytest.approx(times)
    assert found.values == pytest.approx(1e-3 * values, rel=1e-8)
    assert found.points[:, 0] == pytest.approx([0.0, 0.001, 0.002])
    with pytest.raises(MeasurementError, match="give the folder with these files"):
        read_scan(tmp_path / "scan_0.txt")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("Component:\tRoot", "Average:\t3", "line 3 is 'Average"),
        ("Point Index:\t5\n", "", "no line 'Point Index:'"),
        ("Point Index:\t5", "Point Index:\t9", "belongs to point 9, but places.csv has no line for it"),
        ("Point Index:\t5", "Point Index:\t6", "point 6 has several files"),
        ("Vib Velocity", "Vib 3D Velocity", "Signal is 'Time - Vib 3D Velocity"),
        ("Time - Vib", "FFT - Vib", "samples over time along one beam"),
        ("Vib Velocity", "Vib Displacement", r"units are '\[ s \] \[ mm/s \]'; allowed"),
        ("[ mm/s ]", "[ V ]", "of velocity, "),
        ("[ s ]", "[ ms ]", r"allowed: \[ s \]"),
        ("Time\tTime Signal", "Frequency\tSpectrum", "two columns, Time"),
        ("\n\n", "\n", "the empty line after the head is missing|line 5 is 'Time"),
        ("0.000125\t", "0,000125\t", "line 9 is '0,000125.*with decimal points"),
        ("0.00025\t", "0.000251\t", "times differ from"),
    ],
)
def test_what_isnt_known_in_polytecs_text_is_refused(tmp_path, old, new, words):
    polytec(tmp_path)
    text = (tmp_path / "scan_0.txt").read_text(encoding="cp1252")
    assert old in text
    (tmp_path / "scan_0.txt").write_text(text.replace(old, new, 1), encoding="cp1252")
    with pytest.raises(MeasurementError, match=words):
        read_scan(tmp_path)


def test_polytecs_folders_without_files_or_places_are_refused(tmp_path):
    with pytest.raises(MeasurementError, match=r"contains no \.txt files"):
        read_scan(tmp_path)
    polytec(tmp_path)
    (tmp_path / "places.csv").write_text("point,x_m,y_m\n5,0,0\n")
    with pytest.raises(MeasurementError, match="has no column 'z_m'"):
        read_scan(tmp_path)
    (tmp_path / "places.csv").unlink()
    with pytest.raises(MeasurementError, match=r"places.csv: cannot be read.*columns point, x_m"):
        read_scan(tmp_path)


SET_164 = {"type": 164, "units_code": 5, "units_description": "mm", "temp_mode": 1, "length": 1000.0, "force": 1.0,
           "temp": 1.0, "temp_offset": 0.0}  # fmt: skip


@pytest.mark.parametrize(
    "label, scale, time_label, sets, fault",
    [
        ("m/s", 1.0, "s", [], None), ("mm/s", 1e3, "s", [], None), ("um/s", 1e6, "s", [], None),
        ("\u00b5m/s", 1e6, "s", [], None), ("NONE", 1.0, "NONE", [], None), ("mm/s", 1e3, "s", [SET_164], None),
        ("km/h", 3.6, "s", [], "has the unit label 'km/h'; allowed: m/s, mm/s, um/s, or none"),
        ("mm", 1e3, "s", [], "velocity has the unit label 'mm'"),
        ("mm/s", 1e3, "ms", [], "times have the unit label 'ms'; allowed: s"),
        ("m/s", 1.0, "s", [SET_164], "unit label 'm/s', but data set 164 has lengths of 0.001 m"),
    ],
)  # fmt: skip
def test_the_unit_label_of_a_uff_record_is_used_or_refused(tmp_path, label, scale, time_label, sets, fault):
    pyuff = pytest.importorskip("pyuff")
    scan = Scan(
        "velocity", np.arange(16) / 1000.0, np.array([[0.0, 0, 0], [0.01, 0, 0]]), np.outer(np.arange(16), [1, 2])
    )
    write_scan(tmp_path / "plain.uff", scan)
    content = pyuff.UFF(str(tmp_path / "plain.uff")).read_sets()
    for one in content:
        if one["type"] == 58:
            one |= {"data": scale * one["data"], "binary": 0}
            one |= {"ordinate_axis_units_lab": label, "abscissa_axis_units_lab": time_label}
        elif one["type"] == 2411 and sets:
            one |= {axis: 1e3 * np.asarray(one[axis]) for axis in "xyz"}
    kept = [*sets, *(one for one in content if one["type"] in (2411, 58))]
    pyuff.UFF(str(tmp_path / "scan.uff")).write_sets(kept, mode="overwrite")
    if fault is None:
        read = read_scan(tmp_path / "scan.uff")
        np.testing.assert_allclose(read.values, scan.values, rtol=1e-5)
        np.testing.assert_allclose(read.points, scan.points, atol=1e-6)
    else:
        with pytest.raises(MeasurementError, match=fault):
            read_scan(tmp_path / "scan.uff")


def test_places_in_millimetres_are_refused(tmp_path):
    scan = Scan("velocity", np.arange(16) / 1000.0, np.array([[0.0, 0, 0], [10.0, 0, 0]]), np.ones((16, 2)))
    write_scan(tmp_path / "scan.csv", scan)
    with pytest.raises(MeasurementError, match="points are 10 m apart; allowed: at most 2 m: give positions in metres"):
        read_scan(tmp_path / "scan.csv")
