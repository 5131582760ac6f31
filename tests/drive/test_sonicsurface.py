"""Bytes to the SonicSurface and what it emits, held against the protocol's arithmetic and free-field sums."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from palmfield.acoustics.arrays import layout
from palmfield.drive.boards.sonicsurface import (
    BOARD,
    FRAME_BYTES,
    FRAME_RATE_HZ,
    LINE,
    OFF_FRAME,
    OFF_SEQUENCE,
    SonicSurfaceTwin,
)
from palmfield.errors import DeviceError

HALF_STEP = np.pi / 32
QUIET = np.zeros(256, dtype=complex)
phases = arrays(np.float64, 256, elements=st.floats(-20, 20, allow_subnormal=True))


def encode(amplitudes: np.ndarray) -> bytes:
    return BOARD.encode(amplitudes)


def decode(data: bytes) -> list[np.ndarray]:
    return BOARD.decode(data)


def fed(board: SonicSurfaceTwin, data: bytes) -> list[np.ndarray]:
    return [change.amplitudes for change in board.feed(data)]


def lagging() -> np.ndarray:
    return np.arange(256) % 8 == 3


def test_frame_arithmetic():
    assert FRAME_BYTES == 258
    assert LINE.baud == 230400
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
def test_an_amplitude_that_cannot_be_sent_is_refused(amplitude):
    wanted = np.ones(256, dtype=complex)
    wanted[17] = amplitude
    with pytest.raises(DeviceError, match=r"transducer 17 .* (fixed 50 % duty|allowed: 0 \(off\) to 1)"):
        encode(wanted)


@pytest.mark.parametrize("shape", [(255,), (256, 1), ()])
def test_a_frame_of_another_shape_is_refused(shape):
    with pytest.raises(DeviceError, match="shape"):
        encode(np.ones(shape))


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
    assert fed(board, encode(np.full(256, -1))[:-1]) == []
    np.testing.assert_array_equal(board.emitted, before)
    assert len(fed(board, b"\xfd")) == 1


def test_a_short_frame_leaves_the_phases_of_two_frames_before():
    board = SonicSurfaceTwin()
    for phase in (1j, -1):
        fed(board, encode(np.full(256, phase)))
    short = encode(np.full(256, -1j))
    (emitted,) = fed(board, short[:101] + b"\xfd")
    np.testing.assert_allclose(emitted[:100], -1j, atol=1e-12)
    np.testing.assert_allclose(emitted[100:], 1j, atol=1e-12)


def test_one_off_frame_is_undone_by_a_stray_swap_and_two_are_not():
    once, twice = SonicSurfaceTwin(), SonicSurfaceTwin()
    fed(once, OFF_FRAME)
    fed(twice, OFF_FRAME + OFF_FRAME)
    np.testing.assert_array_equal(once.emitted, QUIET)
    fed(once, b"\xfd")
    fed(twice, b"\xfd")
    np.testing.assert_allclose(np.abs(once.emitted), 1.0)
    np.testing.assert_array_equal(twice.emitted, QUIET)


@given(st.integers(0, 257))
def test_a_start_byte_recovers_from_a_frame_cut_anywhere(cut):
    board = SonicSurfaceTwin()
    fed(board, encode(np.full(256, -1))[:cut])
    wanted = np.exp(2j * np.pi * np.arange(256) / 32)
    np.testing.assert_allclose(fed(board, encode(wanted))[-1], wanted, atol=1e-12)


def test_bytes_fed_one_by_one_do_the_same():
    stream = encode(np.full(256, 1j)) + OFF_FRAME + encode(np.full(256, -1))
    board = SonicSurfaceTwin()
    single = [frame for byte in stream for frame in fed(board, bytes([byte]))]
    np.testing.assert_array_equal(single, decode(stream))


def test_stopped_clocks_make_no_ultrasound_and_keep_the_frame():
    board = SonicSurfaceTwin()
    wanted = np.full(256, 1j)
    (quiet,) = fed(board, b"\x96")
    np.testing.assert_array_equal(quiet, QUIET)
    fed(board, encode(wanted))
    np.testing.assert_array_equal(board.emitted, QUIET)
    (emitted,) = fed(board, b"\x97")
    np.testing.assert_allclose(emitted, wanted, atol=1e-12)


def test_two_boards_on_one_line():
    left, right = np.full(256, 1j), np.full(256, -1)
    stream = b"\xc0" + encode(left)[1:-1] + b"\xc1" + encode(right)[1:-1] + b"\xfd"
    assert len(stream) == 515
    primary, secondary = SonicSurfaceTwin(), SonicSurfaceTwin(secondary=True)
    np.testing.assert_allclose(fed(primary, stream)[-1], left, atol=1e-12)
    # 16.5 of 32 steps late
    np.testing.assert_allclose(fed(secondary, stream)[-1], right * np.exp(2j * np.pi * 16.5 / 32), atol=1e-12)


def test_only_32_is_off_and_other_bytes_are_phases_modulo_32():
    (emitted,) = fed(SonicSurfaceTwin(), b"\xfe" + bytes([40]) * 256 + b"\xfd")
    np.testing.assert_allclose(emitted[~lagging()], 1j, atol=1e-12)


def test_too_much_data_is_flagged_where_the_board_is_undefined_and_the_next_frame_counts():
    board = SonicSurfaceTwin()
    assert fed(board, b"\xfe" + bytes(257)) == []
    assert [flag.kind for flag in board.flags] == ["overrun"]
    np.testing.assert_allclose(fed(board, encode(np.full(256, 1j)))[-1], 1j, atol=1e-12)


def test_start_and_stop_are_byte_for_byte_the_sequence_that_ends_any_state():
    wanted = 2 * (bytes([151, 192, 254]) + 256 * bytes([32]) + bytes([253]))
    assert BOARD.start == BOARD.stop == OFF_SEQUENCE == wanted


@pytest.mark.parametrize("left", [b"\xc1", b"\x96", b"\x96\xc1", b"\xfe" + bytes(100), b"\xc1\xfe" + bytes(300)])
def test_the_stop_sequence_silences_whatever_a_program_left_behind(left):
    board = SonicSurfaceTwin()
    fed(board, encode(np.full(256, 1j)) + left)
    fed(board, BOARD.stop)
    np.testing.assert_array_equal(board.emitted, QUIET)
    fed(board, b"\xfd")
    np.testing.assert_array_equal(board.emitted, QUIET)
    fed(board, encode(np.ones(256)))
    np.testing.assert_allclose(board.emitted, 1.0, atol=1e-12)


def test_stopped_clocks_leave_dc_on_about_half_of_the_pins():
    rng = np.random.default_rng(0)
    board = SonicSurfaceTwin()
    fed(board, encode(np.exp(2j * np.pi * rng.random(256))) + b"\x96")
    assert 96 < board.pins_high.sum() < 160
    assert board.flags[-1].kind == "dc" and f"{board.pins_high.sum()} of 256 pins" in board.flags[-1].text
    fed(board, b"\x97")
    assert not board.pins_high.any()


def test_changes_carry_the_time_of_their_last_byte_on_the_line():
    (change,) = SonicSurfaceTwin().feed(encode(np.full(256, 1j)), 0.5)
    assert change.time_s == pytest.approx(0.5 + 258 * 10 / 230400, rel=1e-12)
