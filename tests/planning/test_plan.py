"""What a plan says against what a run does, and against the benchmark pages that it names."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from refusals import changed

import palmfield
from palmfield.acoustics import body_scattering
from palmfield.acoustics.air import sound_speed
from palmfield.estimate.biases import FACE_BY_FACE
from palmfield.estimate.summary import estimated_budget
from palmfield.planning.costs import SCATTER_ELEMENT_S, SCATTER_PAIR_S
from palmfield.planning.modelled import BODY_SOUNDS
from palmfield.planning.scene_plan import warnings
from palmfield.types import Air

pytestmark = pytest.mark.usefixtures("kept_operators")

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
SCATTERED = {
    "stimulus": STEADY,
    "array": {"response": "off"},
    "skin": {"body_sound": "scattering", "radius_m": 0.007, "thickness_m": 0.003, "element_m": 0.004},
}
JOINT = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'
PAGE = Path(__file__).parents[2] / "docs" / "bench" / "scattering.md"
SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"


def flat(plan):
    """A plan's text without its tables' lines."""
    return " ".join(re.sub("[^ -~]", " ", str(plan)).split())


def row(rows, what):
    return next(r for r in rows if r.what == what)


def with_joint(path, joint, attribute=""):
    plain = path.parent / "plain.xml"
    text = plain.read_text().replace(JOINT, joint)
    plain.write_text(text.replace('<body name="pad"', f'<body name="pad"{attribute}'))
    return path


@pytest.fixture
def solutions(monkeypatch):
    """A list that grows by one for each solution by boundary elements."""
    made = []
    solve = body_scattering.scatter

    def counting(*args, **keys):
        made.append(1)
        return solve(*args, **keys)

    monkeypatch.setattr(body_scattering, "scatter", counting)
    return made


@pytest.mark.parametrize(("joint", "moves"), [(JOINT, True), ("", False)], ids=["sliding", "fixed"])
def test_plan_counts_the_solutions_that_a_run_makes(small_scene, moment, solutions, joint, moves):
    steps = 4
    none = SCATTERED | {"skin": SCATTERED["skin"] | {"body_sound": "none"}}
    bare = palmfield.load(with_joint(small_scene(**none), joint))
    bare.duration_s = steps * 1e-3
    bare_s = palmfield.plan(bare).seconds
    scene = palmfield.load(with_joint(small_scene(**SCATTERED), joint))
    scene.duration_s = steps * 1e-3
    scene.data.qvel[:] = 0.01
    body = scene.runtime.work.reference.bodies[0]
    wavelength_m = 343.2 / 40e3
    elements = len(body_scattering.boundary_mesh(body.vertices, body.faces, wavelength_m)[1])
    one = SCATTER_PAIR_S * elements**2 + SCATTER_ELEMENT_S * elements
    planned = (palmfield.plan(scene).seconds - bare_s) / one
    # Poses of the steps, and one with another mesh of the disc; a body that moves also goes back to its loudest pose
    assert planned == pytest.approx(steps + 2 if moves else 2)
    solutions.clear()
    scene.step(steps // 2)
    loudest = moment(scene)
    scene.step(steps - steps // 2)
    estimated_budget(scene, 0, loudest)
    assert len(solutions) <= round(planned) and len(solutions) >= (steps if moves else 1)
    said = [text for text in warnings(scene) if "which can move: about" in text]
    assert len(said) == moves


def test_mocap_bodies_and_bodies_on_moving_ones_can_move(small_scene):
    path = with_joint(small_scene(**SCATTERED), "", ' mocap="true"')
    assert any("can move" in text for text in warnings(path))


def test_a_still_body_is_solved_for_once(small_scene, solutions):
    scene = palmfield.load(with_joint(small_scene(**SCATTERED), ""))
    for _ in range(5):
        mujoco.mj_step(scene.model, scene.data)
    assert len(solutions) == 1


def test_a_flat_disc_is_told_no_stories_of_hands(small_scene):
    told = flat(palmfield.plan(small_scene(stimulus=STEADY)))
    assert not re.search(r"\bhands?\b|finger|bone|cup", told.replace(str(SCENES.parents[1]), "")), told
    assert row(palmfield.plan(small_scene()).left_out, "cast shadows").size == "0 %"


def test_a_body_that_moves_is_told_its_own_inertia():
    plan = palmfield.plan(SCENES / "hover_explore.xml", accuracy=0.5)
    size = row(plan.besides, "acceleration of the body").size
    load, depth = (float(x) for x in re.search(r"([\d.]+) Pa for 1 m/s\^2 and ([\d.]+) mm", size).groups())
    # The palm's material has 1000 to 1100 kg/m3
    assert 1000 * depth * 1e-3 * 0.95 < load < 1100 * depth * 1e-3 * 1.05


HAND_STORIES, DISC_STORIES = (
    (r"\bhands?\b", r"\bfingers?\b", r"\bcupped\b"),
    ("flat face", "flat plate at", "this face is"),
)


def sayings(plan):
    """What a plan says of sound and bodies: materials, and the study behind the mesh, are told of whatever body."""
    rows = (*plan.modelled, *plan.left_out, *plan.besides)
    return " ".join(f"{row.what} {row.size} {row.why}" for row in rows) + " ".join(plan.warnings)


@pytest.mark.parametrize("path", sorted(set(SCENES.glob("*.xml")) - set(SCENES.glob("plain_*"))), ids=lambda p: p.stem)
def test_a_plan_tells_stories_of_the_body_at_hand(path):
    said = sayings(palmfield.plan(path, accuracy=0.5))
    disc = path.stem.startswith("phantom")
    assert [bool(re.search(story, said)) for story in HAND_STORIES] == [not disc] * len(HAND_STORIES)
    assert [story in said for story in DISC_STORIES] == [disc] * len(DISC_STORIES)


def test_a_disc_that_a_script_moves_is_no_hand(small_scene):
    path = with_joint(small_scene(stimulus=STEADY), "", ' mocap="true"')
    keys = '<config key="body" value="pad"/><config key="keyframes" value="down.toml"/>'
    motion = f'<plugin plugin="palmfield.motion"><instance name="down">{keys}</instance></plugin>'
    path.write_text(path.read_text().replace("</extension>", motion + "</extension>"))
    key = "[[key]]\ntime_s = {}\nposition_m = [0.0, 0.0, {}]\nquaternion = [0.0, 1.0, 0.0, 0.0]\n"
    (path.parent / "down.toml").write_text(key.format(0.0, 0.13) + key.format(0.1, 0.12))
    said = sayings(palmfield.plan(path))
    assert "a script moves a part of the scene" in said
    assert not any(re.search(story, said) for story in HAND_STORIES)


def test_figures_of_scattering_are_those_of_the_page():
    by_face = {
        name: int(value)
        for name, value in re.findall(r"^\| (\w+) \| no shadow \| [\d.]+ \| (\d+) % \|", PAGE.read_text(), re.MULTILINE)
    }
    for name, words in (("hand", "on an open hand"), ("finger", "on a finger"), ("cupped", "in a cup")):
        assert f"{by_face[name]} %" in FACE_BY_FACE.split(words)[0].split(",")[-1]
    assert "more than half on skin that faces away" in FACE_BY_FACE and by_face["turned"] > 50


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "pistons with a radius of 4.5 mm"),
        ({"directivity": "point"}, "point sources"),
        ({"directivity": "t4010a1"}, "measured directivity"),
    ],
)
def test_plan_names_the_directivity(small_scene, keys, words):
    said = row(palmfield.plan(small_scene(stimulus=STEADY, array=keys)).modelled, "sound field").why
    assert words in said
    assert [kind in said for kind in ("pistons", "point sources", "measured")].count(True) == 1


def test_plan_says_what_was_measured_of_the_drive(small_scene):
    scene = palmfield.load(small_scene(stimulus={"am_frequency_Hz": 5, "start_s": 0.001, "ramp_s": 0.1}))
    response = scene.runtime.model.stimuli[0].response
    assert not response.on
    said = row(palmfield.plan(scene).left_out, "transducers' ring-up")
    assert f"{100 * response.ring_up.rms:.2g} % rms, {100 * response.ring_up.peak:.2g} % at worst" in said.why
    assert -2.0 * response.ring_up.rms < float(said.size.split()[0]) / 100.0 <= 0.0
    assert "estimated from samples of the drive" in said.why
    ringing = palmfield.load(small_scene())
    said = row(palmfield.plan(ringing).modelled, "transducers' ring-up").why
    assert f"{ringing.runtime.model.stimuli[0].response.ring_up}" in said


def test_plan_names_every_arrays_quality(small_scene, add_array):
    path = add_array(small_scene(stimulus=STEADY), '<config key="quality" value="40"/>')
    assert "Q 25 and 40" in flat(palmfield.plan(path))


def test_plan_names_board_device_and_stepper_with_the_reason(small_scene):
    plan = palmfield.plan(small_scene(), device="cpu", keys={"skin.solver": "wedges"})
    assert "board ideal" in row(plan.modelled, "drive").why
    assert "on cpu (palmfield_device)" in row(plan.modelled, "sound field").why
    assert "set by key solver" in row(plan.modelled, "skin solver wedges").why
    reduced = row(palmfield.plan(small_scene(), keys={"skin.solver": "reduced"}).modelled, "skin solver reduced")
    assert "set by key solver" in reduced.why and "wedges about" in reduced.size


def test_a_scene_with_one_of_each_needs_no_names(small_scene):
    plan = palmfield.plan(small_scene())
    assert "stimulus" not in {name.strip() for name in re.split("[^ -~]", str(plan))}
    assert row(plan.modelled, "elements").instance == "skin"


def test_rows_say_whose_they_are(small_scene, add_skin):
    path = add_skin(small_scene(), "0.2 0 0.12")
    plan = palmfield.plan(path, keys={"second.element_m": 0.005})
    elements = [r for r in plan.modelled if r.what == "elements"]
    assert [r.instance for r in elements] == ["skin", "second"] and elements[0].size != elements[1].size
    assert row(plan.modelled, "sound at the body").instance == "skin, second"
    assert [r.instance for r in plan.modelled if r.what == "drive"] == ["stimulus"]
    assert "skin, second" in flat(plan)


def test_a_skin_without_a_focus_is_warned_of_by_name(small_scene, add_skin):
    text = next(text for text in warnings(add_skin(small_scene(), "0.2 0 0.12")) if "no focus is near" in text)
    assert "skin 'second'" in text and "stimulus 'stimulus'" in text and "180 mm" in text
    near = {"stimulus": {**STEADY, "path": "line", "path_width_m": 0.42, "path_rate_Hz": 5}}
    assert not any("no focus is near" in text for text in warnings(add_skin(small_scene(**near), "0.2 0 0.12")))


def test_a_plan_of_a_simulation_takes_its_keys_and_moment(small_scene):
    scene = palmfield.load(small_scene(), accuracy=0.3)
    assert row(palmfield.plan(scene).error, "mesh and time step").size == "target 30 %"
    with pytest.raises(palmfield.SceneError, match=r"give them to Simulation"):
        palmfield.plan(scene, accuracy=0.2)


def test_keys_that_make_a_skin_coarser_are_told(small_scene):
    """And keys that make it finer, or as fine, are not."""
    scene = small_scene(skin={"element_m": None, "step_s": None}, stimulus={"am_frequency_Hz": 200})
    chosen = palmfield.plan(scene).numbers["skins"][0]
    assert not [text for text in warnings(scene) if "coarser" in text]
    assert "sizes follow a convergence study" in row(palmfield.plan(scene).error, "mesh and time step").why
    coarse = {"element_m": 0.03, "step_s": 0.001, "max_frequency_Hz": 100}
    keys = {f"skin.{name}": value for name, value in coarse.items()}
    plan = palmfield.plan(scene, keys=keys)
    (said,) = [text for text in plan.warnings if "coarser" in text]
    assert all(name in said for name in coarse) and "max_frequency_Hz 100 (stimulus:" in said
    error = row(plan.error, "mesh and time step")
    assert "keys make it coarser" in error.why and error.size == "target 5 %"
    fine = {"skin.element_m": 0.9 * chosen["edge_fine_m"], "skin.step_s": 0.0001}
    assert not [text for text in palmfield.plan(scene, keys=fine).warnings if "coarser" in text]


def test_a_run_that_steps_make_longer_or_shorter_is_told(small_scene):
    path = changed(small_scene(), 'timestep="0.001"', 'timestep="0.2"')
    told = {}
    for duration_s in (0.4, 0.05, 0.5):
        plan = palmfield.plan(path, duration_s=duration_s)
        told[duration_s] = [text for text in plan.warnings if "the run takes" in text]
        assert plan.numbers["steps"] == {0.4: 2, 0.05: 1, 0.5: 2}[duration_s]
    assert told[0.4] == []
    assert "takes 0.2 s instead of 0.05 s, which is one MuJoCo step: option timestep is 0.2 s" in told[0.05][0]
    assert "takes 0.4 s instead of 0.5 s, which is 2 MuJoCo steps" in told[0.5][0]


def test_what_part_of_a_surface_is_modelled_is_said_as_it_is(small_scene):
    assert row(palmfield.plan(small_scene()).modelled, "skin layer").why.startswith("the whole disc;")
    palm, pinned = SCENES / "palm_am200.xml", SCENES / "tap_button.xml"
    assert "in which waves matter" in row(palmfield.plan(palm, accuracy=0.5).modelled, "skin layer").why
    assert "key patch_radius_m" in row(palmfield.plan(pinned, accuracy=0.5).modelled, "skin layer").why


def test_planning_makes_no_matrices(small_scene):
    # A duration of its own: scenes with equal specs share a model, which another test may have stepped
    path = small_scene(duration_s=0.0173)
    view = palmfield.session.preview.preview(path)
    palmfield.plan(path)
    model = view.runtime.model
    assert not any(lazy.made for lazy in (*model.begin, *model.whole))


@pytest.mark.slow
@pytest.mark.parametrize("scene", sorted(SCENES.glob("[!p]*.xml")), ids=lambda path: path.stem)
def test_no_shipped_scene_of_moving_hands_is_warned_of_a_far_focus(scene):
    told = warnings(scene)
    assert not any(words in text for text in told for words in ("no focus is near", "faces away", "edge-on"))


def test_plan_says_what_a_board_is_sent_and_where_the_sound_is_loudest(small_scene):
    made = palmfield.plan(small_scene(), board="autd2018")
    said = row(made.modelled, "sending").size
    assert said.startswith("9 bytes per frame, 2000 frames/s due, capacity of the line 2000; latency 0.391 to 0.781 ms")
    assert made.as_dict()["board"] == "autd2018" and made.as_dict()["sending"]["frame_bytes"] == 9
    assert palmfield.plan(small_scene()).as_dict()["sending"] is None
    arrays = palmfield.load(small_scene(), board="autd2018").runtime.model.arrays
    distance = np.linalg.norm(arrays.array.positions - [0.0, 0.0, 0.12], axis=1)
    drive = np.exp(-2j * np.pi * 40e3 / sound_speed(Air()) * distance)
    heights = np.linspace(0.09, 0.13, 2001)
    along = np.abs(arrays.pressure64(np.column_stack([np.zeros((2001, 2)), heights]), drive))
    nearer_mm = 1e3 * (0.12 - heights[along.argmax()])
    told = float(row(made.modelled, "loudest point").size.split("the maximum of |p| lies ")[1].split(" mm nearer")[0])
    assert nearer_mm > 1.0 and told == pytest.approx(nearer_mm, abs=0.3)


def test_a_run_that_ends_in_its_ramp_is_warned_of(small_scene):
    """A raised cosine of 0.15 s has reached (1 - cos(pi / 10)) / 2 of the ARP after 15 ms."""
    said = " ".join(palmfield.plan(small_scene(stimulus={"ramp_s": 0.15})).warnings)
    assert "ramp of stimulus 'stimulus' takes 0.15 s" in said and "reaches 2.4 %" in said
    assert "ramp" not in " ".join(palmfield.plan(small_scene(stimulus={"ramp_s": 0.005})).warnings)


def test_a_beam_is_warned_of_as_it_arrives_and_not_behind_the_skin(small_scene):
    """A focus 1 m away, loud enough for a shock there, behind skin at 0.12 m, which it meets long before."""
    path = small_scene(array={"p0_Pa_m": 6.0}, stimulus={"focus_m": "0 0 1"})
    assert "shock" not in " ".join(palmfield.plan(path).warnings)
    loud = small_scene(array={"p0_Pa_m": 12.0})
    assert "shock" in " ".join(palmfield.plan(loud).warnings)


def test_a_plan_solves_for_no_scattering(small_scene, solutions):
    """Where the sound arrives is looked at in free air."""
    palmfield.plan(small_scene(stimulus=STEADY, skin={"body_sound": "scattering"}))
    assert not solutions


def test_body_sounds_are_the_keys_values() -> None:
    assert list(BODY_SOUNDS) == ["none", "shadows", "scattering"]
