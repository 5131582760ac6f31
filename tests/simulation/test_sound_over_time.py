"""Ring-up and flight time of the transducers' sound in scenes, and sound that a body scatters."""

import mujoco
import numpy as np
import pytest

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.body_scattering import boundary_mesh
from palmfield.acoustics.scattering import scatter
from palmfield.drive.response import Pole, envelope_response
from palmfield.drive.transducer_response import commanded_drive
from palmfield.errors import SceneError
from palmfield.estimate.estimated_run import run
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.simulation.posed_scene import reference_scene

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
RAMPED = {"start_s": 0.001, "ramp_s": 0.05}


def arp_over_time(path, steps):
    sim = load(path)
    felt = []
    for _ in range(steps):
        sim.step()
        felt.append(sim.data.sensordata[5])
    return np.array(felt), sim


def full_drive(model):
    """Where the sound goes first, and the amplitudes that bring it there."""
    focus = model.stimuli[0].first_focus
    return focus, array_drives(model, model.arrays)[0].unit_drive(focus).amplitudes


def test_a_step_rings_up_with_the_pole(small_scene):
    slow = {"response": "on", "quality": 200}
    rung, sim = arp_over_time(small_scene(stimulus=STEADY, array=slow), 8)
    steady, _ = arp_over_time(small_scene(stimulus=STEADY, array={"response": "off"}), 2)
    # The sensor after step n shows the time n - 1 steps.
    time = 1e-3 * np.arange(8)
    damping = np.pi * 40e3 / 200
    np.testing.assert_allclose(rung, steady[0] * (1 - np.exp(-damping * time)) ** 2, rtol=1e-6, atol=1e-9)
    assert sim.runtime.model.response_on and sim.runtime.model.stimuli[0].response.on


def test_sound_dies_away_after_the_stop(small_scene):
    felt, _ = arp_over_time(
        small_scene(stimulus=STEADY | {"stop_s": 0.0042}, array={"response": "on", "quality": 200}), 12
    )
    damping = np.pi * 40e3 / 200
    assert felt[4] > 0
    np.testing.assert_allclose(felt[7:] / felt[6:-1], np.exp(-2 * damping * 1e-3), rtol=1e-6)


def test_am_is_filtered_as_the_pole_says(small_scene):
    sim = load(small_scene(array={"response": "on"}, skin={"step_s": 2e-5}))
    levels, times = [], []
    for step in range(40):
        sim.step()
        if step >= 20:
            levels.append(abs(sim.emitted[0]))
            times.append(sim.time)
    response = envelope_response(200.0, Pole(40e3, 25.0))[..., 0]
    expected = 0.5 + 0.5 * np.imag(np.conj(response) * np.exp(2j * np.pi * 200 * np.array(times)))
    np.testing.assert_allclose(levels, expected, atol=2e-4)


def test_auto_keeps_what_matters(small_scene):
    def rings(**changes):
        model = load(small_scene(**changes)).runtime.model
        assert model.response_on == model.stimuli[0].response.on
        return model.response_on

    assert rings()
    # A sudden start is a jump, however slow or still the sound is afterwards
    assert rings(stimulus={"am_frequency_Hz": 5}) and rings(stimulus=STEADY)
    assert not rings(stimulus={"am_frequency_Hz": 5} | RAMPED)
    assert not rings(stimulus=STEADY | RAMPED)
    assert rings(stimulus=STEADY | RAMPED | {"stop_s": 0.2})
    assert not rings(stimulus=RAMPED, array={"quality": 2})
    assert not rings(stimulus={"am_frequency_Hz": 50} | RAMPED)
    assert rings(stimulus={"am_frequency_Hz": 50} | RAMPED, skin={"accuracy": 0.002})
    assert not rings(array={"response": "off"})


def test_a_silent_array_costs_nothing(small_scene):
    response = load(small_scene(stimulus={"drive_amplitude": 0})).runtime.model.stimuli[0].response
    assert response.ring_up.rms == response.flight_time.rms == 0.0 and not response.on


