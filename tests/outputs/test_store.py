import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import tracemalloc
from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palmfield.errors import OutputError
from palmfield.outputs import netcdf, store
from palmfield.outputs.netcdf import SpillingFile, read_image
from palmfield.outputs.schema import instances, tree, variables_of
from palmfield.outputs.store import DERIVED, MemoryStore, Store, open_result, recover, write_json

# A run in a process of its own: blocks of 10 steps with 1000 vertices of noise, one chunk a block.
CHILD = """
import resource, signal, sys, time
from pathlib import Path
import numpy as np
from palmfield.errors import OutputError
from palmfield.outputs import store
store.FLUSH_SECONDS = 0.0
# A shell that runs tests in the background has its children ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
random = np.random.default_rng(0)
target = store.Store(Path(sys.argv[1]), {"/skin/p": {"rest_position": np.zeros((1000, 3))}})
def block(k, noise=None):
    noise = random.normal(size=(10, 1000, 3)).astype(np.float32) if noise is None else noise
    return {"/": {"time": len(noise) * k + np.arange(float(len(noise)))}, "/skin/p": {"displacement": noise}}
"""
ENDLESS = """
k = 0
try:
    while True:
        target.append(block(k))
        k += 1
        print(k, flush=True)
        time.sleep(0.01)
except KeyboardInterrupt:
    target.finish({"reason": "stopped by Ctrl-C"}, complete=False)
"""


def _start(script, out):
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", CHILD + script, str(out)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)


def _interrupted(out, number, after=8):
    child = _start(ENDLESS, out)
    for line in child.stdout:
        if int(line) == after:
            break
    child.send_signal(number)
    rest, errors = child.communicate(timeout=60)
    return after + len(rest.splitlines()), errors


def _write_all(out, static, block_arrays, blocks=4, **options):
    target = Store(out, static, **options)
    for k in range(blocks):
        target.append(block_arrays(25 * k, 25))
    return target


def _times(*times):
    return {"/": {"time": np.array(times, dtype=np.float64)}}


def _load(path):
    with open_result(path) as result:
        return result.load()


SMALL = {"/skin/p": {"rest_position": np.zeros((4, 3))}}


@pytest.mark.smoke
def test_round_trip(tmp_path, static_arrays, block_arrays, merge, attributes, monkeypatch):
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)
    target = _write_all(tmp_path / "run", static_arrays, block_arrays, attributes=attributes)
    assert len(list((tmp_path / "run" / ".partial").glob("chunk_*.nc"))) == 4
    path = target.finish({"reason": "done"}, complete=True)
    assert path == tmp_path / "run" / "result.nc"
    assert sorted(p.name for p in path.parent.iterdir()) == ["result.nc"]
    expected = tree(merge(static_arrays, block_arrays(0, 100)), attributes)
    found = _load(path)
    assert [node.path for node in found.subtree] == [node.path for node in expected.subtree]
    xr.testing.assert_equal(found, expected)
    for node in expected.subtree:
        for name, variable in node.variables.items():
            assert found[node.path][name].dtype == variable.dtype
            assert found[node.path][name].attrs == variable.attrs
        assert node.path == "/" or found[node.path].attrs == {
            k: v if isinstance(v, str) else json.dumps(v) for k, v in node.attrs.items()
        }
    assert found.attrs["complete"] == 1
    assert (found.attrs["reason"], found.attrs["scene"]) == ("done", "synthetic")
    assert found.attrs["Conventions"] == "CF-1.11"


def test_a_run_in_memory_gives_the_same(tmp_path, static_arrays, block_arrays, attributes):
    targets = [Store(tmp_path, static_arrays, attributes), MemoryStore(static_arrays, attributes)]
    for target in targets:
        target.append(block_arrays(0, 25))
        target.append(block_arrays(25, 25))
    written, held = (target.finish({"reason": "done"}, complete=True) for target in targets)
    xr.testing.assert_equal(_load(written), held)
    assert held.attrs["complete"] == 1 and held["body/palm"].attrs["body"] == "hand"


