"""`palmfield bench scene`: what is drawn, what is counted, how errors and predictions add up, and a whole report."""

import math
import re

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.studies.bench import scene
from palmfield.studies.bench.consumer_card import SHARE, BEGIN_s, Card, KERNEL_s, Work, predicted_s
from palmfield.studies.bench.scene_run import (
    LEVELS,
    ASIDE_m,
    TILT_rad,
    draw_again,
    drawn_stimulus,
    move_arrays,
    node_areas,
    relative_errors,
    sounding,
)

pytestmark = pytest.mark.usefixtures("kept_operators")

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}


def test_what_is_drawn_is_what_a_scene_with_these_keys_would_do(small_scene):
    """A model that was built before against one that is built of the drawn keys, with the board where it was put."""
    # Elements so coarse that the mesh does not follow the focus
    alike = {"skin.solver": "wedges", "skin.element_m": 0.01}
    sim = palmfield.Simulation(small_scene(), keys=alike)
    stepper = sim.runtime.model.begin[0].value
    draw_again(sim, 3)
    assert sim.runtime.model.begin[0].value is stepper
    config = sim.runtime.model.spec.stimuli[0].config
    keys = {"stimulus.focus_m": config.focus_m, "stimulus.drive_amplitude": config.drive_amplitude}
    other = palmfield.Simulation(small_scene(), keys=alike | keys)
    board = sim.model.body("board").id
    assert not np.allclose(sim.model.body_pos[board], other.model.body_pos[board], atol=1e-5)
    other.model.body_pos[board], other.model.body_quat[board] = sim.model.body_pos[board], sim.model.body_quat[board]
    other.reset()
    unmoved = palmfield.Simulation(small_scene(), keys=alike)
    for one in (sim, other, unmoved):
        one.step(5)
    size = np.abs(other.skin().displacement).max()
    assert np.abs(sim.skin().displacement - other.skin().displacement).max() < 1e-5 * size
    assert np.abs(sim.skin().displacement - unmoved.skin().displacement).max() > 0.01 * size
    assert np.allclose(sim.forces, other.forces, rtol=1e-4)


@pytest.mark.parametrize("keys", [{}, {"drive_amplitude": 0.6}, {"arp_peak_Pa": 20.0}])
def test_levels_are_drawn_as_arp_whichever_key_sets_them(small_scene, keys):
    sim = palmfield.Simulation(small_scene(stimulus=keys))
    before = sim.runtime.model.spec.stimuli[0].config
    for seed in range(5):
        after = drawn_stimulus(before, np.random.default_rng(seed))
        if before.arp_peak_Pa is not None:
            ratio = after.arp_peak_Pa / before.arp_peak_Pa
        else:
            ratio = (after.drive_amplitude / keys.get("drive_amplitude", 1.0)) ** 2
        assert LEVELS[0] <= ratio <= LEVELS[1]
        moved = np.subtract(after.focus_m, before.focus_m)
        assert moved[2] == 0.0 and 0.0 < np.abs(moved[:2]).max() <= ASIDE_m


def test_arrays_move_by_a_little(small_scene):
    sim = palmfield.Simulation(small_scene())
    model, sites = sim.model, sim.runtime.binding.array_sites

    def frames():
        mujoco.mj_forward(model, sim.data)
        return [(sim.data.site_xpos[n].copy(), sim.data.site_xmat[n].reshape(3, 3).copy()) for n in sites]

    before = frames()
    move_arrays(model, sites, np.random.default_rng(0))
    for (old, turned), (new, turn) in zip(before, frames(), strict=True):
        angle = math.acos(min(1.0, 0.5 * (np.trace(turn @ turned.T) - 1.0)))
        assert 0.0 < np.linalg.norm(new - old) < 3.0 * ASIDE_m and 0.0 < angle < 2.0 * TILT_rad


