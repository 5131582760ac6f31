"""Transducers one by one, judged on readings of a laboratory that shares no model with the fit."""

from typing import Any

import numpy as np
import pytest
from check_calibration import judged
from laboratory import Laboratory, strange_board

from palmfield.acoustics.arrays import layout
from palmfield.drive.calibration.element_fit import fit_elements
from palmfield.errors import PalmfieldError
from palmfield.types import Air

BOARD = layout("sonicsurface")


@pytest.fixture(scope="module")
def rough() -> list[dict[str, Any]]:
    """Places 1 mm and air 1 K off (sd), a measured directivity for the piston, 10 % echo, 8 bits."""
    return [judged(seed) for seed in range(3)]


def test_a_real_room_gives_polarity_phase_and_gain(rough: list[dict[str, Any]]) -> None:
    """Asked are 15 deg and 8 %."""
    for one in rough:
        assert one["polarities"] == 0 and one["silent"], "five silent ones are found, and no other"
        assert np.degrees(np.sqrt(np.mean(one["phase"] ** 2))) < 5.0
        assert np.sqrt(np.mean(one["gain"] ** 2)) < 0.03
        assert abs(one["p0"]) < 0.03


def test_intervals_cover_the_truth(rough: list[dict[str, Any]]) -> None:
    """Errors of neighbours go together, so that three boards say little more than three errors of phase do."""
    phases = [np.abs(one["phase"]) < 1.96 * one["phase_sd"] for one in rough]
    gains = [np.abs(one["gain"]) < 1.96 * one["gain_sd"] for one in rough]
    assert np.mean(phases) > 0.8 and np.mean(gains) > 0.88
    assert all(abs(one["speed"]) < 3.0 * one["speed_sd"] for one in rough)


def test_exact_places_and_air_leave_the_readings_noise() -> None:
    one = judged(5, True)
    assert one["polarities"] == 0
    assert np.degrees(np.sqrt(np.mean(one["phase"] ** 2))) < 0.6 and np.sqrt(np.mean(one["gain"] ** 2)) < 0.01
    assert np.mean(np.abs(one["phase"]) < 1.96 * one["phase_sd"]) == pytest.approx(0.95, abs=0.05)


def test_a_board_without_faults_is_found_to_have_none() -> None:
    random = np.random.default_rng(2)
    at = np.column_stack([random.uniform(-0.05, 0.05, (4, 2)), random.uniform(0.15, 0.2, 4)])
    lab = Laboratory(BOARD.positions, np.ones(len(BOARD)), p0=1.0, noise=1e-4, random=random)
    elements = fit_elements(BOARD, Air(), at, lab.read(lab.each(at))).elements
    assert all(elements.enabled) and set(elements.polarity) == {1}
    assert np.degrees(np.abs(elements.phase_rad).max()) < 1.0 and np.abs(np.array(elements.gain) - 1.0).max() < 0.02


AT = np.array([[0.0, 0.0, 0.15], [0.02, 0.0, 0.2], [0.0, 0.03, 0.18]])
ONES = np.ones((3, len(BOARD)), complex)


@pytest.mark.parametrize(
    ("at", "readings", "told"),
    [
        (AT[:2], ONES[:2], "at least 3"),
        (AT, ONES[:, :7], "a column for each transducer"),
        (AT * [1, 1, -1], ONES, "not in front of all"),
        (AT, np.where(np.arange(len(BOARD)) == 9, np.nan, ONES), "transducer 9 has no finite reading"),
        (AT, np.where(np.arange(len(BOARD)) == 4, np.inf, ONES), "transducer 4 has no finite reading"),
        (AT, 0.0 * ONES, "all readings are 0"),
    ],
)
def test_readings_that_do_not_serve_are_refused(at: np.ndarray, readings: np.ndarray, told: str) -> None:
    with pytest.raises(PalmfieldError, match=told):
        fit_elements(BOARD, Air(), at, readings)


