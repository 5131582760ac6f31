import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palmfield.errors import OutputError
from palmfield.outputs import store
from palmfield.outputs.schema import dataset
from palmfield.outputs.store import Store, load, recover, write_json

# A run in a process of its own: blocks of 10 steps with 1000 vertices of noise, one chunk a block.
CHILD = """
import resource, signal, sys, time
from pathlib import Path
import numpy as np
from palmfield.errors import OutputError
from palmfield.outputs import store
from palmfield.outputs.schema import dataset
store.FLUSH_SECONDS = 0.0
# A shell that runs tests in the background has its children ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
random = np.random.default_rng(0)
target = store.Store(Path(sys.argv[1]), dataset(skin_position=np.zeros((1000, 3))))
def block(k):
    noise = random.normal(size=(10, 1000)).astype(np.float32)
    return dataset(time=10.0 * k + np.arange(10.0), normal_displacement=noise)
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
    rest, errors = child.communicate(timeout=30)
    return after + len(rest.splitlines()), errors


def _write_all(out, static, block_arrays, blocks=4):
    target = Store(out, static)
    for k in range(blocks):
        target.append(dataset(**block_arrays(25 * k, 25)))
    return target


@pytest.mark.smoke
def test_round_trip(tmp_path, static, static_arrays, block_arrays, monkeypatch):
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)
    target = _write_all(tmp_path / "run", static, block_arrays)
    assert len(list((tmp_path / "run" / ".partial").glob("chunk_*.nc"))) == 4
    path = target.finish({"reason": "done"}, complete=True)
    assert path == tmp_path / "run" / "result.nc"
    assert sorted(p.name for p in path.parent.iterdir()) == ["result.nc"]
    expected = dataset(**static_arrays, **block_arrays(0, 100))
    found = load(path)
    xr.testing.assert_equal(found, expected)
    for name in expected.variables:
        assert found[name].dtype == expected[name].dtype or name in ("xyz", "corner", "pose7")
        assert found[name].attrs == expected[name].attrs
    assert found.attrs["complete"] == 1
    assert found.attrs["reason"] == "done"


def test_each_chunk_can_be_read_alone(tmp_path, static, block_arrays, monkeypatch):
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)
    _write_all(tmp_path, static, block_arrays)
    xr.testing.assert_equal(load(tmp_path / ".partial" / "chunk_000003.nc"), dataset(**block_arrays(50, 25)))


def test_small_blocks_wait_and_large_ones_are_flushed(tmp_path, static):
    target = Store(tmp_path, static)
    target.append(dataset(time=np.zeros(1), arp=np.zeros((1, 469), np.float32)))
    assert not list((tmp_path / ".partial").glob("chunk_*"))
    target.append(dataset(time=np.zeros(5000), arp=np.zeros((5000, 469), np.float32)))
    assert len(list((tmp_path / ".partial").glob("chunk_*"))) == 1


def test_blocks_are_copied(tmp_path, static):
    target = Store(tmp_path, static)
    buffer = np.ones((1, 469), np.float32)
    target.append(dataset(time=np.zeros(1), arp=buffer))
    buffer[:] = 7.0
    assert load(target.finish({}, True))["arp"].max() == 1.0


def test_variables_without_time_replace_earlier_ones(tmp_path):
    target = Store(tmp_path, dataset(skin_pressure=np.zeros(4, np.float32)))
    target.append(dataset(skin_pressure=np.full(4, 2.0, np.float32)))
    target.append(dataset(skin_pressure=np.full(4, 3.0, np.float32)))
    assert load(target.finish({}, True))["skin_pressure"].values.tolist() == [3.0] * 4


def test_a_run_without_steps(tmp_path, static):
    found = load(Store(tmp_path, static).finish({"reason": "no steps"}, complete=False))
    xr.testing.assert_equal(found, static)
    assert found.attrs["complete"] == 0


def test_blocks_with_other_variables_are_refused(tmp_path, static):
    target = Store(tmp_path, static)
    target.append(dataset(time=np.zeros(2), arp=np.zeros((2, 469), np.float32)))
    with pytest.raises(OutputError, match="3 along 'vertex' where the run has 469"):
        target.append(dataset(time=np.zeros(2), arp=np.zeros((2, 3), np.float32)))
    with pytest.raises(OutputError, match="earlier ones held arp, time"):
        target.append(dataset(time=np.zeros(2), focus=np.zeros((2, 3))))


def test_attributes_of_any_kind_become_netcdf(tmp_path, static):
    attrs = {"scene": {"air": None}, "ok": True, "n": np.int64(3), "x": 0.5, "names": ["a"], "xml": "y" * 100_000}
    found = load(Store(tmp_path, static).finish(attrs, True)).attrs
    assert json.loads(found["scene"]) == {"air": None}
    assert json.loads(found["ok"]) is True
    assert json.loads(found["names"]) == ["a"]
    assert (found["n"], found["x"], len(found["xml"])) == (3, 0.5, 100_000)


def test_an_unfinished_run_is_not_overwritten(tmp_path, static):
    Store(tmp_path, static)
    with pytest.raises(OutputError, match=f"`palmfield recover {tmp_path}` first"):
        Store(tmp_path, static)


def test_an_old_result_is_replaced_only_by_a_new_one(tmp_path, static, block_arrays):
    _write_all(tmp_path, static, block_arrays, 1).finish({"reason": "first"}, True)
    second = _write_all(tmp_path, static, block_arrays, 2)
    assert load(tmp_path / "result.nc").attrs["reason"] == "first"
    second.finish({"reason": "second"}, True)
    assert load(tmp_path / "result.nc").attrs["reason"] == "second"


def test_a_folder_that_cannot_be_written_is_named(tmp_path, static):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot write .*file/run: Not a directory; choose"):
        Store(tmp_path / "file" / "run", static)


def test_kill_9_leaves_what_was_flushed(tmp_path):
    count, _ = _interrupted(tmp_path, signal.SIGKILL)
    assert not (tmp_path / "result.nc").exists()
    found = load(recover(tmp_path))
    steps = found.sizes["time"]
    # Every block that the child counted was flushed before; one more may have been.
    assert 10 * count <= steps <= 10 * (count + 1)
    assert found["time"].values.tolist() == list(range(steps))
    noise = np.random.default_rng(0).normal(size=(steps, 1000)).astype(np.float32)
    np.testing.assert_array_equal(found["normal_displacement"].values, noise)
    assert found.attrs["complete"] == 0
    assert "recovered after the run was cut off" in found.attrs["reason"]
    with pytest.raises(OutputError, match="no unfinished run"):
        recover(tmp_path)


def test_ctrl_c_keeps_every_block(tmp_path):
    count, errors = _interrupted(tmp_path, signal.SIGINT)
    assert errors == ""
    found = load(tmp_path / "result.nc")
    assert 10 * count <= found.sizes["time"] <= 10 * (count + 1)
    assert found["time"].values.tolist() == list(range(found.sizes["time"]))
    assert (found.attrs["complete"], found.attrs["reason"]) == (0, "stopped by Ctrl-C")
    assert not (tmp_path / ".partial").exists()


@pytest.mark.parametrize("place", ["fsync", "replace"])
def test_ctrl_c_inside_a_flush_neither_loses_nor_doubles(tmp_path, static, monkeypatch, place):
    target = Store(tmp_path, static)
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)
    real = getattr(os, place)

    def interrupted(*args):
        real(*args)
        raise KeyboardInterrupt

    block = dataset(time=np.arange(3.0))
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(os, place, interrupted)
        target.append(block)
    found = load(target.finish({"reason": "Ctrl-C"}, False))
    assert found["time"].values.tolist() == [0.0, 1.0, 2.0]
    assert found.attrs["unreadable_chunks"] == 0


def test_a_full_disk_leaves_what_was_flushed(tmp_path):
    """A file-size limit stands in for a full disk: the system refuses the write in the same way (EFBIG for ENOSPC)."""
    script = """
