"""Sound the transducers one after the other, for the microphone of a calibration (docs/calibration.md)."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from palmfield.acoustics.arrays import LAYOUTS
from palmfield.drive.board import Board
from palmfield.drive.boards import playable_board
from palmfield.drive.frame_log import LogHead
from palmfield.drive.limits import SoundLimits
from palmfield.drive.playback import REFRESH_S, TimedFrame
from palmfield.errors import DeviceError, SceneError
from palmfield.hardware.play import Performance, Target, send
from palmfield.tables import write_table

LONGEST_S = 60.0


def sound_one_by_one(
    board: str,
    target: Target,
    times: Path,
    *,
    elements: Sequence[int] | None = None,
    dwell_s: float = 0.5,
    pause_s: float = 0.2,
    progress: bool = False,
) -> Performance:
    """Sound single transducers of a board at full drive and phase 0, as wired, and write their times to a table.

    times: path of the CSV table with columns `element`, `from_s`, `to_s` (times since the first frame) and
        `layout_version`
    elements: numbers in the order of the layout, each once; None: all transducers of one unit
    dwell_s, pause_s: duration of each sound, and of the silence before it [s]
    Raises DeviceError for a board without amplitude control, and for a lost board. Raises SceneError for an unknown
    transducer, and for times that are not above 0. Raises OutputError if the table cannot be written.
    """
    chosen = playable_board(board)
    if chosen.takes != "amplitudes":
        raise DeviceError(f"board '{board}' takes a focus, so single transducers cannot be driven; use another board")
    head = LogHead(board, chosen.unit, chosen.layouts[0])
    chosen = head.playable
    numbers = list(range(chosen.transducers)) if elements is None else list(elements)
    for number in numbers:
        if not 0 <= number < chosen.transducers:
            raise SceneError(
                f"element {number} does not exist on board '{board}'; allowed: 0 to {chosen.transducers - 1}"
            )
    if len(set(numbers)) < len(numbers):
        twice = next(number for number in numbers if numbers.count(number) > 1)
        raise SceneError(f"element {twice} is given twice; give each once")
    for name, value in (("dwell", dwell_s), ("pause", pause_s)):
        if not chosen.frame_time_s <= value <= LONGEST_S:
            least = 1e3 * chosen.frame_time_s
            raise SceneError(f"{name} of {value:g} s; allowed: {least:.3g} ms, the time of a frame, to {LONGEST_S:g} s")
    turn_s = pause_s + dwell_s
    begins = pause_s + turn_s * np.arange(len(numbers))
    version = np.full(len(numbers), LAYOUTS[head.array].version)
    columns = np.column_stack([numbers, begins, begins + dwell_s, version])
    write_table(times, ["element", "from_s", "to_s", "layout_version"], columns)
    duration_s = turn_s * len(numbers) + pause_s
    frames = _frames(chosen, numbers, dwell_s, pause_s)
    return send(frames, chosen, duration_s, target, head, SoundLimits(), progress)


def _frames(board: Board, numbers: Sequence[int], dwell_s: float, pause_s: float) -> Iterator[TimedFrame]:
    off = board.encode(np.zeros(board.transducers))
    begin = 0.0
    for number in numbers:
        yield from _hold(off, begin, pause_s, sounds=False)
        begin += pause_s
        drive = np.zeros(board.transducers)
        drive[number] = 1.0
        yield from _hold(board.encode(drive), begin, dwell_s, sounds=True)
        begin += dwell_s
    yield from _hold(off, begin, pause_s, sounds=False)


def _hold(data: bytes, begin_s: float, length_s: float, *, sounds: bool) -> Iterator[TimedFrame]:
    """Repeat one frame for a time, so that a lost byte has no lasting effect."""
    for time_s in np.arange(begin_s, begin_s + length_s - 1e-9, REFRESH_S).tolist():
        yield TimedFrame(time_s, data, sounds)
