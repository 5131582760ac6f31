"""Times and memory by phase: what is counted where, and the table of `palmfield run --profile`."""

import sys
import threading
import time
import weakref

import numpy as np
import pytest

import palmfield.cli.app as program
from palmfield.phases import phase
from palmfield.profile import BEFORE, ELSEWHERE, Times, count_arrays, measured


def work(seconds):
    """Keep the processor busy."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        sum(range(1000))


def test_nothing_is_counted_outside_a_measurement():
    with measured() as profile:
        pass
    with phase("late"):
        count_arrays("late", np.ones(2**20))
    assert set(profile.phases) == {(BEFORE,)} and not profile.memory


def test_phases_hold_those_inside_them():
    with measured() as profile:
        for _ in range(2):
            with phase("outer"):
                work(0.02)
                phase("inner")(work)(0.03)
    outer, inner = profile.phases["outer",], profile.phases["outer", "inner"]
    assert outer.calls == inner.calls == 2 and inner.peak_bytes > 2**24
    assert inner.cpu_s >= 0.06 and outer.cpu_s >= inner.cpu_s + 0.04
    assert inner.wall_s >= 0.9 * inner.cpu_s and outer.wall_s > inner.wall_s and not outer.beside_s
    lines = str(profile).splitlines()
    assert any(line.startswith("│   inner") for line in lines) and not any("late" in line for line in lines)


def test_a_phase_ends_by_an_error():
    with measured() as profile:
        with pytest.raises(ValueError, match="broken"), phase("broken"):
            raise ValueError("broken")
        with phase("next"):
            pass
    assert ("next",) in profile.phases


def test_phases_of_another_process_are_beside_those_of_this_one():
    with measured() as profile, phase("plots"):
        work(0.02)
    other = {("plots",): Times(0.5, 0.7, 0.0, 1, 2**40), ("plots", "a.png"): Times(0.4, 0.6, 0.0, 1, 2**30)}
    before = profile.total.cpu_s
    profile.add_process(other)
    whole = profile.phases["plots",]
    assert 0.52 <= whole.cpu_s < 0.6 and whole.wall_s < 0.6 and (whole.beside_s, whole.calls) == (0.7, 2)
    assert whole.peak_bytes == 2**40 and profile.phases["plots", "a.png"].cpu_s == 0.4
    assert profile.total.cpu_s == pytest.approx(before + 0.5)
    with measured() as second, phase("late"):
        pass
    assert set(second.own_phases()) == {("late",)}


def test_a_phase_of_another_thread_is_beside_those_of_the_first():
    def other():
        with phase("other"):
            work(0.1)

    with measured() as profile, phase("first"):
        thread = threading.Thread(target=other)
        thread.start()
        work(0.05)
        thread.join()
    first, beside = profile.phases["first",], profile.phases["first", "other"]
    assert beside.wall_s == 0.0 and beside.beside_s >= 0.09 and beside.calls == 1
    assert beside.cpu_s >= 0.1 and first.cpu_s >= beside.cpu_s + 0.05
    assert beside.beside_s <= first.wall_s <= profile.total.wall_s


def test_phases_of_a_thread_that_begins_before_any_other():
    def other():
        with phase("other"):
            phase("inner")(work)(0.01)
            work(0.01)

    with measured() as profile:
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        with phase("first"):
            pass
    assert [key for key in profile.phases if key != (BEFORE,)] == [("other",), ("other", "inner"), ("first",)]
    assert profile.phases["other",].cpu_s >= 0.02 and profile.phases["other", "inner"].cpu_s >= 0.01


def test_a_phase_may_end_after_its_measurement():
    with measured() as profile:
        begun = phase("long")
        begun.__enter__()
    begun.__exit__(None, None, None)
    assert profile.phases["long",].calls == 1


def test_arrays_count_once_and_until_they_are_freed():
    shared = np.ones(2**18)
    with measured() as profile:
        things = [{"of": [shared, shared[:10]], "call": lambda: shared}, (shared, np.ones(2**17))]
        for thing in things:
            count_arrays("things", thing)
        held = profile.memory["things"]
        assert held.now_bytes == held.most_bytes == 3 * 2**20 and held.count == 2
        assert phase("made")(np.zeros)(2**17).nbytes == profile.memory["made"].most_bytes == 2**20
        assert profile.memory["made"].now_bytes == 0
        gone = weakref.ref(things[1][1])
        del things, thing
        assert gone() is None and held.now_bytes == 2 * 2**20 and held.most_bytes == 3 * 2**20
    assert "│ things" in str(profile)


@pytest.mark.smoke
@pytest.mark.usefixtures("kept_operators")
def test_nearly_all_of_a_run_is_in_its_phases(small_scene, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    monkeypatch.setenv("PALMFIELD_CACHE", "off")
    # A layer of its own, so that no other test has made its matrices
    scene = str(small_scene(skin={"element_m": 0.00231}))
    words = ["run", scene, "--out", str(out), "--profile", "--quiet", "--no-plots", "--no-usd"]
    monkeypatch.setattr(sys, "argv", ["palmfield", *words])
    with pytest.raises(SystemExit) as stop:
        program.main()
    told = capsys.readouterr()
    assert stop.value.code == 0 and not told.out
    assert sorted(file.name for file in out.iterdir()) == ["result.nc", "summary.json"]
    rows = [[cell.rstrip() for cell in line.strip("│").split("│")] for line in told.err.splitlines() if "│" in line]
    times = {cells[0][1:]: [float(cell or 0.0) for cell in cells[1:3]] for cells in rows if len(cells) == 6}
    named = {"reading and building the scene", "preparing", "stepping", "result file"}
    assert named < set(times) and {"factors", "matrices"} & {cells[0].strip() for cells in rows}
    ignored = (ELSEWHERE, "all")
    outer = np.sum([pair for name, pair in times.items() if name not in ignored and name[0] != " "], axis=0)
    # Numbers are rounded, and phases below 5 ms are not printed
    tolerance = 0.01 * len(times)
    assert (outer <= np.array(times["all"]) + tolerance).all() and (outer > 0.8 * np.array(times["all"])).all()
    np.testing.assert_allclose(outer + times[ELSEWHERE], times["all"], atol=tolerance)