for k in range(3):
    target.append(block(k))
resource.setrlimit(resource.RLIMIT_FSIZE, (45_000, resource.RLIM_INFINITY))
try:
    target.append(dataset(time=30 + np.arange(20.0), normal_displacement=random.normal(size=(20, 1000)).astype("f4")))
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
    assert sorted(p.name for p in (tmp_path / ".partial").iterdir()) == [
        *(f"chunk_00000{k}.nc" for k in (1, 2, 3)),
        "static.nc",
    ]
    assert load(recover(tmp_path)).sizes["time"] == 30


def test_a_flush_that_failed_is_made_up_for_when_there_is_room(tmp_path, static, monkeypatch):
    target = Store(tmp_path, static)
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch, pytest.raises(OutputError, match="No space left on device"):
        patch.setattr(os, "fsync", full)
        target.append(dataset(time=np.arange(3.0)))
    found = load(target.finish({}, True))
    assert (found.sizes["time"], found.attrs["complete"]) == (3, 1)


def test_a_flush_lost_for_good_makes_the_result_incomplete(tmp_path, static, monkeypatch):
    target = Store(tmp_path, static)
    real = os.replace

    def full(source, to):
        if "chunk" in str(to):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(source, to)

    target.append(dataset(time=np.arange(3.0)))
    monkeypatch.setattr(os, "replace", full)
    found = load(target.finish({"reason": "done"}, True))
    assert found.attrs["complete"] == 0
    assert "No space left on device" in found.attrs["reason"]


