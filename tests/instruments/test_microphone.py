"""The virtual microphone on plane waves, whose mean over a disc is known, and on modulated carriers."""

import numpy as np
import pytest
from scipy.special import j1, jv

from palmfield.errors import MeasurementError
from palmfield.instruments import Microphone, microphone_scan, through_band
from palmfield.instruments.microphone import angle_response

K = 2.0 * np.pi * 40e3 / 343.0


def wave(angle_deg):
    along = np.array([np.sin(np.radians(angle_deg)), 0.0, np.cos(np.radians(angle_deg))])
    return lambda points: 7.0 * np.exp(1j * K * points @ along)


@pytest.mark.parametrize("inches", [1 / 8, 1 / 4, 1 / 2])
@pytest.mark.parametrize("angle", [0.0, 30.0, 50.0, 90.0])
def test_a_piston_averages_a_plane_wave_as_its_directivity(inches, angle):
    head = Microphone(diameter_m=inches * 0.0254)
    x = K * 0.5 * inches * 0.0254 * np.sin(np.radians(angle))
    exact = 7.0 if x == 0.0 else 7.0 * 2.0 * j1(x) / x
    assert microphone_scan(wave(angle), [[0.0, 0.0, 0.0]], head).values[0] == pytest.approx(exact, abs=1e-5)


@pytest.mark.parametrize("angle", [30.0, 90.0])
def test_a_membrane_hears_less_at_its_rim(angle):
    x = K * 0.5 * 0.00635 * np.sin(np.radians(angle))
    head = Microphone(diameter_m=0.00635, diaphragm="membrane")
    # Mean of J0(x r) with weight 2 (1 - r^2) 2 r over r from 0 to 1
    assert microphone_scan(wave(angle), [[0.0, 0.0, 0.0]], head).values[0] == pytest.approx(
        7.0 * 8.0 * jv(2, x) / x**2, abs=1e-5
    )


def test_a_point_reads_the_field_itself_and_a_face_doubles_it():
    places = np.array([[0.0, 0.0, 0.1], [0.01, 0.02, 0.3]])
    point = microphone_scan(wave(20.0), places, Microphone())
    assert np.array_equal(point.values, wave(20.0)(places)) and point["x"].values[1] == 0.01
    double = microphone_scan(wave(20.0), places, Microphone(face="doubling"))
    assert np.abs(double.values) ** 2 == pytest.approx(4.0 * np.abs(point.values) ** 2)


def test_the_angle_counts_from_where_the_diaphragm_faces():
    head = Microphone(diameter_m=0.0127, facing=(-np.sin(0.6), 0.0, -np.cos(0.6)))
    assert microphone_scan(wave(np.degrees(0.6)), [[0.0, 0.0, 0.0]], head).values[0] == pytest.approx(7.0, abs=1e-9)


@pytest.mark.parametrize("modulation", [100.0, 1000.0, 3000.0])
def test_each_side_band_meets_the_band_at_its_own_frequency(modulation):
    rate, carrier, edge, order = 64e3, 40e3, 41e3, 3
    times = np.arange(64_000) / rate
    envelope = 1.0 + 0.6 * np.cos(2.0 * np.pi * modulation * times)
    heard = through_band(times, envelope, carrier, Microphone(high_Hz=edge, order=order))
    lines = np.abs(np.fft.fft(heard)) / len(times)
    place = round(modulation)

    def gain(f):
        return 1.0 / np.sqrt(1.0 + (f / edge) ** (2 * order))

    assert lines[0] == pytest.approx(gain(carrier), rel=1e-9)
    # e^{-i w t}: the upper side band stands at the negative frequency of NumPy's transform
    assert lines[-place] == pytest.approx(0.3 * gain(carrier + modulation), rel=1e-9)
    assert lines[place] == pytest.approx(0.3 * gain(carrier - modulation), rel=1e-9)


