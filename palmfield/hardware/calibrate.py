"""Calibrations as files: add readings, describe them, and rehearse."""

import shlex
from pathlib import Path

from palmfield.acoustics.arrays import layout as layout_named
from palmfield.acoustics.calibration_file import Calibration, Pose, read_calibration, write_calibration
from palmfield.drive.calibration.openmpd_file import read_board_file
from palmfield.drive.calibration.readings import MEASUREMENTS, Circumstances, measured
from palmfield.drive.calibration.rehearsal import FOCUS_M, PLATE_M, TRUTH, rehearse
from palmfield.errors import SceneError
from palmfield.types import Estimate

NEEDS_FOCUS = ("plate", "focus", "sweep")


def add_readings(kind: str, readings: Path, board: Path, layout: str | None, circumstances: Circumstances) -> list[str]:
    """Add readings to the calibration file `board`, which is created if missing; return their results.

    kind: a key of `MEASUREMENTS`; layout: layout of the array, needed for a new file
    Raises SceneError for invalid files, layouts and sources, PalmfieldError for unusable readings, OutputError
    if the file cannot be written; it is then unchanged.
    """
    if not circumstances.source.strip():
        raise SceneError("the source is missing; state who measured, when, and with which instrument (--source TEXT)")
    if board.exists():
        calibration = read_calibration(board)
        if layout is not None and layout != calibration.layout:
            raise SceneError(
                f"{board} is for layout '{calibration.layout}', but --layout is '{layout}'; give another file"
            )
    elif layout is None:
        raise SceneError(f"{board} does not exist; to begin a new calibration give the array layout (--layout NAME)")
    else:
        calibration = Calibration(layout=layout)
    result = measured(kind, readings, calibration, layout_named(calibration.layout), circumstances)
    write_calibration(board, result.calibration)
    return list(result.report)


def imported(file: Path, board: Path) -> list[str]:
    """Convert a vendor file of an OpenMPD board to a calibration; return a description.

    Raises SceneError for an invalid file and for an existing calibration, and OutputError like `add_readings`.
    """
    if board.exists():
        raise SceneError(f"{board} already exists; give another file")
    write_calibration(board, read_board_file(file))
    return [*described(board, None), "not tested on hardware: check a focus with a microphone or a sheet of paper"]


def described(board: Path, png: Path | None) -> list[str]:
    """Describe a calibration file line by line, and name the missing parts.

    If `png` is not None, also draw the calibration.
    """
    calibration = read_calibration(board)
    array = layout_named(calibration.layout)
    lines = [f"calibration of {calibration.layout}, {len(array)} transducers"]
    lines += [_estimate("p0", "Pa m", calibration.p0), _estimate("Q", "", calibration.quality)]
    lines.append(_estimate("resonance", "Hz", calibration.resonance_Hz))
    elements = calibration.elements
    if elements is None:
        lines.append("single transducers: not measured; an uncalibrated board does not focus")
    else:
        silent = elements.enabled.count(False)
        lines.append(f"single transducers: {elements.polarity.count(-1)} with reversed polarity, {silent} silent")
    if calibration.pose == Pose():
        lines.append("position of the board: not measured, nominal")
    else:
        lines.append(
            "position of the board: " + ", ".join(f"{1e3 * x:+.2f}" for x in calibration.pose.offset_m) + " mm"
        )
    level, warm_up = calibration.level, calibration.warm_up
    lines.append(
        "level: not measured"
        if level is None
        else f"level: to the power {level.exponent:.3f} up to {level.linear_to:g}"
    )
    lines.append(
        "warm-up: not measured" if warm_up is None else f"warm-up: {100 * warm_up.drop:+.1f} %, {warm_up.time_s:.0f} s"
    )
    if png is not None:
        from palmfield.outputs.calibration_picture import draw_calibration

        lines.append(f"wrote {draw_calibration(calibration, array, png)}")
    return lines


def rehearsed(layout: str, folder: Path, seed: int) -> list[str]:
    """Write the files of a rehearsal; return their list and the next commands."""
    lines = [f"wrote {path}" for path in rehearse(layout_named(layout), folder, seed)]
    lines.append(f"{TRUTH} lists the true values behind the readings. Next:")
    for kind in MEASUREMENTS:
        options = f" --focus {' '.join(map(str, FOCUS_M))}" if kind in NEEDS_FOCUS else ""
        options += f" --plate {' '.join(map(str, PLATE_M))}" if kind == "plate" else ""
        begin = f" --layout {layout}" if kind == next(iter(MEASUREMENTS)) else ""
        files = f"{shlex.quote(str(folder / f'{kind}.csv'))} {shlex.quote(str(folder / 'board.json'))}"
        lines.append(f"palmfield calibrate add {kind} {files}{begin}{options} --source rehearsal")
    return lines


def _estimate(name: str, unit: str, one: Estimate | None) -> str:
    if one is None:
        return f"{name}: not measured"
    return f"{name}: {one.value:.4g} ({one.low:.4g} to {one.high:.4g}) {unit}".rstrip() + f", {one.source}"
