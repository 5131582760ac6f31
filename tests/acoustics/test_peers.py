"""palmfield's field against what other programs gave: arrays that scripts/peers/write_reference.py wrote."""

from pathlib import Path

import numpy as np
import pytest

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.reference import pressure64
from palmfield.types import Air, Array, Complex

FOLDER = Path(__file__).parents[1] / "data" / "peers"
UNIT = 249


def stored(name: str) -> dict[str, np.ndarray]:
    with np.load(FOLDER / f"{name}.npz") as arrays:
        return dict(arrays)


def air_of(speed_m_s: float) -> Air:
    air = Air(temperature_C=273.15 * ((speed_m_s / 331.3) ** 2 - 1.0))
    assert sound_speed(air) == pytest.approx(speed_m_s, rel=1e-14)
    return air


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


@pytest.fixture(scope="module")
def emulator() -> dict[str, np.ndarray]:
    return stored("autd3_emulator")


def units(data: dict[str, np.ndarray]) -> Array:
    normals = np.tile([0.0, 0.0, 1.0], (len(data["positions"]), 1))
    return Array("peer", data["positions"], normals, float(data["p0_Pa_m"]), piston_radius_m=0.0)


def emitted(data: dict[str, np.ndarray], shift: int) -> Complex:
    """Drive of the emulated units: their recorded pulse width of 512 is a square wave whose first harmonic counts."""
    phase = data["phase"].astype(int)
    phase[2 * UNIT :] += shift
    return np.sin(np.pi * data["pulse_width"] / 512.0) * np.exp(2j * np.pi * phase / 256.0)


def test_emulator_quantises_the_pulse_width_as_documented(emulator: dict[str, np.ndarray]) -> None:
    expected = np.round(512.0 * np.arcsin(emulator["intensity"] / 255.0) / np.pi)
    np.testing.assert_array_equal(emulator["pulse_width"], expected)


@pytest.mark.parametrize("i", range(4))
def test_magnitude_is_that_of_autd3_emulator(emulator: dict[str, np.ndarray], i: int) -> None:
    array, air = units(emulator), air_of(float(emulator["sound_speed_m_s"]))
    drive = emitted(emulator, int(emulator["shifts"][i]))
    p, _ = pressure64(emulator["points"], array, drive, air, absorption_Np_m=0.0)
    assert relative(np.abs(p), emulator["magnitude"][i]) < 5e-6
    fast = FieldEvaluator(array, air, "cpu", absorption_Np_m=0.0).pressure(emulator["points"], drive).pressure
    assert relative(np.abs(fast), emulator["magnitude"][i]) < 3e-5


def test_phase_is_that_of_autd3_emulator(emulator: dict[str, np.ndarray]) -> None:
    """Four magnitudes |a + i^n b| give conj(a) b, so the phase's sign: a conjugate field would fail here."""
    array, air = units(emulator), air_of(float(emulator["sound_speed_m_s"]))
    drive = emitted(emulator, 0)
    parts = []
    for first in (True, False):
        only = drive * ((np.arange(len(array)) < 2 * UNIT) == first)
        parts.append(pressure64(emulator["points"], array, only, air, absorption_Np_m=0.0)[0])
    squares = emulator["magnitude"].astype(float) ** 2
    theirs = (squares[0] - squares[2] - 1j * (squares[1] - squares[3])) / 4.0
    ours = parts[0].conj() * parts[1]
    assert relative(ours, theirs) < 1e-5
    assert relative(ours.conj(), theirs) > 0.1


@pytest.fixture(scope="module")
def levitate() -> dict[str, np.ndarray]:
    return stored("levitate")


@pytest.mark.parametrize(("model", "radius_m"), [("piston", 4.5e-3), ("point", 0.0)])
def test_field_is_that_of_levitate(levitate: dict[str, np.ndarray], model: str, radius_m: float) -> None:
    array = Array(
        "peer", levitate["positions"], levitate["normals"], float(levitate["p0_Pa_m"]), piston_radius_m=radius_m
    )
    air = air_of(float(levitate["sound_speed_m_s"]))
    points, drive = levitate["points"], levitate["drive"]
    p, gradient = pressure64(points, array, drive, air, gradient=True, absorption_Np_m=0.0)
    assert relative(p, levitate[model]) < 1e-13
    evaluator = FieldEvaluator(array, air, "cpu", absorption_Np_m=0.0)
    fast = evaluator.pressure(points, drive, gradient=True)
    assert relative(fast.pressure, levitate[model]) < 3e-5
    assert relative(evaluator.pressure(points, drive).pressure, levitate[model]) < 3e-5
    if model == "point":
        assert gradient is not None and fast.gradient is not None
        assert relative(gradient, levitate["point_gradient"]) < 1e-13
        assert relative(fast.gradient, levitate["point_gradient"]) < 3e-5