def test_the_order_of_the_scene_stays(tmp_path):
    names = ["palm", "finger", "arm"]
    given = {"/stimulus/b": {"scale": 1}, "/stimulus/a": {}}
    target = Store(tmp_path, {f"/skin/{name}": {"rest_position": np.zeros((2, 3))} for name in names}, given)
    target.append(_times(0.0) | {f"/skin/{n}": {"arp": np.zeros((1, 2), np.float32)} for n in reversed(names)})
    found = _load(target.finish({}, True))
    assert list(found.children) == ["skin", "stimulus"]
    assert list(instances(found, "skin")) == names
    assert list(instances(found, "stimulus")) == ["b", "a"]


def test_each_chunk_can_be_read_alone(tmp_path, static_arrays, block_arrays, monkeypatch):
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)
    _write_all(tmp_path, static_arrays, block_arrays)
    arrays, attributes = read_image(tmp_path / ".partial" / "chunk_000003.nc")
    xr.testing.assert_equal(tree(arrays, attributes), tree(block_arrays(50, 25)))


def test_a_finished_result_is_that_of_the_file(tmp_path, static_arrays, block_arrays, attributes):
    target = Store(tmp_path, static_arrays, attributes)
    target.append(block_arrays(0, 25))
    path = target.finish({}, True)
    xr.testing.assert_identical(store.finished_result(path), _load(path))


def test_small_blocks_wait_and_large_ones_are_flushed(tmp_path):
    target = Store(tmp_path, {"/skin/p": {"rest_position": np.zeros((400, 3))}})
    target.append(_times(0.0) | {"/skin/p": {"arp": np.zeros((1, 400), np.float32)}})
    assert not list((tmp_path / ".partial").glob("chunk_*"))
    target.append(_times(*range(1, 6001)) | {"/skin/p": {"arp": np.zeros((6000, 400), np.float32)}})
    assert len(list((tmp_path / ".partial").glob("chunk_*"))) == 1


def test_blocks_are_copied(tmp_path):
    target = Store(tmp_path, SMALL)
    buffer = np.ones((1, 4), np.float32)
    target.append(_times(0.0) | {"/skin/p": {"arp": buffer}})
    buffer[:] = 7.0
    assert _load(target.finish({}, True))["skin/p/arp"].max() == 1.0


def test_variables_without_time_replace_earlier_ones(tmp_path):
    target = Store(tmp_path, {"/skin/p": {"loudest_arp": np.zeros(4, np.float32)}})
    for value in (2.0, 3.0):
        target.append({"/skin/p": {"loudest_arp": np.full(4, value, np.float32), "loudest_time": np.array(value)}})
        target._flush()
    found = _load(target.finish({}, True))["skin/p"]
    assert found["loudest_arp"].values.tolist() == [3.0] * 4 and found["loudest_time"] == 3.0


def test_a_run_without_steps(tmp_path, static_arrays):
    found = _load(Store(tmp_path, static_arrays).finish({"reason": "no steps"}, complete=False))
    xr.testing.assert_equal(found, tree(static_arrays))
    assert found.attrs["complete"] == 0


def test_blocks_that_do_not_go_on_from_earlier_ones_are_refused(tmp_path):
    target = Store(tmp_path, SMALL)
    target.append(_times(0.0, 1.0) | {"/skin/p": {"arp": np.zeros((2, 4), np.float32)}})
    with pytest.raises(OutputError, match="length 3 along 'vertex', but the result has 4"):
        target.append(_times(2.0, 3.0) | {"/skin/p": {"arp": np.zeros((2, 3), np.float32)}})
    with pytest.raises(OutputError, match="earlier blocks contained arp"):
        target.append(_times(2.0, 3.0) | {"/skin/p": {"displacement": np.zeros((2, 4, 3), np.float32)}})
    for times in ((3.0, 3.0), (1.0, 2.0)):
        with pytest.raises(OutputError, match="'time' does not rise"):
            target.append(_times(*times) | {"/skin/p": {"arp": np.zeros((2, 4), np.float32)}})
    target.append(_times(2.0) | {"/skin/p": {"arp": np.ones((1, 4), np.float32)}})
    assert _load(target.finish({}, True)).sizes["time"] == 3


