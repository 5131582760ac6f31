"""A whole run: what it writes, and what is left when it is cut off."""

import json
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh
import xarray as xr
from palmfield.report import format_report
from palmfield.runner import recover
from pxr import Usd, UsdGeom

import palmfield
from palmfield.outputs.usd import validate_usd
from palmfield.skin.fem.solver import static

FILES = ("result.nc", "summary.json", "pressure.png", "displacement.png", "scene.png", "scene.usdc")


@pytest.fixture(scope="module")
def finished(tmp_path_factory, module_scene):
    out = tmp_path_factory.mktemp("run") / "out"
    scene = palmfield.load(module_scene())
    result = palmfield.run(scene, out, progress=False)
    with xr.open_dataset(out / "result.nc", engine="h5netcdf") as ds:
        yield result, ds.load()


@pytest.mark.smoke
def test_everything_is_written(finished):
    result, ds = finished
    assert set(result.files) == set(FILES)
    assert all((result.out / name).stat().st_size > 1000 for name in FILES)
    assert not (result.out / ".partial").exists()
    assert ds.attrs["complete"] == 1


@pytest.mark.smoke
def test_result_is_labelled_and_consistent(finished):
    _, ds = finished
    for name in (
        "time",
        "skin_position",
        "normal_displacement",
        "normal_velocity",
        "arp",
        "drive_amplitude",
        "drive_phase",
    ):
        assert ds[name].attrs["units"] and ds[name].attrs["long_name"]
    assert ds.sizes["time"] == 31 and ds.sizes["step_time"] == 15
    # Velocity is the displacement's slope.
    u, v, t = (ds[n].values.astype(float) for n in ("normal_displacement", "normal_velocity", "time"))
    vertex = np.abs(u).max(axis=0).argmax()
    slope = np.gradient(u[:, vertex], t)
    assert np.corrcoef(slope, v[:, vertex])[0, 1] > 0.98
    # The force is the mean over its step of the ARP summed over the disc (Simpson over begin, middle and end).
    corners = ds["skin_position"].values[ds["skin_faces"].values]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total = (area * ds["arp"].values[:, ds["skin_faces"].values].mean(axis=2)).sum(axis=1)
    force = np.linalg.norm(ds["arp_force"].values, axis=1)
    begin = np.searchsorted(ds["time"].values, ds["step_time"].values - 1e-9)
    mean = (total[begin] + 4 * total[begin + 1] + total[begin + 2]) / 6
    np.testing.assert_allclose(force, mean, rtol=0.05, atol=0.01 * force.max())
    for key in ("array", "stimulus", "skin", "driver", "material", "conventions", "versions"):
        assert json.loads(ds.attrs[key])


@pytest.mark.smoke
def test_summary_holds_the_tables_numbers(finished):
    result, ds = finished
    stored = json.loads((result.out / "summary.json").read_text())
    levels = ("level_morioka_griffin_2006_dB_SL", "level_afferent_human_dB_SL")
    peaks = ("peak_pressure_Pa", "peak_arp_Pa", "total_force_peak_N", "peak_displacement_m", "rms_displacement_m")
    for key in (*peaks, "displacement_error_relative", *levels):
        assert np.isfinite(stored[key]), key
    assert stored["peak_displacement_m"] == pytest.approx(float(np.abs(ds["normal_displacement"]).max()))
    assert 0 < stored["displacement_error_relative"] < 1


@pytest.mark.smoke
def test_usd_passes_the_validators_and_moves(finished):
    result, ds = finished
    assert validate_usd(result.files["scene.usdc"]) == []
    stage = Usd.Stage.Open(str(result.files["scene.usdc"]))
    moving = [
        UsdGeom.PrimvarsAPI(p).GetPrimvar("normal_displacement")
        for p in stage.Traverse()
        if UsdGeom.PrimvarsAPI(p).HasPrimvar("normal_displacement")
    ]
    assert len(moving) == 1 and len(moving[0].GetTimeSamples()) == ds.sizes["time"]


def test_halving_p0_quarters_the_displacement(small_scene, tmp_path):
    peaks = []
    for p0 in (2.0, 1.0):
        scene = palmfield.load(small_scene(array={"p0_Pa_m": p0}))
        skin = scene.skin
        sound = skin.chain.sound(np.array([0, 0, 0.12]), skin.pose())
        settled = static(skin.rig.system, sound.skin_force)
        peaks.append(np.abs(skin.chain.surface_operator @ settled).max())
    assert peaks[0] / peaks[1] == pytest.approx(4, rel=1e-4)


