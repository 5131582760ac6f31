import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from palmfield.acoustics.arrays import layout
from palmfield.drive.foci import transfer64
from palmfield.drive.response import (
    Pole,
    delay_bound,
    delay_spread,
    emitted_at,
    envelope_response,
    filter_frames,
    flight_times,
    ring_bound,
)
from palmfield.errors import DeviceError, SceneError
from palmfield.types import Air, Complex, Float

QUALITIES = st.floats(5.0, 60.0)
DETUNINGS_HZ = st.floats(-900.0, 900.0)
FREQUENCIES_HZ = st.floats(1.0, 3000.0)


def test_gain_at_500_hz_is_the_figure_of_a_quality_of_25() -> None:
    response = envelope_response(np.array([-500.0, 0.0, 500.0]), Pole(40e3, 25.0))[:, 0]
    decibels = 20 * np.log10(np.abs(response))
    np.testing.assert_allclose(decibels, [-1.43, 0.0, -1.43], atol=0.01)


@pytest.mark.parametrize(("f0_Hz", "Q"), [(40e3, 25.0), (40.6e3, 25.0), (39.5e3, 100.0)])
def test_the_pole_is_the_envelope_of_a_resonator_at_40_khz(f0_Hz: float, Q: float) -> None:
    """The second-order equation in real time, at the carrier, knows nothing of envelopes or poles.

    The pole leaves out terms of the order of 1/Q and of the detuning over f0; the difference must be of that order.
    """
    carrier, dt, frames = 40e3, 1e-4, 12
    drive = np.exp(1j * np.linspace(0.0, 4.0, frames)) * np.linspace(1.0, 0.3, frames)
    w, w0 = 2 * np.pi * carrier, 2 * np.pi * f0_Hz

    def motion(t: float, state: Float, u: complex) -> list[float]:
        force = (-1j * w0**2 / Q * u * np.exp(-1j * w * t)).real
        return [state[1], force - w0 / Q * state[1] - w0**2 * state[0]]

    state, envelope = np.zeros(2), [0.0 + 0.0j]
    for k, u in enumerate(drive):
        run = solve_ivp(motion, (k * dt, (k + 1) * dt), state, method="DOP853", rtol=1e-9, atol=1e-12, args=(u,))
        state = run.y[:, -1]
        # x = Re(a e^{-iwt}) and x' = Re(-iw a e^{-iwt}) for an envelope that is slow beside the carrier.
        envelope.append((state[0] + 1j * state[1] / w) * np.exp(1j * w * (k + 1) * dt))
    emitted = filter_frames(drive[:, None], dt, Pole(f0_Hz, Q, carrier))[:, 0]
    difference = np.linalg.norm(emitted - np.array(envelope)) / np.linalg.norm(envelope)
    assert difference < 0.5 / Q + abs(carrier - f0_Hz) / f0_Hz
    assert np.linalg.norm(np.append(0, drive) - envelope) / np.linalg.norm(envelope) > 5 * difference


def test_the_pole_comes_closer_to_the_resonator_as_its_quality_grows() -> None:
    """First order in 1/Q, at equal g t: steady-state response of the resonator, in closed form, against the pole's."""
    errors = []
    for Q in (25.0, 50.0, 100.0):
        pole = Pole(40e3, Q)
        f = 0.6 * 40e3 / (2 * Q)
        s = (40e3 + f) / 40e3
        resonator = (-1j / Q) / (1 - s**2 - 1j * s / Q)
        errors.append(abs(envelope_response(f, pole)[0] - resonator))
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2.0, rtol=0.02)


