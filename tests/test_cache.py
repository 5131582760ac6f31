"""What is kept on disk between runs: found again, told apart, damaged, full, shared and limited."""

import dataclasses
import errno
import multiprocessing
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse
from typer.testing import CliRunner

import palmfield
from palmfield import cache
from palmfield.cli.app import app
from palmfield.data import folder
from palmfield.errors import PalmfieldError
from palmfield.simulation import build


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    folder = tmp_path / "kept"
    monkeypatch.setenv("PALMFIELD_CACHE", str(folder))
    monkeypatch.setattr(cache, "_warned", set())
    return folder


class Maker:
    """Counts how often it is asked."""

    def __init__(self, size=3):
        self.asked, self.size = 0, size

    def __call__(self):
        self.asked += 1
        return {"numbers": np.arange(self.size, dtype=np.float64), "fact": np.array(2.5)}


def test_the_second_time_it_is_read(place):
    make = Maker()
    first, second = (cache.kept("thing", [1.0, "a"], make) for _ in range(2))
    assert make.asked == 1
    for name in ("numbers", "fact"):
        np.testing.assert_array_equal(first[name], second[name])
    cache.kept("thing", [1.0, "b"], make)
    cache.kept("other", [1.0, "a"], make)
    assert make.asked == 3
    assert sorted(entry.kind for entry in cache.entries()) == ["other", "thing", "thing"]
    assert not list(place.glob("*.part"))


@pytest.mark.parametrize("named", ["off", "", "OFF"])
def test_it_can_be_switched_off(monkeypatch, named):
    monkeypatch.setenv("PALMFIELD_CACHE", named)
    make = Maker()
    for _ in range(2):
        cache.kept("thing", [1], make)
    assert make.asked == 2 and cache.folder() is None and cache.entries() == [] and cache.clear() == 0


