import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.drive import pulse_width
from palmfield.drive.pulse_width import Edge
from palmfield.errors import DeviceError
from palmfield.types import Complex, Float

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


@given(ticks=TICKS, start=st.integers(0, 639), share=DUTIES)
def test_the_law_is_the_first_harmonic_of_the_pulse(ticks: int, start: int, share: float) -> None:
    start, width = start % ticks, round(share * ticks)
    wave = pulse_width.waveform([start], [width], ticks)
    assert wave.sum() == width
    np.testing.assert_allclose(pulse_width.emitted([start], [width], ticks), first_harmonic(wave), atol=1e-12)


@given(duty=DUTIES, exponent=st.floats(1.0, 3.0))
def test_duty_is_the_inverse_of_the_pressure(duty: float, exponent: float) -> None:
    amplitude = pulse_width.relative_pressure(duty, exponent)
    # The law is flat at a duty of 1/2, where a rounding error of the amplitude moves the duty by its square root.
    assert pulse_width.relative_pressure(pulse_width.duty_cycle(amplitude, exponent), exponent) == pytest.approx(
        float(amplitude), abs=1e-12
    )


def test_duty_of_half_amplitude_is_a_sixth() -> None:
    assert pulse_width.duty_cycle(0.5) == pytest.approx(1 / 6)
    assert pulse_width.duty_cycle([0.0, 1.0]).tolist() == [0.0, 0.5]


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
    arp = pulse_width.relative_pressure(duty, 1.5) ** 2
    slope = np.polyfit(np.log(np.sin(np.pi * duty)), np.log(arp), 1)[0]
    assert slope == pytest.approx(1.5, rel=1e-12)


@pytest.mark.parametrize("held", ["leading", "trailing"])
def test_a_held_edge_turns_the_phase_by_pi_d(held: Edge) -> None:
    """By FFT of the pulses: the phase relative to full drive's is that of edge_phase; compensated it stays."""
    ticks = 512
    amplitude = np.sin(np.pi * np.array([16, 64, 128, 200, 256]) / ticks)
    wave = pulse_width.waveform(*pulse_width.pulses(amplitude, ticks, held=held), ticks)
    duty = wave.mean(axis=1)
    turned = np.angle(first_harmonic(wave))
    expected = pulse_width.edge_phase(duty, held) - pulse_width.edge_phase(0.5, held)
    np.testing.assert_allclose(turned, expected, atol=1e-12)
    assert abs(turned[0]) == pytest.approx(np.pi * (0.5 - 16 / 512))
    centred = first_harmonic(pulse_width.waveform(*pulse_width.pulses(amplitude, ticks), ticks))
    np.testing.assert_allclose(centred, amplitude, atol=1e-12)


@given(ticks=TICKS, amplitude=st.floats(0.0, 1.0), phase=st.floats(-10.0, 10.0), exponent=st.floats(1.0, 2.0))
def test_pulses_come_out_as_asked_to_a_tick(ticks: int, amplitude: float, phase: float, exponent: float) -> None:
    """Half a tick of width, and half a tick of start: the errors that rounding can make."""
    wanted = np.array([amplitude * np.exp(1j * phase)])
    start, width = pulse_width.pulses(wanted, ticks, exponent=exponent)
    assert 0 <= start[0] < ticks
    assert 0 <= width[0] <= ticks // 2
    got = pulse_width.emitted(start, width, ticks, exponent)[0]
    low, high = (
        pulse_width.relative_pressure(np.clip((width[0] + side) / ticks, 0.0, 0.5), exponent) for side in (-0.5, 0.5)
    )
    assert low - 1e-9 <= amplitude <= high + 1e-9
    if width[0] > 0:
        assert abs(np.angle(got / wanted[0])) <= np.pi / ticks + 1e-9


def test_a_pulse_that_is_not_wide_enough_for_a_tick_is_off() -> None:
    start, width = pulse_width.pulses([1e-4], 512)
    assert width[0] == 0
    assert pulse_width.emitted(start, width, 512)[0] == 0.0


def test_resampled_frames_follow_a_slow_signal_and_drop_its_images() -> None:
    """200 Hz in 2 kHz frames: at 40 kHz the sine itself within 0.2 %, its images at 1.8 and 2.2 kHz 50 dB down."""
    t = np.arange(400) / 2000.0
    smooth = pulse_width.resample(np.sin(2 * np.pi * 200 * t), 2000.0)
    assert len(smooth) == 8000
    inner = slice(400, -400)  # the ends are held, not continued
    fine = np.arange(8000) / 40e3
    assert np.abs(smooth - np.sin(2 * np.pi * 200 * fine))[inner].max() < 2e-3
    spectrum = np.abs(np.fft.rfft(smooth[inner])) / (0.5 * len(smooth[inner]))
    frequency = np.fft.rfftfreq(len(smooth[inner]), 1 / 40e3)
    held = np.repeat(np.sin(2 * np.pi * 200 * t), 20)[inner]
    steps = np.abs(np.fft.rfft(held)) / (0.5 * len(held))
    for image in (1800.0, 2200.0):
        i = int(np.abs(frequency - image).argmin())
        assert spectrum[i] < 10 ** (-50 / 20)
        assert steps[i] > 0.05  # what the frames held give instead


@pytest.mark.parametrize("cutoff", [None, 300.0, 700.0])
def test_resampling_leaves_a_constant_alone(cutoff: float | None) -> None:
    frames = np.full((5, 3), 0.3 + 0.1j)
    smooth = pulse_width.resample(frames, 2000.0, cutoff_Hz=cutoff)
    assert smooth.shape == (100, 3)
    np.testing.assert_allclose(smooth, 0.3 + 0.1j, rtol=1e-12)


def test_resampling_at_half_the_frame_rate_goes_through_the_frames() -> None:
    frames = np.random.default_rng(0).random(30)
    smooth = pulse_width.resample(frames, 2000.0, span=12)
    np.testing.assert_allclose(smooth[::20], frames, atol=1e-12)


@pytest.mark.parametrize("cutoff", [300.0, 700.0])
def test_resampling_delays_nothing(cutoff: float) -> None:
    """The step of symmetric frames stays symmetric."""
    frames = np.concatenate([np.zeros(30), np.ones(1), np.zeros(30)])
    smooth = pulse_width.resample(frames, 2000.0, cutoff_Hz=cutoff, span=16)
    np.testing.assert_allclose(smooth[600 - 300 : 600 + 301], smooth[600 + 300 : 600 - 301 : -1], atol=1e-12)


def test_what_makes_no_sense_is_refused() -> None:
    cases = [
        (lambda: pulse_width.duty_cycle([0.2, 1.2]), "amplitude 1.2 is outside 0 to 1"),
        (lambda: pulse_width.duty_cycle(np.nan), "amplitude nan"),
        (lambda: pulse_width.relative_pressure(0.6), "duty 0.6 is outside 0 to 0.5"),
        (lambda: pulse_width.duty_cycle(0.5, exponent=0.0), "exponent = 0.0"),
        (lambda: pulse_width.widths(0.5, 511), "ticks = 511"),
        (lambda: pulse_width.emitted([0], [300], 512), "duty 0.5859"),
        (lambda: pulse_width.resample(np.ones(4), 3000.0), "frame rate 3000.0 Hz does not divide"),
        (lambda: pulse_width.resample(np.ones(4), 2000.0, span=3), "span = 3"),
        (lambda: pulse_width.resample(np.ones(4), 2000.0, cutoff_Hz=25e3), "cutoff_Hz = 25000.0"),
    ]
    for work, message in cases:
        with pytest.raises(DeviceError, match=message):
            work()
