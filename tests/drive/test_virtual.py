"""Virtual boards: paced as the real line, holding what the real ones hold, with faults in the line."""

import time

import numpy as np
import pytest

from palmfield.drive.boards import BOARDS
from palmfield.drive.ports import open_port
from palmfield.drive.transport import PortLost
from palmfield.drive.virtual import Faults, VirtualBoard
from palmfield.errors import DeviceError

pytestmark = pytest.mark.wall_clock

BOARD = BOARDS["sonicsurface"]
TAKES_BYTES = [board for board in BOARDS.values() if not board.exact]


def sounding(board) -> bytes:
    if board.takes == "focus":
        return board.encode_focus((0.0, 0.0, 0.2), 1.0)
    return board.encode(np.exp(1j * np.arange(board.transducers)))


@pytest.mark.parametrize("by", ["pty", "tcp"])
@pytest.mark.parametrize("board", TAKES_BYTES, ids=lambda board: board.name)
def test_every_board_plays_on_its_virtual_one_and_ends_silent(board, by):
    frame = sounding(board)
    with VirtualBoard(board, by=by) as virtual:
        port = open_port(virtual.port, board.line.baud)
        for data in (board.start, *(4 * [frame]), board.stop):
            assert port.write(data)
        virtual.settle()
        port.close()
        assert bytes(virtual.received) == board.start + 4 * frame + board.stop
        assert virtual.flags == []
        wanted = board.decode(frame)[-1]
        heard = [change for change in virtual.emitted if np.allclose(change.amplitudes, wanted, atol=1e-9)]
        assert len(heard) == 4
        assert not virtual.twin.emitted.any()


def test_bytes_come_as_fast_as_the_line_carries_them():
    frame = sounding(BOARD)
    with VirtualBoard(BOARD) as virtual:
        port = open_port(virtual.port, 230400)
        for _ in range(120):
            port.write(frame)
        virtual.settle()
        times = [change.time_s for change in virtual.emitted]
        port.close()
    assert len(times) == 120
    # 119 frames of 258 bytes after the first one; a look may let 20 ms through at once
    takes_s = 119 * 258 * 10 / 230400
    assert takes_s - 0.02 <= times[-1] - times[0] <= 1.005 * takes_s + 2e-3


def test_a_line_that_idles_saves_up_no_time():
    """A frame on a line that was free sounds a line's time after its first byte, however long nothing came before."""
    frame, late = sounding(BOARD), []
    with VirtualBoard(BOARD) as virtual:
        port = open_port(virtual.port, 230400)
        for _ in range(7):
            time.sleep(0.05)
            before = len(virtual.emitted)
            began = virtual.clock
            port.write(frame)
            virtual.settle(0.03)
            late.append(virtual.emitted[before].time_s - began)
        port.close()
    # Where this machine is busy a look may come too late to know when the bytes came; so the median
    assert np.median(late) > 0.8 * BOARD.frame_time_s


def test_lost_and_turned_bytes_are_those_that_were_asked_for():
    data = bytes(range(256)) * 400
    lost = Faults(drop=0.1).through(data)
    assert len(lost) / len(data) == pytest.approx(0.9, abs=0.005)
    turned = Faults(flip=0.1).through(data)
    different = [a ^ b for a, b in zip(turned, data, strict=True) if a != b]
    assert len(different) / len(data) == pytest.approx(0.1, abs=0.005)
    assert all(bits.bit_count() == 1 for bits in different)
    assert Faults(drop=0.1).through(data) == lost
    assert Faults().through(data) == data
    with pytest.raises(DeviceError, match="drop has value 2; allowed"):
        Faults(drop=2.0)


def test_a_line_that_loses_bytes_never_ends_a_board(tmp_path):
    with VirtualBoard(BOARD, faults=Faults(drop=0.02, flip=0.02)) as virtual:
        port = open_port(virtual.port, 230400)
        for _ in range(60):
            port.write(sounding(BOARD))
        virtual.settle()
        assert len(virtual.received) == 60 * 258 and virtual.emitted
        port.close()


def test_a_stall_holds_bytes_back_and_loses_none():
    with VirtualBoard(BOARD) as virtual:
        port = open_port(virtual.port, 230400)
        virtual.stall()
        for _ in range(5):
            port.write(sounding(BOARD))
        time.sleep(0.15)
        assert not virtual.received
        virtual.stall(False)
        virtual.settle()
        assert len(virtual.received) == 5 * 258
        port.close()


def test_after_an_unplug_writing_says_so_and_the_board_goes_on():
    virtual = VirtualBoard(BOARD)
    port = open_port(virtual.port, 230400)
    port.write(sounding(BOARD))
    virtual.settle()
    virtual.unplug()
    with pytest.raises(PortLost, match=r"connection to .* lost"):
        for _ in range(50):
            port.write(sounding(BOARD))
            time.sleep(0.01)
    assert virtual.twin.emitted.all()
    port.close()


def test_a_port_that_is_taken_is_refused():
    with VirtualBoard(BOARD, by="tcp") as virtual:
        number = int(virtual.port.rpartition(":")[2])
        with pytest.raises(DeviceError, match=f"TCP port {number} cannot be opened"):
            VirtualBoard(BOARD, by="tcp", tcp_port=number)