def test_far_transducers_play_what_was_asked_earlier(small_scene):
    circle = STEADY | {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 100}
    model = load(small_scene(stimulus=circle, array={"response": "on"})).runtime.model
    part, drive = model.stimuli[0], array_drives(model, model.arrays)[0]
    delays = part.response.delays_s
    far = np.linalg.norm(model.arrays.array.positions - part.first_focus, axis=1)
    assert delays[far.argmax()] > 0 > delays[far.argmin()]
    assert np.abs(delays - (far - 0.5 * (far.max() + far.min())) / 343.2).max() < 1.1e-5
    places = reference_scene(model).focal_points(part, 0)
    [now] = commanded_drive(part.config, drive, delays, np.array([0.005]), places)
    e = int(far.argmax())
    [earlier] = commanded_drive(part.config, drive, np.zeros(256), np.array([0.005 - delays[e]]), places)
    assert now[e] == pytest.approx(earlier[e], abs=1e-12)


def test_plain_steps_and_a_run_agree_with_ringing(small_scene):
    path = small_scene(array={"response": "on"})
    sim = load(path)
    run(sim, duration_s=0.01, progress=False)
    other = load(path)
    for _ in range(10):
        mujoco.mj_step(other.model, other.data)
    np.testing.assert_array_equal(sim.data.sensordata, other.data.sensordata)
    # The force is the step's mean: between its ends, where the level rises.
    assert np.isfinite(sim.data.sensordata).all()


def test_scattering_wants_one_focus_and_one_pole(small_scene):
    circle = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 50}
    with pytest.raises(
        SceneError, match=r"instance 'skin': key 'body_sound' has value 'scattering'; allowed: with path"
    ):
        load(small_scene(stimulus=circle, skin={"body_sound": "scattering"}))
    with pytest.raises(SceneError, match="arp_law 'default'"):
        load(small_scene(skin={"body_sound": "scattering", "arp_law": "alpha"}))


def test_shadows_and_scattering_on_a_flat_pad(small_scene):
    arp = {}
    for kind in ("none", "shadows", "scattering"):
        skin = {"body_sound": kind, "element_m": 0.002}
        felt, sim = arp_over_time(small_scene(stimulus=STEADY, array={"response": "off"}, skin=skin), 3)
        arp[kind] = (felt[1], sim.data.sensordata[2])
    # A flat pad shades nothing of its lit face, and the loss at a dark back is none
    assert arp["shadows"] == pytest.approx(arp["none"], rel=1e-6)
    # The rim, 20 mm from the middle, sends sound back there. Keller's coefficient of a rigid right-angled edge for
    # normal incidence, seen along the face, is -2/sqrt(3) e^{i pi/4}/sqrt(2 pi k); around the whole rim this makes
    # -2/sqrt(3) e^{ika} times the mean sound at the rim, against 2 p of the face.
    arrays = sim.runtime.model.arrays
    focus, drive = full_drive(sim.runtime.model)
    around = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    rim = focus + 0.02 * np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    edge = arrays.pressure64(rim, drive).mean() / arrays.pressure64(focus[None], drive)[0]
    k = 2 * np.pi * 40e3 / sound_speed(arrays.air)
    back = abs(1 - edge * np.exp(1j * k * 0.02) / np.sqrt(3)) ** 2
    assert back > 1.04
    # Left out: the beam's slope at the rim, sound that passes the rim twice, and 1 % of the boundary elements
    assert arp["scattering"][0] / arp["none"][0] == pytest.approx(back, abs=0.02)
    # Over the face what comes from the rim changes sign every half wavelength, and its mean is small
    assert arp["scattering"][1] == pytest.approx(arp["none"][1], rel=0.01)


def test_the_scenes_scattering_is_the_solution_for_its_body(small_scene):
    """The scene's poses and mesh against a solution set up by hand in the array's frame."""
    path = small_scene(stimulus=STEADY, array={"response": "off"}, skin={"body_sound": "scattering", "radius_m": 0.008})
    felt, sim = arp_over_time(path, 2)
    model = sim.runtime.model
    air, body = model.arrays.air, reference_scene(model).bodies[0]
    k = 2 * np.pi * 40e3 / sound_speed(air)
    vertices, faces = boundary_mesh(body.vertices, body.faces, 2 * np.pi / k)
    # The pad hangs upside down at 0.12 m: half a turn about y
    vertices = vertices * [-1, 1, -1] + [0, 0, 0.12]
    _, drive = full_drive(model)
    solved = scatter(vertices, faces, lambda x: model.arrays.pressure64(x, drive), k, device="cpu")
    nearest = np.linalg.norm(solved.centroids - [0, 0, 0.12], axis=1).argmin()
    there = solved.pressure[nearest] + solved.gradient[nearest] @ ([0, 0, 0.12] - solved.centroids[nearest])
    near = np.abs(there) ** 2 - (np.abs(solved.gradient[nearest]) ** 2).sum() / k**2
    expected = near / (4 * density(air) * sound_speed(air) ** 2)
    assert felt[1] == pytest.approx(expected, rel=1e-3)


