"""Whole sweeps in this process: what is in the dataset, and how they go on."""

import errno
import json
import os

import numpy as np
import pytest
import xarray as xr

import palmfield
from palmfield.errors import OutputError, PalmfieldError
from palmfield.outputs import instances, normal_component
from palmfield.studies.sweeps import batch, store, whole_sweep
from palmfield.studies.sweeps.design import Range, listed, sobol
from palmfield.studies.sweeps.store import DONE, FAILED, NOT_DONE

pytestmark = pytest.mark.usefixtures("kept_operators")

FREQUENCY, LEVEL, THICKNESS = "stimulus.am_frequency_Hz", "stimulus.drive_amplitude", "skin.thickness_m"


def swept(scene, design, out, **more):
    return palmfield.sweep(scene, design, out, **({"workers": 0, "progress": False, "picture": False} | more))


@pytest.fixture(scope="module")
def whole(module_scene, tmp_path_factory):
    """A grid of two frequencies and two levels, and the scene."""
    scene = module_scene(duration_s=0.02)
    design = {FREQUENCY: [100.0, 200.0], LEVEL: [0.5, 1.0]}
    result = swept(scene, design, tmp_path_factory.mktemp("sweep"), picture=True, errors=True)
    return scene, result


@pytest.mark.nightly
@pytest.mark.parametrize(("frequency", "level"), [(100.0, 0.5), (200.0, 1.0)])
def test_a_point_has_the_numbers_of_a_run_by_itself(frequency, level, whole):
    scene, result = whole
    alone = palmfield.run(palmfield.Simulation(scene, keys={FREQUENCY: frequency, LEVEL: level}), progress=False)
    point = result.dataset.sel({FREQUENCY: frequency, LEVEL: level, "skin": "skin"})
    (numbers,) = alone.summary["skins"]
    for name, known in (
        ("peak_displacement", "peak_displacement_m"),
        ("peak_velocity", "peak_velocity_m_s"),
        ("rms_displacement", "rms_displacement_m"),
        ("rms_displacement_without_mean", "rms_displacement_without_dc_m"),
        ("peak_arp", "peak_arp_Pa"),
        ("main_frequency", "main_frequency_Hz"),
        ("displacement_error", "displacement_error_relative"),
    ):
        assert float(point[name]) / numbers[known] == pytest.approx(1.0, rel=1e-5), name
    for observer in point["observer"].values:
        seen = point.sel(observer=observer)
        assert str(seen["level_why"].values) == numbers[f"level_{observer}_why"]
        for name, key in (("level", "level"), ("level_with_area", "level_area")):
            known = numbers.get(f"{key}_{observer}_dB_SL")
            assert float(seen[name]) == pytest.approx(np.nan if known is None else known, rel=1e-5, nan_ok=True)
    assert np.isfinite(point["level"]).sum() == 3 and np.isfinite(point["level_with_area"]).sum() == 1
    assert float(point["drive_level"].item()) == pytest.approx(level)
    (forces,) = instances(alone.dataset, "forces").values()
    assert float(point["peak_force"]) == pytest.approx(np.linalg.norm(forces["force"], axis=1).max(), rel=1e-6)
    np.testing.assert_allclose(point["mean_force"], numbers["total_force_mean_N"], rtol=1e-6)
    # The course is that of the vertex that moves most, whose place it names
    (skin,) = instances(alone.dataset, "skin").values()
    motion = normal_component(skin)
    vertex = numbers["peak_displacement_vertex"]
    np.testing.assert_array_equal(point["loudest_position"], skin["rest_position"][vertex])
    np.testing.assert_allclose(point["normal_displacement"], motion[:, vertex], atol=1e-6 * float(np.abs(motion).max()))
    (sensor,) = instances(alone.dataset, "sensors").values()
    read = sensor["value"].values[:, list(sensor["channel"].values).index("normal_displacement_m")]
    np.testing.assert_allclose(point["sensor_displacement"].squeeze(), read, rtol=1e-5)


def test_rms_over_the_last_period_is_that_of_the_course(whole):
    _, result = whole
    point = result.dataset.sel({FREQUENCY: 200.0, LEVEL: 1.0, "skin": "skin"}).load()
    # 5 ms of 200 Hz end with the run: its substeps of 0.5 ms are 10 in a period
    last = point["normal_displacement"].values[-10:].astype(float)
    assert float(point["rms_displacement_last_period"]) == pytest.approx(np.sqrt(np.mean(last**2)), rel=1e-5)
    assert point["time"].values[-1] == pytest.approx(0.02)


def test_the_dataset_is_labelled(whole):
    _, result = whole
    with xr.open_zarr(result.out / "sweep.zarr", consolidated=False) as dataset:
        assert dataset["peak_displacement"].dims == (FREQUENCY, LEVEL, "skin")
        assert dataset[FREQUENCY].attrs["units"] == "Hz"
        assert dataset["normal_displacement"].dims[-1] == "time" and dataset["time"].attrs["units"] == "s"
        for name, variable in dataset.data_vars.items():
            assert variable.attrs["long_name"], name
            assert variable.attrs.get("units") or name in ("failure", "displacement_error_missing", "level_why"), name
        assert json.loads(dataset.attrs["versions"])["palmfield"] == palmfield.__version__
        assert (dataset["status"] == DONE).all()
    assert result.done == result.points == 4 and result.failed == {}


