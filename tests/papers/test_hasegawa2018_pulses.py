import numpy as np
import pytest

from palmfield.errors import DeviceError
from palmfield_papers.hasegawa2018.pulses import duty_course, resample, waveform


def test_a_train_is_up_for_its_width_from_its_start() -> None:
    assert waveform([6, 0], [4, 0], 8).tolist() == [[1, 1, 0, 0, 0, 0, 1, 1], [0] * 8]


def test_the_duty_of_packets_is_smoothed_to_the_carrier():
    steady = duty_course(np.full(20, 160))
    assert len(steady) == 400
    np.testing.assert_allclose(steady, 0.25, atol=1e-12)
    jump = duty_course(np.repeat([80, 240], 20))
    # Without the filter a packet's step would come at once, from 1/8 to 3/8
    assert np.abs(np.diff(jump)).max() < 0.25 / 8 and jump[0] == 0.125 and jump[-1] == 0.375


def test_resampled_frames_follow_a_slow_signal_and_drop_its_images() -> None:
    """200 Hz in 2 kHz frames: at 40 kHz the sine itself within 0.2 %, its images at 1.8 and 2.2 kHz 50 dB down."""
    t = np.arange(400) / 2000.0
    smooth = resample(np.sin(2 * np.pi * 200 * t), 2000.0)
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
    smooth = resample(frames, 2000.0, cutoff_Hz=cutoff)
    assert smooth.shape == (100, 3)
    np.testing.assert_allclose(smooth, 0.3 + 0.1j, rtol=1e-12)


def test_resampling_at_half_the_frame_rate_goes_through_the_frames() -> None:
    frames = np.random.default_rng(0).random(30)
    smooth = resample(frames, 2000.0, span=12)
    np.testing.assert_allclose(smooth[::20], frames, atol=1e-12)


@pytest.mark.parametrize("cutoff", [300.0, 700.0])
def test_resampling_delays_nothing(cutoff: float) -> None:
    """The step of symmetric frames stays symmetric."""
    frames = np.concatenate([np.zeros(30), np.ones(1), np.zeros(30)])
    smooth = resample(frames, 2000.0, cutoff_Hz=cutoff, span=16)
    np.testing.assert_allclose(smooth[600 - 300 : 600 + 301], smooth[600 + 300 : 600 - 301 : -1], atol=1e-12)


@pytest.mark.parametrize(
    ("rate_Hz", "keys", "message"),
    [
        (3000.0, {}, "frame rate 3000.0 Hz does not divide"),
        (2000.0, {"span": 3}, "span = 3"),
        (2000.0, {"cutoff_Hz": 25e3}, "cutoff_Hz = 25000.0"),
    ],
)
def test_what_makes_no_sense_is_refused(rate_Hz: float, keys: dict[str, float], message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        resample(np.ones(4), rate_Hz, **keys)
