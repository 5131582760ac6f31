import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.drive import quantise
from palmfield.drive.boards import BOARDS
from palmfield.drive.foci import transfer64
from palmfield.errors import DeviceError
from palmfield.types import Air, Complex

STEPS = st.integers(1, 512)


def phase_noise(steps: int, transducers: int) -> float:
    """Rms of what phase rounding scatters, over the focus without: 1 - sinc^2(1/N) each, n of them as 1/sqrt(n)."""
    return float(np.sqrt((1.0 - np.sinc(1.0 / steps) ** 2) / transducers))


def random_phases(count: int, seed: int = 0) -> Complex:
    return np.exp(2j * np.pi * np.random.default_rng(seed).random(count))


@given(steps=STEPS, phase=st.floats(-50.0, 50.0))
def test_phases_go_to_the_nearest_step(steps: int, phase: float) -> None:
    code = int(quantise.phase_codes([np.exp(1j * phase)], steps)[0])
    assert 0 <= code < steps
    everything = np.exp(2j * np.pi * np.arange(steps) / steps)
    nearest = np.abs(everything - np.exp(1j * phase)).min()
    assert abs(everything[code] - np.exp(1j * phase)) <= nearest + 1e-12


@given(steps=STEPS, sign=st.sampled_from([-1.0, 1.0]))
def test_rounding_error_about_zero_phase_is_step_zero(steps: int, sign: float) -> None:
    """A floor would make the last step of -1e-17, which is "off" for some devices."""
    assert quantise.phase_codes([1.0 + sign * 1e-17j, np.exp(sign * 2j * np.pi)], steps).tolist() == [0, 0]


@given(steps=STEPS, amplitude=st.floats(0.0, 1.0))
def test_amplitudes_go_to_the_nearest_level(steps: int, amplitude: float) -> None:
    code = int(quantise.amplitude_codes([amplitude * 1j], steps)[0])
    assert 0 <= code <= steps
    assert abs(code / steps - amplitude) <= 0.5 / steps + 1e-12


@given(steps=STEPS, levels=STEPS, seed=st.integers(0, 99))
def test_quantising_twice_changes_nothing_more(steps: int, levels: int, seed: int) -> None:
    drive = random_phases(50, seed) * np.random.default_rng(seed).random(50)
    once = quantise.quantise(drive, phase_steps=steps, amplitude_steps=levels)
    np.testing.assert_allclose(quantise.quantise(once, phase_steps=steps, amplitude_steps=levels), once, atol=1e-12)


def test_without_steps_nothing_changes() -> None:
    drive = 0.3 * random_phases(20)
    np.testing.assert_allclose(quantise.quantise(drive), drive, rtol=1e-14)


def test_the_sonicsurface_plays_the_same_phases() -> None:
    """The board's own encoder and state machine, lag of every eighth address included in both directions."""
    drive = random_phases(256)
    board = BOARDS["sonicsurface"]
    heard = board.decode(board.encode(drive))[-1]
    np.testing.assert_allclose(quantise.quantise(drive, phase_steps=32, amplitude_steps=1), heard, atol=1e-12)


@pytest.mark.parametrize("steps", [2, 3, 4, 8, 16, 32])
def test_expected_loss_and_noise_of_random_phases(steps: int) -> None:
    """A million random phases: the mean of a*/a is the loss, the variance about it the noise."""
    drive = random_phases(1_000_000)
    ratio = quantise.quantise(drive, phase_steps=steps) / drive
    loss = quantise.phase_loss(steps)
    assert abs(ratio.mean() - loss) < 5e-3 * np.sqrt(1 - loss**2)  # five standard errors of a mean of a million
    spread = np.sqrt(np.mean(np.abs(ratio - ratio.mean()) ** 2))
    assert spread == pytest.approx(phase_noise(steps, 1), rel=5e-3)


@pytest.mark.parametrize("steps", [4, 8, 32])
def test_a_focus_loses_what_is_expected(steps: int) -> None:
    """Over 60 foci: the mean loss lies within five standard errors of sinc(1/N)."""
    array, air = layout("uhev1"), Air()
    random = np.random.default_rng(2)
    ratios = []
    for point in random.uniform([-0.05, -0.05, 0.1], [0.05, 0.05, 0.3], (60, 3)):
        drive = focus(array, air, point)
        coarse = quantise.quantise(drive, phase_steps=steps)
        whole, part = (pressure64(point[None], array, a, air)[0][0] for a in (drive, coarse))
        ratios.append(part / whole)
    error = np.mean(ratios) - quantise.phase_loss(steps)
    # Pressures at the focus are not quite equal over the transducers, which leaves fewer independent ones.
    assert abs(error) < 5 * phase_noise(steps, 256) / np.sqrt(60) * 1.1


def test_phase_noise_is_spread_over_the_directions() -> None:
    """Far from the focus: rms of what rounding adds, relative to a focus at each of those points."""
    array, air = layout("uhev1"), Air()
    random = np.random.default_rng(3)
    transfer = transfer64(random.uniform([-0.5, -0.5, 1.9], [0.5, 0.5, 2.1], (400, 3)), array, air)
    squares = []
    for target in random.uniform([-0.05, -0.05, 0.15], [0.05, 0.05, 0.25], (12, 3)):
        drive = focus(array, air, target)
        change = quantise.quantise(drive, phase_steps=4) - quantise.phase_loss(4) * drive
        squares.append(np.mean(np.abs(transfer @ change / np.abs(transfer).sum(axis=1)) ** 2))
    assert np.sqrt(np.mean(squares)) == pytest.approx(phase_noise(4, 256), rel=0.1)


def test_expected_noise_of_amplitudes() -> None:
    amplitudes = np.random.default_rng(4).random(1_000_000)
    for steps in (8, 255):
        error = quantise.quantise(amplitudes, amplitude_steps=steps) - amplitudes
        assert np.sqrt(np.mean(np.abs(error) ** 2)) == pytest.approx(1.0 / (steps * np.sqrt(12.0)), rel=5e-3)


@pytest.mark.parametrize(
    ("drive", "steps", "message"),
    [
        ([1.1], 32, "drive amplitude 1.1 is above 1"),
        ([np.nan], 32, "not finite"),
        ([1.0], 0, "_steps = 0 is below 1"),
    ],
)
def test_what_cannot_be_played_is_refused(drive: list[float], steps: int, message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        quantise.quantise(drive, phase_steps=steps)
    with pytest.raises(DeviceError, match=message):
        quantise.quantise(drive, amplitude_steps=steps)