def test_a_band_delays_the_envelope():
    times = np.arange(6400) / 64e3
    envelope = np.exp(-(((times - 0.05) / 0.002) ** 2))
    heard = np.abs(through_band(times, envelope, 40e3, Microphone(high_Hz=40e3, order=4)))
    assert times[heard.argmax()] - 0.05 + 1e-4 > 1e-5 and np.sum(times * heard) / np.sum(heard) > 0.05


def test_wrong_settings_are_told():
    with pytest.raises(MeasurementError, match="low_Hz below high_Hz"):
        through_band(np.arange(8.0), np.ones(8), 40e3, Microphone(low_Hz=2.0, high_Hz=1.0))
    with pytest.raises(MeasurementError, match="facing is"):
        microphone_scan(wave(0.0), [[0.0, 0.0, 0.0]], Microphone(facing=(0, 0, 0)))
    with pytest.raises(MeasurementError, match="key 'diameter_m' has value -1"):
        Microphone(diameter_m=-1)
    with pytest.raises(MeasurementError, match="places of a microphone"):
        microphone_scan(wave(0.0), [[0.0, 0.0]], Microphone())


def test_a_body_much_smaller_than_a_wave_shifts_the_phase_alone():
    """Of a rigid sphere p = 1 + 3/2 i k a cos(gamma) to first order, gamma from the wave's direction (Rayleigh)."""
    cosine = np.array([1.0, 0.5, 0.0, -1.0])
    ka = 1e-3
    found = angle_response(cosine, 2e-3, ka / 1e-3)
    assert found == pytest.approx(1.0 + 1.5j * ka * (1.0 - cosine), abs=1e-5)


def test_a_large_body_doubles_from_ahead_and_shades_from_behind():
    found = np.abs(angle_response(np.array([1.0, 0.8, np.cos(2.8)]), 0.02, 3000.0))
    assert found[1] == pytest.approx(1.0, abs=0.05)
    assert found[2] < 0.3


def test_a_point_hears_all_alike_and_odd_cosines_are_refused():
    assert angle_response([0.3, -1.0], 0.0, 700.0) == pytest.approx(1.0)
    with pytest.raises(MeasurementError, match="-1 to 1"):
        angle_response([1.2], 3e-3, 700.0)
    with pytest.raises(MeasurementError, match="wavenumber"):
        angle_response([1.0], 3e-3, 0.0)


def test_a_cylinders_face_rises_from_no_doubling_to_more_than_doubling():
    from palmfield.instruments.microphone import face_rise

    assert abs(face_rise(0.2, 1.0)) == pytest.approx(1.0, abs=0.01)
    eighth = abs(face_rise(0.003175, K))
    # The rigid sphere, exact, rises by 3.4 dB there; an edge adds to a flat face's sound
    sphere = 1.48
    assert sphere < eighth < 1.7
    assert 2.0 < abs(face_rise(0.2, 30.0)) < 2.3
    # In the shadow of its own body, which is short beside a wave no longer
    assert abs(face_rise(0.2, 30.0, -1.0)) < 0.6
    head = Microphone(diameter_m=0.003175, face="cylinder")
    read = microphone_scan(wave(0.0), [[0.0, 0.0, 0.0]], head, wavenumber=K)
    assert abs(read.values[0]) == pytest.approx(7.0 * eighth)
    with pytest.raises(MeasurementError, match="give a wavenumber"):
        microphone_scan(wave(0.0), [[0.0, 0.0, 0.0]], head)
    with pytest.raises(MeasurementError, match="k a is 7; allowed: above 0, up to 6"):
        face_rise(0.2, 70.0)


def test_the_mesh_of_a_cylinder_is_closed_and_of_its_size():
    import trimesh

    from palmfield.instruments.microphone import LENGTH_RADII, cylinder

    body = trimesh.Trimesh(*cylinder(6), process=False)
    assert body.is_watertight and body.volume == pytest.approx(np.pi * LENGTH_RADII, rel=0.03)


def test_a_scan_of_no_places_is_told():
    with pytest.raises(MeasurementError, match="places of a microphone have shape"):
        microphone_scan(lambda points: np.ones(len(points)), np.zeros((0, 3)), Microphone())