@pytest.mark.parametrize("linear", [False, True])
@given(Q=QUALITIES, detuning=DETUNINGS_HZ, dt=st.floats(1e-7, 2e-3), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_frames_are_exact_for_any_step(linear: bool, Q: float, detuning: float, dt: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    pole = Pole(np.array([40e3, 40e3 + detuning]), Q)
    wanted = random.normal(size=(4, 2)) + 1j * random.normal(size=(4, 2))
    start = random.normal(size=2) + 0j
    emitted = filter_frames(wanted, dt, pole, linear=linear, initial=start)

    def motion(t: float, a: Complex, k: int) -> Complex:
        u = wanted[k] + (wanted[k + 1] - wanted[k]) * (t / dt) if linear else wanted[k]
        return pole.damping * u - pole.rate * a

    a = start
    for k in range(len(emitted) - 1):
        np.testing.assert_allclose(emitted[k], a, rtol=1e-7, atol=1e-8)
        a = solve_ivp(motion, (0.0, dt), a, method="DOP853", rtol=1e-10, atol=1e-11, args=(k,)).y[:, -1]
    np.testing.assert_allclose(emitted[-1], a, rtol=1e-7, atol=1e-8)


def test_held_frames_split_in_two_give_the_same() -> None:
    random = np.random.default_rng(1)
    drives = random.normal(size=(30, 5)) + 1j * random.normal(size=(30, 5))
    pole = Pole(np.linspace(39e3, 41e3, 5), np.linspace(10, 40, 5))
    whole = filter_frames(drives, 1e-4, pole)
    halves = filter_frames(np.repeat(drives, 2, axis=0), 5e-5, pole)
    np.testing.assert_allclose(halves[::2], whole, atol=1e-13)
    between = emitted_at(5e-5 * np.arange(61), drives, 1e-4, pole)
    np.testing.assert_allclose(between, halves, atol=1e-13)


def test_a_constant_drive_settles_at_the_response_at_0_hz() -> None:
    pole = Pole(np.array([40e3, 40.5e3]), 25.0)
    emitted = filter_frames(np.ones((200, 2)), 1e-4, pole)
    np.testing.assert_allclose(emitted[-1], envelope_response(0.0, pole), rtol=1e-12)
    assert abs(emitted[2, 0]) == pytest.approx(1 - np.exp(-1.0), abs=0.01)  # ring-up in Q/(pi f0) = 0.199 ms


def test_flight_times_spread_over_a_16_by_16_array() -> None:
    """0.08 ms at 200 mm for a 16 x 16 array: the farthest corner against the middle."""
    array, air = layout("uhev1"), Air()
    half, c = 7.5 * 10.3e-3, 331.3 * np.sqrt(1 + 20 / 273.15)
    corner, middle = np.hypot(0.2, np.sqrt(2) * half), np.hypot(0.2, np.sqrt(2) * 5.15e-3)
    spread = delay_spread(array, (0, 0, 0.2), air)
    assert spread == pytest.approx((corner - middle) / c, rel=1e-12)
    assert spread == pytest.approx(0.08e-3, abs=0.005e-3)
    assert flight_times(array, (0, 0, 0.2), air).max() == pytest.approx(corner / c)


def test_sound_arrives_after_its_flight() -> None:
    array, air = layout("uhev1"), Air()
    point = np.array([0.03, 0.0, 0.12])
    flight = flight_times(array, point, air)
    drives = np.ones((20, len(array)), complex)
    times = np.array([0.9 * flight.min(), 2e-3])
    arrived = emitted_at(times[:, None] - flight, drives, 1e-4, Pole())
    assert np.all(arrived[0] == 0.0)
    np.testing.assert_allclose(arrived[1], 1 - np.exp(-np.pi * 40e3 / 25 * (2e-3 - flight)), rtol=1e-12)


def band_limited(random: np.random.Generator, top_Hz: float) -> tuple[Float, Complex]:
    """Frequencies up to top_Hz and their complex amplitudes: an envelope sum_j A_j e^{-2 pi i f_j t}."""
    frequencies = np.append(random.uniform(-top_Hz, top_Hz, 12), random.choice([-top_Hz, top_Hz]))
    return frequencies, random.normal(size=13) + 1j * random.normal(size=13)


@pytest.mark.parametrize("remove_delay", [False, True])
@given(Q=QUALITIES, detuning=DETUNINGS_HZ, spread=st.floats(0.0, 300.0), top=FREQUENCIES_HZ, seed=st.integers(0, 999))
@settings(max_examples=150, deadline=None)
def test_ring_bound_is_a_bound(
    remove_delay: bool, Q: float, detuning: float, spread: float, top: float, seed: int
) -> None:
    """Every single frequency by the response of the pole, and random sums of them, stay below it."""
    pole = Pole(40e3 + detuning + spread * np.array([-1.0, 0.0, 1.0]), Q)
    bound = ring_bound(top, pole, remove_delay=remove_delay)
    delay = float(np.mean((1 / pole.rate).real)) if remove_delay else 0.0
    static = envelope_response(0.0, pole)
    grid = np.linspace(-top, top, 2001)
    late = np.exp(2j * np.pi * grid * delay)[:, None]
    single = np.abs(envelope_response(grid, pole) / static - late)
    assert single.max() <= bound * (1 + 1e-9)
    frequencies, amplitudes = band_limited(np.random.default_rng(seed), top)
    off = np.abs(envelope_response(frequencies, pole) / static - np.exp(2j * np.pi * frequencies * delay)[:, None])
    rms = np.linalg.norm(off * amplitudes[:, None], axis=0) / np.linalg.norm(amplitudes)
    assert np.all(rms <= bound * (1 + 1e-9))


def test_ring_bounds_are_reached_and_have_the_right_order() -> None:
    """Without the delay's removal the bound is the largest error itself; with it, second order in the frequency."""
    for pole in (Pole(), Pole(40.7e3, 25.0)):
        grid = np.linspace(-4000.0, 4000.0, 80_001)
        error = np.abs(envelope_response(grid, pole) / envelope_response(0.0, pole) - 1.0)
        assert ring_bound(4000.0, pole) == pytest.approx(error.max(), rel=1e-5)
    assert ring_bound(20.0, Pole(), remove_delay=True) / ring_bound(10.0, Pole(), remove_delay=True) == pytest.approx(
        4.0, rel=1e-3
    )
    true = abs(envelope_response(10.0, Pole())[0] * np.exp(-20j * np.pi * 25 / (np.pi * 40e3)) - 1.0)
    assert ring_bound(10.0, Pole(), remove_delay=True) == pytest.approx(true, rel=0.01)


def test_ring_bound_holds_for_frames_in_time() -> None:
    """200 Hz amplitude modulation, stepped finely, after the ring-up: time domain against the bound."""
    dt, pole = 1e-6, Pole()
    t = dt * np.arange(20_001)
    drive = 0.5 + 0.5 * np.sin(2 * np.pi * 200 * t)
    emitted = filter_frames(drive[:, None], dt, pole, linear=True)[:, 0]
    last = slice(-5001, -1)  # one period
    error = np.linalg.norm((emitted - drive)[last]) / np.linalg.norm(drive[last])
    bound = ring_bound(200.0, pole)
    assert 0.3 * bound < error < bound


@given(
    x=st.floats(-0.08, 0.08), y=st.floats(-0.08, 0.08), z=st.floats(0.05, 0.6), top=FREQUENCIES_HZ,
    seed=st.integers(0, 999),
)  # fmt: skip
@settings(max_examples=15, deadline=None)
def test_delay_bound_is_a_bound(x: float, y: float, z: float, top: float, seed: int) -> None:
    """The pressure with every transducer's own flight time, against one time for all, relative to the sum of all."""
    array, air = layout("uhev1"), Air()
    flight = flight_times(array, (x, y, z), air)
    common = 0.5 * (flight.min() + flight.max())
    bound = delay_bound(top, delay_spread(array, (x, y, z), air))
    strength = np.abs(transfer64([(x, y, z)], array, air)[0])
    random = np.random.default_rng(seed)
    drive = random.normal(size=len(array)) + 1j * random.normal(size=len(array))
    frequencies, amplitudes = band_limited(random, top)
    turn = 2j * np.pi * frequencies[:, None]
    for a in (drive, np.ones(len(array))):
        off = (np.exp(turn * flight) - np.exp(turn * common)) @ (strength * a)
        rms = np.linalg.norm(off * amplitudes) / np.linalg.norm(amplitudes)
        assert rms <= bound * np.sum(strength * np.abs(a)) * (1 + 1e-9)


def test_delay_bound_is_reached_by_two_transducers_at_the_ends_of_the_spread() -> None:
    spread, f = 0.31e-3, 500.0
    off = abs(np.exp(2j * np.pi * f * spread / 2) - 1)
    assert delay_bound(f, spread) == pytest.approx(off, rel=1e-12)
    assert delay_bound(1e5, spread) == 2.0
    assert delay_bound(0.0, spread) == 0.0


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (lambda: Pole(Q=0.0), "Q = 0.0"),
        (lambda: Pole(f0_Hz=np.array([40e3, np.nan])), "f0_Hz = nan"),
        (lambda: Pole(f0_Hz=np.full(3, 40e3), Q=np.full(2, 25.0)), "f0_Hz has 3 values and Q 2"),
        (lambda: filter_frames(np.ones(3), 1e-3, Pole()), r"shape \(3,\)"),
        (lambda: filter_frames(np.ones((0, 3)), 1e-3, Pole()), "at least one frame"),
        (lambda: filter_frames([[1.0], [np.nan]], 1e-3, Pole()), r"drives\[1\] is not finite"),
        (lambda: filter_frames(np.ones((2, 3)), 0.0, Pole()), "dt = 0.0"),
        (lambda: filter_frames(np.ones((2, 3)), 1e-3, Pole(Q=np.full(2, 25.0))), "pole has 2 transducers"),
        (lambda: filter_frames(np.ones((2, 3)), 1e-3, Pole(), initial=np.ones(2)), "initial has shape"),
        (lambda: ring_bound(-1.0, Pole()), "envelope_frequency_Hz = -1.0"),
        (lambda: delay_bound(100.0, np.nan), "spread_s = nan"),
    ],
)
def test_what_makes_no_sense_is_refused(work: object, message: str) -> None:
    assert callable(work)
    with pytest.raises(DeviceError, match=message):
        work()


def test_flight_to_no_position_is_refused() -> None:
    with pytest.raises(SceneError, match="not a finite position"):
        flight_times(layout("uhev1"), (0.0, np.nan, 0.2), Air())
