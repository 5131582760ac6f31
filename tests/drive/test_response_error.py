"""What leaving out ring-up and flight time costs, against the poles' equation solved by itself."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.phased_array import ArrayInstance
from palmfield.config import ArrayConfig, StimulusConfig
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.boards import BOARDS
from palmfield.drive.response import Pole, envelope_response
from palmfield.drive.response_error import shares, windows
from palmfield.drive.transducer_response import transducer_response
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.schedule import frame_at
from palmfield.transforms import IDENTITY, Placement, Transform

AM = {"modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": 200, "am_depth": 1}
FOCUS = np.array([0.0, 0.0, 0.12])


def instance(**keys):
    return ArrayInstance(ArrayConfig(**keys), Placement.of(IDENTITY))


def errors_of(source, stimulus, frame=IDENTITY):
    every = np.arange(len(source.array), dtype=np.int32)
    drive = ArrayDrive(source, every, None, None, BOARDS["ideal"])
    return transducer_response(stimulus, drive, FocalPoints(frame), [instance()], 0.05)


def parts_of(source, focus):
    distances = np.linalg.norm(focus - source.array.positions, axis=1)
    return shares(np.ones(len(source.array), complex), source.array.gain, distances)


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


def worst_by_ode(stimulus, jumps, drive, weights):
    found = [by_ode(drive, window, jumps, weights) for window in windows(stimulus, 25 / np.pi / 40e3)]
    return max(rms for rms, _ in found), max(peak for _, peak in found)


@pytest.mark.parametrize(
    ("keys", "moment"),
    [
        (AM, 0.75 * 0.005),
        (AM | {"am_waveform": "rectangle", "am_waveform_duty": 0.3}, 0.3 * 0.005),
        (AM | {"am_waveform": "rectangle", "am_waveform_duty": 0.3, "am_frequency_Hz": 2.0}, 0.3 * 0.5),
        (AM | {"am_waveform": "burst", "am_burst_length_s": 1.0, "am_burst_period_s": 4.0}, 0.5),
    ],
    ids=["sine", "rectangle", "slow rectangle", "burst"],
)
def test_a_window_lies_round_the_most_sudden_moment(keys, moment):
    """In some period; of a burst to within two of its sine's, whose crests are about the same there."""
    _, stretch = windows(StimulusConfig(start_s=0.1, **keys), 2e-4)
    period = {"burst": 4.0}.get(keys.get("am_waveform"), 1.0 / keys["am_frequency_Hz"])
    turns = (0.5 * sum(stretch) - 0.1 - moment) / period
    slack = 2.0 / keys["am_frequency_Hz"] / period if keys.get("am_waveform") == "burst" else 1e-6
    assert turns == pytest.approx(round(turns), abs=slack) and turns > -slack
    assert stretch[1] - stretch[0] == pytest.approx(min(max(period, 0.01), 0.1))


CUSPS = AM | {"am_quantity": "arp", "am_frequency_Hz": 50, "start_s": 0.001, "ramp_s": 0.08}


RECTANGLE = CUSPS | {"am_waveform": "rectangle", "am_waveform_duty": 0.25, "am_depth": 0.8, "ramp_s": 0.0}


@pytest.mark.parametrize(
    ("keys", "jumps", "rms", "peak"),
    [
        # (1 + sin)/2 of the ARP is |sin| of the pressure, with a cusp in every period
        (CUSPS, (), None, None),
        # After a step the drive is ahead by e^{-gt}, and 1 - e^{-1} just before the late one comes
        ({"start_s": 0.002}, (0.002,), np.sqrt(0.2358 / (np.pi * 40e3 / 25 * 0.01)), 1 - np.exp(-1)),
        (AM | {"am_frequency_Hz": 50, "stop_s": 0.1}, (0.0, 0.1), None, None),
        (RECTANGLE, 0.001 + np.sort(np.concatenate([0.02 * np.arange(8), 0.02 * np.arange(8) + 0.005])), None, None),
    ],
    ids=["cusps", "start", "start and stop", "rectangle"],
)
def test_cost_of_no_ring_up_is_that_of_the_poles_equation(source, keys, jumps, rms, peak):
    stimulus = StimulusConfig(focus_m=tuple(FOCUS), **keys)
    ring_up = errors_of(source, stimulus).ring_up

    def drive(t):
        return np.array([np.sqrt(frame_at(stimulus, t).arp_factor)], complex)

    direct = worst_by_ode(stimulus, jumps, drive, np.ones(1))
    assert ring_up.rms == pytest.approx(direct[0], rel=0.03)
    assert ring_up.peak == pytest.approx(direct[1], rel=0.05)
    if rms is not None:
        assert ring_up.rms == pytest.approx(rms, rel=0.05)
        assert ring_up.peak == pytest.approx(peak, rel=0.05)


UPRIGHT = Transform(FOCUS, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
"""Its y axis points along the array's z, its z axis along -y."""


@pytest.mark.parametrize(
    ("points", "upright"), [(4, False), (0, False), (0, True)], ids=["4 points", "flat", "upright"]
)
def test_cost_of_a_path_counts_its_points_and_its_plane(source, points, upright):
    stimulus = StimulusConfig(
        path="circle", path_diameter_m=0.03, path_rate_Hz=100, path_points=points, ramp_s=0.02,
        focus_m=(0, 0, 0) if upright else tuple(FOCUS),
    )  # fmt: skip
    k = 2 * np.pi * 40e3 / sound_speed(source.air)

    def drive(t):
        frame = frame_at(stimulus, t)
        x, y, z = frame.focus
        focus = np.array([x, -z, 0.12 + y]) if upright else frame.focus
        away = np.linalg.norm(focus - source.array.positions, axis=1)
        return np.sqrt(frame.arp_factor) * np.exp(-1j * k * away)

    first = UPRIGHT.points(np.array([0.015, 0, 0])) if upright else FOCUS + np.array([0.015, 0, 0])
    jumps = np.arange(1, 40) / 400 if points else ()
    rms, peak = worst_by_ode(stimulus, jumps, drive, parts_of(source, first))
    ring_up = errors_of(source, stimulus, UPRIGHT if upright else IDENTITY).ring_up
    # A part of the transducers stands for all
    assert ring_up.rms == pytest.approx(rms, rel=0.1)
    assert ring_up.peak == pytest.approx(peak, rel=0.1)


def test_cost_of_one_flight_time_is_that_of_the_sum_over_the_transducers(source):
    stimulus = StimulusConfig(focus_m=tuple(FOCUS), **AM | {"am_frequency_Hz": 1000, "start_s": 0.001, "ramp_s": 0.05})
    times = np.linalg.norm(FOCUS - source.array.positions, axis=1) / sound_speed(source.air)
    weights = parts_of(source, FOCUS)
    late = times - weights @ times
    # At a full sine (1 + sin wt)/2 only the sine is late: by 1 - sum of w e^{iw late}, filtered by the pole
    turn = 2 * np.pi * 1000
    share = abs(1 - weights @ np.exp(1j * turn * late)) * abs(envelope_response(1000.0, Pole(40e3, 25.0))[..., 0])
    response = errors_of(source, stimulus)
    assert response.flight_time.rms == pytest.approx(share / np.sqrt(3), rel=0.03)  # rms sqrt(1/2)/2 against sqrt(3/8)
    assert response.flight_time.peak == pytest.approx(share / 2, rel=0.03)
    assert response.spread_s == pytest.approx(np.ptp(times))
    assert str(response.flight_time).endswith("% at worst")
