"""Send the bytes of a log or record to a port again, with the limits of the original play."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from palmfield.acoustics.arrays import LAYOUTS, layout
from palmfield.acoustics.reference import pressure64
from palmfield.config import DriverConfig, parse
from palmfield.config.driver import SAFETY_KEYS
from palmfield.drive.board import TWIN_DELAY_S, Board, Emitted
from palmfield.drive.frame_log import LogHead, Piece
from palmfield.drive.limits import SoundLimits
from palmfield.errors import DeviceError, SceneError
from palmfield.hardware.decode import pieces_of
from palmfield.hardware.play import Performance, play_on_port
from palmfield.hardware.safety.exposure import SoundMoment, at_head, check_head, with_band
from palmfield.hardware.safety.scene_sound import MOMENTS, moments_of
from palmfield.types import Complex

LOG = logging.getLogger(__name__)


def replay(
    path: str | Path,
    port: str,
    board: str | None = None,
    *,
    keys: Mapping[str, str] | None = None,
    progress: bool = False,
) -> Performance:
    """Send the bytes of a file to a port at their times, then silence the board. Return a report, in one sentence.

    keys: limits on level and duration (keys of palmfield.driver), which replace the limits in the log
    Raises DeviceError, before anything is sent, if a limit on duration, duty or level at the head is exceeded. Raises
    DeviceError also if the port cannot be opened or is lost. Other errors are those of `pieces_of`.
    """
    head, pieces = pieces_of(path, board)
    made = head.playable
    frames, cut = _frames(made, pieces)
    ends = frames[-1][0] if frames else 0.0
    for line in check_limits(head, made, frames, _driver(head, keys or {})):
        LOG.warning(line)
    done = play_on_port(frames, made, port, ends, progress=progress)
    return done.saying(f"{cut} incomplete pieces are skipped") if cut else done


def _driver(head: LogHead, keys: Mapping[str, str]) -> DriverConfig:
    """Return the limits of the log, with the replacements in `keys`.

    Raises SceneError for other keys and invalid values.
    """
    replaced = {name.removeprefix("driver."): value for name, value in keys.items()}
    for name in replaced:
        if name not in SAFETY_KEYS:
            allowed = ", ".join(f"driver.{key}" for key in SAFETY_KEYS)
            raise SceneError(
                f"--set driver.{name} has no effect on a replay, which sends the logged bytes; allowed: {allowed}"
            )
    logged = {key: _text(value) for key, value in head.limits.items() if key in SAFETY_KEYS}
    return cast(DriverConfig, parse(DriverConfig, {**logged, **replaced}, "the limits of a replay"))


def _text(value: object) -> str:
    return " ".join(map(repr, value)) if isinstance(value, list | tuple) else str(value)


def check_limits(head: LogHead, board: Board, frames: list[tuple[float, bytes]], driver: DriverConfig) -> list[str]:
    """Check limits before frames are sent; return warnings for users, in words.

    The level at the head is computed from the transducers and phases in the log, with equal amplitudes. If the log has
    the range of p0, its upper end is used. Raises DeviceError if a limit is exceeded. Raises DeviceError also if a
    limit at the head is set and the log has no array positions.
    """
    emitted = _emitted(board, frames)
    if not emitted:
        return []
    first, last = emitted[0].time_s, max(emitted[-1].time_s, frames[-1][0])
    times = [one.time_s - first for one in emitted]
    SoundLimits.of(driver).check(times, [bool(one.amplitudes.any()) for one in emitted], last - first)
    if driver.head_m is None:
        return []
    array = layout(head.array, head.p0_Pa_m)
    most_Pa_m = head.p0_high_Pa_m or max(array.p0_Pa_m, LAYOUTS[head.array].p0.high)
    if len(array) != head.transducers:
        where = f"the log has bytes for {head.transducers} transducers of several arrays, but not their positions"
        if driver.head_limit_dB is not None:
            raise DeviceError(f"{where}, so head_limit_dB cannot be checked: play the scene itself (palmfield drive)")
        return [f"{where}: the level at the head is unknown"]
    places, turns = head.elements
    array = replace(array, positions=places, gain=turns)
    shares: dict[bytes, tuple[Complex, float]] = {}
    for time_s in moments_of(MOMENTS, last - first):
        now = emitted[int(np.searchsorted(times, time_s, "right")) - 1].amplitudes
        shares[now.tobytes()] = now, shares.get(now.tobytes(), (now, 0.0))[1] + 1.0 / MOMENTS

    def moment_of(amplitudes: Complex, share: float) -> SoundMoment:
        return SoundMoment(lambda points: pressure64(points, array, amplitudes, head.air)[0], share)

    moments = [moment_of(amplitudes, share) for amplitudes, share in shares.values() if amplitudes.any()]
    loudest = with_band(at_head(moments, driver, array.positions), (1.0, (most_Pa_m / array.p0_Pa_m) ** 2))
    return check_head(loudest, driver)


def _emitted(board: Board, frames: list[tuple[float, bytes]]) -> list[Emitted]:
    """Return the emission of a board for frames, computed by the virtual twin of the board."""
    assert board.line is not None
    twin = board.wired_twin()
    emitted: list[Emitted] = []
    for time_s, data in frames:
        begins = time_s - board.line.time_s(len(data))
        emitted += [*twin.until(begins), *twin.feed(data, begins)]
    return emitted + twin.until(twin.time_s + TWIN_DELAY_S)


def _frames(board: Board, pieces: list[Piece]) -> tuple[list[tuple[float, bytes]], int]:
    """Convert pieces of the byte stream to frames with their emission times, and count incomplete frames.

    A piece may end within a frame; the next piece then begins with its start. The player itself sends the start and
    stop sequences.
    """
    assert board.line is not None
    whole = [piece for piece in pieces if piece.whole]
    frames: list[tuple[float, bytes]] = []
    for piece in whole:
        time_s, data = piece.time_s, piece.data
        if not frames:
            data = data.removeprefix(board.start)
        if piece is whole[-1]:
            data = data.removesuffix(board.stop)
        for at in range(0, len(data), board.frame_bytes):
            part = data[at : at + board.frame_bytes]
            time_s += board.line.time_s(len(part))
            frames.append((time_s, part))
    return frames, len(pieces) - len(whole)
