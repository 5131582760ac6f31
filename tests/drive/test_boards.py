"""Boards: what they play and refuse, and their bytes against the protocols, written down here a second time."""

import numpy as np
import pytest

from palmfield.acoustics.arrays import layout
from palmfield.config import DriverConfig, allowed
from palmfield.config.driver import SAFETY_KEYS
from palmfield.drive.board import check, control_rate_Hz, play
from palmfield.drive.boards import BOARDS, board_named, board_of
from palmfield.errors import DeviceError

BOARD = BOARDS["sonicsurface"]
IDEAL = BOARDS["ideal"]
OF_AMPLITUDES = [board for board in BOARDS.values() if not board.exact and board.takes == "amplitudes"]
FRAMES = 10_000


def named(board):
    return board.name


def drives(board, count: int, seed: int) -> np.ndarray:
    """Random drives; levels where the board has them, else off and full; shape (count, n)."""
    rng = np.random.default_rng(seed)
    shape = count, board.transducers
    levels = rng.random(shape) if board.levels else rng.random(shape) > 0.1
    return levels * np.exp(2j * np.pi * rng.random(shape))


# -- the protocols, from what is known of them ---------------------------------------------------------------------


def sonicsurface_says(data: bytes) -> np.ndarray:
    """254, 256 bytes, 253: 32 steps, 32 is off; addresses 3, 11, 19, ... come a step late."""
    assert data[0] == 254 and data[-1] == 253 and len(data) == 258
    return np.array(
        [0.0 if byte == 32 else np.exp(2j * np.pi * (byte + (a % 8 == 3)) / 32) for a, byte in enumerate(data[1:-1])]
    )


def pair_says(data: bytes) -> np.ndarray:
    """By place: the vendor's x and z of an address; the downward board's are -z and -x."""
    assert len(data) == 517 and data[:2] == b"\xc0\xfe" and data[258:260] == b"\xc1\xfe" and data[-1] == 253
    first = sonicsurface_says(b"\xfe" + data[2:258] + b"\xfd")
    second = sonicsurface_says(b"\xfe" + data[260:516] + b"\xfd") * np.exp(2j * np.pi * 16.5 / 32)
    places = layout("sonicsurface").positions
    x, z = places[:, 0], -places[:, 1]
    mirrored_x, mirrored_z = -z, -x
    # The upper board's frame is turned by half a turn about x: its y is the other way
    in_frame = np.column_stack([mirrored_x, mirrored_z])
    row = [int(np.argmin(np.hypot(*(places[:, :2] - place).T))) for place in in_frame]
    assert sorted(row) == list(range(256))
    result = np.zeros(512, complex)
    result[:256] = first
    result[256 + np.array(row)] = second
    return result


def tactile_says(data: bytes) -> np.ndarray:
    """16 steps in the upper bits, duty 7/16 against one half."""
    assert len(data) == 258
    level = np.sin(np.pi * 7 / 16)
    return np.array([0.0 if byte == 32 else level * np.exp(2j * np.pi * (byte >> 1) / 16) for byte in data[1:-1]])


# Of DriverMEGA.ino: ports A C L B K F H D G J, ten divisions of a period, pins by the host's table
PORT_OF_SIGNAL = [
    51, 52, 53, 54, 28, 29, 30, 31, 47, 46, 45, 44, 43, 42, 41, 40, 56, 57, 58, 59, 48, 49, 72, 69, 39, 38, 37, 36, 35,
    34, 33, 32, 21, 23, 65, 63, 9, 11, 13, 15, 20, 22, 64, 66, 8, 10, 12, 14, 24, 25, 26, 27, 16, 17, 18, 19, 7, 6, 5,
    4, 3, 2, 1, 0,
]  # fmt: skip


