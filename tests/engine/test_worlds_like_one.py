"""What MuJoCo itself does in one world, worlds that are stepped in C must do too."""

import mujoco
import numpy as np
import pytest

import palmfield

pytestmark = pytest.mark.usefixtures("kept_operators")


def test_the_cutoff_of_a_sensor_holds_in_worlds(small_scene):
    path = small_scene()
    limited = path.read_text().replace('objtype="site"', 'cutoff="0.0001" objtype="site"')
    assert limited != path.read_text()
    path.write_text(limited)
    one, two = palmfield.Simulation(path), palmfield.Simulation(path, worlds=2)
    one.step(8)
    two.step(8)
    assert np.abs(one.data.sensordata).max() == 1e-4
    np.testing.assert_allclose(two.sensors, [one.data.sensordata] * 2, atol=1e-9)


def test_an_error_in_a_callback_is_raised_in_worlds(small_scene):
    sim = palmfield.Simulation(small_scene(), worlds=2)

    def control(model, data):
        raise ValueError("the controller failed")

    mujoco.set_mjcb_control(control)
    try:
        with pytest.raises(ValueError, match="the controller failed"):
            sim.step()
    finally:
        mujoco.set_mjcb_control(None)
