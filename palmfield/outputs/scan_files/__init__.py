"""Files of measured scans, by their ending: read into and written from `palmfield.instruments.scan.Scan`."""

from pathlib import Path

from palmfield.errors import MeasurementError, OutputError
from palmfield.instruments.scan import Scan
from palmfield.outputs.scan_files.matlab import read_mat, write_mat
from palmfield.outputs.scan_files.uff import read_uff, write_uff
from palmfield.outputs.scan_files.wide_csv import read_csv, write_csv

READERS = {".csv": read_csv, ".uff": read_uff, ".unv": read_uff, ".mat": read_mat}
WRITERS = {".csv": write_csv, ".uff": write_uff, ".unv": write_uff, ".mat": write_mat}


def read_scan(path: str | Path) -> Scan:
    """A scan from a file. Raises MeasurementError for one that isn't there, of another kind, or with faults."""
    file = Path(path)
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise MeasurementError(f"{file}: the file's kind is '{file.suffix}'; allowed: {', '.join(READERS)}")
    return reader(file)


def write_scan(path: str | Path, scan: Scan) -> None:
    """Write a scan. Raises OutputError for another kind of file, and where it can't be written."""
    file = Path(path)
    writer = WRITERS.get(file.suffix.lower())
    if writer is None:
        raise OutputError(f"{file}: the file's kind is '{file.suffix}'; allowed: {', '.join(WRITERS)}")
    writer(file, scan)
