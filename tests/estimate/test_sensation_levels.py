"""Levels of runs: by force on the palm, by motion, with the area that moves."""

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.estimate.sensation_levels import contact_levels, felt_levels, moved_area_m2, region_at
from palmfield.hand.triangles import vertex_areas
from palmfield.perception.observers import OBSERVERS
from palmfield.planning.facts import first_drive
from palmfield.session.loudest_moment import LoudestMoment
from palmfield.simulation.radiation import Radiation
from palmfield.stimulus.schedule import factors_at

TIMES = np.arange(0.0, 0.05, 5e-4)
SINE = np.sin(2 * np.pi * 200.0 * TIMES)
MOTION = 2e-6 * SINE[:, None]
AREAS = np.array([3e-3])
FORCE = "level_hasegawa_2018"


def test_levels_need_two_periods_and_three_samples_a_period():
    assert contact_levels(TIMES[:15], MOTION[:15], [200.0], AREAS) == {}
    assert contact_levels(TIMES, MOTION, [], AREAS) == {} and contact_levels(TIMES, MOTION, [900.0], AREAS) == {}
    levels = contact_levels(TIMES, MOTION, [200.0, 900.0], AREAS)
    for name in OBSERVERS:
        assert levels[f"level_{name}_dB_SL"] == levels[f"level_all_lines_{name}_dB_SL"] > 0.0
        assert levels[f"level_{name}_why"].startswith("applies: ")


def test_an_observer_whose_table_does_not_reach_is_refused():
    times = np.arange(0.0, 0.05, 1e-4)
    levels = contact_levels(times, np.sin(np.arange(500.0))[:, None], [600.0], AREAS)
    assert levels["level_afferent_human_dB_SL"] is None
    assert levels["level_afferent_human_why"] == (
        "refused: its table covers 2 to 350 Hz, but the main line is at 600 Hz"
    )


def test_a_small_spot_has_no_level_of_a_gripped_handle():
    levels = contact_levels(TIMES, MOTION, [200.0], np.array([1e-4]))
    assert levels["level_morioka_griffin_2006_dB_SL"] is None
    assert levels["level_morioka_griffin_2006_why"] == (
        "refused: it applies to 20 cm2 or more of moving skin, but 1 cm2 move by half of the maximum"
    )
    assert levels["level_bolanowski_1988_dB_SL"] > 0.0


def test_twice_the_motion_is_6_dB_more_for_every_contact_observer():
    once, twice = (contact_levels(TIMES, factor * MOTION, [200.0], AREAS) for factor in (1.0, 2.0))
    for key in [key for key in once if key.endswith("_dB_SL")]:
        assert twice[key] - once[key] == pytest.approx(6.0206, abs=1e-4), key


def test_the_area_that_moves_is_where_half_of_the_most_is_exceeded():
    """Three of four vertices, of 1, 2 and 4 mm2, exceed half; 7 mm2 is 0.07 cm2, 16.17 dB below 2.9 cm2."""
    motion = MOTION * np.array([1.0, 0.51, 0.49, -0.6])
    areas = 1e-6 * np.array([1.0, 2.0, 8.0, 4.0])
    levels = contact_levels(TIMES, motion, [200.0], areas)
    assert levels["level_area_bolanowski_1988_m2"] == pytest.approx(7e-6)
    fall = levels["level_bolanowski_1988_dB_SL"] - levels["level_area_bolanowski_1988_dB_SL"]
    assert fall == pytest.approx(16.173, abs=1e-3)
    assert not [key for key in levels if key.startswith("level_area") and "bolanowski" not in key]


def test_lines_that_do_not_sum_over_area_move_none():
    low = contact_levels(TIMES, 1e-4 * np.sin(2 * np.pi * 60.0 * TIMES)[:, None], [60.0], AREAS)
    assert low["level_area_bolanowski_1988_dB_SL"] is None and low["level_area_bolanowski_1988_m2"] == 0.0
    assert moved_area_m2(OBSERVERS["bolanowski_1988"], [60.0], np.ones((1, 1)), AREAS) == 0.0


def test_vertices_share_the_area_of_their_triangles():
    square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]])
    assert vertex_areas(square, np.array([[0, 1, 2], [0, 2, 3]])) == pytest.approx([2.0, 1.0, 2.0, 1.0])