def test_attributes_of_any_kind_become_netcdf(tmp_path):
    own = {"skin": {"air": None}, "ok": True, "n": np.int64(3), "x": 0.5, "names": ["a"], "xml": "y" * 100_000}
    found = _load(Store(tmp_path, SMALL, {"/": own, "/skin/p": {"side": "left"}}).finish({}, True))
    assert json.loads(found.attrs["skin"]) == {"air": None}
    assert json.loads(found.attrs["ok"]) is True
    assert json.loads(found.attrs["names"]) == ["a"]
    assert (found.attrs["n"], found.attrs["x"], len(found.attrs["xml"])) == (3, 0.5, 100_000)
    assert found["skin/p"].attrs["side"] == "left"


# CF Conventions


def _each_variable(file):
    for group in (file, *(g for kind in file.groups.values() for g in kind.groups.values())):
        for name, variable in group.variables.items():
            yield group.name, name, variable


def test_the_file_keeps_to_cf(tmp_path, static_arrays, block_arrays, attributes):
    path = _write_all(tmp_path, static_arrays, block_arrays, attributes=attributes).finish({"reason": "done"}, True)
    seen = 0
    with h5netcdf.File(path, "r") as file:
        assert file.attrs["Conventions"] == "CF-1.11" and file.attrs["title"]
        for group, name, variable in _each_variable(file):
            said = dict(variable.attrs)
            assert said["long_name"], (group, name)
            # Nothing is missing, so nothing may stand for what is missing.
            assert not {"_FillValue", "missing_value", "scale_factor", "add_offset"} & set(said), (group, name)
            text = variable.dtype.kind == "O"
            assert text or variable.dtype.kind in "fi", (group, name)
            assert ("units" in said) != text, (group, name)
            assert len(set(variable.dimensions)) == len(variable.dimensions)
            if variable.dimensions == (name,) and not text:
                assert (np.diff(variable[...]) > 0).all(), (group, name)
            seen += 1
    assert seen > 60


def test_nothing_is_nan_and_silence_has_its_foci(tmp_path, static_arrays, block_arrays):
    found = _load(_write_all(tmp_path, static_arrays, block_arrays).finish({}, True))
    for node in found.subtree:
        for name, variable in node.variables.items():
            if variable.dtype.kind == "f":
                assert np.isfinite(variable.values).all(), (node.path, name)
    pulse = found["stimulus/pulse"]
    assert pulse["sounding"].dtype == bool and not pulse["sounding"].values.all()
    silent = pulse["foci"].values[~pulse["sounding"].values]
    assert len(silent) and np.isfinite(silent).all()


def test_all_times_are_the_roots_and_in_seconds(tmp_path, static_arrays, block_arrays):
    found = _load(_write_all(tmp_path, static_arrays, block_arrays).finish({}, True))
    for dim in ("time", "step_time", "frame_time"):
        assert found[dim].attrs["units"] == "s" and found[dim].dtype == np.float64
        for node in found.subtree:
            assert node.path == "/" or dim not in node.to_dataset(inherit=False).coords
            assert dim not in node.sizes or node.sizes[dim] == found.sizes[dim]
    assert found["skin/tip"]["arp"].sel(time=4e-4, method="nearest").sizes == {"vertex": 127}


def test_other_tools_read_it(tmp_path, static_arrays, block_arrays):
    """A group on its own with xarray; plain HDF5 with h5py: booleans are bytes, names are text."""
    path = _write_all(tmp_path, static_arrays, block_arrays).finish({}, True)
    with xr.open_dataset(path, group="skin/palm", engine="h5netcdf") as skin:
        assert skin["displacement"].dims == ("time", "vertex", "xyz")
    with h5py.File(path) as file:
        assert file["stimulus/pulse/sounding"].dtype == np.int8
        assert file["sensors/nose/channel"].asstr()[...].tolist() == ["normal_displacement", "arp"]


# Reading back


def test_a_result_is_read_where_it_is_used(tmp_path):
    out = tmp_path / "run"
    target = Store(out, {"/skin/p": {"rest_position": np.zeros((1000, 3))}})
    for k in range(10):
        rows = np.full((400, 1000, 3), k, np.float32)
        target.append({"/": {"time": 400.0 * k + np.arange(400.0)}, "/skin/p": {"displacement": rows}})
    target.finish({}, True)
    tracemalloc.start()
    with open_result(out) as result:
        skin = result["skin/p"]
        assert skin["displacement"].isel(time=3999).values.max() == 9.0
        assert skin["displacement"].isel(vertex=5, xyz=2, time=slice(0, 3000, 400)).values.tolist() == list(range(8))
    assert tracemalloc.get_traced_memory()[1] < 8e6 < 4000 * 1000 * 3 * 4
    tracemalloc.stop()


