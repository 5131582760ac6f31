"""Ring-up of the transducers and flight time, in scenes and by themselves."""

from itertools import pairwise

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import palmfield
from palmfield import runner
from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.scattering import scatter
from palmfield.drive.response import Pole, envelope_response, flight_times, pole_step
from palmfield.emission import asked
from palmfield.envelope import shares, windows
from palmfield.errors import SceneError
from palmfield.stimulus.schedule import frame_at

STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}


def arp_over_time(path, steps):
    scene = palmfield.load(path)
    found = []
    for _ in range(steps):
        mujoco.mj_step(scene.model, scene.data)
        found.append(scene.data.sensordata[5])
    return np.array(found), scene


def test_a_step_rings_up_with_the_pole(small_scene):
    slow = {"response": "on", "quality": 200}
    rung, scene = arp_over_time(small_scene(stimulus=STEADY, array=slow), 8)
    steady, _ = arp_over_time(small_scene(stimulus=STEADY, array={"response": "off"}), 2)
    # The sensor after step n shows the time n - 1 steps.
    time = 1e-3 * np.arange(8)
    damping = np.pi * 40e3 / 200
    np.testing.assert_allclose(rung, steady[0] * (1 - np.exp(-damping * time)) ** 2, rtol=1e-6, atol=1e-9)
    assert scene.skin.rig.response.on


def test_sound_dies_away_after_the_stop(small_scene):
    found, _ = arp_over_time(
        small_scene(stimulus=STEADY | {"stop_s": 0.0042}, array={"response": "on", "quality": 200}), 12
    )
    damping = np.pi * 40e3 / 200
    assert found[4] > 0
    np.testing.assert_allclose(found[7:] / found[6:-1], np.exp(-2 * damping * 1e-3), rtol=1e-6)


def test_am_is_filtered_as_the_pole_says(small_scene):
    scene = palmfield.load(small_scene(array={"response": "on"}))
    rig = scene.skin.rig
    emitter, pole = rig.reference_emitter, rig.response.pole
    step, emitted = 2e-5, np.zeros(len(rig.array), complex)
    level = []
    for k in range(2000):
        first, last = (
            asked(rig.stimulus, emitter, np.zeros(len(rig.array)), t, rig.reference_aim)
            for t in (k * step, (k + 1) * step)
        )
        emitted = pole_step(emitted, first, last, pole, step)
        level.append(abs(emitted[0]))
    last_turn = np.array(level[-250:])
    response = envelope_response(200.0, Pole(40e3, 25.0))[..., 0]
    time = step * np.arange(1751, 2001)
    wanted = 0.5 + 0.5 * np.imag(np.conj(response) * np.exp(2j * np.pi * 200 * time))
    np.testing.assert_allclose(last_turn, wanted, atol=2e-4)


RAMPED = {"start_s": 0.001, "ramp_s": 0.05}


def test_auto_keeps_what_matters(small_scene):
    def heard(**changes):
        return palmfield.load(small_scene(**changes)).skin.rig.response

    assert heard().on
    # A sudden start is a jump, however slow or still the sound is afterwards
    assert heard(stimulus={"am_frequency_Hz": 5}).on and heard(stimulus=STEADY).on
    assert not heard(stimulus={"am_frequency_Hz": 5} | RAMPED).on
    assert not heard(stimulus=STEADY | RAMPED).on
    assert heard(stimulus=STEADY | RAMPED | {"stop_s": 0.2}).on
    assert not heard(stimulus=RAMPED, array={"quality": 2}).on
    assert not heard(stimulus={"am_frequency_Hz": 50} | RAMPED).on
    assert heard(stimulus={"am_frequency_Hz": 50} | RAMPED, skin={"accuracy": 0.002}).on
    assert not heard(array={"response": "off"}).on


def by_ode(drive, window, jumps, weights):
    """Rms and peak of |a - u(t - 1/g)| in a window, with a from da/dt = g (u - a), settled long before.

    drive: time -> each transducer's drive, shape (n,); jumps: its times [s]; weights: shape (n,)
    """
    g = np.pi * 40e3 / 25
    edges = np.linspace(*window, 3001)
    time = 0.5 * (edges[1:] + edges[:-1])
    begin = window[0] - 12 / g
    bounds = [begin, *sorted(t for t in jumps if begin < t < window[1]), window[1]]
    emitted, state = np.zeros((len(time), len(weights)), complex), drive(begin)
    for low, high in pairwise(bounds):
        middle = 0.5 * (low + high)

        def slope(t, a, low=low, high=high, middle=middle):
            # Between two jumps, whichever side of them rounding puts t
            return g * (drive(middle + (t - middle) * (1 - 1e-4)) - a)

        found = solve_ivp(slope, (low, high), state, dense_output=True, rtol=1e-6, atol=1e-8, max_step=0.3 / g)
        inside = (time >= low) & (time < high)
        if inside.any():
            emitted[inside] = found.sol(time[inside]).T
        state = found.y[:, -1]
    off = np.sqrt(np.abs(emitted - np.array([drive(t - 1 / g) for t in time])) ** 2 @ weights)
    full = np.sqrt(np.abs(np.array([drive(t) for t in time])) ** 2 @ weights)
    return np.sqrt((off**2).mean() / (full**2).mean()), off.max() / full.max()


