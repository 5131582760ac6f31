"""Which points are worlds of one model, and that their numbers are those of runs by themselves."""

import numpy as np
import pytest

import palmfield
from palmfield.outputs import instances
from palmfield.studies.sweeps import batch, groups, store
from palmfield.studies.sweeps.batch import Failed, Point, Task, run_batch
from palmfield.studies.sweeps.design import grid, listed
from palmfield.studies.sweeps.groups import groups_of, in_words
from palmfield.studies.sweeps.keys import scene_keys
from palmfield.studies.sweeps.store import DONE, NOT_DONE

FREQUENCY, LEVEL, DEPTH = "stimulus.am_frequency_Hz", "stimulus.drive_amplitude", "stimulus.am_depth"
FOCUS_X, THICKNESS = "stimulus.focus_m[0]", "skin.thickness_m"
COARSE = {"accuracy": 0.3}


@pytest.fixture
def few_are_many(monkeypatch):
    """Modes serve four different loads already, whatever they cost."""
    monkeypatch.setattr(groups, "MANY_LOADS", 4)
    monkeypatch.setattr(groups, "_pays", lambda *_: True)


@pytest.fixture
def simulated(monkeypatch):
    """How many worlds each simulation of a sweep had, and what stepped them."""
    plain, seen = batch.measured, []

    def measured(simulation, *others):
        numbers = plain(simulation, *others)
        several = simulation.worlds is not None
        runtimes = simulation.runtimes if several else [simulation.runtime]
        seen.append((len(runtimes) * several, {one.model.begin[0].value.name for one in runtimes}))
        return numbers

    monkeypatch.setattr(batch, "measured", measured)
    return seen


def cut(scene, design, fixed=None):
    return groups_of(scene, design, scene_keys(scene, design, fixed or {}), None, None)


def swept(scene, design, out, **more):
    return palmfield.sweep(scene, design, out, workers=0, progress=False, picture=False, **more)


def computed(scene, group, design, times, fixed=None):
    """Numbers of a group's points in one batch, and of each by itself."""
    known, task = scene_keys(scene, design, fixed or {}), Task(scene, None, None, float(times[-1]), times, False)
    values = [design.point(number) for number in group.points]
    points = [Point(known.of_point(one), known.differing(one)) for one in values]
    together = run_batch(task, group.base, group.shared, points)
    return together, [run_batch(task, group.base, group.shared, [point])[0] for point in points]


def assert_same(one, other, rtol=1e-6):
    for name in one.keys() - {"wall_time"}:
        if np.asarray(one[name]).dtype.kind not in "fiub":  # words
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)
            continue
        size = float(np.nanmax(np.abs(one[name]), initial=0.0))
        np.testing.assert_allclose(one[name], other[name], rtol=rtol, atol=rtol * size, err_msg=name)


def test_points_of_other_levels_are_worlds_and_others_are_by_themselves(small_scene):
    scene = small_scene()
    found = cut(scene, grid({FREQUENCY: [100.0, 200.0], LEVEL: [0.0, 0.5, 1.0]}))
    assert [group.points for group in found] == [(0, 1, 2), (3, 4, 5)]
    assert all(group.shared is not None and not group.shared.modal for group in found)
    # What the layer is made for sounds
    assert [group.base[LEVEL] for group in found] == [1.0, 1.0]
    alone = cut(scene, grid({FREQUENCY: [100.0, 200.0], THICKNESS: [0.005, 0.006]}))
    assert [group.points for group in alone] == [(0,), (1,), (2,), (3,)]
    assert all(group.shared is None for group in alone) and in_words(alone) == ""


def test_a_board_with_steps_makes_each_level_another_load(small_scene):
    found = cut(small_scene(driver={"board": "sonicsurface"}), grid({LEVEL: [0.5, 1.0]}))
    assert [group.points for group in found] == [(0,), (1,)]


