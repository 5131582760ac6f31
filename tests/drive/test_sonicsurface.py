"""Bytes to the SonicSurface and what it emits, held against the protocol's arithmetic and free-field sums."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from palmfield.acoustics.arrays import layout
from palmfield.drive.boards.sonicsurface import (
    BAUD,
    FRAME_BYTES,
    FRAME_RATE_HZ,
    OFF_FRAME,
    Calibration,
    SonicSurfaceTwin,
    decode,
    encode,
)
from palmfield.errors import DeviceError

HALF_STEP = np.pi / 32
QUIET = np.zeros(256, dtype=complex)
phases = arrays(np.float64, 256, elements=st.floats(-20, 20, allow_subnormal=True))


def lagging() -> np.ndarray:
    return np.arange(256) % 8 == 3


def test_frame_arithmetic():
    assert FRAME_BYTES == 258
    assert BAUD == 230400
    # 258 bytes of 10 bits at 230400 bit/s take 11.198 ms
    frame_time_ms = 1e3 / FRAME_RATE_HZ
    assert frame_time_ms == pytest.approx(11.198, abs=5e-4)
    assert OFF_FRAME == b"\xfe" + 256 * b"\x20" + b"\xfd"


@given(phases)
def test_what_is_emitted_is_within_half_a_step_of_what_was_asked_lag_included(phase):
    emitted = decode(encode(np.exp(1j * phase)))[-1]
    np.testing.assert_allclose(np.abs(emitted), 1.0)
    error = np.angle(emitted * np.exp(-1j * phase))
    assert np.abs(error).max() <= HALF_STEP * (1 + 1e-9)


@given(
    phases,
    arrays(np.float64, 256, elements=st.sampled_from([-1.0, 1.0])),
    arrays(np.float64, 256, elements=st.floats(-4, 4)),
)
def test_a_calibrated_board_emits_what_was_asked(phase, polarity, residual):
    calibration = Calibration(polarity, residual)
    emitted = decode(encode(np.exp(1j * phase), calibration), calibration)[-1]
    assert np.abs(np.angle(emitted * np.exp(-1j * phase))).max() <= HALF_STEP * (1 + 1e-9)


def test_an_inverted_transducer_without_calibration_is_half_a_turn_off():
    polarity = np.ones(256)
    polarity[7] = -1
    emitted = decode(encode(np.ones(256)), Calibration(polarity, np.zeros(256)))[-1]
    np.testing.assert_allclose(emitted[7], -1)
    np.testing.assert_allclose(np.delete(emitted, 7), 1)


def test_bytes_of_a_quarter_turn():
    frame = encode(np.full(256, 1j))
    data = np.frombuffer(frame[1:-1], dtype=np.uint8)
    assert frame[0] == 254
    assert frame[-1] == 253
    assert len(frame) == 258
    assert set(data[lagging()]) == {7}
    assert set(data[~lagging()]) == {8}


@pytest.mark.parametrize("phase", [-1e-17, -1e-300, 0.0, 1e-17, -HALF_STEP / 2, 2 * np.pi - 1e-12])
def test_a_phase_that_rounds_to_a_whole_turn_is_not_off(phase):
    frame = encode(np.full(256, np.exp(1j * phase)))
    data = np.frombuffer(frame[1:-1], dtype=np.uint8)
    assert set(data[~lagging()]) == {0}
    assert set(data[lagging()]) == {31}
    np.testing.assert_allclose(decode(frame)[-1], 1.0)


def test_minus_nothing_in_the_imaginary_part_is_not_off():
    frame = encode(np.full(256, complex(1.0, -1e-17)))
    assert 32 not in frame


def test_zero_is_off_and_the_rest_plays():
    wanted = np.ones(256, dtype=np.complex64)
    wanted[[0, 3, 255]] = 0
    frame = encode(wanted)
    assert [frame[1 + address] for address in (0, 3, 255)] == [32, 32, 32]
    np.testing.assert_allclose(decode(frame)[-1], wanted, atol=1e-12)
    assert encode(QUIET) == OFF_FRAME


@pytest.mark.parametrize("amplitude", [0.5, 1.01, 0.999, float("nan"), float("inf")])
def test_an_amplitude_is_refused_and_the_duty_named(amplitude):
    wanted = np.ones(256, dtype=complex)
    wanted[17] = amplitude
    with pytest.raises(DeviceError, match=r"emitter 17 .* fixed 50 % duty"):
        encode(wanted)


@pytest.mark.parametrize("shape", [(255,), (256, 1), ()])
def test_a_frame_of_another_shape_is_refused(shape):
    with pytest.raises(DeviceError, match="shape"):
        encode(np.ones(shape))


@pytest.mark.parametrize(
    ("polarity", "phase"),
    [(np.ones(255), np.zeros(256)), (np.zeros(256), np.zeros(256)), (np.ones(256), np.full(256, np.nan))],
)
def test_a_calibration_that_makes_no_sense_is_refused(polarity, phase):
    with pytest.raises(DeviceError, match="calibration"):
        Calibration(polarity, phase)


def test_focus_off_axis():
    """Monopoles at the board's places, focus off axis: what the 32 phases and the lag leave of the asked pressure."""
    places = layout("sonicsurface").positions
    wave_number = 2 * np.pi * 40e3 / 343.2
    distance = np.linalg.norm(places - [0.05, -0.02, 0.15], axis=1)
    asked = np.exp(-1j * wave_number * distance)
    emitted = decode(encode(asked))[-1]

    def at_focus(amplitude):
        return abs(np.sum(amplitude * np.exp(1j * wave_number * distance) / distance))

    kept = at_focus(emitted) / at_focus(asked)
    # Phase errors spread evenly over +-half a step leave sinc(1/32) of the peak.
    assert kept == pytest.approx(np.sinc(1 / 32), abs=1e-3)
    error = np.angle(emitted / asked)
    assert error.std() == pytest.approx(2 * HALF_STEP / np.sqrt(12), rel=0.1)
    assert abs(error[lagging()].mean() - error[~lagging()].mean()) < HALF_STEP / 3


