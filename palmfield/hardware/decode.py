"""Decode foci from the bytes of a file: run the virtual twin of the board, and fit foci to the sound that it emits."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.calibration_file import calibrated, read_calibration
from palmfield.config import DriverConfig
from palmfield.drive.board import Emitted, Flag, frames_in_words
from palmfield.drive.boards import board_of, playable_board
from palmfield.drive.focus_fit import fitted_focus
from palmfield.drive.frame_log import LogHead, Piece, is_log, read_log
from palmfield.errors import SceneError
from palmfield.files import read_bytes, reading, whole, writing
from palmfield.hardware.focus_board import array_named
from palmfield.types import Float

FREQUENCY_HZ = 40e3
GOOD_RAD = 1.0
"""Largest phase error [rad] at which a sound counts as a focus."""


@dataclass(frozen=True)
class DecodedFocus:
    """One decoded emission.

    time_s: its start
    focus: focus in the array frame [m], NaN if there is none
    misfit_rad: rms phase difference between the emission and that focus
    sounding: number of active transducers
    level: mean amplitude of the active transducers, relative to full drive
    """

    time_s: float
    focus: tuple[float, float, float]
    misfit_rad: float
    sounding: int
    level: float


@dataclass(frozen=True)
class Decoded:
    """Content of the decoded bytes.

    head: head of the log
    foci: foci in order of time
    flags: errors of the virtual board
    frames: number of frames, in words
    """

    head: LogHead
    foci: list[DecodedFocus]
    flags: list[Flag]
    frames: str


def pieces_of(
    path: str | Path, board: str | None, array: str | None = None, calibration: Path | None = None
) -> tuple[LogHead, list[Piece]]:
    """Read a log written by `--log`, or a file of raw bytes, for which the name of the board is required.

    array: name of a layout, or CSV file of transducers; None: first layout of the board
    calibration: calibration file of the transducers
    Raises SceneError for a file that cannot be read and for raw bytes without a board, and DeviceError for an unknown
    board.
    """
    if is_log(path):
        head, pieces = read_log(path)
        return _measured(head, calibration), pieces
    file = Path(path)
    with reading(file, SceneError, "a file of --record or --log"):
        data = read_bytes(file)
    if board is None:
        raise SceneError(f"{file} is not a log, so its board is unknown; give it by --board")
    chosen = playable_board(board)
    name = array or chosen.layouts[0]
    places = array_named(name)[0]
    head = LogHead(board, len(places) * chosen.arrays[0], places.name)
    if places.name == "csv":
        own = board_of(DriverConfig.model_validate({"board": board}), len(places), address=places.address)
        head = head.measured(places, own.places)
    return _measured(head, calibration), [Piece(0.0, data)]


def _measured(head: LogHead, calibration: Path | None) -> LogHead:
    if calibration is None:
        return head
    array = calibrated(layout(head.array), read_calibration(calibration))
    driver = DriverConfig.model_validate({"board": head.board})
    return head.measured(array, board_of(driver, head.transducers, address=array.address).places)


def decode(
    path: str | Path, board: str | None = None, array: str | None = None, calibration: Path | None = None
) -> Decoded:
    """Decode the foci of the bytes in a file. Arguments and errors are those of `pieces_of`.

    Phase errors of the transducers are included, if the log or a calibration contains them.
    """
    head, pieces = pieces_of(path, board, array, calibration)
    twin = head.playable.wired_twin()
    emitted: list[Emitted] = []
    for piece in pieces:
        emitted += [*twin.until(piece.time_s), *twin.feed(piece.data, piece.time_s)]
    emitted += twin.until(twin.time_s + 1.0)
    positions, turns = head.elements
    wavenumber = 2.0 * math.pi * FREQUENCY_HZ / sound_speed(head.air)
    foci: list[DecodedFocus] = []
    near: Float | None = None
    cached: dict[bytes, tuple[Float, float]] = {}
    for one in emitted:
        # With several arrays report the focus of the first: only the scene gives the poses of the others
        own = one.amplitudes[: len(positions)] * turns
        key = own.tobytes()
        if key not in cached:
            cached[key] = fitted_focus(positions, own, wavenumber, near)
        place, misfit = cached[key]
        if misfit < GOOD_RAD:
            near = place
        else:
            place = np.full(3, np.nan)
        magnitude = np.abs(own)
        on = int((magnitude > 1e-9).sum())
        level = float(magnitude.sum() / on) if on else 0.0
        x, y, z = place.tolist()
        foci.append(DecodedFocus(one.time_s, (x, y, z), misfit, on, level))
    return Decoded(head, foci, twin.flags, frames_in_words(emitted))


def as_table(decoded: Decoded, most: int | None = None) -> str:
    """Return rows of time, focus, misfit and level for a table; most: largest number of rows."""
    shown = decoded.foci if most is None else decoded.foci[:most]
    lines = [f"board {decoded.head.board}, layout {decoded.head.array}: {decoded.frames}"]
    lines.append("  time [ms]   x [mm]   y [mm]   z [mm]  misfit [deg]  on   level")
    for row in shown:
        place = "".join(f" {1e3 * value:8.2f}" if math.isfinite(value) else "        -" for value in row.focus)
        misfit = f"{math.degrees(row.misfit_rad):13.1f}" if math.isfinite(row.misfit_rad) else "            -"
        lines.append(f"{1e3 * row.time_s:11.3f}{place} {misfit} {row.sounding:4d} {row.level:6.3f}")
    if len(shown) < len(decoded.foci):
        lines.append(f"and {len(decoded.foci) - len(shown)} more; --csv FILE writes all of them")
    for flag in decoded.flags[:10]:
        lines.append(f"at {1e3 * flag.time_s:.3f} ms {flag.kind}: {flag.text}")
    if len(decoded.flags) > 10:
        lines.append(f"and {len(decoded.flags) - 10} more of this kind")
    return "\n".join(lines)


def write_csv(decoded: Decoded, path: Path) -> None:
    """Write all rows. The column names contain the units. Raises OutputError if writing fails."""
    with writing(path), whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "x_m", "y_m", "z_m", "misfit_rad", "sounding", "level"])
        for row in decoded.foci:
            writer.writerow([row.time_s, *row.focus, row.misfit_rad, row.sounding, row.level])


def draw_foci(times_s: Sequence[float], foci: Float, path: Path) -> None:
    """Draw foci [m], shape (n, 3), over their times [s], into a PNG. NaN marks a time without focus.

    Raises OutputError if the file cannot be written.
    """
    from matplotlib.figure import Figure

    from palmfield.outputs.style import same_scale, save

    figure = Figure(figsize=(9.0, 3.6), dpi=120, layout="constrained")
    above, side, course = figure.subplots(1, 3)
    moments, places = 1e3 * np.asarray(times_s), 1e3 * foci
    dots = above.scatter(places[:, 0], places[:, 1], c=moments, s=12)
    side.scatter(places[:, 0], places[:, 2], c=moments, s=12)
    for axes, up in ((above, 1), (side, 2)):
        axes.set(xlabel="x [mm]", ylabel=f"{'xyz'[up]} [mm]")
        same_scale(axes, places[:, 0], places[:, up])
    for number, name in enumerate("xyz"):
        # A single time cannot be drawn as a line
        course.step(moments, places[:, number], "." if len(moments) == 1 else "", where="post", label=name)
    course.set(xlabel="time [ms]", ylabel="focus [mm]")
    course.legend()
    figure.colorbar(dots, ax=side, label="time [ms]")
    save(figure, path, dpi=120)
