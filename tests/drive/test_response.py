import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from palmfield.drive.response import Pole, envelope_response, filter_frames
from palmfield.errors import DeviceError
from palmfield.types import Complex, Float

QUALITIES = st.floats(5.0, 60.0)
DETUNINGS_HZ = st.floats(-900.0, 900.0)


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


def test_a_constant_drive_settles_at_the_response_at_0_hz() -> None:
    pole = Pole(np.array([40e3, 40.5e3]), 25.0)
    emitted = filter_frames(np.ones((200, 2)), 1e-4, pole)
    np.testing.assert_allclose(emitted[-1], envelope_response(0.0, pole), rtol=1e-12)
    assert abs(emitted[2, 0]) == pytest.approx(1 - np.exp(-1.0), abs=0.01)  # ring-up in Q/(pi f0) = 0.199 ms


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
    ],
)
def test_what_makes_no_sense_is_refused(work: object, message: str) -> None:
    assert callable(work)
    with pytest.raises(DeviceError, match=message):
        work()
