"""Where a small model of a skin ends, and what goes over to the whole layer."""

import numpy as np
import pytest

from palmfield.session.simulation import load
from palmfield.simulation.emission import Emission
from palmfield.simulation.posed_scene import PosedScene, reference_scene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.small_models.leaving import OutsideClass, continue_on_whole_layer, leaves_small_model
from palmfield.simulation.state import new_state, stepper_of
from palmfield.skin.reduction.reduced_stepper import ReducedStepper
from palmfield.skin.stepper import Outside
from palmfield.transforms import IDENTITY, Transform


@pytest.fixture
def model(small_scene):
    """Of a focus under AM, with a small model for its load."""
    made = load(small_scene(duration_s=5.0, array={"response": "on"})).runtime.model
    assert isinstance(made.begin[0].value, ReducedStepper)
    return made


@pytest.mark.parametrize(("shift", "leaves"), [(0.0, False), (0.9, False), (1.1, True)])
def test_a_focus_may_move_by_less_than_matters(model, shift, leaves):
    rest = reference_scene(model)
    frame = Transform(np.array([0.0, shift * model.skins[0].still_m, 0.0]), np.eye(3))
    posed = PosedScene(IDENTITY, rest.arrays, [frame], rest.bodies, rest.skins)
    assert leaves_small_model(model, new_state(model), 0, posed, rest, Emission(model), 0.0) == leaves


def test_the_whole_layer_goes_on_under_the_sound_that_there_is(model, monkeypatch):
    """The pressure that a small model's accelerations follow from is that of what is emitted, at any level."""
    rest, state, pressures = reference_scene(model), new_state(model), []
    drive = Emission(model).placed(rest, 0.0)[0].drive
    amplitudes = 0.3 * drive.unit_drive(model.stimuli[0].first_focus).amplitudes
    stepper, radiation = stepper_of(model, state, 0)[0], Radiation(model)

    def lifted(self, numbers, pressure):
        pressures.append(pressure())
        return np.zeros((1, model.whole[0].value.state_size))

    monkeypatch.setattr(ReducedStepper, "lifted", lifted)
    continue_on_whole_layer(model, state, 0, rest, Emission(model), radiation, amplitudes, 0.0)
    radiation.choose(0, stepper.points)
    expected = radiation.on(rest, 0, "load", amplitudes).arp
    np.testing.assert_allclose(pressures[0], expected, rtol=1e-5, atol=1e-6 * expected.max())
    assert stepper_of(model, state, 0)[0] is model.whole[0].value


def test_what_lies_outside_a_class_counts_by_its_norm():
    """Sums of squares of a step of which a tenth lies outside, then of a louder one of which nothing does."""
    outside = OutsideClass()
    outside.loudest = 1.0
    assert outside.add(Outside(0.04, 4.0, 0.09, 9.0)) == pytest.approx(0.1)
    assert outside.add(Outside(0.0, 12.0, 0.0, 27.0)) == 0.0 and outside.loudest == 12.0
    assert outside.energy_share == pytest.approx(0.05) and outside.pressure_share == pytest.approx(0.05)
    assert outside.errors((0.12, 0.2)) == pytest.approx((0.13, 0.25))
