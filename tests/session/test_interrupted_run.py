"""Runs that are cut off carry what they had computed on the error, with a folder and without."""

import contextlib
import errno
import json
import os
import signal
import traceback
from types import SimpleNamespace

import numpy as np
import pytest
from unestimated import UNESTIMATED

import palmfield
from palmfield.estimate import estimated_run
from palmfield.outputs import store
from palmfield.session import recorded_run
from palmfield.session.recorder import Recorder

pytestmark = pytest.mark.usefixtures("kept_operators")


@pytest.fixture(autouse=True)
def python_raises():
    """A shell that runs tests in the background has them ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def unestimated():
    with UNESTIMATED:
        yield


@pytest.fixture(params=["memory", "folder"])
def out(request, tmp_path):
    return None if request.param == "memory" else tmp_path / "out"


def stopped_at(sim, step, stop, monkeypatch):
    """The simulation, whose steps are as before until `stop` is called after one of them."""
    plain, done = sim.step, []

    def one():
        plain()
        done.append(1)
        if len(done) == step:
            stop()

    monkeypatch.setattr(sim, "step", one)
    return sim


def ctrl_c():
    os.kill(os.getpid(), signal.SIGINT)


def fail():
    raise ValueError("a module's own words")


def displacement(result):
    return result.dataset["skin/skin"]["displacement"].values


@pytest.mark.parametrize(("stop", "kind"), [(ctrl_c, KeyboardInterrupt), (fail, ValueError)])
def test_what_was_computed_comes_with_the_error(small_scene, out, stop, kind, monkeypatch):
    path = small_scene()
    whole = palmfield.run(path, progress=False)
    sim = stopped_at(palmfield.load(path), 6, stop, monkeypatch)
    with pytest.raises(kind) as caught:
        palmfield.run(sim, out, progress=False, plots=[])
    result = caught.value.result
    assert isinstance(result, recorded_run.Result) and result.out == out
    assert result.dataset.attrs["complete"] == 0 and result.summary["complete"] is False
    assert kind.__name__ in result.dataset.attrs["reason"] == result.summary["reason"]
    # An error of the sixth step comes before that is recorded; Ctrl-C waits for its end.
    steps = 6 if stop is ctrl_c else 5
    assert result.summary["steps"] == steps
    np.testing.assert_array_equal(displacement(result), displacement(whole)[: 1 + 2 * steps])
    assert result.summary["peak_arp_Pa"] > 0.0
    said = "".join(traceback.format_exception(caught.value))
    assert ("attribute `result`" if out is None else str(out)) in said
    assert (out is None) == (not result.files)


def test_the_second_process_has_ended_when_the_partial_result_is_written(small_scene, tmp_path, monkeypatch):
    events, plain = [], recorded_run.Store.finish

    def finish(*arguments, **options):
        events.append("result")
        return plain(*arguments, **options)

    monkeypatch.setattr(recorded_run.Store, "finish", finish)
    monkeypatch.setattr(recorded_run, "_second", [SimpleNamespace(end=lambda: events.append("ended"))])
    with pytest.raises(KeyboardInterrupt):
        palmfield.run(
            stopped_at(palmfield.load(small_scene()), 2, ctrl_c, monkeypatch), tmp_path / "out", progress=False
        )
    assert events == ["ended", "result"]


def test_a_body_in_the_array_ends_a_run_in_memory_with_what_came_before(small_scene):
    path = small_scene()
    plain = path.with_name("plain.xml")
    text = plain.read_text().replace('axis="1 0 0" stiffness="400" damping="10"', 'axis="0 0 1"')
    plain.write_text(text.replace('gravcomp="1"', "").replace('pos="0 0 0.12"', 'pos="0 0 0.02"'))
    with pytest.raises(palmfield.SceneError, match="is too close to the array") as caught:
        palmfield.run(path, duration_s=1.0, progress=False)
    assert 10 < caught.value.result.summary["steps"] < 100


def test_ctrl_c_while_the_error_is_estimated_leaves_a_complete_result(small_scene, out, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(estimated_run, "estimated_budget", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        palmfield.run(small_scene(), out, progress=False, plots=[])
    result = caught.value.result
    assert result.dataset.attrs["complete"] == 1 and result.summary["complete"] is True
    assert len(displacement(result)) == 31 and "displacement_error_relative" not in result.summary["skins"][0]


def test_ctrl_c_after_the_last_step_loses_the_loudest_moment_only(small_scene, out, monkeypatch):
    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Recorder, "surfaces", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        palmfield.run(small_scene(), out, progress=False, plots=[])
    result = caught.value.result
    assert result.dataset.attrs["complete"] == 0 and len(displacement(result)) == 31
    assert "loudest_arp" not in result.dataset["skin/skin"]


def test_ctrl_c_while_the_result_is_assembled_waits_for_it(small_scene, monkeypatch):
    plain = recorded_run.MemoryStore.finish

    def finish(*arguments, **options):
        ctrl_c()
        return plain(*arguments, **options)

    monkeypatch.setattr(recorded_run.MemoryStore, "finish", finish)
    with pytest.raises(KeyboardInterrupt) as caught:
        palmfield.run(small_scene(), progress=False)
    assert caught.value.result.dataset.attrs["complete"] == 1


def test_ctrl_c_while_the_result_is_assembled_on_disk_waits_for_it(small_scene, tmp_path, monkeypatch):
    plain = store.read_image

    def read_image(*arguments, **options):
        if options == {"static": False}:  # the records of a chunk
            monkeypatch.setattr(store, "read_image", plain)
            ctrl_c()
        return plain(*arguments, **options)

    monkeypatch.setattr(store, "read_image", read_image)
    with pytest.raises(KeyboardInterrupt) as caught:
        palmfield.run(small_scene(), tmp_path / "out", progress=False, plots=[])
    result = caught.value.result
    assert result.dataset.attrs["complete"] == 1 and result.summary["complete"] is True
    assert len(displacement(result)) == 31 and not (tmp_path / "out" / ".partial").exists()


def full_at_the_last_flush(monkeypatch):
    plain = store._write_sealed

    def write(path, data):
        if path.name.startswith("chunk_"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        plain(path, data)

    monkeypatch.setattr(store, "_write_sealed", write)
    monkeypatch.setattr(store, "FLUSH_SECONDS", 1000.0)  # so that there is one flush, that of the end


def test_a_disk_that_is_full_at_the_last_flush_makes_the_run_fail(small_scene, tmp_path, monkeypatch):
    full_at_the_last_flush(monkeypatch)
    with pytest.raises(palmfield.OutputError, match="are lost: No space left on device; free some space") as caught:
        palmfield.run(small_scene(), tmp_path / "out", progress=False, plots=[])
    result = caught.value.result
    for said in (result.summary, json.loads((tmp_path / "out" / "summary.json").read_text()), result.dataset.attrs):
        assert said["complete"] == 0 and "last blocks" in said["reason"] and "completed" in said["reason"]
    assert "time" not in result.dataset.sizes or result.dataset.sizes["time"] == 0


def test_a_disk_that_is_full_for_the_summary_too_leaves_the_result_on_the_error(small_scene, tmp_path, monkeypatch):
    def write_json(path, numbers):
        raise palmfield.OutputError(f"cannot write {path}")

    monkeypatch.setattr(recorded_run, "write_json", write_json)
    with pytest.raises(palmfield.OutputError, match="cannot write") as caught:
        palmfield.run(small_scene(), tmp_path / "out", progress=False, plots=[])
    assert len(displacement(caught.value.result)) == 31


# -- a folder that holds an older run's files -----------------------------------------------------------------------


def no_room(tree, path):
    raise palmfield.OutputError(f"cannot write {path}: No space left on device")


def interrupted(tree, path):
    raise KeyboardInterrupt


def cut_off_by_ctrl_c(sim, monkeypatch):
    stopped_at(sim, 3, ctrl_c, monkeypatch)


def cut_off_by_an_error(sim, monkeypatch):
    stopped_at(sim, 3, fail, monkeypatch)


def cut_off_by_a_full_disk(sim, monkeypatch):
    full_at_the_last_flush(monkeypatch)


def cut_off_in_the_first_picture(sim, monkeypatch):
    monkeypatch.setattr(recorded_run, "PICTURES", (("pressure.png", interrupted), *recorded_run.PICTURES[1:]))


def no_room_for_a_picture(sim, monkeypatch):
    monkeypatch.setattr(recorded_run, "PICTURES", (("pressure.png", no_room), ("scene.usdc", no_room)))


ENDS = [
    cut_off_by_ctrl_c, cut_off_by_an_error, cut_off_by_a_full_disk, cut_off_in_the_first_picture, no_room_for_a_picture,
]  # fmt: skip


@pytest.mark.parametrize("end", ENDS, ids=lambda end: end.__name__)
def test_no_old_picture_stays_beside_new_data(end, small_scene, tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    for name in ("result.nc", *store.DERIVED):
        (out / name).write_text("of an older run")
    sim = palmfield.load(small_scene())
    end(sim, monkeypatch)
    try:
        palmfield.run(sim, out, overwrite=True)
    except (KeyboardInterrupt, ValueError, palmfield.OutputError) as error:
        assert end is not no_room_for_a_picture, error
    there = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    assert {"result.nc", "summary.json"} <= set(there)
    assert not [name for name, data in there.items() if data == b"of an older run"]
    assert not [name for name in there if name.startswith(".") or name.endswith(".tmp")]


def test_a_picture_that_fails_leaves_a_whole_result(small_scene, tmp_path, monkeypatch):
    def failing(tree, path):
        raise RuntimeError("a library's own words")

    pictures = tuple((name, failing if name == "displacement.png" else make) for name, make in recorded_run.PICTURES)
    monkeypatch.setattr(recorded_run, "PICTURES", pictures)
    with pytest.raises(RuntimeError, match="own words"):
        palmfield.run(small_scene(), tmp_path, progress=False)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["complete"] and summary["wall_time_s"] > 0.0 and "verdict" in summary["skins"][0]
    with store.open_result(tmp_path) as tree:
        assert tree.attrs["complete"] == 1 and len(tree["skin/skin"]["displacement"]) == 31
    assert (tmp_path / "pressure.png").exists() and not (tmp_path / "scene.usdc").exists()


def test_ctrl_c_waits_until_a_library_of_pictures_is_loaded(monkeypatch):
    called = []

    def load(name):
        # OpenUSD catches the error of Ctrl-C in its modules, and goes on without them
        with contextlib.suppress(KeyboardInterrupt):
            ctrl_c()
            called.append(name)
        return SimpleNamespace(draw=lambda: called.append("drawn"))

    monkeypatch.setattr(recorded_run, "import_module", load)
    with pytest.raises(KeyboardInterrupt):
        recorded_run._drawn_by("pictures", "draw")
    assert called == ["palmfield.outputs.pictures"]