def test_without_a_name_it_is_the_users_cache_folder(monkeypatch, tmp_path):
    monkeypatch.delenv("PALMFIELD_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert cache.folder().name == "palmfield"


@dataclasses.dataclass(frozen=True)
class Pair:
    one: float
    two: tuple[int, ...]


DIFFERENT = [
    (1,), (1.0,), (True,), ("1",), (None,), (), (1, 1), ((1, 1),), ([1, 1],), ("ab", "c"), ("a", "bc"), (b"a",), ("a",),
    (np.zeros(2),), (np.zeros(2, np.float32),), (np.zeros((1, 2)),), (np.zeros(3),), (np.array([0.0, -0.0]),),
    (sparse.csr_matrix(np.eye(2)),), (sparse.csr_matrix(np.eye(3)),), (np.eye(2),), ({"a": 1},), ({"a": 2},),
    (Pair(1.0, (2,)),), (Pair(1.0, (2, 3)),), ((1.0, (2,)),),
]  # fmt: skip


def test_whatever_differs_has_a_digest_of_its_own():
    assert len({cache.digest(*parts) for parts in DIFFERENT}) == len(DIFFERENT)
    for parts in DIFFERENT:
        assert cache.digest(*parts) == cache.digest(*parts)


def test_the_same_content_has_the_same_digest():
    matrix = sparse.random(30, 20, 0.2, format="csr", random_state=0)
    shuffled = matrix.tocoo()
    order = np.random.default_rng(0).permutation(shuffled.nnz)
    again = sparse.coo_matrix((shuffled.data[order], (shuffled.row[order], shuffled.col[order])), shape=matrix.shape)
    assert cache.digest(matrix) == cache.digest(again) == cache.digest(matrix.tocsc())
    numbers = np.arange(12.0).reshape(3, 4)
    assert cache.digest(numbers) == cache.digest(np.asfortranarray(numbers))
    assert cache.digest({"a": 1, "b": 2}) == cache.digest({"b": 2, "a": 1})


@given(st.lists(st.one_of(st.integers(), st.floats(), st.text(), st.none()), max_size=4), st.integers(0, 3))
def test_a_change_of_any_part_changes_the_digest(parts, which):
    if which < len(parts):
        changed = [*parts]
        changed[which] = ("changed", changed[which])
        assert cache.digest(*changed) != cache.digest(*parts)


def test_what_has_no_digest_is_refused():
    for part in (object(), lambda: 0, np.array([object()]), {1, 2}):
        with pytest.raises(TypeError, match="digest"):
            cache.digest(part)


@pytest.mark.parametrize(
    "damage", ["cut", "bit", "empty", "text", "pickle", "other", "nan", "unmarked", "lacking", "pipe"]
)
def test_a_damaged_file_is_made_again_and_said(place, damage):
    make = Maker(1000)
    expected = cache.kept("thing", [1], make)
    [entry] = cache.entries()
    whole = entry.path.read_bytes()
    content = bytearray(whole)
    if damage == "cut":
        content = content[: len(content) // 2]
    elif damage == "bit":
        content[len(content) // 2] ^= 4
    elif damage == "empty":
        content = bytearray()
    elif damage == "text":
        content = bytearray(b"this is no archive")
    entry.path.write_bytes(content)
    if damage == "pickle":
        np.savez(entry.path, numbers=np.array([{"a": 1}], dtype=object))
    elif damage == "pipe":
        entry.path.unlink()
        os.mkfifo(entry.path)
    elif damage == "other":
        cache.kept("thing", [2], Maker(1000))
        os.replace(next(one.path for one in cache.entries() if one.path != entry.path), entry.path)
    elif damage in ("nan", "unmarked", "lacking"):
        entry.path.write_bytes(whole)
        with np.load(entry.path) as archive:
            arrays = dict(archive)
        if damage == "nan":
            arrays["numbers"][3] = np.nan
        else:
            del arrays[cache.MARKS if damage == "unmarked" else "numbers"]
        np.savez(entry.path, **arrays)
    with pytest.warns(RuntimeWarning, match=r"thing-.*is damaged"):
        again = cache.kept("thing", [1], make)
    np.testing.assert_array_equal(again["numbers"], expected["numbers"])
    assert make.asked == 2
    cache.kept("thing", [1], make)
    assert make.asked == 2


def test_another_scenes_entries_under_a_scenes_names_change_nothing(place):
    """What is kept of another material, focus and frequency, each in the place of its own kind."""

    def results(material, focus, frequency):
        keys = {"skin.material": material, "stimulus.focus_m": focus, "stimulus.am_frequency_Hz": frequency}
        scene = folder("mjcf") / "scenes" / "phantom_am200.xml"
        sim = palmfield.Simulation(scene, keys={"skin.accuracy": 0.5, "skin.element_m": 0.01, **keys})
        sim.step(10)
        return sim.skin().displacement

    expected = results("ecoflex_00-10", (0, 0, 0.2), 200.0)
    own = {entry.kind: [] for entry in cache.entries()}
    for entry in cache.entries():
        own[entry.kind].append(entry.path)
    results("palm", (0.005, 0, 0.2), 100.0)
    known = {path for paths in own.values() for path in paths}
    others = {entry.kind: entry.path for entry in cache.entries() if entry.path not in known}
    assert others
    for kind, path in others.items():
        for mine in own.get(kind, ()):
            mine.write_bytes(path.read_bytes())
    build._models.clear()  # in which a process keeps its latest scenes
    with pytest.warns(RuntimeWarning, match="the file contains the result of another key"):
        again = results("ecoflex_00-10", (0, 0, 0.2), 200.0)
    np.testing.assert_array_equal(again, expected)


def test_a_full_disk_costs_the_cache_only(place, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(cache.np, "savez", full)
    make = Maker()
    with pytest.warns(RuntimeWarning, match="No space left"):
        assert cache.kept("thing", [1], make)["fact"] == 2.5
    cache.kept("thing", [2], make)  # it is said once
    assert make.asked == 2 and cache.entries() == [] and not list(place.glob("*.part"))


def test_a_folder_that_can_not_be_is_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path / "file" / "deep"))
    make = Maker()
    with pytest.warns(RuntimeWarning, match="continuing without a cache"):
        cache.kept("thing", [1], make)
    cache.kept("thing", [1], make)
    assert make.asked == 2


def test_a_home_that_can_not_be_written_is_done_without_and_said_once(tmp_path):
    (tmp_path / "home").write_text("no folder")
    own = {name: value for name, value in os.environ.items() if name not in ("XDG_CACHE_HOME", "WARP_CACHE_PATH")}
    command = [sys.executable, "-m", "palmfield", "calibrate", "kinds"]
    ended = subprocess.run(command, capture_output=True, text=True, env=own | {"HOME": str(tmp_path / "home")})
    assert ended.returncode == 0 and "columns" in ended.stdout
    (line,) = ended.stderr.splitlines()
    assert "compiled kernels is not writable (Not a directory)" in line and "set WARP_CACHE_PATH" in line


def only_readable(monkeypatch):
    """Files can be read, as of another user or on a disk without writing; root may write whatever the mode."""

    def refused(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(cache.filelock.FileLock, "acquire", refused)
    monkeypatch.setattr(cache.os, "utime", refused)


def test_a_folder_that_can_only_be_read_gives_what_it_has_and_says_what_it_has_not(monkeypatch, recwarn):
    first = Maker()
    cache.kept("thing", [1], first)
    only_readable(monkeypatch)
    np.testing.assert_array_equal(cache.kept("thing", [1], first)["numbers"], first()["numbers"])
    assert first.asked == 2 and not recwarn.list  # once before, once in this assertion
    other = Maker()
    with pytest.warns(RuntimeWarning, match="Read-only file system; continuing without a cache"):
        cache.kept("thing", [2], other)
    assert other.asked == 1


def test_a_file_of_another_user_is_not_damaged(monkeypatch, recwarn):
    make = Maker()
    cache.kept("thing", [1], make)

    def refused(*_, **__):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(cache.os, "utime", refused)
    cache.kept("thing", [1], make)
    assert make.asked == 1 and not recwarn.list


def test_an_error_of_the_maker_is_its_own_and_keeps_nothing():
    def fails():
        raise PalmfieldError("no")

    with pytest.raises(PalmfieldError, match="no"):
        cache.kept("thing", [1], fails)
    assert cache.entries() == []
    make = Maker()
    cache.kept("thing", [1], make)
    assert make.asked == 1


def test_what_was_used_least_lately_goes(monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE_MB", "0.03")  # three of some 8 kB
    for number in range(3):
        cache.kept("thing", [number], Maker(1000))
    for age, entry in enumerate(reversed(cache.entries())):
        os.utime(entry.path, (time.time() - 100 + age,) * 2)
    oldest = cache.entries()[-1].path
    first = Maker(1000)
    cache.kept("thing", [0], first)  # used again, if it is the oldest or not
    assert first.asked == 0
    cache.kept("thing", [3], Maker(1000))
    kept = [entry.path for entry in cache.entries()]
    assert len(kept) == 3 and sum(entry.size_bytes for entry in cache.entries()) <= 0.03e6
    assert (oldest in kept) == (oldest.stem.endswith(cache.digest(cache.code_mark(), "thing", 0)))
    for bad in ("many", "-1", "0", "nan"):
        monkeypatch.setenv("PALMFIELD_CACHE_MB", bad)
        with pytest.raises(PalmfieldError, match=f"PALMFIELD_CACHE_MB is '{bad}'"):
            cache.limit_bytes()


def test_modes_outlast_newer_entries_for_a_month(monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE_MB", "0.03")
    cache.kept("modes", [0], Maker(1000))
    (modes,) = cache.entries()
    for days, kept in ((29, True), (31, False)):
        os.utime(modes.path, (time.time() - 86400 * days,) * 2)
        for number in range(4):
            cache.kept("thing", [days, number], Maker(1000))
        assert (modes.path in [entry.path for entry in cache.entries()]) == kept


def test_what_is_larger_than_the_limit_is_not_kept_and_said(monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE_MB", "0.001")
    with pytest.warns(RuntimeWarning, match="more than PALMFIELD_CACHE_MB allows"):
        cache.kept("thing", [1], Maker(1000))
    assert cache.entries() == []


def test_threads_that_ask_for_the_same_make_it_once():
    make = Maker()
    slow = threading.Barrier(4)

    def ask():
        slow.wait()
        cache.kept("thing", [1], lambda: (time.sleep(0.2), make())[1])

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert make.asked == 1


def slowly(folder, count):
    os.environ["PALMFIELD_CACHE"] = folder

    def make():
        time.sleep(0.3)
        with count.get_lock():
            count.value += 1
        return {"numbers": np.ones(4)}

    assert cache.kept("thing", [1], make)["numbers"].sum() == 4.0


def test_processes_that_ask_for_the_same_make_it_once(place):
    context = multiprocessing.get_context("fork")
    count = context.Value("i", 0)
    processes = [context.Process(target=slowly, args=(str(place), count)) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
        assert process.exitcode == 0
    assert count.value == 1


def test_the_command_line_lists_and_clears(place, monkeypatch):
    cache.kept("small-model", [1], Maker(1000))
    listed = CliRunner().invoke(app, ["cache", "list"])
    assert listed.exit_code == 0 and "small-model-" in listed.output and f"1 entries in {place}" in listed.output
    cleared = CliRunner().invoke(app, ["cache", "clear"])
    assert cleared.exit_code == 0 and "removed 1" in cleared.output
    assert not any(place.iterdir())
    monkeypatch.setenv("PALMFIELD_CACHE", "off")
    for command in ("list", "clear"):
        assert "PALMFIELD_CACHE is off" in CliRunner().invoke(app, ["cache", command]).output
