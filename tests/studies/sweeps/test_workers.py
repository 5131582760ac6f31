"""Sweeps on Dask workers in processes of their own: one is killed; a scheduler that can't be reached."""

import os
import threading
import time

import psutil
import pytest
import warp
import xarray as xr

import palmfield
from palmfield.errors import PalmfieldError
from palmfield.studies.sweeps import whole_sweep
from palmfield.studies.sweeps.cluster import local_cluster, slots, visible_gpus
from palmfield.studies.sweeps.store import DONE, open_dataset
from palmfield.threads import cores

LEVEL = "stimulus.drive_amplitude"
DESIGN = {LEVEL: [round(0.05 * n, 2) for n in range(1, 21)]}


def kill_one_worker_after(count, out):
    """Kill one of the two processes that compute as soon as `count` points are done; those that it killed."""
    own, killed = psutil.Process(), []

    def watch():
        for _ in range(1200):
            time.sleep(0.1)
            try:
                done = int((open_dataset(out / "sweep.zarr")["status"] == DONE).sum())
            except PalmfieldError:
                continue
            if done >= count:
                # A nanny has one child, which computes
                working = [p for p in own.children(recursive=True) if not p.children() and p.memory_info().rss > 1.5e8]
                working[0].kill()
                killed.append((working[0].pid, done))
                return

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread, killed


@pytest.mark.nightly
def test_a_killed_worker_changes_nothing(small_scene, tmp_path):
    scene = small_scene(duration_s=0.1)
    here = palmfield.sweep(scene, DESIGN, tmp_path / "here", workers=0, progress=False, picture=False)
    thread, killed = kill_one_worker_after(2, tmp_path / "there")
    there = palmfield.sweep(scene, DESIGN, tmp_path / "there", workers=2, progress=False, picture=False)
    thread.join()
    assert killed and killed[0][1] < len(DESIGN[LEVEL])
    assert there.done == len(DESIGN[LEVEL]) and there.failed == {}
    with here.dataset as one, there.dataset as other:
        texts = ["failure", "wall_time"]
        xr.testing.assert_allclose(one.drop_vars(texts), other.drop_vars(texts), rtol=1e-6, atol=0.0)


@pytest.mark.slow
def test_each_worker_sees_its_own_gpu_and_knows_the_scene(small_scene):
    scene = small_scene()
    with local_cluster(2, ["3", "5"]) as client:
        seen = client.run(os.getenv, "CUDA_VISIBLE_DEVICES")
        assert sorted(seen.values()) == ["3", "5"]
        there = slots(client, scene)
        assert [slot.threads for slot in there] == [max(1, cores() // 2)] * 2
        with pytest.raises(PalmfieldError, match=r"cannot read .*nowhere\.xml; put the scene where all workers"):
            slots(client, scene.with_name("nowhere.xml"))


@pytest.mark.parametrize(
    ("there", "gpus", "points", "memory", "on_gpu", "expected"),
    [
        (16, ["0"], 1000, 1, 100, whole_sweep.MOST_PER_GPU),
        (4, ["0"], 1000, 1, 100, 4),
        (2, ["0", "1", "2", "3"], 1000, 1, 100, 4),
        (16, ["0"], 3, 1, 100, 3),
        (16, ["0"], 1000, 1, 4, 3),
        (16, ["0", "1"], 1000, 1, 4, 6),
        (16, ["0"], 1000, 1, 0, 1),
        (16, ["0", "1"], 1000, 2**60, 2**62, 2),
        (16, [], 1000, 1, 0, 16),
    ],
)
def test_workers_share_gpus_as_cores_and_memory_allow(there, gpus, points, memory, on_gpu, expected, monkeypatch):
    monkeypatch.setattr(whole_sweep, "cores", lambda: there)
    assert whole_sweep._worker_count(None, gpus, points, memory, on_gpu) == expected
    assert whole_sweep._worker_count(3, gpus, points, memory, on_gpu) == 3


def test_gpus_are_named_as_the_process_sees_them(monkeypatch):
    monkeypatch.setattr(warp, "get_cuda_device_count", lambda: 2)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert visible_gpus() == ["0", "1"]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,7")
    assert visible_gpus() == ["4", "7"]


def test_workers_that_do_not_start_in_time_name_the_cause_and_the_mend(monkeypatch):
    monkeypatch.setattr("palmfield.studies.sweeps.cluster.WORKERS_S", 0.01)
    monkeypatch.setattr(os, "getloadavg", lambda: (99.0, 99.0, 99.0))
    monkeypatch.setattr("distributed.Client.wait_for_workers", _late)
    with (
        pytest.raises(PalmfieldError, match=r"of 1 local workers started.*busy \(99 programs.*or --workers 0"),
        local_cluster(1, []),
    ):
        pass


def _late(*_args, **_options):
    raise TimeoutError


def test_an_unreachable_scheduler_is_said_before_a_folder_is_made(small_scene, tmp_path):
    with pytest.raises(PalmfieldError, match=r"--scheduler tcp://127\.0\.0\.1:1 was not reached within 5 s"):
        palmfield.sweep(small_scene(), DESIGN, tmp_path / "out", scheduler="tcp://127.0.0.1:1", progress=False)
    assert not (tmp_path / "out").exists()