def readings_of(signal: np.ndarray, seed: int, places: int = 8) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, readings and the truth of a rough board on which place j sounds by the signal `signal[j]`."""
    random = np.random.default_rng(seed)
    truth = strange_board(random, len(BOARD))
    at = np.column_stack([random.uniform(-0.06, 0.06, (places, 2)), random.uniform(0.15, 0.25, places)])
    warm = 20.0 + float(random.normal())
    lab = Laboratory(BOARD.positions, truth, 2.2, warm, plate_m=0.3, reflection=0.1, bits=8, noise=0.01, random=random)
    seen = np.empty((places, len(BOARD)), complex)
    seen[:, signal] = lab.each(at + random.normal(0.0, 1e-3, at.shape))
    return at, lab.read(seen), truth


@pytest.mark.parametrize("places", [4, 8])
@pytest.mark.parametrize("wires", [[17, 200], [100, 101], [5, 90, 250], range(40, 48), range(64, 128)], ids=str)
def test_swapped_wires_are_found(wires: list[int], places: int) -> None:
    """They were called silent or turned, and switched off."""
    signal = np.arange(len(BOARD))
    signal[list(wires)] = list(wires)[::-1] if len(wires) > 3 else np.roll(wires, 1)
    at, readings, truth = readings_of(signal, 1, places)
    fit = fit_elements(BOARD, Air(), at, readings)
    sounds = truth != 0.0
    assert fit.unfit == () and np.array_equal(fit.elements.enabled, sounds)
    assert fit.elements.address is not None
    np.testing.assert_array_equal(np.array(fit.elements.address)[sounds], signal[sounds])
    assert {n for n in wires if sounds[n] and signal[n] != n} <= set(fit.swapped)
    found = np.array(fit.elements.polarity) * np.exp(1j * np.array(fit.elements.phase_rad))
    turn = (found * truth.conj())[sounds]
    assert (np.cos(np.angle(turn) - 0.5 * np.angle((turn**2).sum())) ** 2 > 0.9).all()


def test_loud_readings_that_fit_no_place_are_named_and_off() -> None:
    at, readings, truth = readings_of(np.arange(len(BOARD)), 1)
    sounds = truth != 0.0
    random = np.random.default_rng(7)
    readings[:, [30, 31]] = np.abs(readings[:, [30, 31]]) * np.exp(2j * np.pi * random.random((8, 2)))
    fit = fit_elements(BOARD, Air(), at, readings)
    assert fit.unfit == (30, 31) and fit.swapped == () and fit.elements.address is None
    assert np.array_equal(fit.elements.enabled, sounds & ~np.isin(np.arange(len(BOARD)), [30, 31]))


def test_readings_in_another_order_are_refused() -> None:
    at, readings, _ = readings_of(np.random.default_rng(0).permutation(len(BOARD)), 1)
    with pytest.raises(PalmfieldError, match="check the layout, the order of its transducers"):
        fit_elements(BOARD, Air(), at, readings)


@pytest.mark.parametrize("where", ["over all", "at each place", "between places", "warmer"])
def test_intervals_hold_under_a_drift_of_one_kelvin(where: str) -> None:
    """A drift at each place left 39 % of phases within their intervals."""
    inside, places = [], 8
    for seed in range(5):
        random = np.random.default_rng(seed)
        truth = strange_board(random, len(BOARD))
        at = np.column_stack([random.uniform(-0.06, 0.06, (places, 2)), random.uniform(0.15, 0.25, places)])
        really, turn = at + random.normal(0.0, 1e-3, at.shape), np.arange(len(BOARD)) / len(BOARD)
        rows = []
        for m in range(places):
            begin, step = {
                "over all": (m / places, 1 / places), "at each place": (0.0, 1.0),
                "between places": (m / (places - 1), 0.0), "warmer": (1.5, 0.0),
            }[where]  # fmt: skip
            cold, warm = (
                Laboratory(BOARD.positions, truth, 2.2, t, plate_m=0.3, reflection=0.1).each(really[[m]])[0]
                for t in (19.5, 20.5)
            )
            rows.append(cold * np.exp(1j * (begin + step * turn) * np.angle(warm * cold.conj())))
        lab = Laboratory(BOARD.positions, truth, bits=8, noise=0.01, random=random)
        elements = fit_elements(BOARD, Air(), at, lab.read(np.array(rows))).elements
        sounds = truth != 0.0
        found = np.array(elements.polarity) * np.exp(1j * np.array(elements.phase_rad)) * truth.conj()
        error = 0.5 * np.angle(found[sounds] ** 2 * np.exp(-1j * np.angle((found[sounds] ** 2).sum())))
        inside.append(np.abs(error) < 1.96 * np.array(elements.phase_sd_rad)[sounds])
    assert np.mean(inside) >= 0.9