def test_half_a_chunk_is_left_out_and_counted(tmp_path, static, block_arrays, monkeypatch):
    monkeypatch.setattr(store, "FLUSH_SECONDS", 0.0)
    _write_all(tmp_path, static, block_arrays)
    whole = tmp_path / ".partial" / "chunk_000002.nc"
    whole.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    (tmp_path / ".partial" / "chunk_000005.nc.tmp").write_bytes(b"half")
    found = load(recover(tmp_path))
    assert found.sizes["time"] == 75
    assert found.attrs["unreadable_chunks"] == 2
    assert "2 of 5 chunks could not be read" in found.attrs["reason"]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.floats(0, 0.9999), change=st.integers(1, 255))
def test_one_wrong_byte_anywhere_in_a_chunk_is_noticed(tmp_path, where, change):
    shutil.rmtree(tmp_path / "run", ignore_errors=True)
    target = Store(tmp_path / "run", dataset(skin_position=np.zeros((50, 3))))
    target.append(dataset(time=np.arange(5.0), arp=np.random.default_rng(1).random((5, 50), np.float32)))
    target._flush()
    chunk = tmp_path / "run" / ".partial" / "chunk_000001.nc"
    data = bytearray(chunk.read_bytes())
    data[int(where * len(data))] ^= change
    chunk.write_bytes(data)
    found = load(recover(tmp_path / "run"))
    assert found.attrs["unreadable_chunks"] == 1
    assert (found.sizes["vertex"], "arp" in found) == (50, False)


def test_a_kill_after_the_result_is_in_place_loses_nothing(tmp_path, static, block_arrays, monkeypatch):
    target = _write_all(tmp_path, static, block_arrays)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", lambda _: None)
        target.finish({"reason": "done"}, True)
    assert (tmp_path / ".partial").exists()
    found = load(recover(tmp_path))
    assert (found.attrs["complete"], found.attrs["reason"], found.sizes["time"]) == (1, "done", 100)
    assert not (tmp_path / ".partial").exists()


def test_nothing_to_recover(tmp_path):
    with pytest.raises(OutputError, match="no unfinished run"):
        recover(tmp_path)
    (tmp_path / ".partial").mkdir()
    with pytest.raises(OutputError, match=r"no readable static\.nc"):
        recover(tmp_path)


def test_load_names_a_file_that_is_no_result(tmp_path):
    (tmp_path / "result.nc").write_text("no")
    with pytest.raises(OutputError, match=r"result\.nc is not a readable result"):
        load(tmp_path / "result.nc")


def test_memory_of_the_result_stays_below_its_raw_size(tmp_path):
    """Joining reads one chunk at a time: 160 MB of zeros (compressed to next to nothing) must not be held at once."""
    script = """
target._flush()
for k in range(20):
    rows = np.zeros((2000, 1000), np.float32)
    target.append(dataset(time=2000.0 * k + np.arange(2000.0), normal_displacement=rows))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
target.finish({}, complete=True)
print(before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
    child = _start(script, tmp_path)
    said, errors = child.communicate(timeout=60)
    assert errors == ""
    before, after = map(int, said.split())
    assert (after - before) * 1024 < 60e6
    assert load(tmp_path / "result.nc").sizes["time"] == 40_000


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