def test_silent_steps_are_left_out_but_for_one_that_rings_on(small_scene):
    """Bursts of 2 ms every 5 ms from 1 ms on, in steps of 1 ms."""
    burst = {"burst_window": "rectangular", "burst_length_s": 0.002, "burst_period_s": 0.005, "start_s": 0.001}
    sim = palmfield.Simulation(small_scene(stimulus=STEADY | burst))
    heard = sounding(sim.runtime.model, 11)
    # Bursts begin at 1, 6 and 11 ms; a step has the sound of its both ends.
    inside = [any(start < n + 1.0 + 1e-9 and n < start + 2.0 for start in (1.0, 6.0, 11.0)) for n in range(11)]
    assert not heard[5 - 1] and heard == [a or b for a, b in zip(inside, [False, *inside], strict=False)]


def test_areas_of_nodes_add_up_to_the_surface(small_scene):
    skin = palmfield.Simulation(small_scene()).runtime.model.skins[0]
    assert node_areas(skin.nodes[0], skin.faces).sum() == pytest.approx(math.pi * 0.02**2, rel=0.05)


def test_errors_are_weighed_by_area():
    expected = np.ones((4, 2, 2))
    motion = expected.copy()
    motion[:, 0, 0] *= 1.1
    motion[:, 1] *= 0.8
    displacement, velocity = relative_errors([motion], [expected], [np.array([1.0, 3.0])])
    assert displacement == pytest.approx(0.1 * math.sqrt(1.0 / 4.0)) and velocity == pytest.approx(0.2)
    twice = relative_errors([motion, expected], [expected, expected], [np.array([1.0, 3.0]), np.array([2.0, 2.0])])
    assert twice[0] == pytest.approx(displacement / math.sqrt(2.0))


def test_predicted_times_are_operations_over_rates():
    card = Card("a card", 1e12, 0.5, 1e11)
    assert Work(single=3e9).seconds(card) == pytest.approx(3e-3 / SHARE)
    assert Work(double=3e9).seconds(card) == pytest.approx(6e-3 / SHARE)
    assert Work(bytes=3e9).seconds(card) == pytest.approx(3e-2 / SHARE)
    assert (Work(kernels=2.0) + Work(kernels=3.0)).seconds(card) == pytest.approx(5.0 * KERNEL_s)


def test_a_prediction_counts_pairs_and_has_none_for_sparse_solves(small_scene):
    """On a card that does nothing but field pairs at a finite rate, their number is that of points and samples."""
    sim = palmfield.Simulation(small_scene(), keys={"skin.solver": "reduced"})
    pairs_only = Card("pairs", 1e6, 1e30, 1e30)
    seconds = predicted_s(sim.runtime.model, pairs_only)
    body = sim.runtime.work.reference.bodies[0]
    points = len(sim.runtime.model.begin[0].value.points)
    frames = sim.runtime.model.substeps + 1 if sim.runtime.model.response_on else 1
    pairs = 256 * (points * frames + len(body.samples[0]))
    assert seconds is not None and SHARE * 1e6 * (seconds - BEGIN_s) == pytest.approx(44.75 * pairs, rel=0.05)
    whole = palmfield.Simulation(small_scene(), keys={"skin.solver": "wedges"})
    assert predicted_s(whole.runtime.model) is None


def test_a_whole_report(small_scene, tmp_path):
    """Speed and error of a small disc: its modes are near the whole layer, whose mesh is fixed by a key."""
    path = small_scene(duration_s=0.01, skin={"solver": None})
    text = scene.main([str(path)], tmp_path / "out.md", steps=15, error=True, commit="abc")
    assert text == (tmp_path / "out.md").read_text() and "commit abc" in text
    speed, error = (line.split("|") for line in re.findall(r"^\| small \|.*$", text, re.MULTILINE))
    p50, p90, p99, most = (float(speed[column]) for column in (6, 7, 8, 9))
    assert int(speed[5]) >= 15 and 0.0 < p50 <= p90 <= p99 <= most + 0.05
    assert float(error[3].split()[0]) < 20.0