def test_a_file_of_schema_1_is_refused_with_a_sentence(tmp_path):
    path = tmp_path / "result.nc"
    xr.Dataset({"skin_position": (("vertex", "xyz"), np.zeros((4, 3)))}, attrs={"run_id": "x"}).to_netcdf(
        path, engine="h5netcdf"
    )
    with pytest.raises(OutputError, match=r"result\.nc has schema 1 .*, .*reads schema 2; run its scene again, or"):
        open_result(path)


@pytest.mark.parametrize(
    ("attributes", "words"), [({}, "palmfield did not write"), ({"schema_version": 3}, "has schema 3")]
)
def test_other_files_are_refused(tmp_path, attributes, words):
    xr.Dataset(attrs=attributes).to_netcdf(tmp_path / "x.nc", engine="h5netcdf")
    with pytest.raises(OutputError, match=words):
        open_result(tmp_path / "x.nc")


def test_files_that_are_no_results_are_named(tmp_path):
    (tmp_path / "result.nc").write_text("no")
    for path in (tmp_path, tmp_path / "result.nc", tmp_path / "missing.nc"):
        with pytest.raises(OutputError, match=r"\.nc is not a readable result"):
            open_result(path)


# Folders


def test_an_unfinished_run_is_not_overwritten(tmp_path):
    Store(tmp_path, SMALL)
    for overwrite in (False, True):
        with pytest.raises(OutputError, match=f"`palmfield recover {tmp_path}` first"):
            Store(tmp_path, SMALL, overwrite=overwrite)


@pytest.mark.parametrize("name", ["result.nc", *DERIVED])
def test_another_runs_results_are_not_overwritten(tmp_path, name):
    (tmp_path / name).write_text("of another run")
    with pytest.raises(OutputError) as caught:
        Store(tmp_path, SMALL)
    assert str(tmp_path) in str(caught.value) and name in str(caught.value) and "--overwrite" in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    Store(tmp_path, SMALL, overwrite=True).finish({}, True)


def test_other_files_in_the_folder_are_in_nobodys_way(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    Store(tmp_path, SMALL).finish({}, True)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_an_old_result_is_replaced_only_by_a_new_one(tmp_path, static_arrays, block_arrays):
    _write_all(tmp_path, static_arrays, block_arrays, 1).finish({"reason": "first"}, True)
    (tmp_path / "scene.png").write_text("of the first")
    second = _write_all(tmp_path, static_arrays, block_arrays, 2, overwrite=True)
    assert _load(tmp_path).attrs["reason"] == "first" and (tmp_path / "scene.png").exists()
    second.finish({"reason": "second"}, True)
    assert _load(tmp_path).attrs["reason"] == "second"
    # A picture of another run beside this result would lie.
    assert not (tmp_path / "scene.png").exists()


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot write .*file/run: Not a directory; choose"):
        Store(tmp_path / "file" / "run", SMALL)


# Cut off


def test_kill_9_leaves_what_was_flushed(tmp_path):
    count, _ = _interrupted(tmp_path, signal.SIGKILL)
    assert not (tmp_path / "result.nc").exists()
    found = _load(recover(tmp_path))
    steps = found.sizes["time"]
    # Every block that the child counted was flushed before; one more may have been.
    assert 10 * count <= steps <= 10 * (count + 1)
    assert found["time"].values.tolist() == list(range(steps))
    noise = np.random.default_rng(0).normal(size=(steps, 1000, 3)).astype(np.float32)
    np.testing.assert_array_equal(found["skin/p/displacement"].values, noise)
    assert found.attrs["complete"] == 0
    assert "recovered after the run was interrupted" in found.attrs["reason"]
    with pytest.raises(OutputError, match="no unfinished run"):
        recover(tmp_path)


def test_ctrl_c_keeps_every_block(tmp_path):
    count, errors = _interrupted(tmp_path, signal.SIGINT)
    assert errors == ""
    found = _load(tmp_path / "result.nc")
    assert 10 * count <= found.sizes["time"] <= 10 * (count + 1)
    assert found["time"].values.tolist() == list(range(found.sizes["time"]))
    assert (found.attrs["complete"], found.attrs["reason"]) == (0, "stopped by Ctrl-C")
    assert not (tmp_path / ".partial").exists()


@pytest.mark.parametrize("place", ["fsync", "replace"])
def test_ctrl_c_inside_a_flush_neither_loses_nor_doubles(tmp_path, monkeypatch, place):
    target = Store(tmp_path, SMALL)
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)
    real = getattr(os, place)

    def interrupted(*args):
        real(*args)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(os, place, interrupted)
        target.append(_times(0.0, 1.0, 2.0))
    found = _load(target.finish({"reason": "Ctrl-C"}, False))
    assert found["time"].values.tolist() == [0.0, 1.0, 2.0]
    assert found.attrs["unreadable_chunks"] == 0


