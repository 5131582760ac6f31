"""Read and write scans as MATLAB files.

Variables: `time_s` (t), `points_m` (n by 3), `velocity_m_s` or `displacement_m` (t by n), and `sights` (n by 3), which
may be missing. Other names need a file NAME.toml next to NAME.mat, see `named_mat`. SciPy reads files up to version 7,
h5py version 7.3, which is HDF5. Version 5 is written.
"""

from pathlib import Path

from scipy.io import savemat

from palmfield.errors import MeasurementError
from palmfield.files import writing
from palmfield.instruments.scan import Quantity, Scan
from palmfield.instruments.settings import read_settings
from palmfield.outputs.scan_files.named_mat import MatVariables, NamedMat, listed, read_variable

VALUES: dict[str, Quantity] = {"velocity_m_s": "velocity", "displacement_m": "displacement"}
NAMES = {quantity: name for name, quantity in VALUES.items()}
KNOWN = ("time_s", "points_m", "sights", *VALUES)


def read_mat(file: Path) -> Scan:
    """Read a scan from a MATLAB file. Raises MeasurementError for missing variables and wrong shapes."""
    if (names := file.with_suffix(".toml")).is_file():
        return NamedMat(file, read_settings(names, MatVariables)).scan()
    found = listed(file)
    there = [name for name in VALUES if name in found]
    if len(there) != 1:
        raise MeasurementError(
            f"{file}: has {' and '.join(there) or 'no values'}; give exactly one of {', '.join(VALUES)}"
        )
    for name in ("time_s", "points_m"):
        if name not in found:
            raise MeasurementError(f"{file}: has no variable '{name}'; give {', '.join(KNOWN)}")
    arrays = {name: read_variable(file, name).astype(float) for name in KNOWN if name in found}
    times_s, points, values = arrays["time_s"].ravel(), arrays["points_m"], arrays[there[0]]
    return Scan(VALUES[there[0]], times_s, points, values, arrays.get("sights"), file.name)


def write_mat(file: Path, scan: Scan) -> None:
    """Write a scan; `read_mat` reads it back unchanged. Raises OutputError if that fails."""
    variables = {"time_s": scan.times_s[:, None], "points_m": scan.points, NAMES[scan.quantity]: scan.values}
    with writing(file):
        savemat(file, variables | ({} if scan.sights is None else {"sights": scan.sights}), appendmat=False)