def test_regions_of_the_reference_hand():
    assert region_at("open_men_p50", np.zeros(3)) == "palm_centre"
    assert region_at("open_men_p50", np.array([0.0, 0.0, 0.03])) == "dorsum"


PALM = "mjcf/scenes/palm_am200.xml"
COARSE = {"skin.accuracy": 0.5}


def force_levels(scene, drive=1.0, until_s=0.05, begun_s=0.0):
    """Levels of a skin under its stimulus's full sound, with the course that its keys ask for and without motion.

    drive: factor on what the transducers emit; until_s, begun_s: length of the record, and the clock at its start [s]
    """
    model, reference = scene.runtime.model, scene.runtime.work.reference
    emitted, radiation = drive * first_drive(model, 0), Radiation(model)
    loudest = LoudestMoment(0.0, scene.runtime.posed, emitted, 1.0)
    times = np.arange(0.0, until_s, 2.5e-4)
    peak = float(radiation.on(loudest.posed, 0, "nodes", emitted).arp.max())
    normal = np.zeros((len(times), len(model.skins[0].nodes[0])))
    arp = peak * factors_at(model.stimuli[0].config, begun_s + times)
    return felt_levels(model, 0, loudest, radiation, reference, times, normal, arp, begun_s=begun_s)


@pytest.fixture(scope="module")
def palm():
    return palmfield.load(PALM, keys=COARSE)


def test_force_on_the_palm_is_that_of_its_arp_and_not_of_motion():
    """Under pressure AM of depth 1 the ARP is (1 + sin)^2 / 4 of the highest: its mean is 3/8, its line 1/2.

    That force is held against a sum over force samples of the hand's own, finer surface.
    """
    palm = palmfield.load(PALM, keys={**COARSE, "skin.force_accuracy": 0.002})
    levels = force_levels(palm)
    assert levels[FORCE + "_why"].startswith("applies: ")
    assert levels["force_mean_N"] / levels["force_line_N"] == pytest.approx(0.75, rel=1e-6)
    assert levels[FORCE + "_dB_SL"] == pytest.approx(20 * np.log10(levels["force_line_N"] / 0.4e-3), abs=1e-9)
    model, posed = palm.runtime.model, palm.runtime.posed
    drive = first_drive(model, 0)
    highest = posed.skins[0].nodes[0][Radiation(model).on(posed, 0, "nodes", drive).arp.argmax()]
    samples, outwards, areas = Radiation(model).samples(posed, 0)[:3]
    near = np.linalg.norm(samples - highest, axis=1) < np.sqrt(144e-6 / np.pi)
    arp = Radiation(model).at(posed, 0, "probe", samples[near], outwards[near], drive).arp
    assert 2.0 * levels["force_line_N"] == pytest.approx(float(arp @ areas[near]), rel=0.03)
    assert levels["level_morioka_griffin_2006_dB_SL"] is None
    assert levels["level_morioka_griffin_2006_why"].startswith("refused: the skin does not move")


def test_twice_the_force_is_6_dB_more(palm):
    """ARP goes with the square of the drive."""
    once, twice = (force_levels(palm, drive=np.sqrt(factor)) for factor in (0.5, 1.0))
    assert twice[FORCE + "_dB_SL"] - once[FORCE + "_dB_SL"] == pytest.approx(6.0206, abs=1e-4)


@pytest.mark.parametrize(
    ("scene", "keys", "reason"),
    [
        (PALM, {"stimulus.am_frequency_Hz": 100}, "printed for 200 Hz only, but the sound has 100 Hz"),
        ("mjcf/scenes/palm_circle.xml", {}, "stationary focus, but path is 'circle'"),
        ("mjcf/scenes/tap_button.xml", {}, "the loudest point lies on 'index_"),
        ("mjcf/scenes/phantom_am200.xml", {}, "shape 'disc' has no known palm"),
        ("mjcf/scenes/approach_withdraw.xml", {}, "hand and focus at rest"),
        ("mjcf/scenes/two_hands_both_feel.xml", {}, "2 stimuli are active"),
    ],
)
def test_the_force_observer_is_refused_where_it_was_not_asked(scene, keys, reason):
    levels = force_levels(palmfield.load(scene, keys={"skin.accuracy": 0.5} | keys))
    assert levels[FORCE + "_dB_SL"] is None and "force_line_N" not in levels
    assert levels[FORCE + "_why"].startswith("refused: ") and reason in levels[FORCE + "_why"]