@pytest.mark.parametrize("at", [1, 40, 150])
def test_ctrl_c_while_the_result_is_put_together_leaves_the_chunks(tmp_path, static_arrays, block_arrays, at):
    """HDF5 calls Python to write: the interrupt waits until HDF5 is out of it."""
    script = f"""
for k in range(4):
    target.append(block(k))
from palmfield.outputs import netcdf
real, count = netcdf.SpillingFile.write, 0
def write(self, data):
    global count
    count += 1
    if count == {at}:
        signal.raise_signal(signal.SIGINT)
    return real(self, data)
netcdf.SpillingFile.write = write
try:
    target.finish({{}}, complete=True)
except KeyboardInterrupt:
    print("interrupted")
else:
    print("finished", count)
"""
    child = _start(script, tmp_path)
    said, errors = child.communicate(timeout=60)
    assert (child.returncode, errors) == (0, "")
    if said.startswith("finished"):
        assert int(said.split()[1]) < at
        return
    assert not (tmp_path / "result.nc").exists() and not (tmp_path / "result.nc.tmp").exists()
    assert _load(recover(tmp_path)).sizes["time"] == 40


def test_a_full_disk_leaves_what_was_flushed(tmp_path):
    """A file-size limit stands in for a full disk: the system refuses the write in the same way (EFBIG for ENOSPC)."""
    script = """
for k in range(3):
    target.append(block(k))
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, resource.RLIM_INFINITY))
try:
    target.append({"/": {"time": 30 + np.arange(20.0)},
                   "/skin/p": {"displacement": random.normal(size=(20, 1000, 3)).astype("f4")}})
except OutputError as error:
    print(error)
try:
    target.finish({}, complete=True)
except OutputError as error:
    print(error)
"""
    child = _start(script, tmp_path)
    said, errors = child.communicate(timeout=60)
    assert (child.returncode, errors) == (0, "")
    flush, finish = said.splitlines()
    assert "chunk_000004.nc: File too large; 3 earlier chunks are safe" in flush
    assert "result.nc: File too large; 3 chunks are safe" in finish
    assert f"`palmfield recover {tmp_path}`" in flush and f"`palmfield recover {tmp_path}`" in finish
    assert sorted(p.name for p in tmp_path.iterdir()) == [".partial"]
    assert sorted(p.name for p in (tmp_path / ".partial").iterdir()) == [
        *(f"chunk_00000{k}.nc" for k in (1, 2, 3)),
        "static.nc",
    ]
    assert _load(recover(tmp_path)).sizes["time"] == 30


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(room=st.integers(0, 130_000), seed=st.integers(0, 2**32 - 1))
def test_hdf5_never_learns_of_a_full_disk(tmp_path, room, seed):
    """Whatever has no room on the disk is read back as it was written, and the error is there afterwards."""
    path = tmp_path / "x.nc"
    values = np.random.default_rng(seed).normal(size=(30, 1000))
    real = os.pwrite

    def full(file, data, offset):
        if offset >= room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(file, data[: max(1, room - offset)], offset)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(netcdf.os, "pwrite", full)
        disk = SpillingFile(path)
        with h5py.File(disk, "w") as file:
            made = file.create_dataset("x", values.shape, "f8", chunks=(7, 1000), compression="gzip")
            for start in range(0, 30, 4):
                made[start : start + 4] = values[start : start + 4]
            np.testing.assert_array_equal(made[...], values)
        disk.close()
    assert disk.lost is not None and disk.lost.errno == errno.ENOSPC