def test_levels_scale_as_the_square_of_the_drive(whole):
    _, result = whole
    peaks = result.dataset["peak_displacement"].sel(skin="skin")
    np.testing.assert_allclose(peaks.sel({LEVEL: 1.0}) / peaks.sel({LEVEL: 0.5}), 4.0, rtol=0.02)


def test_the_same_sweep_computes_nothing_twice(whole, monkeypatch):
    scene, result = whole
    monkeypatch.setattr(whole_sweep, "run_batch", lambda *_: pytest.fail("computed again"))
    again = swept(scene, {FREQUENCY: [100.0, 200.0], LEVEL: [0.5, 1.0]}, result.out, errors=True)
    assert again.done == 4


@pytest.mark.parametrize(
    ("design", "more", "said"),
    [
        ({FREQUENCY: [100.0, 150.0], LEVEL: [0.5, 1.0]}, {"errors": True}, "its design is"),
        ({FREQUENCY: [100.0, 200.0], LEVEL: [0.5, 1.0]}, {"errors": False}, "its errors is true, not false"),
        (
            {FREQUENCY: [100.0, 200.0], LEVEL: [0.5, 1.0]},
            {"errors": True, "keys": {"skin.accuracy": 0.3}},
            "its keys that all points share is {}",
        ),
        ({FREQUENCY: [100.0, 200.0], LEVEL: [0.5, 1.0]}, {"errors": True, "duration_s": 0.01}, "its duration is 0.02"),
    ],
    ids=["design", "errors", "keys", "duration"],
)
def test_another_sweep_in_the_folder_is_refused(design, more, said, whole):
    scene, result = whole
    with pytest.raises(OutputError, match=f"contains another sweep: {said}"):
        swept(scene, design, result.out, **more)
    assert (result.dataset["status"] == DONE).all()


def test_another_scene_of_the_same_name_is_refused(small_scene, tmp_path):
    swept(small_scene(duration_s=0.002), {LEVEL: [1.0]}, tmp_path / "out")
    changed = small_scene(duration_s=0.002, skin={"thickness_m": 0.007})
    with pytest.raises(OutputError, match="contains another sweep: its scene"):
        swept(changed, {LEVEL: [1.0]}, tmp_path / "out")


def test_a_failing_point_is_recorded_and_tried_again(small_scene, tmp_path, monkeypatch):
    scene, plain = small_scene(duration_s=0.002), batch.Simulation
    # The speed of a path that the scene has not
    design = listed(
        {LEVEL: [0.5, 0.6, 0.7], "stimulus.start_s": [0.0, 0.0, 0.001], "stimulus.stop_s": [1.0, 1.0, 0.0005]}
    )
    result = swept(scene, design, tmp_path / "out")
    assert result.done == 2 and list(result.failed) == [2]
    assert "stop_s 0.0005 must be later than start_s 0.001" in result.failed[2]
    dataset = result.dataset.load()
    assert dataset["status"].values.tolist() == [DONE, DONE, FAILED]
    assert np.isnan(dataset["peak_displacement"].values[2]).all() and dataset["peak_displacement"].values[:2].all()
    assert dataset["failure"].values[2] == result.failed[2]
    assert dataset[LEVEL].dims == ("point",) and dataset[LEVEL].values.tolist() == [0.5, 0.6, 0.7]
    tried = []
    monkeypatch.setattr(
        batch, "Simulation", lambda *a, keys, **b: (tried.append(keys[LEVEL]), plain(*a, keys=keys, **b))[1]
    )
    swept(scene, design, tmp_path / "out")
    assert tried == [0.7]


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))], ids=str)
def test_a_sweep_that_is_cut_off_goes_on_to_the_same_dataset(stop, small_scene, tmp_path, monkeypatch):
    scene, design = small_scene(duration_s=0.002), {LEVEL: [0.4, 0.6, 0.8, 1.0]}
    kind = KeyboardInterrupt if isinstance(stop, KeyboardInterrupt) else OutputError
    whole = swept(scene, design, tmp_path / "whole").dataset.load()
    plain, calls = store.SweepStore._flush, []

    def flush(self, rows):
        calls.append(rows)
        if len(calls) == 3:
            raise stop
        plain(self, rows)

    with monkeypatch.context() as patch:
        patch.setattr(store.SweepStore, "_flush", flush)
        with pytest.raises(kind, match=None if kind is KeyboardInterrupt else "2 points are saved: free some space"):
            swept(scene, design, tmp_path / "cut")
    cut = store.open_dataset(tmp_path / "cut" / "sweep.zarr").load()
    assert cut["status"].values.tolist() == [DONE, DONE, NOT_DONE, NOT_DONE]
    xr.testing.assert_identical(
        cut["peak_displacement"].isel({LEVEL: slice(2)}), whole["peak_displacement"].isel({LEVEL: slice(2)})
    )
    resumed = swept(scene, design, tmp_path / "cut").dataset.load()
    xr.testing.assert_identical(resumed.drop_vars("wall_time"), whole.drop_vars("wall_time"))


