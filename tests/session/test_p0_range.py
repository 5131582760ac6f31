"""The range of p0 in a scene: of all its arrays, and none where the stimulus sets the level."""

import numpy as np
import pytest

from palmfield.session.error_budget import p0_band, p0_given
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives

STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}
SECOND = (
    '<plugin plugin="palmfield.array"><instance name="second"><config key="site" value="second"/>'
    '<config key="p0_Pa_m" value="4"/><config key="p0_low_Pa_m" value="2"/><config key="p0_high_Pa_m" value="6"/>'
    "</instance></plugin>"
)
CART = (
    '<body name="cart" pos="0.3 0 0.05"><joint name="cart" type="slide" axis="0 1 0"/>'
    '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><site name="second" quat="0.9238795 0 -0.3826834 0"/></body>'
)


def test_the_range_of_p0_is_that_of_all_arrays(small_scene):
    path = small_scene(stimulus=STEADY)
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", f"<worldbody>{CART}", 1))
    path.write_text(path.read_text().replace("<extension>", "<extension>" + SECOND, 1))
    model = load(path).runtime.model
    arrays, focus = model.arrays, model.stimuli[0].first_focus
    drive = array_drives(model, arrays)[0].unit_drive(focus).amplitudes
    halves = [np.where(np.arange(512) // 256 == i, drive, 0) for i in (0, 1)]
    strengths = [abs(arrays.pressure64(focus[None], half)[0]) for half in halves]
    ranged = [array.config.p0_low_Pa_m is not None for array in model.spec.arrays]
    low = sum(p * (0.5 if has else 1.27 / 2.53) for p, has in zip(strengths, ranged, strict=True)) / sum(strengths)
    high = sum(p * (1.5 if has else 8.02 / 2.53) for p, has in zip(strengths, ranged, strict=True)) / sum(strengths)
    # Both sound in phase at the focus, so that magnitudes add up
    assert p0_band(model, 0) == pytest.approx((low**2, high**2), rel=1e-6)
    assert not p0_given(model, 0)


def test_no_range_of_p0_where_the_stimulus_sets_the_level(small_scene):
    assert p0_band(load(small_scene(stimulus={"arp_peak_Pa": 1})).runtime.model, 0) is None