def test_a_spilling_file_is_a_file(tmp_path):
    disk = SpillingFile(tmp_path / "x.nc")
    values = np.arange(30_000.0)
    with h5py.File(disk, "w") as file:
        file["x"] = values
    disk.close()
    assert disk.lost is None
    with h5py.File(tmp_path / "x.nc") as file:
        np.testing.assert_array_equal(file["x"][...], values)


def test_a_flush_that_failed_is_made_up_for_when_there_is_room(tmp_path, monkeypatch):
    target = Store(tmp_path, SMALL)
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch, pytest.raises(OutputError, match="No space left on device"):
        patch.setattr(os, "fsync", full)
        target.append(_times(0.0, 1.0, 2.0))
    found = _load(target.finish({}, True))
    assert (found.sizes["time"], found.attrs["complete"]) == (3, 1)


def test_a_flush_lost_for_good_makes_the_result_incomplete(tmp_path, monkeypatch):
    target = Store(tmp_path, SMALL)
    real = os.replace

    def full(source, to):
        if "chunk" in str(to):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(source, to)

    target.append(_times(0.0, 1.0, 2.0))
    monkeypatch.setattr(os, "replace", full)
    found = _load(target.finish({"reason": "done"}, True))
    assert found.attrs["complete"] == 0
    assert "No space left on device" in found.attrs["reason"]


# Damage


def test_half_a_chunk_is_left_out_and_counted(tmp_path, static_arrays, block_arrays, monkeypatch):
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)
    _write_all(tmp_path, static_arrays, block_arrays)
    whole = tmp_path / ".partial" / "chunk_000002.nc"
    whole.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    (tmp_path / ".partial" / "chunk_000005.nc.tmp").write_bytes(b"half")
    found = _load(recover(tmp_path))
    assert found.sizes["time"] == 75
    assert found.attrs["unreadable_chunks"] == 2
    assert "2 of 5 chunks could not be read" in found.attrs["reason"]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.floats(0, 0.9999), change=st.integers(1, 255))
def test_one_wrong_byte_anywhere_in_a_chunk_is_noticed(tmp_path, where, change):
    shutil.rmtree(tmp_path / "run", ignore_errors=True)
    target = Store(tmp_path / "run", {"/skin/p": {"rest_position": np.zeros((50, 3))}})
    load = np.random.default_rng(1).random((5, 50), np.float32)
    target.append(_times(*range(5)) | {"/skin/p": {"arp": load}})
    target._flush()
    chunk = tmp_path / "run" / ".partial" / "chunk_000001.nc"
    data = bytearray(chunk.read_bytes())
    data[int(where * len(data))] ^= change
    chunk.write_bytes(data)
    found = _load(recover(tmp_path / "run"))
    assert found.attrs["unreadable_chunks"] == 1
    assert (found["skin/p"].sizes["vertex"], "arp" in found["skin/p"]) == (50, False)


def test_a_kill_after_the_result_is_in_place_loses_nothing(tmp_path, static_arrays, block_arrays, monkeypatch):
    target = _write_all(tmp_path, static_arrays, block_arrays)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", lambda _: None)
        target.finish({"reason": "done"}, True)
    assert (tmp_path / ".partial").exists()
    found = _load(recover(tmp_path))
    assert (found.attrs["complete"], found.attrs["reason"], found.sizes["time"]) == (1, "done", 100)
    assert not (tmp_path / ".partial").exists()


def test_nothing_to_recover(tmp_path):
    with pytest.raises(OutputError, match="no unfinished run"):
        recover(tmp_path)
    (tmp_path / ".partial").mkdir()
    with pytest.raises(OutputError, match=r"no readable static\.nc"):
        recover(tmp_path)


def test_what_another_schema_left_is_not_recovered(tmp_path):
    Store(tmp_path, SMALL)
    static = tmp_path / ".partial" / "static.nc"
    memory = static.read_bytes()[: -store.SEAL_BYTES]
    static.write_bytes(memory)
    with h5py.File(static, "a") as file:
        del file.attrs["schema_version"]
    store._write_sealed(static, static.read_bytes())
    with pytest.raises(OutputError, match="written by a palmfield version with schema 1"):
        recover(tmp_path)