def test_at_power_up_every_emitter_sounds_with_only_the_lag():
    emitted = SonicSurfaceTwin().emitted
    np.testing.assert_allclose(emitted[~lagging()], 1.0)
    np.testing.assert_allclose(np.angle(emitted[lagging()]), np.deg2rad(11.25))


def test_nothing_changes_before_the_swap():
    board = SonicSurfaceTwin()
    before = board.emitted
    assert board.feed(encode(np.full(256, -1))[:-1]) == []
    np.testing.assert_array_equal(board.emitted, before)
    assert len(board.feed(b"\xfd")) == 1


def test_a_short_frame_leaves_the_phases_of_two_frames_before():
    board = SonicSurfaceTwin()
    for phase in (1j, -1):
        board.feed(encode(np.full(256, phase)))
    short = encode(np.full(256, -1j))
    (emitted,) = board.feed(short[:101] + b"\xfd")
    np.testing.assert_allclose(emitted[:100], -1j, atol=1e-12)
    np.testing.assert_allclose(emitted[100:], 1j, atol=1e-12)


def test_one_off_frame_is_undone_by_a_stray_swap_and_two_are_not():
    once, twice = SonicSurfaceTwin(), SonicSurfaceTwin()
    once.feed(OFF_FRAME)
    twice.feed(OFF_FRAME + OFF_FRAME)
    np.testing.assert_array_equal(once.emitted, QUIET)
    once.feed(b"\xfd")
    twice.feed(b"\xfd")
    np.testing.assert_allclose(np.abs(once.emitted), 1.0)
    np.testing.assert_array_equal(twice.emitted, QUIET)


@given(st.integers(0, 257))
def test_a_start_byte_recovers_from_a_frame_cut_anywhere(cut):
    board = SonicSurfaceTwin()
    board.feed(encode(np.full(256, -1))[:cut])
    wanted = np.exp(2j * np.pi * np.arange(256) / 32)
    np.testing.assert_allclose(board.feed(encode(wanted))[-1], wanted, atol=1e-12)


def test_bytes_fed_one_by_one_do_the_same():
    stream = encode(np.full(256, 1j)) + OFF_FRAME + encode(np.full(256, -1))
    board = SonicSurfaceTwin()
    single = [frame for byte in stream for frame in board.feed(bytes([byte]))]
    np.testing.assert_array_equal(single, decode(stream))


def test_stopped_clocks_make_no_ultrasound_and_keep_the_frame():
    board = SonicSurfaceTwin()
    wanted = np.full(256, 1j)
    (quiet,) = board.feed(b"\x96")
    np.testing.assert_array_equal(quiet, QUIET)
    board.feed(encode(wanted))
    np.testing.assert_array_equal(board.emitted, QUIET)
    (emitted,) = board.feed(b"\x97")
    np.testing.assert_allclose(emitted, wanted, atol=1e-12)


def test_two_boards_on_one_line():
    left, right = np.full(256, 1j), np.full(256, -1)
    stream = b"\xc0" + encode(left)[1:-1] + b"\xc1" + encode(right)[1:-1] + b"\xfd"
    assert len(stream) == 515
    primary, secondary = SonicSurfaceTwin(), SonicSurfaceTwin(secondary=True)
    np.testing.assert_allclose(primary.feed(stream)[-1], left, atol=1e-12)
    # 16.5 of 32 steps late
    np.testing.assert_allclose(secondary.feed(stream)[-1], right * np.exp(2j * np.pi * 16.5 / 32), atol=1e-12)


def test_only_32_is_off_and_other_bytes_are_phases_modulo_32():
    (emitted,) = SonicSurfaceTwin().feed(b"\xfe" + bytes([40]) * 256 + b"\xfd")
    np.testing.assert_allclose(emitted[~lagging()], 1j, atol=1e-12)


def test_too_much_data_is_refused_where_the_board_is_undefined():
    with pytest.raises(DeviceError, match="more than 256"):
        SonicSurfaceTwin().feed(b"\xfe" + bytes(257))