def test_pictures_of_a_run_cut_off_while_drawing_can_be_made_later(small_scene, tmp_path):
    out = tmp_path / "out"
    palmfield.run(palmfield.load(small_scene()), out, progress=False)
    summary = (out / "summary.json").read_text()
    for name in ("scene.usdc", "displacement.png"):
        (out / name).unlink()
    assert set(recover(out)) == set(FILES)
    assert (out / "summary.json").read_text() == summary
    assert (out / "scene.usdc").exists() and (out / "displacement.png").exists()


@pytest.mark.parametrize("changes", [{"stimulus": {"drive_amplitude": 0}}, {"skin": {"step_s": 0.001}}], ids=str)
def test_silence_and_a_coarse_step_end_well(changes, small_scene, tmp_path):
    result = palmfield.run(palmfield.load(small_scene(**changes)), tmp_path / "out", progress=False)
    assert set(result.files) == set(FILES)
    assert "displacement_error_relative" in result.summary or result.summary["peak_displacement_m"] == 0
    assert "peak ARP" in format_report(result.summary)


def test_force_on_a_mesh_of_large_faces(small_scene, tmp_path):
    """A box of twelve faces feels the force that the fine skin on its lit face adds up to."""
    path = small_scene(
        stimulus={"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None},
        skin={"shape": "mesh", "mesh": "box.obj", "mesh_unit": "mm", "patch_site": "centre", "patch_radius_m": 0.028,
              "radius_m": None, "thickness_m": None, "element_m": 0.004},
    )  # fmt: skip
    box = trimesh.creation.box((60, 60, 30))
    box.apply_translation((0, 0, -15))
    box.export(path.with_name("box.obj"))
    skin = palmfield.load(path).skin
    sound = skin.chain.sound(np.array([0, 0, 0.12]), skin.pose())
    quadrature = skin.rig.quadrature
    load, _ = skin.chain.arp_at(quadrature.points, quadrature.normals, sound.pose, sound.drive)
    on_patch = float(load @ quadrature.weights)
    force, _ = skin.chain.resultant(sound)
    # Side lobes beyond the patch add a little.
    assert 1.0 < -force[2] / on_patch < 1.08


START = "import palmfield, sys; palmfield.run(palmfield.load(sys.argv[1]), sys.argv[2], duration_s=30, progress=False)"


@pytest.fixture
def begin():
    """Starts a run of 30 s in a process of its own and returns when its first chunk is on the disk."""
    started: list[subprocess.Popen] = []

    def start(path, out, **options):
        command = [sys.executable, "-c", START, str(path), str(out)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **options)
        started.append(process)
        deadline = time.monotonic() + 60
        while not list(out.glob(".partial/chunk_*.nc")):
            assert process.poll() is None and time.monotonic() < deadline, process.stderr.read()
            time.sleep(0.05)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


def read(out):
    with xr.open_dataset(out / "result.nc", engine="h5netcdf") as ds:
        return ds.load()


def test_interrupt_keeps_what_was_computed(begin, small_scene, tmp_path):
    out = tmp_path / "out"
    process = begin(small_scene(), out)
    process.send_signal(signal.SIGINT)
    process.wait(60)
    assert process.returncode != 0
    ds = read(out)
    assert ds.attrs["complete"] == 0 and "KeyboardInterrupt" in ds.attrs["reason"]
    assert ds.sizes["time"] >= 2
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
    ds = read(out)
    assert ds.attrs["complete"] == 0 and ds.sizes["time"] >= 2
    assert np.abs(ds["normal_displacement"].values).max() > 0


def test_full_disk_keeps_what_was_written(begin, small_scene, tmp_path):
    """A limit on file sizes, set from outside once a chunk is there, makes writes fail as a full disk does."""
    out = tmp_path / "out"
    process = begin(small_scene(), out, preexec_fn=lambda: signal.signal(signal.SIGXFSZ, signal.SIG_IGN))
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (2000, 2000))
    _, error = process.communicate(timeout=120)
    assert process.returncode != 0 and "OutputError" in error and "Traceback" in error
    subprocess.run([sys.executable, "-m", "palmfield", "recover", str(out)], check=True, timeout=60)
    ds = read(out)
    assert ds.attrs["complete"] == 0 and ds.sizes["time"] >= 2


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
    with pytest.raises(palmfield.SceneError, match="reaches into the array"):
        palmfield.run(scene, tmp_path / "out", duration_s=1.0, progress=False)
    ds = read(tmp_path / "out")
    assert ds.attrs["complete"] == 0 and 10 < ds.sizes["step_time"] < 100
