"""The displacement meter on tilted planes, waves under its spot, and its own digits."""

import numpy as np
import pytest

from palmfield.errors import MeasurementError
from palmfield.instruments import DisplacementMeter, SurfaceMotion, disc_grid, displacement_reading

TIMES = np.arange(400) / 4e3


def surface(displacement, normal=(0.0, 0.0, 1.0), points=None):
    points = disc_grid(0.002, 2e-4) if points is None else points
    unit = np.array(normal) / np.linalg.norm(normal)
    return SurfaceMotion(TIMES, points, np.tile(unit, (len(points), 1)), displacement(points), displacement(points))


def test_it_reads_where_its_beam_meets_a_tilted_plane():
    slide = np.array([3e-6, 1e-6, -2e-6])
    for normal, beam in (((0.3, 0.0, 1.0), (0, 0, 1)), ((0, 0, 1), (1, 0, 1)), ((0.2, -0.4, 1.0), (0.5, 0.1, 1))):
        motion = surface(lambda points: np.broadcast_to(slide, (400, len(points), 3)), normal)
        n = motion.normals[0]
        exact = slide @ n / (np.array(beam) @ n / np.linalg.norm(beam))
        read = displacement_reading(motion, [0, 0, 0], DisplacementMeter(beam=beam))
        assert read.values == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("wavelength", [1e-3, 2e-3, 5e-3])
def test_a_spot_takes_short_waves_away(wavelength):
    k, spot = 2.0 * np.pi / wavelength, 1e-3

    def wave(points):
        height = np.cos(k * points[:, 0]) * np.ones(400)[:, None]
        return np.stack([0 * height, 0 * height, height], axis=-1)

    read = displacement_reading(surface(wave, points=disc_grid(0.002, 5e-5)), [0, 0, 0], DisplacementMeter(spot_m=spot))
    # A Gaussian of deviation spot/4: exp(-(k s)^2/2)
    assert read.values[0] == pytest.approx(np.exp(-0.5 * (k * spot / 4.0) ** 2), abs=2e-3)


def test_averages_range_digits_and_noise():
    rise = surface(lambda points: (np.array([0, 0, 1.0]) * TIMES[:, None, None]) * np.ones((1, len(points), 1)))
    meter = DisplacementMeter(sampling_rate_Hz=4e3, averaged=5)
    assert displacement_reading(rise, [0, 0, 0], meter).values[10:] == pytest.approx(TIMES[10:] - 2 / 4e3, abs=1e-9)
    coarse = displacement_reading(rise, [0, 0, 0], DisplacementMeter(resolution_m=0.01, range_m=0.05)).values
    assert set(np.round(coarse / 0.01)) == set(range(6))
    still = surface(lambda points: np.zeros((400, len(points), 3)))
    noisy = DisplacementMeter(sampling_rate_Hz=4e3, repeatability_m=5e-8)
    read = displacement_reading(still, [0, 0, 0], noisy, seed=3)
    assert read.values.std() == pytest.approx(5e-8, rel=0.15)


def test_wrong_beams_and_spots_are_told():
    motion = surface(lambda points: np.zeros((400, len(points), 3)))
    with pytest.raises(MeasurementError, match="lies along the surface"):
        displacement_reading(motion, [0, 0, 0], DisplacementMeter(beam=(1, 0, 0)))
    with pytest.raises(MeasurementError, match="beam is"):
        displacement_reading(motion, [0, 0, 0], DisplacementMeter(beam=(0, 0, 0)))
    with pytest.raises(MeasurementError, match="points lie within the spot"):
        displacement_reading(motion, [0, 0, 0], DisplacementMeter(spot_m=1e-4))
    for place, told in (
        ([np.nan, 0, 0], "give three finite"),
        ([0, 0], "give three finite"),
        ([1, 0, 0], "m from the nearest point of the motion; allowed"),
    ):
        with pytest.raises(MeasurementError, match=told):
            displacement_reading(motion, place, DisplacementMeter())
