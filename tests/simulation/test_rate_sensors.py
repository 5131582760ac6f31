"""Sensors of the rates of afferents: against the spikes of a record, in copies, in worlds, and in plain MuJoCo."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.hand.regions import regions_at
from palmfield.outputs import instances
from palmfield.outputs.afferents import spikes_of
from palmfield.perception.afferents import AFFERENTS
from palmfield.session import Simulation
from palmfield.simulation.innervation import endings_of

ON = {"receptors": "on", "receptor_densities_per_cm2": "20 60 20"}
LOUD = {"am_frequency_Hz": 40}
REGIONS = """
    <plugin plugin="palmfield.afferents">
      <instance name="all"><config key="window_s" value="0.01"/></instance>
      <instance name="spot"><config key="site" value="near"/><config key="window_s" value="0.01"/>
        <config key="body" value="pad"/></instance>
    </plugin>
  </extension>"""
SENSORS = """
    <plugin name="spot" plugin="palmfield.afferents" instance="spot" objtype="body" objname="pad"/>
    <plugin name="all" plugin="palmfield.afferents" instance="all" objtype="body" objname="pad"/>
  </sensor>"""
WINDOW, STEP_S, SPOT_M = 10, 0.001, 0.006


@pytest.fixture(scope="module")
def scene(module_scene, kept_operators):
    def write(regions=REGIONS, sensors=SENSORS, **keys):
        path = module_scene(**({"array": {"p0_Pa_m": 6}, "skin": ON, "stimulus": LOUD, "duration_s": 0.05} | keys))
        path.write_text(path.read_text().replace("</sensor>", sensors).replace("</extension>", regions))
        plain = path.with_name("plain.xml")
        site = f'<site name="near" pos="0.004 0 0" size="{SPOT_M}"/><site name="cube" type="box" size="1 1 1"/>'
        plain.write_text(plain.read_text().replace('<site name="centre"', site + '<site name="centre"'))
        return path

    return write


@pytest.fixture(scope="module")
def finished(scene):
    return palmfield.run(scene(), None, progress=False)


def value(result, name):
    return instances(result.dataset, "sensors")[name]["value"].values


def stepped(path, steps, sim=None):
    sim = sim or Simulation(path)
    rows = []
    for _ in range(steps):
        sim.step()
        rows.append(np.concatenate([sim.sensor("all"), sim.sensor("spot")], axis=-1))
    return np.array(rows)


def test_a_rate_is_the_count_of_recorded_spikes(finished):
    skin = next(iter(instances(finished.dataset, "skin").values()))
    assert instances(finished.dataset, "sensors")["all"]["channel"].values.tolist() == [
        "rate_sa1_Hz", "rate_ra1_Hz", "rate_pc_Hz",
    ]  # fmt: skip
    fired, classes = spikes_of(skin), skin["afferent_class"].values
    distance = np.linalg.norm(skin["afferent_position"].values - [0.004, 0.0, 0.0], axis=1)
    for name, inside in (("all", distance < 1.0), ("spot", distance <= SPOT_M)):
        read = value(finished, name)
        for channel, of_class in enumerate(AFFERENTS):
            moments, units = fired[of_class]
            # In which MuJoCo step each spike falls: a reading is that at the beginning of a step
            ends = np.ceil(moments[inside[units]] / STEP_S - 1e-6)
            counts = np.array([((ends > k - WINDOW) & (ends <= k)).sum() for k in range(len(read))])
            per_unit = counts / (WINDOW * STEP_S * (inside & (classes == of_class)).sum())
            np.testing.assert_allclose(read[:, channel], per_unit, rtol=1e-12)
    assert (value(finished, "all").max(axis=0)[1:] > 5.0).all()


def test_steps_mj_step_and_a_record_read_the_same(finished, scene):
    path, steps = scene(), 50
    recorded = np.concatenate([value(finished, "all"), value(finished, "spot")], axis=1)
    np.testing.assert_allclose(stepped(path, steps), recorded[:steps], rtol=1e-12)
    sim = Simulation(path)
    for row in recorded[:steps]:
        mujoco.mj_step(sim.model, sim.data)
        palmfield.raise_errors(sim.data)
        np.testing.assert_allclose([*sim.data.sensor("all").data, *sim.data.sensor("spot").data], row, rtol=1e-12)


def test_copies_and_saved_states_continue_equally(scene):
    sim = Simulation(scene())
    stepped(None, 20, sim)
    twin, size = sim.copy(), mujoco.mj_stateSize(sim.model, mujoco.mjtState.mjSTATE_INTEGRATION)
    saved = np.zeros(size)
    mujoco.mj_getState(sim.model, sim.data, saved, mujoco.mjtState.mjSTATE_INTEGRATION)
    onward = stepped(None, 15, sim)
    assert onward.any()
    np.testing.assert_array_equal(stepped(None, 15, twin), onward)
    mujoco.mj_setState(sim.model, sim.data, saved, mujoco.mjtState.mjSTATE_INTEGRATION)
    np.testing.assert_array_equal(stepped(None, 15, sim), onward)
    sim.reset()
    assert not stepped(None, 1, sim).any()


def test_worlds_read_what_each_scene_alone_reads(scene):
    path, foci = scene(), [(0.0, 0.0, 0.12), (0.006, 0.0, 0.12)]
    sim = Simulation(path, worlds=2, keys={"stimulus.focus_m": foci})
    together = stepped(None, 30, sim)
    twin = sim.copy()
    np.testing.assert_array_equal(stepped(None, 5, twin), stepped(None, 5, sim))
    for world, focus in enumerate(foci):
        alone = stepped(None, 30, Simulation(path, keys={"stimulus.focus_m": focus}))
        np.testing.assert_allclose(together[:, world], alone, rtol=1e-12)
    assert np.abs(together[:, 0] - together[:, 1]).max() > 1.0


def test_nothing_is_computed_without_such_a_sensor(scene):
    sim, with_rates = Simulation(scene("</extension>", "</sensor>")), Simulation(scene())
    assert sim.runtime.work.observe == (None,) and sim.steps.observer is None
    assert "innervation" not in vars(sim.runtime.model.skins[0])
    assert not sim.runtime.state.regions and with_rates.runtime.state.regions[0].size > 1239


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('value="pad"', 'value="world"', "instance 'spot': key 'body' has value 'world'; allowed: pad"),
        ('value="near"', 'value="cube"', "key 'site' has value 'cube'; allowed: a site of type sphere"),
        ('value="near"', 'value="array"', "instance 'spot': its region has none of the 1239 afferents of its skin"),
        ('key="body" value="pad"', 'key="skin" value="palm"', "key 'skin' has value 'palm'; allowed: skin"),
    ],
)
def test_a_region_that_is_none_is_refused(old, new, message, scene):
    with pytest.raises(palmfield.SceneError, match=message):
        Simulation(scene(REGIONS.replace(old, new)))


def test_a_region_needs_key_receptors(scene):
    with pytest.raises(palmfield.SceneError, match="needs afferents, but receptors is 'off' at skin 'skin': set it"):
        Simulation(scene(skin={}))


def test_a_bone_carries_the_afferents_of_its_finger(tmp_path):
    """Against the labels of the preset, which do not use the weights of the bones."""
    shipped = Path(palmfield.__file__).parents[1] / "mjcf" / "scenes" / "follow_fingertip.xml"
    text = shipped.read_text().replace('file="', f'file="{shipped.parent}/')
    text = text.replace("../motions", f"{shipped.parents[1]}/motions")
    region = '<plugin plugin="palmfield.afferents"><instance name="tip"><config key="body" value="index_distal"/>'
    path = tmp_path / "tip.xml"
    path.write_text(text.replace("</extension>", region + "</instance></plugin></extension>"))
    keys = {"skin.receptors": "on", "skin.receptor_depths_m": "0.0005 0.0005 0.0006"}
    [skin], [rates] = (getattr(Simulation(path, keys=keys).runtime.model, name) for name in ("skins", "rates"))
    labels = np.array(regions_at(skin.spec.config.hand, endings_of(skin.layer).positions))
    inside = np.isin(np.arange(len(labels)), rates._numbers)
    assert 0 < inside.sum() < len(inside)
    assert ((labels == "index_pulp") == inside).mean() > 0.9
