"""Read files of single OpenMPD boards (board_N.pat of the vendor) as calibrations.

`GenerateBoardConfigurationFiles` of the driver of the vendor writes seven lines: hardware id, number of transducers,
phase steps, positions (x, y, z) [m], place of each transducer in the byte stream, phase [deg], amplitude. The driver
(`AsierInhoImpl_V2::discretizePhases`, sbg97/OpenMPD_Driver) subtracts the phase of a transducer before it rounds. So
the phase is the delay of the transducer, like `phase_rad`. An inverted transducer has about 180 deg more. This was not
tested on hardware."""

import re
from pathlib import Path

import numpy as np

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.calibration_file import Calibration, Elements
from palmfield.errors import SceneError
from palmfield.files import read_text, reading
from palmfield.types import Float

SAME_M = 1e-6
"""Largest difference of equal positions [m]; files have this resolution."""


def read_board_file(path: str | Path) -> Calibration:
    """Read the calibration of layout openmpd from a board file: addresses, polarities, phases, and other positions.

    Positions are None if they equal those of the layout. Raises SceneError, with the line, for a file that cannot be
    read, another number of transducers, pins that are not 0 to 255 each once, phases beyond 360 degrees, and amplitudes
    other than 1, which the driver does not use."""
    file, array = Path(path), layout("openmpd")
    with reading(file, SceneError, "a vendor's file board_N.pat"):
        lines = read_text(file).splitlines()
    if len(lines) < 7:
        raise SceneError(f"{file}: the file has {len(lines)} lines; a vendor's file board_N.pat has 7")
    count = len(array)
    for number, expected in ((2, count), (3, 128)):
        if lines[number - 1].strip() != str(expected):
            raise SceneError(f"{file}: line {number}: {lines[number - 1][:20]!r}; layout openmpd has {expected}")
    positions = _numbers(file, lines, 4, 3 * count).reshape(count, 3)
    pins, degrees, amplitudes = (_numbers(file, lines, number, count) for number in (5, 6, 7))
    if sorted(pins.tolist()) != list(range(count)):
        raise SceneError(f"{file}: line 5: pins must hold each number from 0 to {count - 1} once")
    if np.abs(degrees).max() > 360.0:
        raise SceneError(f"{file}: line 6: phase {degrees[np.abs(degrees).argmax()]:g}; allowed: -360 to 360 degrees")
    if (amplitudes != 1.0).any():
        raise SceneError(f"{file}: line 7: amplitude {amplitudes[amplitudes != 1.0][0]:g}; allowed: 1")
    turns = np.exp(1j * np.radians(degrees))
    # Twice the angle is the same for both polarities
    common = np.exp(0.5j * np.angle((turns**2).sum()))
    polarity = np.where((turns / common).real < 0.0, -1, 1)
    moved = np.abs(positions - array.positions).max() > SAME_M
    elements = Elements(
        enabled=(True,) * count,
        polarity=tuple(polarity.tolist()),
        phase_rad=tuple(np.angle(polarity * turns).tolist()),
        gain=(1.0,) * count,
        position_m=tuple((x, y, z) for x, y, z in positions.tolist()) if moved else None,
        address=tuple(pins.astype(int).tolist()),
    )
    return Calibration(layout="openmpd", elements=elements)


def _numbers(file: Path, lines: list[str], number: int, count: int) -> Float:
    words = [word for word in re.split(r"[(),\s]+", lines[number - 1]) if word]
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        raise SceneError(f"{file}: line {number} is not numeric; give a vendor's file board_N.pat") from None
    if len(values) != count or not np.isfinite(values).all():
        raise SceneError(f"{file}: line {number}: {len(values)} numbers, or one not finite; give {count}")
    return values
