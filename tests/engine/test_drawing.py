"""What the plugins add to MuJoCo's pictures, read from the scene that MuJoCo is about to draw; no window, no OpenGL."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from palmfield.engine import host
from palmfield.engine.array_plugin import PHASES_GROUP
from palmfield.engine.scene_view import SceneView
from palmfield.engine.skin_plugin import ARP_GROUP, LIFT_m
from palmfield.engine.stimulus_plugin import FOCI_GROUP
from palmfield.session.simulation import Simulation

pytestmark = pytest.mark.usefixtures("kept_operators")

STEADY = {"modulation": None, "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
CIRCLE = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 100}
ALL = ("phases", "foci", "arp")


def in_picture(sim, shown=ALL, maxgeom=10000):
    """All shapes of a picture, with some kinds of the plugins' switched on."""
    option = mujoco.MjvOption()
    option.geomgroup[PHASES_GROUP], option.geomgroup[ARP_GROUP] = "phases" in shown, "arp" in shown
    option.sitegroup[FOCI_GROUP] = "foci" in shown
    scene = mujoco.MjvScene(sim.model, maxgeom=maxgeom)
    category = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(sim.model, sim.data, option, None, mujoco.MjvCamera(), category, scene)
    assert scene.ngeom <= maxgeom
    return list(scene.geoms[: scene.ngeom])


def drawn(sim, shown=ALL):
    """Those that the model has no hand in."""
    decor, unknown = mujoco.mjtCatBit.mjCAT_DECOR, mujoco.mjtObj.mjOBJ_UNKNOWN
    return [shape for shape in in_picture(sim, shown) if shape.category == decor and shape.objtype == unknown]


def of_kind(shapes, kind):
    return [shape for shape in shapes if shape.type == kind]


def corners(triangle):
    """As MuJoCo draws them: at 0, x and y of the shape's own frame."""
    places = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) * triangle.size
    return places @ np.reshape(triangle.mat, (3, 3)).T + triangle.pos


@pytest.fixture(scope="module")
def steady(module_scene):
    sim = Simulation(module_scene(stimulus=STEADY))
    sim.step(20)
    mujoco.mj_forward(sim.model, sim.data)
    return sim


def test_each_kind_is_switched_by_its_group(steady):
    kinds = mujoco.mjtGeom
    count = {name: len(drawn(steady, (name,))) for name in ALL}
    assert count["phases"] == 256 and count["foci"] == 1 and count["arp"] > 50
    assert len(drawn(steady)) == sum(count.values())
    assert not drawn(steady, ())
    assert len(of_kind(drawn(steady, ("arp",)), kinds.mjGEOM_TRIANGLE)) == count["arp"] - 1  # and the label


def test_phases_lie_on_the_transducers_of_the_board(steady):
    """Held against the cylinders that the plain scene draws, which know nothing of palmfield's layouts."""
    model, data = steady.model, steady.data
    body = model.geom_bodyid == model.body("board").id
    cylinders = body & (model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER)
    tops = data.geom_xpos[cylinders] + model.geom_size[cylinders, 1:2] * [0.0, 0.0, 1.0]
    discs = np.array([disc.pos for disc in drawn(steady, ("phases",))])
    apart = np.linalg.norm(discs[:, None] - tops, axis=2)
    assert apart.min(axis=0).max() < 5e-4 and sorted(apart.argmin(axis=1)) == list(range(256))


def test_colours_tell_phases(steady):
    """Transducers as far from the focus as others have their colour; those half a wavelength farther another one."""
    discs = drawn(steady, ("phases",))
    distance = np.linalg.norm([disc.pos for disc in discs] - np.array([0.0, 0.0, 0.12]), axis=1)
    colours = np.array([disc.rgba for disc in discs])
    order = np.argsort(distance)
    same = np.abs(np.diff(distance[order])) < 1e-6
    assert same.sum() > 100
    assert np.abs(np.diff(colours[order], axis=0))[same].max() < 0.02
    assert np.ptp(colours[:, :3], axis=0).max() > 0.5