def test_memory_of_the_result_stays_below_its_size(tmp_path):
    """Joining reads one chunk at a time and writes to the disk: 72 MB of noise must not be held at once."""
    script = """
for k in range(12):
    target.append(block(k, random.normal(size=(500, 1000, 3)).astype(np.float32)))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
target.finish({}, complete=True)
print(before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
    child = _start(script, tmp_path)
    said, errors = child.communicate(timeout=120)
    assert errors == ""
    before, after = map(int, said.split())
    assert (tmp_path / "result.nc").stat().st_size > 55e6
    assert (after - before) * 1024 < 30e6
    with open_result(tmp_path) as result:
        assert result.sizes["time"] == 6_000


def test_a_block_takes_little_time(tmp_path, static_arrays, block_arrays, yardsticks):
    """Of the order of a millisecond for ten groups: a store must not be what a step waits for."""
    target = Store(tmp_path, static_arrays)
    blocks = [block_arrays(k, 2) for k in range(0, 100, 2)]
    assert yardsticks(lambda: [target.append(block) for block in blocks]) < len(blocks)


def test_every_variable_of_the_schema_is_stored_as_it_says(tmp_path, static_arrays, block_arrays):
    path = _write_all(tmp_path, static_arrays, block_arrays).finish({}, True)
    with h5netcdf.File(path, "r") as file:
        for group, name, variable in _each_variable(file):
            known = variables_of(group)
            if name in known:
                assert variable.dimensions == known[name].dims
                own = {k: v for k, v in variable.attrs.items() if k not in ("dtype", "coordinates")}
                assert own == known[name].attributes


def test_a_group_is_enough_by_itself(tmp_path, static_arrays, block_arrays):
    """What a reader who opens one group finds: times, places, names of components, and the push along the normal."""
    path = _write_all(tmp_path, static_arrays, block_arrays).finish({}, True)
    with xr.open_dataset(path, group="skin/palm", engine="h5netcdf", decode_times=False) as skin:
        assert {"time", "xyz", "rest_position"} <= set(skin.coords)
        assert skin["displacement"].sel(xyz="z").sel(time=0.01, method="nearest").dims == ("vertex",)
        normal = (skin["displacement"] * skin["rest_normal"]).sum("xyz")
        np.testing.assert_allclose(skin["normal_displacement"], normal, atol=1e-12)
        assert skin["normal_displacement"].attrs["sign"] == "positive outward: a push is negative"
    with xr.open_dataset(path, group="forces/palm", engine="h5netcdf", decode_times=False) as forces:
        assert forces["force"].sel(step_time=0.01, method="nearest").sel(xyz="z").shape == ()


def test_json(tmp_path):
    path = tmp_path / "summary.json"
    write_json(path, {"a": np.float32(0.5), "b": np.arange(2), "c": None})
    assert json.loads(path.read_text()) == {"a": 0.5, "b": [0, 1], "c": None}
    for bad in ({"a": float("nan")}, {"a": object()}):
        with pytest.raises(OutputError, match="as JSON"):
            write_json(path, bad)
    with pytest.raises(OutputError, match="Not a directory"):
        write_json(path / "x.json", {})
    assert json.loads(path.read_text())["c"] is None


@pytest.mark.parametrize(("noise", "packed"), [(0.0, "gzip"), (1.0, None)])
def test_a_variable_is_packed_where_that_saves_a_third(tmp_path, static_arrays, block_arrays, noise, packed):
    store, blocks = Store(tmp_path, static_arrays), [block_arrays(0, 4), block_arrays(4, 4)]
    random = np.random.default_rng(0)
    written = []
    for block in blocks:
        arp = noise * random.normal(size=block["/skin/palm"]["arp"].shape).astype(np.float32)
        written.append(arp)
        store.append(block | {"/skin/palm": block["/skin/palm"] | {"arp": arp}})
    path = store.finish({}, complete=True)
    with h5py.File(path) as file:
        stored = file["skin/palm/arp"]
        assert stored.compression == packed
        np.testing.assert_array_equal(stored[...], np.concatenate(written))