def test_arp_asked_for_after_each_step_is_that_of_the_present_sound(small_scene):
    """A focus on a circle, transducers that ring up: each answer is that of a copy, which has asked for none before."""
    circle = {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 100, "modulation": None}
    stimulus = circle | dict.fromkeys(("am_quantity", "am_frequency_Hz", "am_depth"))
    sim = load(small_scene(stimulus=stimulus, array={"response": "on"}))
    last = None
    for _ in range(4):
        sim.step()
        arp = sim.skin().arp
        np.testing.assert_array_equal(arp, sim.copy().skin().arp)
        assert last is None or np.abs(arp - last).max() > 0.1 * arp.max()
        last = arp


def test_two_foci_that_move_sound_as_loud_as_what_is_told(small_scene):
    """Flips of the drive's common phase would silence transducers that ring: a rule of the pose alone leaves none."""
    stimulus = STEADY | {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 7, "foci_m": "0.01 0 0 -0.01 0 0"}
    skin = {"solver": "wedges", "element_m": 0.008}
    rung, told = (load(small_scene(stimulus=stimulus, array={"response": on}, skin=skin)) for on in ("on", "off"))
    for step in range(6):
        rung.step()
        told.step()
        if step > 0:
            assert np.linalg.norm(rung.emitted) == pytest.approx(np.linalg.norm(rung.drive), rel=0.01)
            assert rung.skin().arp.sum() == pytest.approx(told.skin().arp.sum(), rel=0.02)
    other = load(small_scene(stimulus=stimulus, array={"response": "off"}, skin=skin))
    other.start_at(told.time)
    np.testing.assert_allclose(other.drive, told.drive, rtol=0, atol=1e-9)


PATHS = {
    "point": {},
    "circle": {"path": "circle", "path_diameter_m": 0.03, "path_rate_Hz": 70},
    "slow circle": {"path": "circle", "path_diameter_m": 0.03, "path_rate_Hz": 1},
    "line": {"path": "line", "path_width_m": 0.03, "path_rate_Hz": 50},
    "ticks": {"path": "circle", "path_diameter_m": 0.03, "path_rate_Hz": 70, "control_rate_Hz": 2000},
}


@pytest.mark.parametrize("path", PATHS)
def test_forces_are_of_what_is_emitted_under_any_path(small_scene, path):
    """A step's force is the mean of those over tenths of it, and grows as transducers ring up."""

    def forces(response, step_s, steps):
        skin = {"solver": "wedges", "element_m": 0.008, "step_s": 0.125 * step_s}
        scene = small_scene(stimulus=STEADY | PATHS[path], array={"response": response, "quality": 25}, skin=skin)
        for part in scene.parent.glob("*.xml"):
            part.write_text(part.read_text().replace('timestep="0.001"', f'timestep="{step_s}"'))
        sim = load(scene)
        assert sim.model.opt.timestep == step_s
        result = []
        for _ in range(steps):
            sim.step()
            result.append(sim.forces[0])
        return np.array(result)

    whole, at_once = forces("on", 0.001, 3), forces("off", 0.001, 1)
    tenths = forces("on", 0.0001, 30).reshape(3, 10, 3).mean(axis=1)
    np.testing.assert_allclose(whole, tenths, rtol=0, atol=0.02 * tenths[2, 2])
    rung = np.pi * 40e3 / 25 * 1e-3  # the step over the time in which amplitudes ring up
    first = 1 - 2 * (1 - np.exp(-rung)) / rung + (1 - np.exp(-2 * rung)) / (2 * rung)
    assert whole[0, 2] / at_once[0, 2] == pytest.approx(first, rel=0.1)
