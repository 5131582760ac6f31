"""Each scripted scenario at reduced size, with one check of its physics."""

import mujoco
import numpy as np
import pytest

from palmfield.acoustics.reference import pressure64
from palmfield.data import folder
from palmfield.hand.meshquery import barycentric, build_mesh, closest_faces
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.skin.fem.probe import SurfaceProbe

COARSE = {"skin.accuracy": 0.5, "skin.max_frequency_Hz": 250.0, "skin.element_m": None}
PERIOD_STEPS = 5
"""MuJoCo steps of 1 ms in a period of the scenes' modulation of 200 Hz."""


def opened(name, **keys):
    return load(folder("mjcf") / "scenes" / f"{name}.xml", device="cpu", keys=keys)


def steps(sim, count):
    """Sensor rows of the next steps, shape (count, channels)."""
    rows = []
    for _ in range(count):
        sim.step()
        rows.append(sim.data.sensordata.copy())
    return np.array(rows)


def foci_of(sim, times):
    """Where the one stimulus's focus would be at some times [s], were all to keep still, array frame [m], (k, 3)."""
    runtime = sim.runtime
    [foci] = runtime.work.emission.foci(runtime.posed, np.asarray(times, dtype=float))
    return foci[:, 0]


def test_approach_and_withdraw():
    """While the palm passes the focus its ARP goes as the free field's |p|^2 at its height, in float64."""
    scene = opened("approach_withdraw")
    model = scene.runtime.model
    drive = array_drives(model, model.arrays)[0].unit_drive(model.stimuli[0].first_focus).amplitudes
    felt, expected = [], []
    for time in (0.05, 0.12, 0.3):
        scene.start_at(time)
        rows = steps(scene, PERIOD_STEPS)
        felt.append(rows[:, 5].mean())
        at = scene.data.site("palm_centre").xpos - scene.data.site("array").xpos
        expected.append(abs(pressure64(at[None], model.arrays.array, drive, model.arrays.air)[0][0]) ** 2)
    felt, expected = (np.array(x) / x[1] for x in (felt, expected))
    assert felt == pytest.approx(expected, rel=0.05)
    assert felt[0] < 0.5


def test_hover_and_explore():
    """The palm feels the circle where it is: most ARP, averaged over its turns, when the palm is right above."""
    scene = opened("hover_explore", **{"skin.patch_radius_m": 0.012, "skin.accuracy": 0.4})
    felt = []
    for time in (0.1, 0.2, 0.3):
        scene.start_at(time)
        felt.append(steps(scene, 10)[:, 5].mean())
    offsets = [abs(x - 0.03) for x in (-0.006, 0.032, 0.059)]
    assert np.argsort(felt)[-1] == np.argmin(offsets) == 1
    assert felt[1] > 4.0 * max(felt[0], felt[2])


def test_tap_a_virtual_button():
    """Skin at rest until the pulp is at the button's height; then a knock each 10 ms, at rest again in between."""
    scene = opened("tap_button")
    rows = steps(scene, 128)
    height = scene.data.site("index_pad").xpos[2]
    assert height == pytest.approx(0.2, abs=1e-3)
    assert not rows[:, 3].any()
    pushed = -steps(scene, 30)[:, 3].reshape(3, 10)
    knocks = pushed.max(axis=1)
    assert knocks.min() > 1e-7 and np.ptp(knocks) < 0.1 * knocks.max()
    assert np.abs(pushed[:, -2:]).max() < 0.2 * knocks.min()


def test_follow_a_moving_fingertip():
    """The focus stays on the pulp, and the pulp's ARP with it, while it goes 40 mm."""
    scene = opened("follow_fingertip")
    places, felt = [], []
    for time in (0.05, 0.25, 0.45):
        scene.start_at(time)
        felt.append(steps(scene, PERIOD_STEPS)[:, 5].mean())
        pulp = scene.data.site("index_pad").xpos
        focus = scene.runtime.posed.array_frame.points(foci_of(scene, [scene.time])[0])
        assert focus == pytest.approx(pulp, abs=1e-6)
        places.append(pulp.copy())
    assert np.linalg.norm(places[2] - places[0]) > 0.04
    assert np.ptp(felt) < 0.3 * np.mean(felt)


