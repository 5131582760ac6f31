"""Our AUTD3 bytes in AUTD3's own emulator against our field of what the codec says they emit."""

from dataclasses import replace

import numpy as np
import pytest

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.reference import pressure64
from palmfield.drive.boards import BOARDS
from palmfield.types import Air

SPEED_M_S = 340.0


def test_the_emulator_emits_what_the_codec_says():
    pytest.importorskip("autd3", reason="the extra [autd3] is not installed: pip install 'palmfield[autd3]'")
    pytest.importorskip(
        "autd3_emulator", reason="the emulator of AUTD3 is not installed: pip install 'palmfield[autd3]'"
    )
    import field_peers as peers

    array = layout("autd3")
    rng = np.random.default_rng(0)
    focus = np.array([0.01, -0.02, 0.19])
    distance = np.linalg.norm(array.positions - focus, axis=1)
    asked = rng.random(249) * np.exp(-2j * np.pi * 40e3 / SPEED_M_S * distance)
    board = BOARDS["autd3"]
    data = np.frombuffer(board.encode(asked), np.uint8).reshape(2, 249)
    record = peers.emulator_record(peers.emulator_geometry(array.positions - array.positions[0]), data[0], data[1], 1)
    low, steps, resolution = focus - array.positions[0] - 0.01, np.array([6, 6, 6]), 0.004
    field = peers.emulator_field(record, low, steps, resolution, SPEED_M_S)
    theirs = peers.emulator_next(field)
    points = 1e-3 * field.observe_points().to_numpy().astype(float) + array.positions[0]
    point_sources = replace(array, p0_Pa_m=peers.EMULATOR_P0_PA_M, piston_radius_m=0.0, directivity_table=None)
    air = _air_of(SPEED_M_S)
    ours, _ = pressure64(points, point_sources, board.decode(data.tobytes())[-1], air, absorption_Np_m=0.0)
    assert np.abs(np.abs(ours) - theirs).max() / theirs.max() < 1e-5
    # The same bytes as intensities that nobody has rounded to pulse widths miss by more
    intensity = np.abs(asked) * np.exp(2j * np.pi * data[0] / 256.0)
    other, _ = pressure64(points, point_sources, intensity, air, absorption_Np_m=0.0)
    assert np.abs(np.abs(other) - theirs).max() / theirs.max() > 1e-5


def test_what_directivity_air_and_p0_change_beside_the_emulators_point_sources():
    """The emulator has monopoles of 4.386 Pa m in lossless air: a real unit is quieter at the focus."""
    array = layout("autd3")
    focus = np.array([0.0, 0.0, 0.1])
    drive = np.exp(-2j * np.pi * 40e3 / 343.2 * np.linalg.norm(array.positions - focus, axis=1))
    real, _ = pressure64(focus[None], array, drive, Air())
    points = replace(array, piston_radius_m=0.0, directivity_table=None)
    bare, _ = pressure64(focus[None], points, drive, Air(), absorption_Np_m=0.0)
    assert 0.61 < abs(real[0] / bare[0]) < 0.86
    assert pytest.approx(3.0, abs=0.01) == (4.386 / 2.53) ** 2


def _air_of(speed_m_s: float) -> Air:
    """Air in which sound travels at a speed [m/s]."""
    from scipy.optimize import brentq

    from palmfield.acoustics.air import sound_speed

    return Air(temperature_C=brentq(lambda t: sound_speed(Air(temperature_C=t)) - speed_m_s, -20.0, 50.0))
