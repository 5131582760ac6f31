"""Two skins with small models on one body: whatever their tolerances, both stand in one pose."""

import mujoco
import numpy as np
import pytest
import trimesh

from palmfield.engine.host import raise_errors
from palmfield.planning.scene_plan import plan
from palmfield.session.simulation import load
from palmfield.simulation.state import BEGUN

RADIUS_M = 0.03
MOVABLE = '<body name="pad" mocap="true" pos="0 0 0.12" quat="0 1 0 0">'
SITES = f'<site name="centre" pos="0 0 {RADIUS_M}"/><site name="side" pos="{RADIUS_M} 0 0"/>'
COVER = (
    '<body name="cover" mocap="true" pos="0.3 0 0.06"><geom type="sphere" size="0.02" contype="0" conaffinity="0"/>'
    "</body>"
)


@pytest.fixture
def two_on_a_ball(small_scene, tmp_path):
    """Loads a ball with skins of two accuracies, strict 0.05 and loose 0.5, in the order of their names."""

    def write(*names, covered="loose"):
        path = small_scene(
            skin={"shape": "mesh", "mesh": "ball.stl", "mesh_unit": "m", "patch_site": "centre", "radius_m": None,
                  "thickness_m": None, "depth_m": 0.006, "patch_radius_m": 0.012, "solver": "reduced"},
            array={"response": "off"},
        )  # fmt: skip
        trimesh.creation.icosphere(3, RADIUS_M).export(tmp_path / "ball.stl")
        plain = tmp_path / "plain.xml"
        text = plain.read_text()
        begin = text.index('<body name="pad"')
        end = text.index("</body>", begin)
        plain.write_text(text[:begin] + MOVABLE + SITES + text[end : end + len("</body>")] + COVER + text[end + 7 :])
        scene = path.read_text()
        begin = scene.index('<instance name="skin">')
        end = scene.index("</instance>", begin) + len("</instance>")
        skins = ""
        for name, site in zip(names, ("centre", "side"), strict=True):
            keys = f'<config key="accuracy" value="{ {"strict": 0.05, "loose": 0.5}[name] }"/>'
            keys += '<config key="body_sound" value="shadows"/>'
            if name == covered:
                keys += '<config key="obstacles" value="cover"/>'
            one = scene[begin:end].replace('name="skin"', f'name="{name}"').replace('value="centre"', f'value="{site}"')
            skins += one.replace("</instance>", keys + "</instance>")
        scene = scene[:begin] + skins + scene[end:]
        path.write_text(scene.replace('instance="skin"', f'instance="{names[0]}"'))
        return load(path)

    return write


def moved(sim, distance_m, cover_m=0.0):
    """The scene with the ball, and what may cover it, that far from where they began."""
    start = sim.model.body_pos[sim.model.body_mocapid >= 0]
    sim.data.mocap_pos[:] = start + np.array([[distance_m, 0.0, 0.0], [cover_m, 0.0, 0.0]])
    mujoco.mj_forward(sim.model, sim.data)
    raise_errors(sim.data)
    return sim.runtime.posed


@pytest.mark.parametrize("names", [("strict", "loose"), ("loose", "strict")])
def test_the_strictest_skin_says_whether_the_body_has_moved(two_on_a_ball, names):
    sim = two_on_a_ball(*names)
    model, reference = sim.runtime.model, sim.runtime.work.reference
    still = {skin.spec.name: skin.still_m for skin in model.skins}
    assert still["strict"] < 0.2 * still["loose"] and model.still_m == (still["strict"],)
    near = moved(sim, 0.5 * still["strict"])
    assert near.bodies == reference.bodies and near.skins == reference.skins
    # Further than the strict one allows, not yet as far as the loose one does
    for distance_m in (2.0 * still["strict"], 0.5 * still["loose"], 2.0 * still["loose"]):
        posed = moved(sim, distance_m)
        assert all(skin.body is posed.bodies[0] for skin in posed.skins)
        assert not any(skin is first for skin, first in zip(posed.skins, reference.skins, strict=True))
        shift = posed.skins[0].nodes[0] - reference.skins[0].nodes[0]
        np.testing.assert_allclose(shift, [[distance_m, 0.0, 0.0]] * len(shift), atol=1e-12)
    assert moved(sim, 0.0).skins == reference.skins


def test_an_obstacle_of_one_skin_moves_neither_the_body_nor_the_other_skin(two_on_a_ball):
    sim = two_on_a_ball("strict", "loose")
    reference, still_m = sim.runtime.work.reference, sim.runtime.model.still_m[0]
    posed = moved(sim, 0.5 * still_m, cover_m=-0.05)
    assert posed.bodies == reference.bodies and posed.skins[0] is reference.skins[0]
    assert posed.skins[1] is not reference.skins[1] and posed.skins[1].body is posed.bodies[0]
    shift = posed.skins[1].obstacles[0] - reference.skins[1].obstacles[0]
    np.testing.assert_allclose(shift, [[-0.05, 0.0, 0.0]] * len(shift), atol=1e-4)


def test_both_small_models_go_on_while_the_body_is_still(two_on_a_ball):
    sim = two_on_a_ball("strict", "loose")
    moved(sim, 0.5 * sim.runtime.model.still_m[0])
    sim.step(3)
    assert [state[0, 0] for state in sim.runtime.state.skins] == [BEGUN, BEGUN]
    said = [row.why for row in plan(sim).modelled if row.what == "skin solver reduced"]
    micrometres = f"move by more than {1e6 * sim.runtime.model.still_m[0]:.0f} um"
    assert said and all(micrometres in why for why in said)