def test_many_loads_have_one_layer_for_the_strictest(small_scene, few_are_many):
    scene = small_scene()
    design = listed({FREQUENCY: [80.0, 130.0, 270.0, 110.0], FOCUS_X: [0.0, 0.003, -0.003, 0.001]})
    (group,) = cut(scene, design)
    assert group.points == (0, 1, 2, 3) and group.shared.modal
    (demand,) = group.shared.demands
    layers = []
    for number in range(4):
        keys = scene_keys(scene, design, {}).of_point(design.point(number))
        layers.append(palmfield.Simulation(scene, keys=keys).runtime.model.skins[0].layer.demand)
    assert demand.max_frequency_Hz == max(layer.max_frequency_Hz for layer in layers) > 200.0
    assert demand.spot_fwhm_m == min(layer.spot_fwhm_m for layer in layers)
    assert "4 points share modes for every load, on one layer" in in_words([group])


@pytest.mark.parametrize(
    ("changes", "keys"),
    [
        ({"skin": {"solver": "wedges"}}, {}),
        ({"skin": {"side": "absorbing"}}, {}),
        ({}, {"skin.thickness_m": [0.005, 0.0052, 0.0054, 0.0056]}),
    ],
    ids=["another solver", "no modes", "another layer each"],
)
def test_where_modes_serve_no_group(changes, keys, small_scene, few_are_many):
    design = listed({FREQUENCY: [80.0, 130.0, 270.0, 110.0]} | keys)
    assert [group.shared for group in cut(small_scene(**changes), design)] == [None] * 4


def test_a_silent_point_asks_for_nothing(small_scene, few_are_many):
    design = listed({FREQUENCY: [80.0, 90.0, 100.0, 110.0, 900.0], LEVEL: [1.0, 1.0, 1.0, 1.0, 0.0]})
    (group,) = cut(small_scene(), design)
    assert group.shared.demands[0].max_frequency_Hz < 900.0


@pytest.mark.nightly
def test_worlds_on_modes_have_the_numbers_of_runs_by_themselves(small_scene, few_are_many, simulated):
    # With these keys a run by itself has the group's layer, and its numbers come by another way, through a recorder
    scene = small_scene(skin={"max_frequency_Hz": 500.0}, duration_s=0.02)
    fixed = {"skin.accuracy": 0.3}
    design = listed({FREQUENCY: [100.0, 150.0, 200.0, 250.0], DEPTH: [1.0, 0.9, 0.8, 0.7], LEVEL: [1.0, 0.9, 1.0, 0.6]})
    (group,) = cut(scene, design, fixed)
    times = np.linspace(0.0, 0.02, 41)
    together, alone = computed(scene, group, design, times, fixed)
    assert simulated == [(4, {"modal"})] + [(1, {"modal"})] * 4
    for numbers, one, number in zip(together, alone, range(4), strict=True):
        assert_same(numbers, one)
        keys = fixed | design.point(number) | {"skin.solver": "modal"}
        result = palmfield.run(palmfield.Simulation(scene, keys=keys), progress=False)
        (known,) = result.summary["skins"]
        for name, other in (
            ("peak_displacement", "peak_displacement_m"),
            ("peak_velocity", "peak_velocity_m_s"),
            ("rms_displacement", "rms_displacement_m"),
            ("peak_arp", "peak_arp_Pa"),
            ("mean_force", "total_force_mean_N"),
            ("level_all_lines", None),
        ):
            if other is not None:
                np.testing.assert_allclose(numbers[name][0], known[other], rtol=1e-6, err_msg=name)
        (sensor,) = instances(result.dataset, "sensors").values()
        read = sensor["value"].values[:, list(sensor["channel"].values).index("normal_displacement_m")]
        np.testing.assert_allclose(numbers["sensor_displacement"][0], read, atol=1e-6 * np.abs(read).max())
        assert numbers["drive_level"][0] == pytest.approx(design.values[LEVEL][number], rel=1e-5)


