"""Read and write files of measured scans, `palmfield.instruments.scan.Scan`.

The suffix determines the format. A folder of Polytec text files can only be read.
"""

from pathlib import Path

import numpy as np

from palmfield.errors import MeasurementError, OutputError
from palmfield.instruments.scan import Scan
from palmfield.outputs.scan_files.matlab import read_mat, write_mat
from palmfield.outputs.scan_files.polytec_text import read_polytec
from palmfield.outputs.scan_files.uff import read_uff, write_uff
from palmfield.outputs.scan_files.wide_csv import read_csv, write_csv

READERS = {".csv": read_csv, ".uff": read_uff, ".unv": read_uff, ".mat": read_mat}
LARGEST_M = 2.0
"""Largest extent of a scan [m]."""
WRITERS = {".csv": write_csv, ".uff": write_uff, ".unv": write_uff, ".mat": write_mat}


def read_scan(path: str | Path) -> Scan:
    """Read a scan from a file, or a folder of Polytec text files.

    Raises MeasurementError for a missing file, an unknown format, or errors in it.
    """
    file = Path(path)
    if file.is_dir():
        return read_polytec(file)
    reader = READERS.get(file.suffix.lower())
    if file.suffix.lower() == ".txt":
        raise MeasurementError(
            f"{file}: is a text file; for Polytec text files, one per point, give the folder with these files and "
            "places.csv"
        )
    if reader is None:
        raise MeasurementError(
            f"{file}: the kind of the file is '{file.suffix}'; allowed: {', '.join(READERS)}, or a folder"
        )
    scan = reader(file)
    extent = float(np.ptp(scan.points, axis=0).max())
    if extent > LARGEST_M:
        raise MeasurementError(
            f"{file}: its points are {extent:.3g} m apart; allowed: at most {LARGEST_M:g} m: give positions in metres"
        )
    return scan


def write_scan(path: str | Path, scan: Scan) -> None:
    """Write a scan. Raises OutputError for an unknown format, and if writing fails."""
    file = Path(path)
    writer = WRITERS.get(file.suffix.lower())
    if writer is None:
        raise OutputError(f"{file}: the kind of the file is '{file.suffix}'; allowed: {', '.join(WRITERS)}")
    writer(file, scan)