def ultraino_says(data: bytes) -> np.ndarray:
    """Fourier sum of what each pin does in the ten divisions, against a half that is high from the first one on."""
    assert len(data) == 210 and data[-2:] == b"\x10\x00"
    durations = data[200:208]
    assert [sum(((durations[4 * i + j] >> 6) << (6 - 2 * j)) for j in range(4)) for i in range(2)] == [1, 0]
    assert all(byte & 0x0F == 1 for byte in data[:200])
    memory = [(data[2 * i] & 0xF0) | (data[2 * i + 1] >> 4) for i in range(100)]
    full = sum(np.exp(2j * np.pi * d / 10) for d in range(5))
    result = []
    for pin in PORT_OF_SIGNAL:
        levels = [(memory[10 * d + pin // 8] >> (pin % 8)) & 1 for d in range(10)]
        result.append(sum(level * np.exp(2j * np.pi * d / 10) for d, level in enumerate(levels)) / full)
    return np.array(result)


def openmpd_says(data: bytes) -> np.ndarray:
    """A pulse from its phase on, of 128ths of a period; 64 is full."""
    assert len(data) == 512 and data[0] >= 128 and max(data[1:]) < 128
    result = []
    for phase, width in zip(data[:256], data[256:], strict=True):
        samples = [np.exp(2j * np.pi * (phase % 128 + n + 0.5) / 128) for n in range(width)]
        result.append(sum(samples) / abs(sum(np.exp(2j * np.pi * n / 128) for n in range(64))))
    return np.array(result) * np.exp(-2j * np.pi * 32 / 128)


def autd3_says(data: bytes) -> np.ndarray:
    assert len(data) == 498
    phase, intensity = np.frombuffer(data, np.uint8).reshape(2, 249).astype(float)
    width = np.round(512 * np.arcsin(intensity / 255) / np.pi)
    return np.sin(np.pi * width / 512) * np.exp(2j * np.pi * phase / 256)


SAYS = {
    "sonicsurface": sonicsurface_says,
    "sonicsurface_pair": pair_says,
    "sonicsurface_tactile": tactile_says,
    "ultraino": ultraino_says,
    "openmpd": openmpd_says,
    "autd3": autd3_says,
}


def test_every_board_that_takes_amplitudes_is_held_against_its_protocol():
    assert set(SAYS) == {board.name for board in OF_AMPLITUDES}


@pytest.mark.parametrize("board", OF_AMPLITUDES, ids=named)
def test_what_is_decoded_is_what_the_protocol_says(board):
    for drive in drives(board, 20, 1):
        data = board.encode(drive)
        np.testing.assert_allclose(board.decode(data)[-1], SAYS[board.name](data), atol=1e-9)


@pytest.mark.parametrize("board", OF_AMPLITUDES, ids=named)
def test_what_is_emitted_is_what_was_asked_to_the_boards_steps(board):
    full = np.sin(np.pi * 7 / 16) if board.name == "sonicsurface_tactile" else 1.0
    for drive in drives(board, 20, 2):
        emitted = board.decode(board.encode(drive))[-1] / full
        on = np.abs(emitted) > 0
        turns = np.abs(np.angle(emitted[on] / drive[on])) / (2 * np.pi)
        assert turns.max() <= 0.5 / board.phase_steps * (1 + 1e-9)
        if not board.levels:
            np.testing.assert_array_equal(on, drive != 0)
        else:
            # Rounding of the pulse width: its derivative is at most pi/2 over the steps to half a period
            step = {"autd3": 256}.get(board.name, board.amplitude_steps)
            worst = 0.5 * np.pi / 2 / step + (1.0 / 255 if board.name == "autd3" else 0.0)
            assert np.abs(np.abs(emitted) - np.abs(drive)).max() <= worst * (1 + 1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize("board", OF_AMPLITUDES, ids=named)
def test_ten_thousand_random_frames_come_back_exactly(board):
    """One twin takes them all; a frame made of what it emits is the same frame."""
    twin = board.twin()
    twin.feed(board.start)
    twin.until(twin.time_s + 0.1)
    full = np.sin(np.pi * 7 / 16) if board.name == "sonicsurface_tactile" else 1.0
    for seed in range(FRAMES // 500):
        for drive in drives(board, 500, 100 + seed):
            data = board.encode(drive)
            changes = [*twin.feed(data), *twin.until(twin.time_s + 0.1)]
            assert len(changes) == 1
            assert board.encode(changes[0].amplitudes / full) == data
    assert twin.flags == []


def test_ten_thousand_random_packets_of_a_focus_come_back_exactly():
    board = BOARDS["autd2018"]
    rng = np.random.default_rng(3)
    steps = rng.integers(-32767, 32768, (FRAMES, 3))
    levels = rng.random(FRAMES)
    for numbers, level in zip(steps, levels, strict=True):
        packet = board.encode_focus(0.025e-3 * numbers, level)
        bits = format(int.from_bytes(packet, "big"), "072b")
        assert len(packet) == 9 and bits.startswith("10100101") and bits.endswith("1011010")
        said = [int(bits[8 + 16 * i : 24 + 16 * i], 2) for i in range(3)]
        assert [value - 65536 if value > 32767 else value for value in said] == numbers.tolist()
        # p = sin(pi d), d in ticks of a period's 640
        width = int(bits[56:65], 2)
        assert width == round(640 * np.arcsin(level) / np.pi)
        assert board.numbers(packet) == (*numbers.tolist(), width)


@pytest.mark.parametrize("name", ["autd2018", "autd2018_2x2"])
def test_units_place_the_focus_that_a_packet_tells(name):
    array = layout(name)
    board = BOARDS["autd2018"].sized(len(array))
    focus = np.array([0.01, -0.02, 0.25])
    emitted = board.decode(board.encode_focus(focus, 0.6))[-1]
    distance = np.linalg.norm(array.positions - focus, axis=1)
    turn = np.angle(emitted * np.exp(2j * np.pi * 40e3 / board.board_sound_speed_m_s * distance))
    # Half a tick of 640, and hops of 40 ns
    assert np.abs(turn).max() < 2 * np.pi * (0.5 / 640 + 40e3 * 40e-9) * 1.001
    np.testing.assert_allclose(np.abs(emitted), 0.6, atol=np.pi / 2 / 640)


def test_packets_with_other_keys_are_read_with_them_only():
    driver = DriverConfig(
        board="autd2018", packet_header="111", packet_footer="0", packet_bit_order="lsb_first", packet_lsb_m=1e-4
    )
    board = board_of(driver, 249)
    packet = board.encode_focus((0.01, -0.02, 0.2), 1.0)
    bits = format(int.from_bytes(packet, "big"), f"0{8 * len(packet)}b")
    assert bits[3:19][::-1] == format(100, "016b") and bits[35:51][::-1] == format(2000, "016b")
    assert board.decode(packet)[-1].any()
    twin = BOARDS["autd2018"].twin()
    assert twin.feed(packet * 3) == [] and not twin.emitted.any()


def test_a_line_that_carries_no_2000_packets_a_second_is_refused():
    with pytest.raises(DeviceError, match="packet_baud has value 115200; allowed: at least 180000, for 2000"):
        board_of(DriverConfig(board="autd2018", packet_baud=115200), 249)
    board = board_of(DriverConfig(board="autd2018", packet_baud=1_000_000), 249)
    assert board.frame_time_s == pytest.approx(90e-6) and board.twin().byte_s == pytest.approx(1e-5)


def test_without_sync_units_drift_apart_and_with_it_they_do_not():
    keys = {"clock_drift_ppm": 20.0, "skew_s": 1e-6}
    for sync in ("on", "off"):
        board = BOARDS["autd2018"].with_keys({**keys, "sync": sync}).sized(996)
        twin = board.twin()
        twin.feed(board.encode_focus((0.0, 0.0, 0.4), 1.0))
        early, late = twin.at(0.0), twin.at(1.0)
        apart = np.abs(np.angle(late / early)).max()
        assert (apart > 1.0) == (sync == "off")


def test_an_exponent_changes_the_pulse_and_not_the_level():
    board = BOARDS["autd2018"].with_keys({"duty_exponent": 1.5})
    packet = board.encode_focus((0.0, 0.0, 0.2), 0.5)
    width = board.numbers(packet)[3]
    # sin(pi d)^0.75 = 0.5
    assert width == round(640 / np.pi * np.arcsin(0.5 ** (1 / 0.75)))
    np.testing.assert_allclose(np.abs(board.decode(packet)[-1]), 0.5, atol=3e-3)


# -- what the twins do with bytes that are not as they should be ----------------------------------------------------


@pytest.mark.parametrize("board", [b for b in BOARDS.values() if not b.exact], ids=named)
def test_a_twin_takes_any_bytes_in_pieces_of_any_size_and_stops_when_told(board):
    rng = np.random.default_rng(4)
    noise = rng.integers(0, 256, 20_000, dtype=np.uint8).tobytes()
    whole, pieces = board.twin(), board.twin()
    changes = [*whole.feed(noise, 0.0), *whole.until(100.0)]
    parts, at = [], 0
    for size in rng.integers(1, 700, 200):
        parts += pieces.feed(noise[at : at + size])
        at += int(size)
    parts += [*pieces.feed(noise[at:]), *pieces.until(100.0)]
    assert len(parts) == len(changes)
    for one, other in zip(parts, changes, strict=True):
        assert one.time_s == pytest.approx(other.time_s, abs=1e-9)
        np.testing.assert_allclose(one.amplitudes, other.amplitudes, atol=1e-12)
    whole.feed(b"\x00" * 2 + board.stop * 3)
    whole.until(whole.time_s + 0.1)
    assert not whole.emitted.any()


def test_more_frames_than_openmpd_holds_back_are_flagged():
    board = BOARDS["openmpd"]
    twin = board.twin()
    twin.byte_s = 1e-9  # as fast as the board's own USB, not as the serial line
    changes = twin.feed(board.encode(np.ones(256)) * 40)
    assert [flag.kind for flag in twin.flags] == ["overrun"] * len(twin.flags) and twin.flags
    changes += twin.until(1.0)
    np.testing.assert_allclose(np.diff([change.time_s for change in changes]), 1e-4, rtol=1e-6)


def test_autd3_falls_silent_by_itself():
    board = BOARDS["autd3"]
    twin = board.twin()
    twin.feed(board.encode(np.ones(249)), 0.0)
    assert twin.until(0.3) == [] and twin.emitted.all()
    (change,) = twin.until(0.6)
    assert not change.amplitudes.any() and change.time_s == pytest.approx(0.501, abs=1e-6)


def test_tactile_firmware_is_silent_at_power_up_and_takes_its_rate():
    board = BOARDS["sonicsurface_tactile"]
    twin = board.twin()
    assert not twin.emitted.any() and twin.envelope_Hz == pytest.approx(113.6, abs=0.1)
    twin.feed(bytes([160 + 4]))
    assert twin.envelope_Hz == 250.0


# -- limits ----------------------------------------------------------------------------------------------------------


def test_the_ideal_board_plays_anything():
    asked = np.array([0.3 + 0.1j, 0, 1, -2j])
    played = play(IDEAL, asked)
    np.testing.assert_array_equal(played, asked)
    played[0] = 0
    assert asked[0] != 0
    check(IDEAL, frame_rate_Hz=1e6, points_per_turn=1e4, modulated=True, element="any", modulation_Hz=1e6)


def test_the_board_plays_no_amplitude_between():
    with pytest.raises(DeviceError, match="50 % duty"):
        play(BOARD, np.full(256, 0.4))


@pytest.mark.parametrize("level", [0.1, 0.25, 0.5, 0.9])
def test_dithering_has_as_large_a_share_on_everywhere(level):
    board = BOARD.with_keys({"dither": True})
    on = np.abs(play(board, np.full(256, level))) > 0
    assert on.mean() == pytest.approx(level, abs=1 / 256)
    # Every quarter of the array takes part
    places = layout("sonicsurface").positions
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        quarter = (x * places[:, 0] > 0) & (y * places[:, 1] > 0)
        assert on[quarter].mean() == pytest.approx(level, abs=0.08)


def test_an_unknown_board():
    with pytest.raises(DeviceError, match=f"'toaster' is unknown; allowed: {', '.join(BOARDS)}"):
        board_named("toaster")


def test_the_scenes_key_takes_the_boards_that_there_are():
    assert allowed(DriverConfig, "board").split(" | ") == [board.name for board in BOARDS.values()] == list(BOARDS)
    keys = set(DriverConfig.model_fields) - {"board", "compensate", *SAFETY_KEYS}
    assert keys == {key for board in BOARDS.values() for key in board.keys}


def test_a_key_of_another_board_is_refused():
    with pytest.raises(DeviceError, match="board 'sonicsurface' has no packet_lsb_m; it has dither") as caught:
        board_of(DriverConfig(board="sonicsurface", packet_lsb_m=1e-3), 256)
    assert caught.value.setting == "packet_lsb_m"


@pytest.mark.parametrize(
    ("name", "count", "words"),
    [("sonicsurface", 249, "allowed: 256"), ("autd3", 250, "allowed: 249 to 1992"), ("autd2018", 498, "996")],
)
def test_another_number_of_transducers_is_refused(name, count, words):
    with pytest.raises(DeviceError, match=words):
        board_named(name).sized(count)


def test_silence_in_bytes_is_silence():
    for board in BOARDS.values():
        if board.takes == "focus":
            assert not board.decode(board.encode_focus((0.0, 0.0, 0.1), 0.0))[-1].any()
        elif not board.exact:
            assert not board.decode(board.encode(np.zeros(board.transducers)))[-1].any()
        if not board.exact:
            assert not board.decode(board.start)[-1].any() and not board.decode(board.stop)[-1].any()
            assert board.when_host_dies and board.cannot_guarantee


def test_rates_are_those_of_bytes_on_the_line():
    rates = {board.name: board.max_frame_rate_Hz for board in BOARDS.values()}
    # Bits of a start, 8 data and a stop, for the bytes of a frame
    assert rates["sonicsurface"] == pytest.approx(230400 / 10 / 258)
    assert rates["sonicsurface_pair"] == pytest.approx(44.6, abs=0.05)
    assert rates["ultraino"] == pytest.approx(115200 / 10 / 210)
    assert rates["openmpd"] == pytest.approx(250000 / 10 / 512)
    assert control_rate_Hz(BOARD, 0.001) == pytest.approx(1000 / 12)
    assert control_rate_Hz(BOARDS["autd2018"], 0.001) == 2000


def test_a_still_focus_and_a_slow_path_fit_the_board():
    check(BOARD, frame_rate_Hz=0.0, modulated=False, element="still")
    check(BOARD, frame_rate_Hz=89.0, points_per_turn=8, modulated=False, element="slow")


def test_modulation_is_refused_with_both_sides_said():
    with pytest.raises(DeviceError) as refusal:
        check(BOARD, frame_rate_Hz=0.0, modulated=True, element="am", modulation_Hz=200.0)
    message = str(refusal.value)
    assert "stimulus 'am' needs continuous amplitude at 400 frames/s (200 Hz, two frames per period)" in message
    assert "sonicsurface gives on/off amplitude at 89.3 frames/s" in message
    assert "44.7 Hz" in message
    assert "board ideal" in message
    assert "\n" not in message


def test_a_fast_circle_is_refused_with_the_points_that_are_left():
    with pytest.raises(DeviceError) as refusal:
        check(BOARD, frame_rate_Hz=3500.0, points_per_turn=50, modulated=False, element="circle")
    # 89.3 frames/s over 70 turns/s
    assert "1.3 points per turn" in str(refusal.value)
    assert "continuous" not in str(refusal.value)


def test_a_pulsed_device_of_any_rate_still_refuses_amplitude():
    with pytest.raises(DeviceError, match="continuous amplitude"):
        check(BOARD, frame_rate_Hz=10.0, modulated=True, element="slow am")