def test_trace_a_shape():
    """The focus slides on the turned hand's skin, as fast along it as asked."""
    scene = opened("trace_shape", **{"skin.patch_radius_m": 0.012, "skin.accuracy": 0.4})
    scene.start_at(0.15)
    roll = scene.data.body("hand").xmat.reshape(3, 3)[0, 2]
    assert abs(roll) > 0.2
    times = 0.15 + np.linspace(0.0, 0.02, 401)
    body = scene.runtime.posed.bodies[0]
    surface, faces = body.vertices, body.model.surface.faces
    foci = foci_of(scene, times)
    on_body = body.frame.inverse_points(foci)
    some = on_body[::20]
    corners = surface[faces[closest_faces(build_mesh(surface, faces), some, 0.01)]]
    nearest = np.einsum("nk,nkj->nj", barycentric(corners, some), corners)
    assert nearest == pytest.approx(some, abs=1e-6)
    assert np.ptp(foci[:, 2]) > 2e-3
    speed = np.linalg.norm(np.diff(foci, axis=0), axis=1) / np.diff(times)
    assert np.median(speed) == pytest.approx(4.0, rel=0.01)


def test_two_hands():
    """The other hand between array and palm takes the sound away, and gives it back when it has passed."""
    scene = opened("two_hands")
    felt = []
    for time in (0.05, 0.25, 0.36):
        scene.start_at(time)
        felt.append(steps(scene, PERIOD_STEPS)[:, 5].mean())
    assert felt[0] > 1.0
    assert felt[1] < 0.1 * felt[0]
    assert felt[2] == pytest.approx(felt[0], rel=0.05)


def test_grasp_an_object():
    """Friction carries the ball's weight, and the ball keeps its place between the fingers."""
    scene = opened("grasp_object", **{"stimulus.drive_amplitude": 0})
    model, data = scene.model, scene.data
    ball = model.body("ball")
    steps(scene, 120)
    before = data.body("ball").xpos - data.body("hand").xpos
    carried = []
    for _ in range(80):
        steps(scene, 1)
        force, wrench = np.zeros(3), np.zeros(6)
        for number, contact in enumerate(data.contact):
            bodies = model.geom_bodyid[[contact.geom1, contact.geom2]]
            if ball.id in bodies:
                mujoco.mj_contactForce(model, data, number, wrench)
                force += (1.0 if bodies[1] == ball.id else -1.0) * contact.frame.reshape(3, 3).T @ wrench[:3]
        carried.append(force[2])
    assert np.mean(carried) == pytest.approx(0.02 * 9.81, rel=0.05)
    after = data.body("ball").xpos - data.body("hand").xpos
    assert np.linalg.norm(after - before) < 1e-3


@pytest.mark.nightly
def test_stroke_the_palm():
    """The faster the focus, the longer behind it the skin still moves at a tenth of its largest velocity."""
    wakes = []
    for speed in (1.0, 4.0, 11.0):
        scene = opened("stroke_palm", **{"stimulus.path_speed_m_s": speed, **COARSE})
        model = scene.runtime.model
        stimulus, body, layer = model.stimuli[0], model.bodies[0], model.skins[0].layer
        length = stimulus.config.sites_length_m
        arcs = np.linspace(0.0, length, 280)
        places, _ = stimulus.path.at(arcs, body.surface.vertices, body.surface.faces)
        scene.step(round(0.55 * length / speed / scene.model.opt.timestep))
        [(stepper, numbers)] = scene.runtime.skin_states()
        reader = stepper.reader(SurfaceProbe(layer.mesh, places, layer.system).operator)
        velocity = np.abs(stepper.read(numbers, reader)[0, 1])
        envelope = np.array([velocity[np.abs(arcs - arc) < 0.006].max() for arc in arcs])
        behind = arcs < speed * scene.data.time
        still = np.flatnonzero(behind & (envelope < 0.1 * envelope.max()))
        wakes.append(speed * scene.data.time - arcs[still[-1]])
    assert 0.01 < wakes[0] < 0.8 * wakes[1] < 0.7 * wakes[2]