def test_worlds_of_other_levels_have_the_numbers_of_runs_by_themselves(small_scene, simulated):
    scene, design = small_scene(skin={"solver": "reduced"}), grid({LEVEL: [0.0, 0.4, 0.7, 1.0]})
    (group,) = cut(scene, design)
    together, alone = computed(scene, group, design, np.linspace(0.0, 0.012, 25))
    assert simulated[0] == (4, {"reduced"})
    for numbers, one in zip(together[1:], alone[1:], strict=True):
        assert_same(numbers, one)
    assert together[0]["peak_displacement"][0] == 0.0 and together[0]["peak_arp"][0] == 0.0


def test_worlds_that_step_by_themselves_have_the_same_numbers(small_scene, few_are_many, simulated):
    # Levels that are held for a while jump, so that such worlds are stepped one by one beside the others
    design = listed(
        {
            "stimulus.control_rate_Hz": [0.0, 500.0, 250.0, 0.0],
            "stimulus.stop_s": [0.008, 0.05, 0.006, 0.05],
            FREQUENCY: [100.0, 150.0, 200.0, 250.0],
            LEVEL: [0.9, 1.0, 0.8, 0.7],
        }
    )
    scene = small_scene(skin=COARSE)
    (group,) = cut(scene, design)
    together, alone = computed(scene, group, design, np.linspace(0.0, 0.012, 25))
    assert simulated[0] == (4, {"modal"})
    for numbers, one in zip(together, alone, strict=True):
        assert not isinstance(one, Failed), one
        assert_same(numbers, one)


def test_a_failing_point_leaves_its_error_and_the_others_their_numbers(small_scene, few_are_many, simulated):
    design = listed(
        {
            FREQUENCY: [100.0, 150.0, 200.0, 250.0],
            "stimulus.start_s": [0.0, 0.0, 0.002, 0.0],
            "stimulus.stop_s": [1.0, 1.0, 0.001, 1.0],
        }
    )
    scene = small_scene(skin=COARSE)
    (group,) = cut(scene, design)
    together, alone = computed(scene, group, design, np.linspace(0.0, 0.004, 9))
    assert "stop_s 0.001 must be later than start_s 0.002" in together[2].reason and "world" not in together[2].reason
    for number in (0, 1, 3):
        assert_same(together[number], alone[number])


def test_a_sweep_on_modes_goes_on_with_the_same_numbers(small_scene, few_are_many, simulated, tmp_path, monkeypatch):
    scene, design = (
        small_scene(duration_s=0.005, skin=COARSE),
        grid({FREQUENCY: [100.0, 130.0, 160.0, 190.0], DEPTH: [0.5, 1.0]}),
    )
    monkeypatch.setattr(batch, "BATCHES_PER_WORKER", 3)
    whole = swept(scene, design, tmp_path / "whole").dataset.load()
    assert {solver for _, solvers in simulated for solver in solvers} == {"modal"}
    assert whole.attrs["solver"] == in_words(cut(scene, design))
    plain, calls = store.SweepStore._flush, []

    def flush(self, rows):
        calls.append(rows)
        if len(calls) == 2:
            raise KeyboardInterrupt
        plain(self, rows)

    with monkeypatch.context() as patch:
        patch.setattr(store.SweepStore, "_flush", flush)
        with pytest.raises(KeyboardInterrupt):
            swept(scene, design, tmp_path / "cut")
    there = store.open_dataset(tmp_path / "cut" / "sweep.zarr").load()["status"]
    assert set(np.unique(there)) == {DONE, NOT_DONE}
    # Other points are left than there were, and other ones are worlds of one batch
    monkeypatch.setattr(batch, "BATCHES_PER_WORKER", 2)
    resumed = swept(scene, design, tmp_path / "cut").dataset.load()
    names = [name for name in whole.data_vars if whole[name].dtype.kind == "f"]
    assert_same({name: whole[name].values for name in names}, {name: resumed[name].values for name in names})
    assert (resumed["status"] == DONE).all()