def worst_by_ode(rig, jumps, drive, weights):
    found = [by_ode(drive, window, jumps, weights) for window in windows(rig.stimulus, 25 / np.pi / 40e3)]
    return max(rms for rms, _ in found), max(peak for _, peak in found)


CUSPS = {"am_of": "arp", "am_frequency_Hz": 50, "start_s": 0.001, "ramp_s": 0.08}


@pytest.mark.parametrize(
    ("stimulus", "jumps", "rms", "peak"),
    [
        # (1 + sin)/2 of the ARP is |sin| of the pressure, with a cusp in every period
        (CUSPS, (), None, None),
        # After a step the drive is ahead by e^{-gt}, and 1 - e^{-1} just before the late one comes
        (STEADY | {"start_s": 0.002}, (0.002,), np.sqrt(0.2358 / (np.pi * 40e3 / 25 * 0.01)), 1 - np.exp(-1)),
        ({"am_frequency_Hz": 50, "stop_s": 0.1}, (0.0, 0.1), None, None),
    ],
    ids=["cusps", "start", "start and stop"],
)
def test_cost_of_no_ring_up_is_that_of_the_poles_equation(small_scene, stimulus, jumps, rms, peak):
    rig = palmfield.load(small_scene(stimulus=stimulus)).skin.rig
    found = rig.response.ring

    def drive(t):
        return np.array([np.sqrt(frame_at(rig.stimulus, t).arp_factor)], complex)

    direct = worst_by_ode(rig, jumps, drive, np.ones(1))
    assert found.rms == pytest.approx(direct[0], rel=0.03)
    assert found.peak == pytest.approx(direct[1], rel=0.05)
    if rms is not None:
        assert found.rms == pytest.approx(rms, rel=0.05)
        assert found.peak == pytest.approx(peak, rel=0.05)


UPRIGHT = '<site name="upright" pos="0 0 0.12" euler="90 0 0"/>'


@pytest.mark.parametrize(
    ("points", "upright"), [(4, False), (0, False), (0, True)], ids=["4 points", "flat", "upright"]
)
def test_cost_of_a_path_counts_its_points_and_its_plane(small_scene, points, upright):
    circle = {"path": "circle", "path_diameter_m": 0.03, "path_rate_Hz": 100, "path_points": points}
    place = {"focus_m": "0 0 0", "frame": "upright"} if upright else {}
    path = small_scene(stimulus=STEADY | circle | place | {"ramp_s": 0.02})
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", f"<worldbody>{UPRIGHT}", 1))
    rig = palmfield.load(path).skin.rig
    k = 2 * np.pi * 40e3 / sound_speed(rig.air)

    def drive(t):
        frame = frame_at(rig.stimulus, t)
        x, y, z = frame.focus
        # The frame's y axis points along the array's z, its z axis along -y
        focus = np.array([x, -z, 0.12 + y]) if upright else frame.focus
        away = np.linalg.norm(focus - rig.array.positions, axis=1)
        return np.sqrt(frame.arp_factor) * np.exp(-1j * k * away)

    jumps = np.arange(1, 40) / 400 if points else ()
    weights = shares(rig.reference_emitter, rig.reference_focus)
    rms, peak = worst_by_ode(rig, jumps, drive, weights)
    # A part of the transducers stands for all
    assert rig.response.ring.rms == pytest.approx(rms, rel=0.1)
    assert rig.response.ring.peak == pytest.approx(peak, rel=0.1)


def test_cost_of_one_flight_time_is_that_of_the_sum_over_the_transducers(small_scene):
    rig = palmfield.load(small_scene(stimulus={"am_frequency_Hz": 1000, "start_s": 0.001, "ramp_s": 0.05})).skin.rig
    times = flight_times(rig.array, rig.reference_focus, rig.air)
    weights = shares(rig.reference_emitter, rig.reference_focus)
    late = times - weights @ times
    # At a full sine (1 + sin wt)/2 only the sine is late: by 1 - sum of w e^{iw late}, filtered by the pole
    turn = 2 * np.pi * 1000
    share = abs(1 - weights @ np.exp(1j * turn * late)) * abs(envelope_response(1000.0, Pole(40e3, 25.0))[..., 0])
    assert rig.response.late.rms == pytest.approx(share / np.sqrt(3), rel=0.03)  # rms sqrt(1/2)/2 against sqrt(3/8)
    assert rig.response.late.peak == pytest.approx(share / 2, rel=0.03)


def test_a_silent_or_dead_array_costs_nothing(small_scene):
    rig = palmfield.load(small_scene(stimulus={"drive_amplitude": 0})).skin.rig
    assert rig.response.ring.rms == rig.response.late.rms == 0.0 and not rig.response.on
    rig = palmfield.load(small_scene(array={"dead": " ".join(map(str, range(256)))})).skin.rig
    assert rig.response.ring.peak == 0.0