def test_courses_of_other_substeps_are_at_the_sweeps_times(small_scene, tmp_path):
    design = {"skin.step_s": [0.0005, 0.00025]}
    dataset = swept(small_scene(), design, tmp_path / "out").dataset.load().squeeze(drop=True)
    assert dataset["substep"].values.tolist() == [0.0005, 0.00025]
    assert len(dataset["time"]) == 61
    coarse, fine = dataset["normal_displacement"].values
    # Of each second value the coarse run knows its own; between them the spline lies near the finer run
    size = np.abs(fine).max()
    assert np.abs(coarse - fine).max() < 0.05 * size
    assert np.abs(coarse[1::2] - fine[1::2]).max() < 2.0 * max(np.abs(coarse[::2] - fine[::2]).max(), 0.01 * size)


def test_drawn_points_have_their_keys_as_coordinates(small_scene, tmp_path):
    design = sobol({LEVEL: Range(0.2, 1.0), "stimulus.focus_m[0]": Range(-0.005, 0.005)}, 4, seed=1)
    result = swept(small_scene(duration_s=0.012), design, tmp_path / "out", picture=True)
    dataset = result.dataset
    assert dataset["level"].dims == ("point", "skin", "observer")
    np.testing.assert_array_equal(dataset["stimulus.focus_m[0]"], design.values["stimulus.focus_m[0]"])
    louder = np.argsort(design.values[LEVEL])
    assert (np.diff(dataset["peak_arp"].values[louder, 0]) > 0).all()
    assert result.files["sweep.png"].stat().st_size > 10_000


def test_points_that_share_a_layer_make_it_once(small_scene, tmp_path, monkeypatch):
    from palmfield.skin import scene_layer

    plain, made = scene_layer.assemble, []
    monkeypatch.setattr(scene_layer, "assemble", lambda *a, **b: (made.append(1), plain(*a, **b))[1])
    swept(small_scene(duration_s=0.002, skin={"radius_m": 0.021}), {LEVEL: [0.4, 0.6, 0.8]}, tmp_path / "out")
    assert len(made) == 1


def test_what_is_out_of_proportion_asks_first(small_scene, tmp_path, monkeypatch):
    scene, design, asked = small_scene(duration_s=0.002), {LEVEL: [0.4, 0.6]}, []

    def no(question):
        asked.append(question)
        return False

    monkeypatch.setattr(whole_sweep, "LARGE_BYTES", 1e3)
    with pytest.raises(OutputError, match="not confirmed; give --yes"):
        swept(scene, design, tmp_path / "out")
    with pytest.raises(OutputError, match="may be written"):
        swept(scene, design, tmp_path / "out", ask=no)
    assert len(asked) == 1 and not (tmp_path / "out").exists()
    assert swept(scene, design, tmp_path / "out", yes=True).done == 2


def test_what_takes_too_long_asks_once_and_keeps_what_is_there(small_scene, tmp_path, monkeypatch):
    scene, design = small_scene(duration_s=0.002), {LEVEL: [0.4, 0.6, 0.8, 1.0]}
    monkeypatch.setattr(whole_sweep, "LONG_S", 0.0)
    with pytest.raises(OutputError, match=r"2 of 4 points are left, about 0\.0 h"):
        swept(scene, design, tmp_path / "out")
    monkeypatch.setattr(whole_sweep, "LONG_S", 3600.0)
    assert swept(scene, design, tmp_path / "out").done == 4


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"workers": -1}, "--workers has value -1; allowed: 0"),
        ({"workers": 2, "scheduler": "tcp://127.0.0.1:1"}, "give one of them"),
        ({"workers": None, "scheduler": "nowhere"}, "'nowhere'; allowed: PROTOCOL://HOST:PORT"),
        ({"duration_s": 0.0}, "duration_s is 0.0; allowed"),
        ({"device": "cuda:99"}, "cuda:99"),
    ],
    ids=str,
)
def test_arguments_that_are_refused_before_a_folder_is_made(more, said, small_scene, tmp_path):
    with pytest.raises(PalmfieldError, match=said):
        swept(small_scene(), {LEVEL: [0.5, 1.0]}, tmp_path / "out", **more)
    assert not (tmp_path / "out").exists()


def test_a_missing_extra_is_named(small_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(whole_sweep, "find_spec", lambda name: None if name == "zarr" else object())
    with pytest.raises(PalmfieldError, match=r"sweeps need zarr; .* 'palmfield\[sweep\]'"):
        swept(small_scene(), {LEVEL: [0.5, 1.0]}, tmp_path / "out")