def test_the_focus_is_where_the_scene_has_it(steady):
    (focus,) = drawn(steady, ("foci",))
    assert focus.pos == pytest.approx([0.0, 0.0, 0.12], abs=1e-6)


def test_seen_arp_adds_up_to_the_force_on_the_body(steady):
    seen = host.world_of(steady.data).view.skin(0)
    a, b, c = (seen.vertices[seen.faces[:, i]] for i in range(3))
    force = -0.5 * (np.cross(b - a, c - a) * seen.arp[seen.faces].mean(axis=1)[:, None]).sum(axis=0)
    applied = steady.runtime.applied[0]
    assert applied[2] > 1e-4
    assert force == pytest.approx(applied, abs=0.02 * applied[2])


def test_triangles_lie_on_the_skin_and_the_loudest_is_under_the_focus(steady):
    arp = drawn(steady, ("arp",))
    triangles = of_kind(arp, mujoco.mjtGeom.mjGEOM_TRIANGLE)
    places = np.array([corners(triangle) for triangle in triangles])
    assert np.abs(places[..., 2] - (0.12 - LIFT_m)).max() < 1e-5
    assert np.linalg.norm(places[0].mean(axis=0)[:2]) < 2e-3
    opacity = np.array([triangle.rgba[3] for triangle in triangles])
    assert opacity[0] == 1.0 and opacity[-1] < 0.1 and (np.diff(opacity) <= 1e-6).all()
    (label,) = of_kind(arp, mujoco.mjtGeom.mjGEOM_LABEL)
    name, told, unit, over = label.label.split(maxsplit=3)
    assert (
        (name, unit) == ("ARP", "Pa,")
        and over.startswith("mean over ")
        and float(told) == pytest.approx(steady.data.sensor("skin").data[-1], rel=0.02)
    )


def test_modulated_sound_is_shown_as_its_mean(module_scene, steady):
    """ARP that goes as (1 + cos) / 2 is half of its peak in the mean, at whatever moment it is looked at."""
    loud = host.world_of(steady.data).view.skin(0).arp.max()
    am = {"modulation": "am", "am_quantity": "arp", "am_frequency_Hz": 200, "am_depth": 1}
    sim = Simulation(module_scene(stimulus=am))
    for steps in (1, 2, 3):
        sim.step(steps)
        drawn(sim)
        assert host.world_of(sim.data).view.skin(0).arp.max() == pytest.approx(0.5 * loud, rel=0.01)


def test_a_path_shows_where_the_focus_goes(module_scene):
    sim = Simulation(module_scene(stimulus=CIRCLE))
    sim.step(1)
    places = np.array([ball.pos for ball in drawn(sim, ("foci",))])
    assert len(places) > 10
    assert np.linalg.norm(places[:, :2], axis=1) == pytest.approx(0.005, abs=1e-6)


def test_silence_draws_nothing(module_scene):
    sim = Simulation(module_scene(stimulus=STEADY | {"start_s": 1.0}))
    sim.step(1)
    assert not drawn(sim)


def test_nothing_is_drawn_before_anything_has_its_place(module_scene):
    """A viewer draws data once before it steps them: all poses are zero then."""
    sim = Simulation(module_scene(stimulus=STEADY))
    data = mujoco.MjData(sim.model)
    scene = mujoco.MjvScene(sim.model, maxgeom=1000)
    category = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(sim.model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), category, scene)
    assert not host.world_of(data).undrawn
    assert not [shape for shape in scene.geoms[: scene.ngeom] if shape.type == mujoco.mjtGeom.mjGEOM_TRIANGLE]


@pytest.mark.parametrize(("maxgeom", "share"), [(1, 0.0), (400, 0.0), (600, 0.3), (800, 0.6), (1100, 1.0)])
def test_shapes_take_no_room_from_the_model_and_never_exceed_it(steady, maxgeom, share):
    """MuJoCo asks plugins first: they could push out board and pad."""
    own = [in_picture(steady, shown, maxgeom) for shown in ((), ALL)]
    models = [sum(shape.objtype == mujoco.mjtObj.mjOBJ_GEOM for shape in shapes) for shapes in own]
    assert models[0] == models[1] > 0
    added = len(own[1]) - len(own[0])
    assert 0 <= added <= maxgeom - len(own[0])
    assert added / len(drawn(steady)) == pytest.approx(share, abs=0.1)


