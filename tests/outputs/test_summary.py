import json

import numpy as np
import pytest

from palmfield.outputs.schema import dataset
from palmfield.outputs.summary import summary


def test_numbers_of_a_known_motion(static_arrays):
    """u = -4 um + 5 um sin(2 pi 50 t) over whole periods: rms 5 / sqrt 2 without DC, sqrt(16 + 12.5) with."""
    count = len(static_arrays["skin_position"])
    time = np.arange(1000) * 1e-4
    motion = np.zeros((1000, count), np.float32)
    motion[:, 7] = -4e-6 + 5e-6 * np.sin(2 * np.pi * 50 * time)
    force = np.zeros((1000, 3))
    force[:, 2] = 3e-3
    force[0] = [0.0, 4e-3, 3e-3]
    found = summary(
        dataset(**static_arrays, time=time, normal_displacement=motion, step_time=time, arp_force=force), {"scene": "x"}
    )
    assert found["peak_displacement_vertex"] == 7
    assert found["peak_displacement_m"] == pytest.approx(9e-6)
    assert found["peak_displacement_time_s"] == pytest.approx(0.015)
    assert found["rms_displacement_m"] == pytest.approx(np.sqrt(16 + 12.5) * 1e-6)
    assert found["rms_displacement_without_dc_m"] == pytest.approx(5e-6 / np.sqrt(2))
    assert found["total_force_peak_N"] == pytest.approx(5e-3)
    assert found["total_force_mean_N"] == pytest.approx([0.0, 4e-6, 3e-3])
    assert found["simulated_time_s"] == pytest.approx(0.0999)
    assert found["scene"] == "x"
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_levels_are_rms_over_20_micropascal(static_arrays):
    """1 Pa rms is 94 dB SPL (IEC 61672)."""
    pressure = np.zeros_like(static_arrays["surface_pressure"])
    pressure[3] = np.sqrt(2.0)
    quiet = static_arrays | {"skin_pressure": np.zeros_like(static_arrays["skin_pressure"])}
    found = summary(dataset(**(quiet | {"surface_pressure": pressure})), {})
    assert found["peak_pressure_dB_SPL"] == pytest.approx(93.98, abs=0.005)
    silent = summary(dataset(**(quiet | {"surface_pressure": 0 * pressure})), {})
    assert silent["peak_pressure_dB_SPL"] is None


def test_a_run_without_steps_leaves_motion_out(static):
    found = summary(static, {})
    assert found["skin_vertices"] == 469
    assert not [name for name in found if "displacement" in name or "force" in name or "velocity" in name]
