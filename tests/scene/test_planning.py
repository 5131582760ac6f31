"""What a plan says against what a run does, and against the benchmark pages that it names."""

import re
from pathlib import Path

import mujoco
import pytest

import palmfield
from palmfield import obstacle, runner
from palmfield.planning import SCATTER_ELEMENT_S, SCATTER_PAIR_S, warnings

STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}
SCATTERED = {
    "stimulus": STEADY,
    "array": {"response": "off"},
    "skin": {"body_sound": "scattering", "radius_m": 0.007, "thickness_m": 0.003, "element_m": 0.004},
}
JOINT = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'
PAGE = Path(__file__).parents[2] / "docs" / "bench" / "scattering.md"


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


@pytest.mark.parametrize(("joint", "moves"), [(JOINT, True), ("", False)], ids=["sliding", "fixed"])
def test_plan_counts_the_solutions_that_a_run_makes(small_scene, tmp_path, monkeypatch, joint, moves):
    scene = palmfield.load(with_joint(small_scene(**SCATTERED), joint))
    rig = scene.skin.rig
    made = []
    solve = obstacle.scatter

    def counting(*args, **keys):
        made.append(1)
        return solve(*args, **keys)

    monkeypatch.setattr(obstacle, "scatter", counting)
    monkeypatch.setattr(runner, "PICTURES", ())
    scene.data.qvel[:] = 0.01
    steps = 4
    short = palmfield.scene.Scene(scene.path, scene.model, scene.data, scene.skin, steps * rig.timestep_s)
    elements = len(rig.posed(rig.reference_pose).boundary_mesh[1])
    one = SCATTER_PAIR_S * elements**2 + SCATTER_ELEMENT_S * elements
    none = palmfield.load(
        with_joint(small_scene(**SCATTERED | {"skin": SCATTERED["skin"] | {"body_sound": "none"}}), joint)
    )
    bare = palmfield.plan(palmfield.scene.Scene(none.path, none.model, none.data, none.skin, short.duration_s))
    planned = (palmfield.plan(short).seconds - bare.seconds) / one
    # Poses of the steps, and one with another mesh of the disc; a body that moves also goes back to its loudest pose
    assert planned == pytest.approx(steps + 2 if moves else 2)
    palmfield.run(short, tmp_path / "out", progress=False)
    assert len(made) <= round(planned) and len(made) >= (steps if moves else 2)
    said = [text for text in warnings(short) if "which can move: each pose takes about" in text]
    assert len(said) == moves


def test_mocap_bodies_and_bodies_on_moving_ones_can_move(small_scene):
    path = with_joint(small_scene(**SCATTERED), "", ' mocap="true"')
    assert any("can move" in text for text in warnings(palmfield.load(path)))


def test_a_still_body_is_solved_for_once(small_scene, monkeypatch):
    scene = palmfield.load(with_joint(small_scene(**SCATTERED), ""))
    made = []
    solve = obstacle.scatter
    monkeypatch.setattr(obstacle, "scatter", lambda *args, **keys: made.append(1) or solve(*args, **keys))
    for _ in range(5):
        mujoco.mj_step(scene.model, scene.data)
    assert len(made) == 1


def test_figures_of_scattering_are_those_of_the_page(small_scene):
    size = row(palmfield.plan(palmfield.load(small_scene(stimulus=STEADY))).left_out, "scattered sound").size
    by_face = {
        name: int(value)
        for name, value in re.findall(r"^\| (\w+) \| no shadow \| [\d.]+ \| (\d+) % \|", PAGE.read_text(), re.MULTILINE)
    }
    for name, words in (("hand", "on an open hand"), ("finger", "on a finger"), ("cupped", "in a cup")):
        assert f"{by_face[name]} %" in size.split(words)[0].split(",")[-1]
    assert "more than half on skin turned away" in size and by_face["turned"] > 50


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "pistons of 4.5 mm radius"),
        ({"directivity": "point"}, "point sources"),
        ({"directivity": "t4010a1"}, "measured directivity"),
    ],
)
def test_plan_names_the_directivity(small_scene, keys, words):
    said = row(palmfield.plan(palmfield.load(small_scene(stimulus=STEADY, array=keys))).modelled, "sound field").why
    assert words in said
    assert [kind in said for kind in ("pistons", "point sources", "measured")].count(True) == 1


def test_plan_says_what_was_measured_of_the_drive(small_scene):
    scene = palmfield.load(small_scene(stimulus={"am_frequency_Hz": 5, "start_s": 0.001, "ramp_s": 0.1}))
    rig = scene.skin.rig
    assert not rig.response.on
    said = row(palmfield.plan(scene).left_out, "transducers' ring-up")
    assert f"{100 * rig.response.ring.rms:.2g} % rms, {100 * rig.response.ring.peak:.2g} % at worst" in said.size
    assert "measured on samples of the drive" in said.why
    heard = palmfield.load(small_scene())
    said = row(palmfield.plan(heard).modelled, "transducers' ring-up").why
    assert f"{heard.skin.rig.response.ring}" in said


def test_plan_names_every_arrays_quality(small_scene):
    second = (
        '<plugin plugin="palmfield.array"><instance name="second"><config key="site" value="second"/>'
        '<config key="quality" value="40"/></instance></plugin>'
    )
    path = small_scene(stimulus=STEADY)
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", '<worldbody><site name="second" pos="0.3 0 0"/>', 1))
    path.write_text(path.read_text().replace("<extension>", f"<extension>{second}", 1))
    assert "Q 25 and 40" in flat(palmfield.plan(palmfield.load(path)))