@pytest.mark.parametrize("stimulus", [STEADY, CIRCLE | {"control_rate_Hz": 250}])
def test_to_look_changes_no_number(module_scene, stimulus):
    states = []
    for looks in (False, True):
        sim = Simulation(module_scene(stimulus=stimulus))
        for _ in range(12):
            sim.step(1)
            if looks:
                assert drawn(sim)
        states.append((sim.data.plugin_state.copy(), sim.data.sensordata.copy(), sim.data.qpos.copy()))
    assert all(np.array_equal(one, other) for one, other in zip(*states, strict=True))


def test_a_copy_is_drawn_as_well(steady):
    copy = mujoco.MjData(steady.model)
    mujoco.mj_copyData(copy, steady.model, steady.data)
    scene = mujoco.MjvScene(steady.model, maxgeom=10000)
    category = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(steady.model, copy, mujoco.MjvOption(), None, mujoco.MjvCamera(), category, scene)
    assert scene.ngeom > 600


def test_a_fault_in_drawing_is_told_once_and_the_run_goes_on(module_scene, monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file there
    sim = Simulation(module_scene(stimulus=STEADY))
    sim.step(1)

    def fail(*_):
        raise ValueError("no picture today")

    with monkeypatch.context() as broken:
        broken.setattr(SceneView, "skin", fail)
        shapes = [len(drawn(sim)) for _ in range(3)]
    assert shapes == [257] * 3
    sim.step(1)
    assert np.isfinite(sim.data.sensordata).all()
    assert (
        capfd.readouterr().err.count("no picture today") == 1
        or (tmp_path / "MUJOCO_LOG.TXT").read_text().count("no picture today") == 1
    )
    assert len(drawn(sim)) > 300


def test_what_was_made_for_another_model_is_not_shown(module_scene):
    """Keys that are exchanged change what is seen."""
    sim = Simulation(module_scene(stimulus=STEADY))
    sim.step(1)
    (first,) = drawn(sim, ("foci",))
    assert first.pos == pytest.approx([0.0, 0.0, 0.12], abs=1e-6)
    other = Simulation(module_scene(stimulus=STEADY), keys={"stimulus.focus_m": (0.005, 0.0, 0.12)})
    other.step(1)
    (second,) = drawn(other, ("foci",))
    assert second.pos == pytest.approx([0.005, 0.0, 0.12], abs=1e-6)


RENDERED = """
import sys
import mujoco
import numpy as np
from palmfield.engine.array_plugin import PHASES_GROUP
from palmfield.engine.skin_plugin import ARP_GROUP

model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
mujoco.mj_step(model, data)
try:
    renderer = mujoco.Renderer(model, 120, 160)
except Exception as error:
    sys.exit(f"no OpenGL: {error!r}")
camera = mujoco.MjvCamera()
camera.lookat[:], camera.distance, camera.elevation = (0.0, 0.0, 0.1), 0.2, 60.0
pictures = {}
for shown in (True, False):
    option = mujoco.MjvOption()
    option.geomgroup[PHASES_GROUP] = option.geomgroup[ARP_GROUP] = option.sitegroup[1] = shown
    renderer.update_scene(data, camera, option)
    pictures[shown] = renderer.render().astype(int)
renderer.close()
apart = np.abs(pictures[True] - pictures[False]).max(axis=2)
print((apart > 40).mean())
"""


def test_the_renderer_shows_them(module_scene, tmp_path):
    """With OpenGL as there is on a machine without a display; where there is none, the tests above must do."""
    path = module_scene(stimulus=STEADY)
    done = subprocess.run(
        [sys.executable, "-c", RENDERED, str(path)],
        cwd=tmp_path, env=os.environ | {"MUJOCO_GL": "egl"}, capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    if "no OpenGL" in done.stderr or "EGL" in done.stderr:
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stderr
    assert 0.002 < float(done.stdout) < 0.5
