"""Plane and ring waves stand at their own frequency and wavenumber."""

import numpy as np
import pytest
from scipy.special import hankel1

from palmfield.errors import MeasurementError
from palmfield.instruments import disc_grid, rectangle_grid
from palmfield.instruments.frequency_wavenumber import frequency_wavenumber, on_plane

TIMES = np.arange(2000) / 4e3


def peak(spectrum):
    line, wave = np.unravel_index(spectrum.amplitude.argmax(), spectrum.amplitude.shape)
    return spectrum.frequency_Hz[line], spectrum.wavenumber_rad_m[wave]


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_plane_wave_is_one_peak(angle):
    points = rectangle_grid(0.1, 0.1, 0.004)
    along = points[:, 0] * np.cos(angle) + points[:, 1] * np.sin(angle)
    record = np.cos(2 * np.pi * 200 * TIMES[:, None] - 300 * along)
    found = frequency_wavenumber(TIMES, record, points)
    assert peak(found)[0] == pytest.approx(200, abs=2) and peak(found)[1] == pytest.approx(300, rel=0.03)


def test_a_ring_wave_and_a_tilted_grid():
    flat = disc_grid(0.06, 0.004)
    ring = hankel1(0, 400 * np.maximum(np.linalg.norm(flat, axis=1), 2e-3))
    record = np.real(np.exp(-2j * np.pi * 150 * TIMES)[:, None] * ring)
    tilted = flat @ np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]).T + 0.1
    found = frequency_wavenumber(TIMES, record, tilted, most_Hz=300)
    assert peak(found)[0] == pytest.approx(150, abs=2) and peak(found)[1] == pytest.approx(400, rel=0.05)
    gaps = [np.linalg.norm(part[:, None] - part[None], axis=-1) for part in (on_plane(tilted), flat)]
    assert gaps[0] == pytest.approx(gaps[1], abs=1e-12)


def test_no_lines_in_the_band_is_told():
    with pytest.raises(MeasurementError, match="the record has no line up to"):
        frequency_wavenumber(
            TIMES, np.random.default_rng(0).normal(size=(2000, 9)), disc_grid(0.01, 0.007), most_Hz=0.1
        )


def test_silence_and_records_of_other_points_are_told():
    with pytest.raises(MeasurementError, match="the records are silent"):
        frequency_wavenumber(TIMES, np.ones((len(TIMES), 9)), np.eye(9)[:, :3])
    with pytest.raises(MeasurementError, match="give \\(t, n\\) and"):
        frequency_wavenumber(TIMES, np.ones((len(TIMES), 9)), np.eye(3))
