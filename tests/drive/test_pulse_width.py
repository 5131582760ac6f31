import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.drive import pulse_width
from palmfield.drive.pulse_width import Edge
from palmfield.errors import DeviceError
from palmfield.stimulus.duty_law import duty_cycle, relative_pressure
from palmfield.types import Complex, Float, Int

DUTIES = st.floats(0.0, 0.5)
TICKS = st.sampled_from([128, 512, 640])


def first_harmonic(waves: Float) -> Complex:
    """Complex amplitude at the carrier of one period of samples, by FFT, relative to that of half a period's pulse.

    Samples stand for the middle of their tick. V = Re(A e^{-iwt}), hence the conjugate of NumPy's e^{+iwt} coefficient.
    """
    ticks = waves.shape[-1]
    half = np.abs(np.fft.fft(np.arange(ticks) < ticks // 2))[1]
    coefficient = np.fft.fft(waves, axis=-1)[..., 1] * np.exp(-1j * np.pi / ticks)
    return np.conj(coefficient) / half


def trains(start: Int, width: Int, ticks: int) -> Float:
    """One period of each train of pulses, 0 or 1, one sample a tick, shape (n, ticks)."""
    since = np.mod(np.arange(ticks) - np.asarray(start)[..., None], ticks)
    return (since < np.asarray(width)[..., None]).astype(float)


@given(ticks=TICKS, start=st.integers(0, 639), share=DUTIES)
def test_the_law_is_the_first_harmonic_of_the_pulse(ticks: int, start: int, share: float) -> None:
    start, width = start % ticks, round(share * ticks)
    wave = trains(np.array([start]), np.array([width]), ticks)
    assert wave.sum() == width
    middle = np.exp(2j * np.pi * (start + 0.5 * width) / ticks)
    law = relative_pressure(width / ticks) * middle
    np.testing.assert_allclose(first_harmonic(wave), law, atol=1e-12)


@given(duty=DUTIES, exponent=st.floats(1.0, 3.0))
def test_duty_is_the_inverse_of_the_pressure(duty: float, exponent: float) -> None:
    amplitude = relative_pressure(duty, exponent)
    # The law is flat at a duty of 1/2, where a rounding error of the amplitude moves the duty by its square root.
    assert relative_pressure(duty_cycle(amplitude, exponent), exponent) == pytest.approx(float(amplitude), abs=1e-12)


def test_duty_of_half_amplitude_is_a_sixth() -> None:
    assert duty_cycle(0.5) == pytest.approx(1 / 6)
    assert duty_cycle([0.0, 1.0]).tolist() == [0.0, 0.5]


def test_autd3_widths() -> None:
    """round(512 asin(i/255)/pi): 0 to 256 ticks, and every level's error within half a tick."""
    level = np.arange(256) / pulse_width.AUTD3_LEVELS
    width = pulse_width.widths(level, pulse_width.AUTD3_TICKS)
    assert width[[0, 1, 2, 127, 128, 254, 255]].tolist() == [0, 1, 1, 85, 86, 242, 256]
    assert np.all(np.diff(width) >= 0)
    error = np.abs(np.sin(np.pi * width / 512) - level)
    assert error.max() <= np.pi / 512 * 0.5 + 1e-12


def test_hasegawa_has_320_levels() -> None:
    assert pulse_width.widths(1.0, pulse_width.HASEGAWA_TICKS) == 320


def test_radiation_pressure_under_the_calibration_goes_with_its_exponent() -> None:
    """The measured P is quadratic in the pressure; with g = 1.5 it goes with sin(pi d)^1.5."""
    duty = np.linspace(0.05, 0.5, 10)
    arp = relative_pressure(duty, 1.5) ** 2
    slope = np.polyfit(np.log(np.sin(np.pi * duty)), np.log(arp), 1)[0]
    assert slope == pytest.approx(1.5, rel=1e-12)


@pytest.mark.parametrize("held", ["leading", "trailing"])
def test_a_held_edge_turns_the_phase_by_pi_d(held: Edge) -> None:
    """By FFT of the pulses: the phase relative to full drive's is that of edge_phase; of centred ones it stays."""
    ticks = 512
    width = np.array([16, 64, 128, 200, 256])
    wave = trains(np.full(5, -ticks // 4) if held == "leading" else ticks // 4 - width, width, ticks)
    duty = wave.mean(axis=1)
    turned = np.angle(first_harmonic(wave))
    expected = pulse_width.edge_phase(duty, held) - pulse_width.edge_phase(0.5, held)
    np.testing.assert_allclose(turned, expected, atol=1e-12)
    assert abs(turned[0]) == pytest.approx(np.pi * (0.5 - 16 / 512))
    centred = first_harmonic(trains(-width // 2, width, ticks))
    np.testing.assert_allclose(centred, np.sin(np.pi * duty), atol=1e-12)


def test_what_makes_no_sense_is_refused() -> None:
    cases = [
        (lambda: duty_cycle([0.2, 1.2]), "amplitude 1.2 is outside 0 to 1"),
        (lambda: duty_cycle(np.nan), "amplitude nan"),
        (lambda: relative_pressure(0.6), "duty 0.6 is outside 0 to 0.5"),
        (lambda: duty_cycle(0.5, exponent=0.0), "exponent = 0.0"),
        (lambda: pulse_width.widths(0.5, 511), "ticks = 511"),
    ]
    for work, message in cases:
        with pytest.raises(DeviceError, match=message):
            work()