def test_a_hand_that_was_moved_is_not_at_rest():
    scene = palmfield.load(PALM, keys=COARSE)
    scene.model.body("hand").pos += 0.002
    mujoco.mj_forward(scene.model, scene.data)
    assert "hand and focus at rest" in force_levels(scene)[FORCE + "_why"]


def test_a_hand_that_was_turned_is_not_at_rest():
    """About its own origin, so that the body's position stays."""
    scene = palmfield.load(PALM, keys=COARSE)
    body = scene.model.body("hand")
    turned = np.zeros(4)
    mujoco.mju_mulQuat(turned, body.quat, np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0]))
    body.quat[:] = turned
    mujoco.mj_forward(scene.model, scene.data)
    assert "hand and focus at rest" in force_levels(scene)[FORCE + "_why"]


def test_silence_ramps_and_another_clock_leave_the_force_as_it_is(palm):
    """Line and mean are those of the sound, however much of the record is silent."""
    whole = force_levels(palm)
    for until_s, begun_s, keys in (
        (0.15, 0.0, {"stimulus.stop_s": 0.05}),
        (0.15, 0.0, {"stimulus.start_s": 0.1}),
        (0.15, 0.0, {"stimulus.ramp_s": 0.1}),
        (0.15, 2.0, {"stimulus.stop_s": 2.05}),
    ):
        scene = palmfield.load(PALM, keys=COARSE | keys)
        part = force_levels(scene, until_s=until_s, begun_s=begun_s)
        for key in ("force_line_N", "force_mean_N"):
            assert part[key] / whole[key] == pytest.approx(1.0, rel=0.02), (keys, key)


def test_motion_in_a_record_with_silence_is_that_of_its_sound(small_scene, moment):
    """A sine while the sound lasts, and rest for twice as long: the level is that of the sine."""
    levels = {}
    for stop_s in (0.05, 0.012, None):
        keys = {"stimulus.ramp_s": 0} | ({} if stop_s is None else {"stimulus.stop_s": stop_s})
        scene = palmfield.load(small_scene(), keys=keys)
        scene.step(2)
        model, reference = scene.runtime.model, scene.runtime.work.reference
        times = np.arange(0.0, 0.15 if stop_s else 0.05, 5e-4)
        course = np.where(times < (stop_s or 1.0), np.sin(2 * np.pi * 200.0 * times), 0.0)
        normal = np.zeros((len(times), len(model.skins[0].nodes[0])))
        normal[:, 0] = 2e-6 * course
        loudest = moment(scene)
        levels[stop_s] = felt_levels(model, 0, loudest, Radiation(model), reference, times, normal, 1.0 + course)
    for name in OBSERVERS:
        key = f"level_{name}_dB_SL"
        assert levels[0.05][key] == pytest.approx(levels[None][key], abs=0.3), name
        # 12 ms hold two periods of 200 Hz
        assert levels[0.012][key] == pytest.approx(levels[None][key], abs=0.5), name


def test_too_short_a_sound_has_no_level_and_says_so(palm):
    scene = palmfield.load(PALM, keys=COARSE | {"stimulus.stop_s": 0.008})
    levels = force_levels(scene)
    for name in ("hasegawa_2018", *OBSERVERS):
        assert levels[f"level_{name}_dB_SL"] is None
        assert levels[f"level_{name}_why"].startswith("refused: ") and "two periods" in levels[f"level_{name}_why"]


def test_a_skin_that_no_sound_pushes_has_no_level(small_scene):
    """What moves it then is none of this sound's."""
    scene = palmfield.load(small_scene())
    model, reference = scene.runtime.model, scene.runtime.work.reference
    normal = np.repeat(MOTION, len(model.skins[0].nodes[0]), axis=1)
    levels = felt_levels(model, 0, None, Radiation(model), reference, TIMES, normal, np.zeros(len(TIMES)))
    for name in OBSERVERS:
        assert levels[f"level_{name}_dB_SL"] is None
        assert levels[f"level_{name}_why"] == "refused: no sound acts on this skin"
