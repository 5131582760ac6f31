"""MATLAB files of other laboratories are read by names of variables, one variable at a time."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from palmfield.errors import MeasurementError
from palmfield.outputs.scan_files import read_scan
from palmfield.outputs.scan_files.named_mat import MatVariables, NamedMat, listed

RATE_HZ = 10_000.0
LOCS = np.array([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]])


def parts(seed=1, late=(3, 0, 11)):
    """y (3 places, 400 times, 2 repetitions) and its reference, whose records are late by different samples."""
    rng = np.random.default_rng(seed)
    clean = np.concatenate([np.zeros((100, 3)), rng.normal(size=(300, 3))])
    y = np.stack([np.stack([np.roll(clean[:, n], late[n]) for n in range(3)])] * 2, axis=-1)
    pulse = (np.arange(400) >= 100) & (np.arange(400) < 150)
    reference = np.stack([np.roll(pulse, n) for n in late]).astype(float)
    return clean, {"locs": LOCS, "fs": RATE_HZ, "y": y, "ref": np.stack([reference] * 2, axis=-1)}


def named(file, **changes):
    keys = {"places": "locs", "places_unit": "mm", "rate": "fs", "reference": "ref"}
    return NamedMat(file, MatVariables(**(keys | changes)))


def hdf5(file, variables):
    """Version 7.3: columns first, behind MATLAB's own head."""
    with h5py.File(file, "w", userblock_size=512) as opened:
        for name, values in variables.items():
            opened[name] = np.atleast_2d(values).T
    with file.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("write", [savemat, hdf5])
def test_records_are_aligned_by_their_reference(tmp_path, write):
    clean, variables = parts()
    write(tmp_path / "a.mat", variables)
    one = named(tmp_path / "a.mat")
    times, values = one.records()
    first = int(np.flatnonzero(times >= 0.0)[0])
    assert one.rate_Hz == RATE_HZ and one.places_m[1].tolist() == [0.005, 0.0, 0.0]
    assert np.array_equal(values[1, first : first + 280], clean[100:380])
    assert listed(tmp_path / "a.mat")["y"][0] == (3, 400, 2)


def test_a_grid_is_read_along_x_and_y_and_a_settings_file_makes_a_scan_of_it(tmp_path):
    x, y, t = np.arange(4) * 1e-3, np.arange(3) * 2e-3, np.arange(50) / RATE_HZ
    values = np.random.default_rng(2).normal(size=(50, 4, 3))
    savemat(tmp_path / "b.mat", {"x": x, "yy": y, "t": t, "v": 1e3 * values})
    (tmp_path / "b.toml").write_text(
        '[variables]\nvelocity = "v"\nvelocity_unit = "mm/s"\naxes = "time x y"\nx = "x"\ny = "yy"\nrate = "t"\n'
    )
    scan = read_scan(tmp_path / "b.mat")
    at = int(np.flatnonzero((scan.points[:, 0] == x[2]) & (scan.points[:, 1] == y[1]))[0])
    assert np.allclose(scan.values[:, at], values[:, 2, 1], rtol=1e-14) and scan.rate_Hz == pytest.approx(RATE_HZ)


def test_a_damaged_velocity_is_not_touched_by_reading_places(tmp_path):
    _, variables = parts()
    savemat(tmp_path / "a.mat", variables)
    data = bytearray((tmp_path / "a.mat").read_bytes())
    start = data.index(variables["y"].tobytes(order="F")[:64])
    data[start - 8 : start] = b"\xff" * 8  # type and length of the numbers, behind shape and name
    (tmp_path / "a.mat").write_bytes(bytes(data))
    one = named(tmp_path / "a.mat", onset_s=0.01)
    one.check_shape()
    assert len(one.places_m) == 3 and one.rate_Hz == RATE_HZ
    with pytest.raises(MeasurementError, match=r"variable 'y' cannot be read.*copy the file again"):
        one.records()


@pytest.mark.parametrize(
    ("change", "keys", "words"),
    [
        ({}, {"places": ""}, r"x: has no name; set x in \[variables\]; found: locs \(3 by 2 double\)"),
        ({}, {"places": "xyz"}, r"places: variable 'xyz' is missing.*y \(3 by 400 by 2 double\)"),
        ({}, {"velocity": "u"}, r"velocity: variable 'u' is missing; set velocity in \[variables\]"),
        ({"locs": LOCS[:2]}, {}, "'y' is 3 by 400 by 2 with axes place time repetition, and there are 2 places"),
        ({"locs": np.array([[0.0, np.nan], [5, 0], [0, 5]])}, {}, r"place 0 \(of 1 such\) is \(0, nan\)"),
        ({"locs": {"xy": LOCS}}, {}, r"'locs' is a struct; save its fields as variables"),
        ({}, {"axes": "place t"}, "axes is 'place t'; allowed, in any order: place time;"),
        ({}, {"rate": ""}, "no sampling rate"),
        ({}, {"onset_s": 3.0}, "onset_s is 3; the record has 0.04 s"),
        ({"ref": np.ones((3, 400, 2))}, {}, "no quiet beginning"),
        ({"ref": np.ones((7, 2))}, {}, "'ref' does not have the axes"),
        ({"y": np.full((3, 400, 2), np.nan)}, {}, "velocity of place 0 is not finite"),
    ],
)
def test_what_is_missing_or_wrong_is_named_with_what_was_found(tmp_path, change, keys, words):
    savemat(tmp_path / "a.mat", parts()[1] | change)
    one = named(tmp_path / "a.mat", **keys)
    with pytest.raises(MeasurementError, match=words):
        one.check_shape(), one.rate_Hz, one.records()
