"""A run against a scan that was made of it: moved, louder, later, at 45 degrees behind a filter."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import hankel1
from typer.testing import CliRunner
from unestimated import UNESTIMATED

import palmfield
from palmfield.cli.app import app
from palmfield.errors import MeasurementError, OutputError
from palmfield.instruments import Vibrometer, disc_grid, of_skin, vibrometer_record
from palmfield.instruments.scan import Scan, of_record
from palmfield.instruments.surface_motion import SurfaceMotion
from palmfield.outputs import instances, open_result
from palmfield.outputs.scan_files import read_scan, write_scan
from palmfield.studies.compare.report import guided_modes, in_words
from palmfield.studies.compare.run import FILES, above, compare

pytestmark = pytest.mark.usefixtures("kept_operators")

GAIN, DELAY_S = 1.3, 0.4e-3
TURN = Rotation.from_euler("xy", [2.0, -1.0], degrees=True).as_matrix()
LIFT = np.array([0.0, 0.0, 2e-3])


@pytest.fixture(scope="module")
def run(module_scene, tmp_path_factory):
    """Folder of a run of a small disc, and a scan of its motion."""
    out = tmp_path_factory.mktemp("run")
    scene = module_scene(duration_s=0.03, skin={"accuracy": 0.5})
    with UNESTIMATED:
        palmfield.run(scene, out / "run", plots=[])
    with open_result(out / "run") as result:
        (skin,) = instances(result, "skin").values()
        places = disc_grid(0.012, 0.003) + np.array([0.0, 0.0, skin["rest_position"].values[0, 2]])
        motion = of_skin(skin, places)
        normal = tuple(float(x) for x in motion.normals.mean(axis=0))
        head = Vibrometer(incidence_deg=45, distance_m=0.5, normal=normal, highpass_Hz=50, sampling_rate_Hz=12_800,
                          reading="velocity", duration_s=0.028, flight_s=DELAY_S)  # fmt: skip
        scan = of_record(vibrometer_record(motion, head))
    middle = scan.points.mean(axis=0)
    moved = (scan.points - middle) @ TURN + middle + LIFT
    write_scan(out / "scan.csv", Scan("velocity", scan.times_s, moved, GAIN * scan.values, scan.sights @ TURN))
    (out / "head.toml").write_text("[vibrometer]\nincidence_deg = 45\nhighpass_Hz = 50\n")
    return out


@pytest.mark.nightly
def test_gain_delay_and_place_are_found_again(run, tmp_path):
    done = compare(run / "run", run / "scan.csv", instrument=run / "head.toml", out=tmp_path)
    assert done.place.residual_m.max() < 1e-6 and done.place.undetermined == 3 and done.near.all()
    assert done.median("gain")[0] == pytest.approx(GAIN, rel=0.02)
    assert done.median("delay_s")[0] == pytest.approx(DELAY_S, abs=3e-5)
    assert done.median("l2_shape")[0] < 0.1 and done.median("coherence")[0] > 0.95
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)
    assert json.loads((tmp_path / "compare.json").read_text())["gain"]["median"] == done.median("gain")[0]
    table = np.genfromtxt(tmp_path / "points.csv", delimiter=",", names=True)
    assert len(table) == len(done.near) and table["gain"] == pytest.approx(done.numbers.gain)
    assert read_scan(tmp_path / "computed.csv").values == pytest.approx(done.computed.values)
    for words in ("registration    0.00 mm rms", "3 of 6 directions are not determined", "gain            1."):
        assert words in str(done)
    with pytest.raises(OutputError, match="contains another comparison"):
        compare(run / "run", run / "scan.csv", out=tmp_path)


def test_without_its_instrument_the_filter_is_missed_and_that_is_said(run):
    told = compare(run / "run", run / "scan.csv", instrument=run / "head.toml")
    bare = compare(run / "run", run / "scan.csv")
    assert bare.median("l2_shape")[0] > 1.5 * told.median("l2_shape")[0]
    assert "instrument      not given" in str(bare) and "not given" not in str(told)


def test_a_scan_that_is_longer_is_cut_and_one_that_is_elsewhere_is_refused(run):
    scan = read_scan(run / "scan.csv")
    times = np.arange(600) / 12_800
    longer = Scan("velocity", times, scan.points, np.vstack([scan.values, scan.values[-1:].repeat(242, axis=0)]))
    done = compare(run / "run", longer)
    assert done.cut_s == pytest.approx(599 / 12_800 - 0.03, abs=2e-4) and "cut off" in str(done)
    far = Scan("velocity", scan.times_s, scan.points + np.array([0.2, 0.0, 0.0]), scan.values)
    with pytest.raises(MeasurementError, match="0 of 49 points lie within 5 mm of the skin"):
        compare(run / "run", far, onto_surface=False)
    late = Scan("velocity", scan.times_s + 1.0, scan.points, scan.values)
    with pytest.raises(MeasurementError, match="0 of its samples lie within the run"):
        compare(run / "run", late)


def test_what_looks_like_a_fault_of_the_scan_is_said(run):
    scan = read_scan(run / "scan.csv")

    def said(**changed):
        return str(compare(run / "run", replace(scan, **changed), instrument=run / "head.toml"))

    assert "doubt" not in said()
    assert "not determined by the shape of the skin and keep the values of the file (2 shifts, 1 turn)" in said()
    assert "maximum of the measured motion lies 3.9 mm from" in said(points=scan.points + np.array([4e-3, 0, 0]))
    assert "was moved by 102 mm, more than its width" in said(points=scan.points + np.array([0, 0, 0.1]))
    assert "check the unit" in said(values=1e3 * scan.values)
    assert "most points have the opposite sign" in said(values=-scan.values)
    wild = np.random.default_rng(0).normal(scale=20 * np.abs(scan.values).max(), size=len(scan.values))
    loose = compare(run / "run", replace(scan, values=np.where(np.arange(49) == 7, wild[:, None], scan.values)),
                    instrument=run / "head.toml")  # fmt: skip
    assert "the channel of point 7 seems faulty" in str(loose) and "48 points that move more" in str(loose)
    assert loose.median("gain")[0] == pytest.approx(GAIN, rel=0.02) and "maximum of the measured" not in str(loose)
    assert "1 point without motion" in said(values=np.where(np.arange(49) == 4, 0.0, scan.values))
    late = np.vstack([np.zeros((90, 49)), scan.values[:-90]])
    assert re.search(r"a delay of 7\.\d+ ms fits better than any within 5", said(values=late))
    with pytest.raises(MeasurementError, match=r"scan\.csv: point 4 has a value that is not finite, at sample 0"):
        said(values=np.where(np.arange(49) == 4, np.nan, scan.values))
    with pytest.raises(MeasurementError, match=r"that of the skin 0.056 m: positions are in metres\)"):
        said(points=1e3 * scan.points)
    with pytest.raises(MeasurementError, match=r"scan.csv: times have shape \(18,\); give a row of at least 32"):
        said(times_s=scan.times_s[::20], values=scan.values[::20])


def test_what_is_above_half_the_scans_rate_is_a_share_of_power():
    times = np.arange(1000) / 10e3
    speed = np.sin(2 * np.pi * 200 * times) + 0.5 * np.sin(2 * np.pi * 900 * times)
    velocity = speed[:, None, None] * np.array([0.0, 0.0, 1.0])
    motion = SurfaceMotion(times, np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), velocity, velocity)
    assert above(motion, 500.0) == pytest.approx(0.2, abs=1e-6) and above(motion, 1000.0) < 1e-6


def test_the_command_line(run, tmp_path):
    words = ["compare", str(run / "run"), str(run / "scan.csv"), "--instrument", str(run / "head.toml"), "--out",
             str(tmp_path)]  # fmt: skip
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "gain            1." in done.output and "wavenumbers.png" in done.output
    again = CliRunner().invoke(app, [*words, "--overwrite", "--json"])
    assert json.loads(again.stdout)["points"] == 49
    wrong = CliRunner().invoke(app, [*words, "--overwrite", "--skin", "plam"])
    assert isinstance(wrong.exception, MeasurementError) and "skin 'plam' is not in the run" in str(wrong.exception)


def test_fiducials_are_read_and_wrong_ones_named(run, tmp_path):
    scan = read_scan(run / "scan.csv")
    middle = scan.points.mean(axis=0)
    back = (scan.points - middle) @ TURN.T + middle - LIFT
    pairs = np.hstack([scan.points, back])[[0, 20, 40]]
    head = "x_m,y_m,z_m,skin_x_m,skin_y_m,skin_z_m\n"
    lines = "".join(",".join(map(str, row)) + "\n" for row in pairs)
    (tmp_path / "f.csv").write_text(head + lines)
    done = compare(run / "run", scan, fiducials=tmp_path / "f.csv", onto_surface=False)
    assert done.place.fiducials_m.max() < 1e-6 and "fiducials 0.00 mm" in str(done)
    (tmp_path / "f.csv").write_text(head.replace("skin_y_m", "y2") + lines)
    with pytest.raises(MeasurementError, match="column 'skin_y_m' is missing"):
        compare(run / "run", scan, fiducials=tmp_path / "f.csv")


def test_the_guided_mode_of_both_scans_is_told(run):
    done = compare(run / "run", run / "scan.csv", instrument=run / "head.toml", mode_Hz=200.0, source_radius_m=0.005)
    told = done.as_dict()["guided_mode"]
    # 24 mm hold less than two waves of this skin
    assert not told["measured"]["resolved"] and not told["computed"]["resolved"]
    assert "200 Hz wave     measured not resolved: " in str(done)


def test_two_scans_of_one_mode_show_its_speed_and_length():
    points = disc_grid(0.06, 0.005)
    tilt = Rotation.from_euler("y", 20.0, degrees=True).as_matrix()
    times = np.arange(800) / 8e3
    k = 210.0 + 40.0j
    ring = hankel1(0, k * np.maximum(np.linalg.norm(points - [0.005, 0.0, 0.0], axis=1), 1e-3))
    record = np.real(np.exp(-2j * np.pi * 200.0 * times)[:, None] * ring)
    noise = 0.02 * np.random.default_rng(0).normal(size=record.shape)
    sights = np.tile(tilt @ [0.0, 0.0, 1.0], (len(points), 1))
    scans = [Scan("velocity", times, points @ tilt.T, values, sights) for values in (record + noise, record)]
    for mode in guided_modes(*scans, 200.0, None, 0.016):
        assert mode.wavenumber_rad_m == pytest.approx(k, rel=0.01)
    assert "m/s, 1/e length 25" in in_words(mode, 200.0)
    bent = [Scan("velocity", times, one.points + np.outer(points[:, 0] ** 2 * 4, tilt[:, 2]), one.values, sights)
            for one in scans]  # fmt: skip
    with pytest.raises(MeasurementError, match="can only be fitted on flat skin"):
        guided_modes(*bent, 200.0, None, 0.016)
