"""How many Python functions a step runs: on the CPU half of a step's time was once spent between them."""

import json

import mujoco
import numpy as np
import pytest
from check_scene_reference import REFERENCE, scenes

from palmfield.data import folder
from palmfield.engine.host import raise_errors
from palmfield.session.simulation import Simulation

MOST, AT_REST = 246, 101
"""Of the scenes 82 to 244; of those in which only the level of one focus changes on a reduced model, 82 to 99. In a
graph a step runs 61."""
LEVELS_ONLY = ("palm_am200", "palm_step_sonicsurface", "phantom_am200", "phantom_step")
MORE = 65
"""For each further skin or array of a small scene."""
SECOND_PAD = (
    '<body name="second" pos="0.06 0 0.12" quat="0 1 0 0"><joint type="slide" axis="1 0 0" stiffness="400" '
    'damping="10"/><site name="second_centre"/><geom type="cylinder" size="0.02 0.004" pos="0 0 -0.004" contype="0" '
    'conaffinity="0"/></body>'
)
SECOND_ARRAY = '<body name="further" pos="0.3 0 0"><site name="second_array"/></body>'


def calls_of_steps(sim, python_calls, count=16):
    """Python functions that each of some plain mj_steps runs."""
    counted = []
    for _ in range(count):
        counted.append(python_calls(lambda: mujoco.mj_step(sim.model, sim.data)))
        raise_errors(sim.data)
    return counted


@pytest.mark.parametrize("name", scenes("shipped"))
def test_a_step_of_a_shipped_scene_runs_few_python_functions(name, python_calls):
    """Sound, poses and substeps as shipped; large layers are made coarse, which changes no call."""
    with np.load(REFERENCE / "shipped" / f"{name}.npz") as stored:
        facts = json.loads(str(stored["facts"]))
    keys: dict[str, object] = {"skin.solver": facts["began"]}
    if facts["unknowns"] > 5000:
        keys |= {"skin.step_s": facts["step_s"], "skin.element_m": 0.012}
        keys |= {} if name.startswith("phantom") else {"skin.patch_radius_m": 0.03}
    sim = Simulation(folder("mjcf") / "scenes" / f"{name}.xml", device="cpu", keys=keys)
    if facts["start_s"]:
        sim.start_at(facts["start_s"])
    sim.step(40)  # launches are recorded and loads computed ahead for the first time
    assert sim.runtime.model.substeps == round(sim.model.opt.timestep / facts["step_s"])
    assert sim.skin().solver == facts["ended"]
    assert max(calls_of_steps(sim, python_calls)) <= (AT_REST if name in LEVELS_ONLY else MOST)


def test_a_step_of_coupled_modes_runs_few_python_functions(small_scene, python_calls):
    sheets = {"material": None, "materials": "finger_pad palm forearm", "shares": "0.2 0.3 0.5"}
    sim = Simulation(small_scene(skin={"accuracy": 0.2, "solver": "modal"} | sheets))
    sim.step(24)
    assert sim.skin().solver == "modal" and sim.runtime.model.begin[0].value.coupled
    assert max(calls_of_steps(sim, python_calls)) <= AT_REST


@pytest.mark.parametrize(("name", "further", "most"), [("two_hands_both_feel", 2, 351), ("palm_and_fingertip", 1, 337)])
def test_a_step_of_a_shipped_scene_with_several_skins_runs_few(name, further, most, python_calls):
    """further: skins and arrays beyond the first of each"""
    sim = Simulation(folder("mjcf") / "scenes" / f"{name}.xml", device="cpu")
    assert len(sim.skins) + len(sim.runtime.model.spec.arrays) == 2 + further
    sim.step(8)
    assert max(calls_of_steps(sim, python_calls, 8)) <= most


@pytest.mark.parametrize("path", [{}, {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 100}])
def test_a_further_skin_or_array_adds_few(small_scene, python_calls, path):
    stimulus = {} if not path else path | dict.fromkeys(("modulation", "am_quantity", "am_frequency_Hz", "am_depth"))
    counted = {}
    for what in ("one", "skins", "arrays"):
        scene = small_scene(stimulus=stimulus)
        text, plain = scene.read_text(), scene.with_name("plain.xml")
        if what == "skins":
            first = text[text.index('<plugin plugin="palmfield.skin">') :].partition("</plugin>")[0] + "</plugin>"
            second = first.replace('"skin"', '"second"').replace('"pad"', '"second"')
            sensor = (
                '<plugin plugin="palmfield.skin" instance="second" objtype="site" objname="second_centre"/></sensor>'
            )
            scene.write_text(text.replace(first, first + second).replace("</sensor>", sensor))
            plain.write_text(plain.read_text().replace("<worldbody>", "<worldbody>" + SECOND_PAD, 1))
        if what == "arrays":
            array = (
                '<plugin plugin="palmfield.array"><instance name="further"><config key="site" value="second_array"/>'
            )
            scene.write_text(text.replace("<extension>", f"<extension>{array}</instance></plugin>", 1))
            plain.write_text(plain.read_text().replace("<worldbody>", "<worldbody>" + SECOND_ARRAY, 1))
        sim = Simulation(scene)
        sim.step(24)
        counted[what] = max(calls_of_steps(sim, python_calls))
        assert len(sim.skins) == 1 + (what == "skins") and len(sim.drive) == 256 * (1 + (what == "arrays"))
    assert counted["one"] <= MOST
    assert counted["skins"] <= counted["one"] + MORE
    assert counted["arrays"] <= counted["one"] + MORE
