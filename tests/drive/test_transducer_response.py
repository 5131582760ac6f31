"""What transducers make of the drive over a step, against one transducer and one moment at a time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.acoustics.phased_array import ArrayInstance
from palmfield.config import ArrayConfig, StimulusConfig
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.boards import BOARDS
from palmfield.drive.response import Pole, envelope_response, pole_weights
from palmfield.drive.response_error import ResponseError
from palmfield.drive.transducer_response import (
    SILENT,
    PoleStepper,
    TransducerResponse,
    combined,
    commanded_drive,
    emitted_now,
    emitted_over,
    flight_delays,
    ring,
    rows,
    transducer_response,
)
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.schedule import first_point, frame_at, substep_moments
from palmfield.transforms import IDENTITY, Placement

STILL = FocalPoints(IDENTITY)
NONE = ResponseError(0.0, 0.0)
AM = {"modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": 200, "am_depth": 1}
CIRCLE = {"path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 70}
STIMULI = {
    "am": AM,
    "starts within a step": {"start_s": 0.00113},
    "stops": AM | {"stop_s": 0.0017},
    "control ticks": AM | {"control_rate_Hz": 1700},
    "bursts": {"burst_window": "rectangular", "burst_length_s": 0.0011, "burst_period_s": 0.0023},
    "circle": CIRCLE,
    "path points": CIRCLE | {"path_points": 30, "drive_amplitude": 0.3},
    "circle with am and ticks": CIRCLE | AM | {"control_rate_Hz": 900},
    "line that jumps": {"path": "line", "path_width_m": 0.02, "path_speed_m_s": 10, "path_end": "jump"},
}


def instance(**keys):
    return ArrayInstance(ArrayConfig(**keys), Placement.of(IDENTITY))


def of(**keys):
    return StimulusConfig(**({"focus_m": (0.01, 0.0, 0.15)} | keys))


def drive_of(source, stimulus, chosen=None, board="ideal"):
    every = np.arange(len(source.array), dtype=np.int32)
    return ArrayDrive(
        source, every if chosen is None else chosen, stimulus.arp_peak_Pa, stimulus.drive_amplitude, BOARDS[board]
    )


def response_of(drive, *, on=True, delayed=True, f0=40e3, quality=25.0, focus=(0.01, 0.0, 0.15)):
    delays = flight_delays(drive, np.array(focus)) if delayed else np.zeros(drive.count)
    return TransducerResponse(on, NONE, NONE, 0.0, Pole(f0, quality), delays)


def asked(stimulus, drive, delays, t):
    """The drive at time t, transducer by transducer."""
    found = np.zeros(drive.count, complex)
    for delay in np.unique(delays):
        frame = frame_at(stimulus, t - delay)
        if frame.arp_factor > 0.0:
            unit = drive.unit_drive(STILL.at(frame.focus)).amplitudes
            found[delays == delay] = np.sqrt(frame.arp_factor) * unit[delays == delay]
    return found


def held_frames(stimulus, begin, end):
    """Moments that stand for the parts of a step with their shares of it; none where nothing jumps or is held in it."""
    moments = substep_moments((stimulus,), begin, end - begin, 1)
    return [] if moments.linear[-1] else list(zip(moments.times, moments.first[0], strict=True))


def pole_step(emitted, first, last, pole, time_s):
    """Emitted amplitudes after a drive that went from `first` to `last` along a line, over the steady response."""
    decay, held, slope = pole_weights(pole.rate * time_s)
    return decay * emitted + held * first + slope * (last - first)


def step_by_step(stimulus, drive, response, emitted, t0, step, count):
    """Amplitudes at the ends or the held parts of each step with their shares, and at the end of the last step."""
    pole = Pole(np.broadcast_to(response.pole.f0_Hz, drive.count), response.pole.Q)
    found = []
    for i in range(count):
        begin, end = t0 + i * step, t0 + (i + 1) * step
        held = held_frames(stimulus, begin, end)
        if not held:
            first, last = (asked(stimulus, drive, response.delays_s, t) for t in (begin, end))
            after = pole_step(emitted, first, last, pole, step)
            found.append([(0.5, emitted), (0.5, after)])
            emitted = after
            continue
        found.append([])
        for t, share in held:
            push = asked(stimulus, drive, response.delays_s, t)
            emitted = pole_step(emitted, push, push, pole, 0.5 * share * step)
            found[-1].append((share, emitted))
            emitted = pole_step(emitted, push, push, pole, 0.5 * share * step)
    return found, emitted


@pytest.mark.parametrize("delayed", [False, True], ids=["at once", "flight times"])
@pytest.mark.parametrize("keys", STIMULI.values(), ids=STIMULI)
def test_a_step_in_one_call_is_that_of_each_transducer_by_itself(source, keys, delayed):
    stimulus = of(**keys)
    drive = drive_of(source, stimulus)
    response = response_of(drive, delayed=delayed, focus=first_point(stimulus))
    step, count = 1.25e-4, 8
    emitted = np.zeros(256, complex)
    for k in range(4):
        t0 = k * count * step
        expected, end = step_by_step(stimulus, drive, response, emitted, t0, step, count)
        moments = substep_moments((stimulus,), t0, step, count)
        course = emitted_over(stimulus, drive, response, emitted, STILL, moments)
        first, last = course.weights(moments)
        patterns = np.abs(course.units if len(course.units) else np.zeros((1, 256))) ** 2
        for i, parts in enumerate(expected):
            ends = [np.abs(amplitude) ** 2 for _, amplitude in parts]
            if held_frames(stimulus, t0 + i * step, t0 + (i + 1) * step):
                ends = [sum(share * square for (share, _), square in zip(parts, ends, strict=True))] * 2
            np.testing.assert_allclose(first[i] @ patterns, ends[0], atol=1e-11)
            np.testing.assert_allclose(last[i] @ patterns, ends[1], atol=1e-11)
        np.testing.assert_allclose(course.end, end, atol=1e-11)
        emitted = course.end


@given(
    focus=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0.1, 0.25)),
    rate=st.floats(20, 300),
    times=st.lists(st.floats(0, 0.05), min_size=1, max_size=6),
)
@settings(deadline=None, max_examples=30)
def test_what_is_commanded_is_what_each_transducer_was_asked_earlier(source, focus, rate, times):
    stimulus = of(**CIRCLE | AM | {"focus_m": focus, "path_rate_Hz": rate})
    drive = drive_of(source, stimulus)
    delays = flight_delays(drive, np.array(focus))
    assert delays.max() > 0 > delays.min() and abs(delays.max() + delays.min()) < 2.1e-5
    commanded = commanded_drive(stimulus, drive, delays, np.array(times), STILL)
    expected = np.array([asked(stimulus, drive, delays, t) for t in times])
    np.testing.assert_allclose(commanded, expected, atol=1e-9)


def test_a_still_focus_takes_levels_and_no_more(source):
    stimulus = of(**AM)
    drive = drive_of(source, stimulus)
    response = response_of(drive, delayed=False, f0=40.3e3)
    emitted = np.zeros(256, complex)
    for k in range(30):
        moments = substep_moments((stimulus,), 8e-4 * k, 1e-4, 8)
        course = emitted_over(stimulus, drive, response, emitted, STILL, moments)
        assert len(course.units) == 1
        np.testing.assert_allclose(course.end, course.levels[-1, 0] * course.units[0], atol=1e-15)
        emitted = course.end
    # (1 + sin wt)/2 through the pole, detuned: both sidebands by their own response
    t = moments.times
    up, steady, down = envelope_response([-200.0, 0.0, 200.0], response.pole)[:, 0]
    turn = np.exp(2j * np.pi * 200 * t)
    # relative to the steady sound, at which an array is calibrated
    expected = 0.5 + 0.25j * (turn.conj() * down - turn * up) / steady
    np.testing.assert_allclose(course.levels[:, 0], expected, atol=1e-3)


def test_what_is_no_unit_drive_any_more_is_stepped_as_it_is(source):
    """A focus that has jumped: levels again once the old one has died away."""
    stimulus = of()
    drive = drive_of(source, stimulus)
    response = response_of(drive, delayed=False)
    before = drive_of(source, stimulus).unit_drive(np.array([-0.02, 0.0, 0.2])).amplitudes
    emitted = before
    kinds = []
    for k in range(12):
        course = emitted_over(stimulus, drive, response, emitted, STILL, substep_moments((stimulus,), 0.0, 1e-4, 8))
        kinds.append(len(course.units) == 1)
        emitted = course.end
        g = np.pi * 40e3 / 25 * 8e-4 * (k + 1)
        unit = drive.unit_drive(np.array([0.01, 0.0, 0.15])).amplitudes
        np.testing.assert_allclose(emitted, np.exp(-g) * before + (1 - np.exp(-g)) * unit, atol=1e-9)
    assert not any(kinds[:4]) and all(kinds[-3:]) and sorted(kinds) == kinds


def test_settled_sound_with_flight_times_is_one_unit_drive_again(source):
    stimulus = of(arp_peak_Pa=5.0)
    drive = drive_of(source, stimulus)
    response = response_of(drive, quality=4.0)
    emitted = np.zeros(256, complex)
    for k in range(6):
        course = emitted_over(
            stimulus, drive, response, emitted, STILL, substep_moments((stimulus,), 1e-3 * k, 1e-4, 10)
        )
        emitted = course.end
        assert (len(course.units) == 1) == (k > 0)
    np.testing.assert_allclose(course.levels, 1.0, atol=1e-9)


def test_silence_has_no_drive(source):
    stimulus = of(start_s=1.0, focus_m=(0.0, 0.0, -0.2))
    drive = drive_of(source, stimulus)
    for on in (False, True):
        response = response_of(drive, on=on, delayed=False)
        small = np.full(256, 0.1 * SILENT, complex)
        course = emitted_over(stimulus, drive, response, small, STILL, substep_moments((stimulus,), 0.0, 1e-4, 8))
        assert course.units.shape == (0, 256) and course.levels.shape == (9, 0) and not rows(course).any()
        assert len(emitted_now(stimulus, drive, response, small, STILL, 0.0).units) == 0


@pytest.mark.parametrize("keys", [AM, CIRCLE | AM, AM | {"control_rate_Hz": 1000}], ids=["am", "circle", "ticks"])
def test_without_a_response_sounds_what_is_commanded(source, keys):
    stimulus = of(**keys)
    drive = drive_of(source, stimulus)
    response = response_of(drive, on=False, delayed=False)
    moments = substep_moments((stimulus,), 0.003, 1e-4, 8)
    nothing = np.zeros(256, complex)
    course = emitted_over(stimulus, drive, response, nothing, STILL, moments)
    np.testing.assert_allclose(rows(course), commanded_drive(stimulus, drive, None, moments.times, STILL), atol=1e-12)
    assert course.end is nothing
    now = emitted_now(stimulus, drive, response, nothing, STILL, 0.0042)
    np.testing.assert_allclose(rows(now)[0], asked(stimulus, drive, np.zeros(256), 0.0042), atol=1e-12)


def test_now_is_the_state(source):
    for keys in (AM, CIRCLE):
        stimulus = of(**keys)
        drive = drive_of(source, stimulus)
        response = response_of(drive)
        emitted = (0.3 + 0.1j) * drive.unit_drive(np.array([0.01, 0.0, 0.15])).amplitudes
        now = emitted_now(stimulus, drive, response, emitted, STILL, 0.0)
        unit = drive.unit_drive_at(STILL, first_point(stimulus)).amplitudes
        assert np.array_equal(now.units[0], unit) == (keys is AM)
        np.testing.assert_allclose(rows(now)[0], emitted, atol=1e-15)


@given(
    lengths=st.lists(st.tuples(st.booleans(), st.floats(1e-6, 1e-3)), min_size=1, max_size=6),
    quality=st.floats(2, 200),
    detuning=st.floats(-500, 500),
)
@settings(deadline=None, max_examples=50)
def test_poles_of_their_own_and_one_number_for_all_agree(lengths, quality, detuning):
    """Straight lines and held parts of any length: two transducers with a pole each, and each by itself as a number."""
    held = tuple(length if is_held else 0.0 for is_held, length in lengths)
    linear = tuple(j > 0 and not is_held for j, (is_held, _) in enumerate(lengths))
    moments = substep_moments((of(),), 0.0, 1e-4, 1)._replace(linear=linear, held_s=held)
    poles = [Pole(40e3, quality), Pole(40e3 + detuning, 25.0)]
    both = Pole(np.array([40e3, 40e3 + detuning]), np.array([quality, 25.0]))
    commanded = np.exp(1j * np.arange(2.0 * len(lengths))).reshape(-1, 2)
    start = np.array([0.2, -0.5j])
    emitted, end = ring(start, commanded, moments, PoleStepper(both))
    for n, pole in enumerate(poles):
        one = PoleStepper(pole)
        assert one.alike
        alone, last = ring(complex(start[n]), commanded[:, n], moments, one)
        np.testing.assert_allclose(emitted[:, n], alone, atol=1e-10)
        assert end[n] == pytest.approx(last, abs=1e-10)
        # A constant drive settles to itself at resonance
    np.testing.assert_array_equal(start, [0.2, -0.5j])


def test_weights_are_kept_and_do_not_grow(source):
    stepper = PoleStepper(Pole(40e3, 25.0))
    assert stepper.weights(1e-4) is stepper.weights(1e-4 + 1e-19)
    for k in range(1000):
        stepper.weights(1e-4 + 1e-9 * k)
    assert len(stepper._stored) <= 64


def test_two_stimuli_with_arrays_of_their_own_add_up(mixed):
    first, second = of(**AM), of(**CIRCLE | {"control_rate_Hz": 1700})
    moments = substep_moments((first, second), 0.0, 1e-4, 8)
    # The second one's ticks cut the first one's steps too
    assert all(moments.held_s)
    courses = []
    for stimulus, chosen in ((first, np.arange(256)), (second, np.arange(256, 512))):
        drive = drive_of(mixed, stimulus, chosen.astype(np.int32))
        response = response_of(drive, delayed=False)
        before = np.full(512, 0.25 + 0j)
        courses.append(emitted_over(stimulus, drive, response, before, STILL, moments))
        outside = np.setdiff1d(np.arange(512), chosen)
        assert not rows(courses[-1])[:, outside].any() and not courses[-1].end[outside].any()
    total = combined(courses)
    np.testing.assert_allclose(rows(total), rows(courses[0]) + rows(courses[1]), atol=1e-15)
    np.testing.assert_allclose(total.end, courses[0].end + courses[1].end, atol=1e-15)
    assert combined(courses[:1]) is courses[0]


def test_stimuli_of_one_unit_drive_each_are_told_as_a_superposition(mixed):
    stimuli = of(**AM), of(**AM | {"am_frequency_Hz": 70.0})
    moments = substep_moments(stimuli, 0.0, 1e-4, 8)
    courses = []
    for stimulus, chosen in zip(stimuli, (np.arange(256), np.arange(256, 512)), strict=True):
        drive = drive_of(mixed, stimulus, chosen.astype(np.int32))
        response = response_of(drive, delayed=False)
        courses.append(emitted_over(stimulus, drive, response, np.zeros(512, complex), STILL, moments))
    total = combined(courses)
    assert total.levels.shape == (9, 2) and total.units.shape == (2, 512)
    np.testing.assert_allclose(rows(total), rows(courses[0]) + rows(courses[1]), atol=1e-15)
    # Of as many drives as moments nothing is gained
    short = [course._replace(levels=course.levels[:2]) for course in courses]
    np.testing.assert_array_equal(combined(short).levels, np.eye(2))


def test_one_stimulus_beside_a_silent_one_keeps_its_levels(mixed):
    first, silent = of(**AM), of(start_s=1.0)
    moments = substep_moments((first, silent), 0.0, 1e-4, 8)
    courses = []
    for stimulus, chosen in ((first, np.arange(256)), (silent, np.arange(256, 512))):
        drive = drive_of(mixed, stimulus, chosen.astype(np.int32))
        response = response_of(drive, delayed=False)
        courses.append(emitted_over(stimulus, drive, response, np.zeros(512, complex), STILL, moments))
    total = combined(courses)
    assert total.units is courses[0].units and total.levels is courses[0].levels
    assert total.serial == courses[0].serial
    assert len(combined(courses[1:] * 2).units) == 0


def test_auto_keeps_what_matters(source):
    def active(stimulus, accuracy=0.05, **array):
        drive = drive_of(source, stimulus)
        return transducer_response(stimulus, drive, STILL, [instance(**array)], accuracy)

    ramped = {"start_s": 0.001, "ramp_s": 0.05}
    near = {"focus_m": (0.0, 0.0, 0.12)}
    assert active(of(**AM, **near)).on
    # A sudden start is a jump, however slow or still the sound is afterwards
    assert active(of(**AM | {"am_frequency_Hz": 5}, **near)).on and active(of(**near)).on
    assert not active(of(**AM | {"am_frequency_Hz": 5}, **near, **ramped)).on
    assert not active(of(**near, **ramped)).on
    assert active(of(**near, **ramped, stop_s=0.2)).on
    assert not active(of(**AM, **near, **ramped), quality=2).on
    slow = AM | {"am_frequency_Hz": 50}
    assert not active(of(**slow, **near, **ramped)).on
    assert active(of(**slow, **near, **ramped), accuracy=0.002).on
    assert not active(of(**AM, **near), response="off").on
    assert active(of(**near, **ramped), response="on").on
    circle = active(of(**CIRCLE, **near))
    assert circle.on and circle.delayed and not active(of(**AM, **near)).delayed


def test_only_the_arrays_that_a_stimulus_drives_decide(mixed):
    stimulus = of(**AM, ramp_s=0.05)
    configs = [instance(response="off"), instance(response="on", quality=40)]
    for chosen, on in ((np.arange(256), False), (np.arange(256, 512), True)):
        response = transducer_response(
            stimulus, drive_of(mixed, stimulus, chosen.astype(np.int32)), STILL, configs, 0.05
        )
        assert response.on == on
        assert response.pole.Q[[0, 511]].tolist() == [25, 40] and not response.stepper.alike


def test_a_silent_or_dead_array_costs_nothing(source):
    quiet = of(**AM, drive_amplitude=0.0)
    response = transducer_response(quiet, drive_of(source, quiet), STILL, [instance()], 0.05)
    assert response.ring_up.rms == response.flight_time.rms == 0.0 and not response.on
    faulty = (replace(source.array, gain=np.zeros(256, complex)),)
    dead = type(source)(faulty, faulty)
    loud = of(**AM)
    assert transducer_response(loud, drive_of(dead, loud), STILL, [instance()], 0.05).ring_up.peak == 0.0
    # A silent drive is emitted as silence, whatever the response
    on = response_of(drive_of(source, quiet), delayed=False)
    nothing = emitted_over(
        quiet, drive_of(source, quiet), on, np.zeros(256, complex), STILL, substep_moments((quiet,), 0.0, 1e-4, 8)
    )
    assert not np.any(nothing.levels)


@pytest.mark.parametrize(
    ("keys", "on", "delayed", "most"),
    [
        (AM, True, False, 40),
        (CIRCLE, True, True, 70),
        (AM, False, False, 30),
        (CIRCLE, False, False, 30),
        (AM | {"control_rate_Hz": 1000}, True, False, 40),
    ],
    ids=["am", "circle", "am at once", "circle at once", "ticks"],
)
def test_a_step_takes_few_python_calls(source, python_calls, keys, on, delayed, most):
    stimulus = of(**keys)
    drive = drive_of(source, stimulus)
    response = response_of(drive, on=on, delayed=delayed)
    emitted = np.zeros(256, complex)

    def step():
        moments = substep_moments((stimulus,), 0.01, 1.25e-4, 8)
        emitted_over(stimulus, drive, response, emitted, STILL, moments)

    step()
    assert python_calls(step) <= most