def test_far_transducers_play_what_was_asked_earlier(small_scene):
    circle = STEADY | {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 100}
    scene = palmfield.load(small_scene(stimulus=circle, array={"response": "on"}))
    rig = scene.skin.rig
    delays = rig.response.delays_s
    far = np.linalg.norm(rig.array.positions - rig.reference_focus, axis=1)
    assert delays[far.argmax()] > 0 > delays[far.argmin()]
    assert np.abs(delays - (far - 0.5 * (far.max() + far.min())) / 343.2).max() < 1.1e-5
    now = asked(rig.stimulus, rig.reference_emitter, delays, 0.005, rig.reference_aim)
    e = int(far.argmax())
    earlier = asked(rig.stimulus, rig.reference_emitter, np.zeros(256), 0.005 - delays[e], rig.reference_aim)
    assert now[e] == pytest.approx(earlier[e], abs=1e-12)


def test_plain_steps_and_a_run_agree_with_ringing(small_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "PICTURES", ())
    path = small_scene(array={"response": "on"})
    scene = palmfield.load(path)
    palmfield.run(scene, tmp_path / "out", duration_s=0.01, progress=False)
    other = palmfield.load(path)
    for _ in range(10):
        mujoco.mj_step(other.model, other.data)
    np.testing.assert_array_equal(scene.data.sensordata, other.data.sensordata)
    # The force is the step's mean: between its ends, where the level rises.
    assert np.isfinite(scene.data.sensordata).all()


def test_scattering_wants_one_focus_and_one_pole(small_scene):
    circle = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 50}
    with pytest.raises(SceneError, match="'scattering'; allowed: with path 'point'"):
        palmfield.load(small_scene(stimulus=circle, skin={"body_sound": "scattering"}))
    with pytest.raises(SceneError, match="arp_law 'default'"):
        palmfield.load(small_scene(skin={"body_sound": "scattering", "arp_law": "alpha"}))


def test_shadows_and_scattering_on_a_flat_pad(small_scene):
    arp = {}
    for kind in ("none", "shadows", "scattering"):
        found, scene = arp_over_time(
            small_scene(stimulus=STEADY, array={"response": "off"}, skin={"body_sound": kind}), 3
        )
        arp[kind] = (found[1], scene.data.sensordata[2])
    # A flat pad shades nothing of its lit face, and the loss at a dark back is none
    assert arp["shadows"] == pytest.approx(arp["none"], rel=1e-6)
    # The rim, 20 mm from the middle, sends sound back there. Keller's coefficient of a rigid right-angled edge for
    # normal incidence, seen along the face, is -2/sqrt(3) e^{i pi/4}/sqrt(2 pi k); around the whole rim this makes
    # -2/sqrt(3) e^{ika} times the mean sound at the rim, against 2 p of the face.
    rig, sound = scene.skin.rig, scene.skin.rig.reference_emitter
    drive, _ = rig.unit_drive(rig.reference_focus)
    around = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    rim = rig.reference_focus + 0.02 * np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    edge = sound.pressure64(rim, drive).mean() / sound.pressure64(rig.reference_focus[None], drive)[0]
    k = 2 * np.pi * 40e3 / sound_speed(rig.air)
    back = abs(1 - edge * np.exp(1j * k * 0.02) / np.sqrt(3)) ** 2
    assert back > 1.04
    # Left out: the beam's slope at the rim, sound that passes the rim twice, and 1 % of the boundary elements
    assert arp["scattering"][0] / arp["none"][0] == pytest.approx(back, abs=0.02)
    # Over the face what comes from the rim changes sign every half wavelength, and its mean is small
    assert arp["scattering"][1] == pytest.approx(arp["none"][1], rel=0.01)


def test_the_scenes_scattering_is_the_solution_for_its_body(small_scene):
    """The scene's poses and mesh against a solution set up by hand in the array's frame."""
    path = small_scene(stimulus=STEADY, array={"response": "off"}, skin={"body_sound": "scattering", "radius_m": 0.008})
    found, scene = arp_over_time(path, 2)
    rig = scene.skin.rig
    vertices, faces = rig.posed(rig.reference_pose).boundary_mesh
    # The pad hangs upside down at 0.12 m: half a turn about y
    vertices = vertices * [-1, 1, -1] + [0, 0, 0.12]
    drive, _ = rig.unit_drive(rig.reference_focus)
    k = 2 * np.pi * 40e3 / sound_speed(rig.air)
    solved = scatter(vertices, faces, lambda x: rig.reference_emitter.pressure64(x, drive), k, device="cpu")
    nearest = np.linalg.norm(solved.centroids - [0, 0, 0.12], axis=1).argmin()
    there = solved.pressure[nearest] + solved.gradient[nearest] @ ([0, 0, 0.12] - solved.centroids[nearest])
    near = np.abs(there) ** 2 - (np.abs(solved.gradient[nearest]) ** 2).sum() / k**2
    load = near / (4 * density(rig.air) * sound_speed(rig.air) ** 2)
    assert found[1] == pytest.approx(load, rel=1e-3)
