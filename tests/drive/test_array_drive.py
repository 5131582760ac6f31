"""Phases and levels of a focus."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.acoustics.focus import focus
from palmfield.drive.array_drive import KEPT, ArrayDrive, in_mm, shown_below
from palmfield.drive.boards import BOARDS
from palmfield.drive.foci import solve_foci, transfer64
from palmfield.errors import SceneError
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.transforms import IDENTITY

STILL = FocalPoints(IDENTITY)
PLACES = st.tuples(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(0.05, 0.3))


def drive_of(source, *, chosen=None, arp_peak_Pa=None, amplitude=None, board="ideal"):
    every = np.arange(len(source.array), dtype=np.int32)
    return ArrayDrive(source, every if chosen is None else chosen, arp_peak_Pa, amplitude, BOARDS[board])


@given(place=PLACES)
@settings(deadline=None)
def test_the_sound_of_all_transducers_meets_in_phase(source, place):
    point = np.array(place)
    unit = drive_of(source).unit_drive(point)
    transfer = transfer64(point[None], source.array, source.air)[0]
    # Absorption comes with the phase e^{ikd} only; what is left is the sum of the magnitudes
    assert transfer @ unit.amplitudes == pytest.approx(np.abs(transfer).sum(), rel=1e-9)
    np.testing.assert_allclose(unit.amplitudes, focus(source.array, source.air, point), atol=1e-12)
    assert unit.level == 1.0 and (unit.peak, unit.power) == pytest.approx((1.0, 256.0))


def test_transducers_that_the_focus_is_behind_stay_silent(mixed):
    behind_the_second = np.array([0.3, 0.0, 0.02])
    amplitudes = drive_of(mixed).unit_drive(behind_the_second).amplitudes
    heights = np.einsum("ij,ij->i", behind_the_second - mixed.array.positions, mixed.array.normals)
    assert (heights <= 0).any() and (heights > 0).any()
    np.testing.assert_array_equal(np.abs(amplitudes) > 0.5, heights > 0)


@given(places=st.lists(PLACES, min_size=1, max_size=5), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=30)
@pytest.mark.parametrize("keys", [{}, {"amplitude": 0.3}, {"arp_peak_Pa": 0.5}], ids=["full", "amplitude", "arp"])
def test_many_foci_at_once_are_those_one_by_one(mixed, places, seed, keys):
    points = np.array(places)
    drive = drive_of(mixed, **keys)
    each = np.array([drive_of(mixed, **keys).unit_drive(point).amplitudes for point in points])
    np.testing.assert_allclose(drive.unit_drives(points, STILL), each, atol=1e-10)
    # Each transducer its own of the points
    group = np.random.default_rng(seed).integers(0, len(points), len(mixed.array)).astype(np.int32)
    own = drive.unit_drives(points[None], STILL, group, np.ones((1, len(points)), bool))
    np.testing.assert_allclose(own[0], each[group, np.arange(len(group))], atol=1e-10)


@given(place=PLACES, target=st.floats(0.01, 2.0))
@settings(deadline=None, max_examples=30)
def test_the_level_gives_the_arp_that_is_asked_for(mixed, place, target):
    point = np.array(place)
    unit = drive_of(mixed, arp_peak_Pa=target).unit_drive(point)
    arp = np.abs(mixed.pressure64(point[None], unit.amplitudes)[0]) ** 2 / mixed.impedance
    assert arp == pytest.approx(target, rel=1e-9)
    assert unit.peak == pytest.approx(unit.level)


def test_a_stimulus_drives_the_transducers_that_it_has(mixed):
    first = np.arange(256, dtype=np.int32)
    point = np.array([0.01, 0.0, 0.2])
    alone = drive_of(mixed, chosen=first, arp_peak_Pa=1.0).unit_drive(point).amplitudes
    assert not alone[256:].any() and alone[:256].all()
    second = np.arange(256, 512, dtype=np.int32)
    other = drive_of(mixed, chosen=second, arp_peak_Pa=1.0)
    assert not other.unit_drive(point).amplitudes[:256].any()
    for drive in (alone, other.unit_drive(point).amplitudes, other.unit_drives(point[None], STILL)[0]):
        assert np.abs(mixed.pressure64(point[None], drive)[0]) ** 2 / mixed.impedance == pytest.approx(1.0)
    assert other.flight_times(point).shape == (256,)


def test_several_foci_are_equally_loud_and_as_loud_as_asked(source):
    offsets = np.array([[0.02, 0.0, 0.0], [-0.02, 0.0, 0.0]])
    several = FocalPoints(IDENTITY, offsets)
    point = np.array([0.0, 0.0, 0.15])
    drive = drive_of(source, arp_peak_Pa=2.0)
    amplitudes = drive.unit_drive(several.at(point)).amplitudes
    arp = np.abs(source.pressure64(point + offsets, amplitudes)) ** 2 / source.impedance
    assert arp.max() == pytest.approx(2.0) and arp.min() == pytest.approx(2.0, rel=0.05)
    phases = solve_foci(point + offsets, source.array, source.air).drive
    np.testing.assert_allclose(amplitudes / np.abs(amplitudes), phases, atol=1e-9)
    rows = drive.unit_drives(np.array([point, point + 0.01, point]), several)
    np.testing.assert_array_equal(rows[0], rows[2])
    np.testing.assert_array_equal(rows[1], drive.unit_drive(several.at(point + 0.01)).amplitudes)


def test_a_board_plays_the_phases_that_it_has(source):
    point = np.array([0.0, 0.01, 0.2])
    drive = drive_of(source, board="sonicsurface")
    board = BOARDS["sonicsurface"]
    played = board.decode(board.encode(focus(source.array, source.air, point)))[-1]
    np.testing.assert_array_equal(drive.unit_drive(point).amplitudes, played)
    np.testing.assert_array_equal(drive.unit_drives(point[None], STILL)[0], played)


def test_few_places_are_solved_once_each(source, monkeypatch):
    drive = drive_of(source)
    points = np.linspace([0.0, 0.0, 0.1], [0.0, 0.0, 0.2], KEPT)
    first = [drive.unit_drive(point) for point in points]
    assert all(drive.unit_drive(point) is unit for point, unit in zip(points, first, strict=True))
    drive.unit_drive(np.array([0.0, 0.0, 0.3]))
    assert len(drive._stored) <= KEPT


@pytest.mark.parametrize("many", [False, True], ids=["one", "many"])
@pytest.mark.parametrize(
    ("place", "keys", "words"),
    [
        ((0, 0, -0.1), {}, "^focus .* is behind array"),
        ((np.nan, 0, 0.1), {}, "^focus .* is not a finite position"),
        (
            (0, 0, 0.2),
            {"arp_peak_Pa": 1e6},
            r"arp_peak_Pa 1e\+06 exceeds the output of the array at \(0.0, 0.0, 200.0\)",
        ),
    ],
)
def test_foci_that_cannot_be_made_are_refused(source, place, keys, words, many):
    drive = drive_of(source, **keys)
    point = np.array(place, float)
    with pytest.raises(SceneError, match=words):
        if many:
            drive.unit_drives(np.array([[0.0, 0.0, 0.2], point]), STILL)
        else:
            drive.unit_drive(point)


def test_a_place_that_does_not_sound_need_not_be_one_that_the_array_can_make(source):
    points = np.array([[0.0, 0.0, 0.2], [0.0, 0.0, -0.2]])
    drives = drive_of(source).unit_drives(points, STILL, audible=np.array([[True], [False]]))
    assert np.abs(drives[0]).min() == pytest.approx(1.0)


def test_dead_transducers_are_named(mixed):
    only_dead = np.array([3, 70], np.int32)
    with pytest.raises(SceneError, match="are dead: list fewer"):
        drive_of(mixed, chosen=only_dead, arp_peak_Pa=1.0).unit_drive(np.array([0.0, 0.0, 0.2]))


def test_places_in_words():
    assert in_mm([0, 0.0125, 0.2]) == "(0.0, 12.5, 200.0) mm"
    assert in_mm(np.zeros((2, 3))) == "(0.0, 0.0, 0.0) mm and (0.0, 0.0, 0.0) mm"


@pytest.mark.parametrize(
    ("value", "limit", "told"),
    [
        (9.8213, 12.0, "9.82"),
        (11.9987, 12.0, "11.999"),
        (0.5337, 12.0, "0.534"),
        (12.0 - 2e-15, 12.0, "11.999999999999998"),
    ],
)
def test_a_number_below_a_limit_is_shown_below_it(value, limit, told):
    assert shown_below(value, limit) == told
