"""Where the phases between foci jump, as a run counts it, compared with NumPy's eigenvectors of its result."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import j1
from unestimated import UNESTIMATED

import palmfield
from palmfield.session.phase_turns import PhaseTurns
from palmfield.session.stimulus_import import import_stimulus
from palmfield.stimulus.focus_table_file import focus_table, write_focus_table

WAVELENGTH_M = 346.1 / 40e3


def scene_of(small_scene, tmp_path, apart_m, intensities=((1.0, 1.0), (1.0, 1.0))):
    """Foci that move along x, begin and end so far apart; the intensities of both at begin and end."""
    half = 0.5 * np.array(apart_m)[:, None]
    x = half * np.linspace(-1.0, 1.0, np.shape(intensities)[1])
    places = np.stack([x, np.zeros_like(x), np.full_like(x, 0.12)], axis=2)
    table = focus_table(
        np.array([0.0, 0.02]), places, np.array(intensities), rate_Hz=1000.0, between="linear", quantity="amplitude"
    )
    write_focus_table(tmp_path / "in.csv", table)
    scene = small_scene(array={"response": "off"}, skin={"solver": "wedges"}, duration_s=0.019)
    return import_stimulus(tmp_path / "in.csv", scene).scene


def own_turns(result, pressures):
    """Times of turns by pistons' waves in the result's own places; pressures: of the foci, by time"""
    arrays = result.dataset["array/array"]
    pose = arrays["pose"].values[0]
    assert np.allclose(pose[3:], [1, 0, 0, 0])
    transducers, radius = arrays["transducer_position"].values + pose[:3], float(arrays["piston_radius"])
    k, last, times = 2.0 * np.pi / WAVELENGTH_M, None, []
    stimulus = result.dataset["stimulus/stimulus"]
    records = result.dataset["time"], stimulus["foci"], stimulus["sounding"]
    for time, foci, loud in zip(*(record.values for record in records), strict=True):
        if not loud:
            continue
        rays = foci[:, None] - transducers
        r = np.linalg.norm(rays, axis=2)
        x = np.maximum(k * radius * np.linalg.norm(rays[:, :, :2], axis=2) / r, 1e-9)
        waves = 2.0 * j1(x) / x * np.exp(1j * k * r) / r
        waves *= np.sqrt(pressures(time) / np.sum(np.abs(waves) ** 2, axis=1))[:, None]
        vector = np.linalg.eigh(waves @ waves.conj().T)[1][:, -1]
        if last is not None and abs(np.vdot(vector, last)) < 0.7:
            times.append(time)
        last = vector
    return times


def changes(result):
    """Times of the drive's frames, and what each changes the drive by, relative to it."""
    arrays = result.dataset["array/array"]
    drives = arrays["drive_amplitude"].values * np.exp(1j * arrays["drive_phase"].values)
    full = drives.any(axis=1)
    drives, times = drives[full], result.dataset["frame_time"].values[full]
    return times[1:], np.linalg.norm(np.diff(drives, axis=0), axis=1) / np.linalg.norm(drives[1:], axis=1)


@UNESTIMATED
def test_turns_are_counted_and_named_where_the_drive_jumps(small_scene, tmp_path, caplog):
    """Two foci that move apart through 9.1 and 16.3 mm, where the sound of one has a null at the other."""
    with caplog.at_level(logging.WARNING):
        result = palmfield.run(scene_of(small_scene, tmp_path, (0.007, 0.02)))
    (numbers,) = result.summary["stimuli"]
    own = own_turns(result, lambda time: np.ones(2))
    assert numbers["phase_turns"] == len(own) == 2
    assert numbers["phase_turn_times_s"] == pytest.approx(own, abs=2e-4)
    times, changed = changes(result)
    assert sorted(times[changed > 0.5]) == pytest.approx(numbers["phase_turn_times_s"], abs=1e-6)
    (line,) = [record.getMessage() for record in caplog.records if "the phases between the foci" in record.getMessage()]
    assert f"'stimulus' jump (count: 2, first at {numbers['phase_turn_times_s'][0]:.6g} s)" in line


@UNESTIMATED
@pytest.mark.parametrize(
    ("apart_m", "intensities"),
    [((0.005, 0.008), ((1.0, 1.0), (1.0, 1.0))), ((0.012, 0.012), ((1.0, 0.2), (0.2, 1.0)))],
    ids=["apart", "swap loudness"],
)
def test_foci_whose_eigenvalues_stay_apart_turn_nowhere(small_scene, tmp_path, caplog, apart_m, intensities):
    """Also two that swap their loudness: the sound of each at the other keeps their eigenvalues apart."""
    with caplog.at_level(logging.WARNING):
        result = palmfield.run(scene_of(small_scene, tmp_path, apart_m, intensities))
    (numbers,) = result.summary["stimuli"]

    def pressures(time):
        now = np.array(intensities[0]) + time / 0.02 * (np.array(intensities[1]) - intensities[0])
        return now / now.max()

    assert numbers["phase_turns"] == len(own_turns(result, pressures)) == 0
    assert numbers["phase_turn_times_s"] == []
    assert changes(result)[1].max() < 0.5
    assert not any("the phases between the foci" in record.getMessage() for record in caplog.records)


@UNESTIMATED
def test_one_focus_has_no_phases_to_turn(small_scene):
    (numbers,) = palmfield.run(small_scene(duration_s=0.002)).summary["stimuli"]
    assert "phase_turns" not in numbers


def test_a_vector_turns_where_it_stands_at_right_angles_to_the_last_one():
    """Of complex vectors, whose common phase means nothing."""
    first, other = np.array([1.0, 1j]) / np.sqrt(2.0), np.array([1.0, -1j]) / np.sqrt(2.0)
    vectors = iter([first, 1j * first, other, other])
    drive = SimpleNamespace(wavenumber=730.0, leading_of=lambda foci, wanted: next(vectors))
    turns = PhaseTurns()
    for record in range(4):
        turns.see(0.001 * record, drive, np.array([[0.0, 0.0, 0.1], [0.01, 0.0, 0.1]]) + 1e-5 * record, None)
    assert turns.times == [0.002]
