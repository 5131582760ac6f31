"""A whole run: what it writes, and what is left when it is cut off."""

import json
import resource
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from pxr import Usd, UsdGeom

import palmfield
from palmfield.outputs import instances, normal_component, open_result
from palmfield.outputs.summary_table import format_summary
from palmfield.outputs.usd import validate_usd

pytestmark = pytest.mark.usefixtures("kept_operators")
FILES = ("result.nc", "summary.json", "pressure.png", "displacement.png", "scene.png", "scene.usdc")


def only(result, kind):
    """The one group of a kind, with the root's times."""
    (group,) = instances(result, kind).values()
    return group


@pytest.fixture(scope="module")
def finished(tmp_path_factory, module_scene):
    out = tmp_path_factory.mktemp("run") / "out"
    result = palmfield.run(module_scene(), out, progress=False)
    with open_result(out) as tree:
        yield result, tree.load()


@pytest.mark.smoke
def test_everything_is_written(finished):
    result, tree = finished
    assert set(result.files) == set(FILES)
    assert all((result.out / name).stat().st_size > 1000 for name in FILES)
    assert not (result.out / ".partial").exists()
    assert tree.attrs["complete"] == 1


@pytest.mark.smoke
def test_result_is_labelled_and_consistent(finished):
    _, tree = finished
    skin, drive, forces = only(tree, "skin"), only(tree, "array"), only(tree, "forces")
    for ds, names in ((skin, ("rest_position", "displacement", "velocity", "arp")), (drive, ("drive_amplitude",))):
        assert all(ds[name].attrs["units"] and ds[name].attrs["long_name"] for name in names)
    assert tree.sizes["time"] == 31 and tree.sizes["step_time"] == 15
    # Velocity is the displacement's slope.
    t, u, v = (np.asarray(x) for x in (tree["time"], normal_component(skin), normal_component(skin, "velocity")))
    vertex = np.abs(u).max(axis=0).argmax()
    slope = np.gradient(u[:, vertex].astype(float), t)
    assert np.corrcoef(slope, v[:, vertex])[0, 1] > 0.98
    # The force is the mean over its step of the ARP summed over the disc (Simpson over begin, middle and end).
    faces = skin["face"].values
    corners = skin["rest_position"].values[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total = (area * skin["arp"].values[:, faces].mean(axis=2)).sum(axis=1)
    force = np.linalg.norm(forces["force"].values, axis=1)
    begin = np.searchsorted(t, tree["step_time"].values - 1e-9)
    mean = (total[begin] + 4 * total[begin + 1] + total[begin + 2]) / 6
    np.testing.assert_allclose(force, mean, rtol=0.05, atol=0.01 * force.max())


@pytest.mark.smoke
def test_summary_holds_the_tables_numbers(finished):
    result, tree = finished
    stored = json.loads((result.out / "summary.json").read_text())
    (skin,), (stimulus,) = stored["skins"], stored["stimuli"]
    levels = ("level_bolanowski_1988_dB_SL", "level_afferent_human_dB_SL")
    peaks = ("peak_pressure_Pa", "peak_arp_Pa", "total_force_peak_N", "peak_displacement_m", "rms_displacement_m")
    for key in (*peaks, "displacement_error_relative", *levels):
        assert np.isfinite(skin[key]), key
    assert skin["peak_displacement_m"] == pytest.approx(float(np.abs(normal_component(only(tree, "skin"))).max()))
    force = np.linalg.norm(only(tree, "forces")["force"].values, axis=1)
    assert skin["total_force_peak_N"] == stored["total_force_peak_N"] == pytest.approx(force.max(), rel=1e-12)
    assert 0 < skin["displacement_error_relative"] < 1 and stimulus["drive_level"] == pytest.approx(1.0)
    assert stored["palmfield_device"] == "cpu" and stored["board"] == "ideal"


@pytest.mark.smoke
def test_a_run_kept_in_memory_is_the_one_that_is_written(finished, module_scene):
    result, tree = finished
    kept = palmfield.run(module_scene(), progress=False)
    assert kept.out is None and kept.files == {}
    for name in ("displacement", "arp"):
        np.testing.assert_array_equal(only(kept.dataset, "skin")[name].values, only(tree, "skin")[name].values)
    assert kept.summary["skins"][0]["peak_arp_Pa"] == result.summary["skins"][0]["peak_arp_Pa"]
    np.testing.assert_array_equal(result.dataset["time"].values, tree["time"].values)


@pytest.mark.smoke
def test_another_runs_folder_is_left_alone(finished, module_scene):
    result, _ = finished
    before = (result.out / "result.nc").stat().st_mtime_ns
    with pytest.raises(palmfield.OutputError, match="--overwrite"):
        palmfield.run(module_scene(), result.out, progress=False)
    assert (result.out / "result.nc").stat().st_mtime_ns == before


@pytest.mark.smoke
def test_usd_passes_the_validators_and_moves(finished):
    result, tree = finished
    assert validate_usd(result.files["scene.usdc"]) == []
    stage = Usd.Stage.Open(str(result.files["scene.usdc"]))
    moving = [
        UsdGeom.PrimvarsAPI(p).GetPrimvar("normal_displacement")
        for p in stage.Traverse()
        if UsdGeom.PrimvarsAPI(p).HasPrimvar("normal_displacement")
    ]
    assert len(moving) == 1 and moving[0].GetTimeSamples()[-1] == stage.GetEndTimeCode() == tree.sizes["time"] - 1


def test_pictures_of_a_run_cut_off_while_drawing_can_be_made_later(finished, tmp_path):
    out = shutil.copytree(finished[0].out, tmp_path / "out")
    summary = (out / "summary.json").read_text()
    for name in ("scene.usdc", "displacement.png"):
        (out / name).unlink()
    assert set(palmfield.recover(out)) == set(FILES)
    assert (out / "summary.json").read_text() == summary
    assert (out / "scene.usdc").exists() and (out / "displacement.png").exists()


@pytest.mark.parametrize("changes", [{"stimulus": {"drive_amplitude": 0}}, {"skin": {"step_s": 0.001}}], ids=str)
def test_silence_and_a_coarse_step_end_well(changes, small_scene, tmp_path):
    result = palmfield.run(palmfield.load(small_scene(**changes)), tmp_path / "out", progress=False)
    assert set(result.files) == set(FILES)
    (skin,) = result.summary["skins"]
    assert "displacement_error_relative" in skin or skin["peak_displacement_m"] == 0
    assert "peak ARP" in format_summary(result.summary)


START = """
import palmfield, palmfield.outputs.store, signal, sys
palmfield.outputs.store.FLUSH_SECONDS = 0.2
# A shell that runs tests in the background has its children ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
palmfield.run(palmfield.load(sys.argv[1]), sys.argv[2], duration_s=30, progress=False)
"""


@pytest.fixture
def begin():
    """Starts a run of 30 s in a process of its own and returns when two chunks are on the disk."""
    started: list[subprocess.Popen] = []

    def start(path, out, **options):
        command = [sys.executable, "-c", START, str(path), str(out)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **options)
        started.append(process)
        deadline = time.monotonic() + 60
        while len(list(out.glob(".partial/chunk_*.nc"))) < 2:
            assert process.poll() is None and time.monotonic() < deadline, process.stderr.read()
            time.sleep(0.05)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


def read(out):
    with open_result(out) as tree:
        return tree.load()


def test_interrupt_keeps_what_was_computed(begin, small_scene, tmp_path):
    out = tmp_path / "out"
    process = begin(small_scene(), out)
    process.send_signal(signal.SIGINT)
    process.wait(60)
    assert process.returncode != 0
    tree = read(out)
    assert tree.attrs["complete"] == 0 and "KeyboardInterrupt" in tree.attrs["reason"]
    assert tree.sizes["time"] >= 2
    assert json.loads((out / "summary.json").read_text())["complete"] is False


def test_kill_then_recover(begin, small_scene, tmp_path):
    out = tmp_path / "out"
    path = small_scene()
    process = begin(path, out)
    process.kill()
    process.wait(60)
    with pytest.raises(palmfield.OutputError, match="palmfield recover"):
        palmfield.run(palmfield.load(path), out, progress=False)
    command = [sys.executable, "-m", "palmfield", "recover", str(out)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    tree = read(out)
    assert tree.attrs["complete"] == 0 and tree.sizes["time"] >= 2
    assert np.abs(normal_component(only(tree, "skin"))).max() > 0


def test_full_disk_keeps_what_was_written(begin, small_scene, tmp_path):
    """A limit on file sizes, set from outside once a chunk is there, makes writes fail as a full disk does."""
    out = tmp_path / "out"
    process = begin(small_scene(), out, preexec_fn=lambda: signal.signal(signal.SIGXFSZ, signal.SIG_IGN))
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (2000, 2000))
    _, error = process.communicate(timeout=120)
    assert process.returncode != 0 and "OutputError" in error and "Traceback" in error
    palmfield.recover(out)
    tree = read(out)
    assert tree.attrs["complete"] == 0 and tree.sizes["time"] >= 2


def test_folder_that_cannot_be_written(small_scene, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(palmfield.OutputError, match="file"):
        palmfield.run(palmfield.load(small_scene()), blocked / "out", progress=False)


def test_body_that_falls_into_the_array_ends_the_run(small_scene, tmp_path):
    path = small_scene()
    plain = path.with_name("plain.xml")
    text = plain.read_text().replace('axis="1 0 0" stiffness="400" damping="10"', 'axis="0 0 1"')
    plain.write_text(text.replace('gravcomp="1"', "").replace('pos="0 0 0.12"', 'pos="0 0 0.02"'))
    scene = palmfield.load(path)
    with pytest.raises(palmfield.SceneError, match="is too close to the array"):
        palmfield.run(scene, tmp_path / "out", duration_s=1.0, progress=False)
    tree = read(tmp_path / "out")
    assert tree.attrs["complete"] == 0 and 10 < tree.sizes["step_time"] < 100
