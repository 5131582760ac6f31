"""The dataset of a sweep on disk: one Zarr group readable by xarray, written point by point.

The description of the sweep is written first. The chunks of each array are replaced whole (Zarr writes a new file and
renames it), and `status` comes last. So a point counts as done only when it is complete, even if a process was killed.

They are as in `palmfield.outputs.schema`. The dimensions here come after those of the design.
"""

import json
import math
import os
import shutil
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from palmfield.errors import OutputError, reason_of
from palmfield.outputs.schema import LABELS, Variable
from palmfield.studies.sweeps.batch import Failed
from palmfield.studies.sweeps.design import Design
from palmfield.studies.sweeps.point import Numbers

DATASET = "sweep.zarr"
BLOCK_BYTES, TEXT_BYTES = 4096, 64
"""Block size of the file system, and assumed size of a text [bytes]."""
CHUNK_POINTS = 4096
"""Number of points in one chunk, for a variable with one or a few numbers per point."""
Labels = Mapping[str, NDArray[Any]]
"""Coordinates of dimensions other than the keys: `skin`, `sensor`, `stimulus`, `observer`, `time`, `step_time`."""
NOT_DONE, DONE, FAILED = 0, 1, 2
_NORMAL = "positive outward: a push is negative"
_MOST = "at the vertex that moves most"
VARIABLES: dict[str, Variable] = {
    "peak_displacement": Variable(
        ("skin",), "float64", "m", "largest magnitude of the normal displacement, over all vertices and substeps"
    ),
    "peak_velocity": Variable(
        ("skin",), "float64", "m s-1", "largest magnitude of the normal velocity, over all vertices and substeps"
    ),
    "rms_displacement": Variable(
        ("skin",), "float64", "m", f"root mean square of the normal displacement over the run, {_MOST}"
    ),
    "rms_displacement_without_mean": Variable(
        ("skin",), "float64", "m", f"root mean square of the normal displacement about its mean over the run, {_MOST}"
    ),
    "rms_displacement_last_period": Variable(
        ("skin",), "float64", "m",
        f"root mean square of the normal displacement over the last period of main_frequency, {_MOST}",
    ),
    "rms_velocity": Variable(
        ("skin",), "float64", "m s-1", f"root mean square of the normal velocity over the run, {_MOST}"
    ),
    "rms_velocity_last_period": Variable(
        ("skin",), "float64", "m s-1",
        f"root mean square of the normal velocity over the last period of main_frequency, {_MOST}",
    ),
    "peak_arp": Variable(
        ("skin",), "float64", "Pa", "largest acoustic radiation pressure (ARP), over all vertices and substeps",
        sign="positive values push into the surface",
    ),
    "loudest_position": Variable(
        ("skin", "xyz"), "float64", "m", "vertex whose normal displacement is largest", "body frame at rest",
    ),
    "normal_displacement": Variable(
        ("skin", "time"), "float32", "m", "normal displacement at loudest_position", sign=_NORMAL
    ),
    "sensor_displacement": Variable(
        ("sensor", "step_time"), "float32", "m", "normal displacement at the sensors, at the start of each step",
        sign=_NORMAL,
    ),
    "peak_force": Variable(
        ("skin",), "float64", "N", "largest magnitude of the acoustic force on the body of the skin, mean over a step"
    ),
    "mean_force": Variable(
        ("skin", "xyz"), "float64", "N", "acoustic force on the body of the skin, mean over the run", "world",
        "acts on the body",
    ),
    "drive_level": Variable(
        ("stimulus",), "float64", "1",
        "largest amplitude of the transducers of the stimulus at the highest ARP, 1 is full drive",
    ),
    "main_frequency": Variable(
        ("skin",), "float64", "Hz",
        "frequency of the strongest response of the skin; none for a load that does not repeat",
    ),
    "level": Variable(
        ("skin", "observer"), "float64", "dB",
        f"level of the line at main_frequency above the threshold of the observer (dB SL), {_MOST}; for "
        "hasegawa_2018 that of the force",
    ),
    "level_all_lines": Variable(
        ("skin", "observer"), "float64", "dB",
        f"level of all main lines together above the threshold of the observer (dB SL), {_MOST}",
    ),
    "level_with_area": Variable(
        ("skin", "observer"), "float64", "dB",
        "level_all_lines, with thresholds for the area that moves by half of the maximum or more",
    ),
    "level_why": Variable(("skin", "observer"), "str", "", "reason why the observer applies or is refused"),
}  # fmt: skip
"""Variables of every sweep. A value is NaN if the point has failed, is not computed yet, or has no such number."""
ERRORS: dict[str, Variable] = {
    "displacement_error": Variable(
        ("skin",), "float64", "1", "estimated relative error of the displacement: mesh, step, reduction, cut edges"
    ),
    "displacement_error_missing": Variable(("skin",), "str", "", "reason for a missing estimate"),
}
"""Variables of a sweep with estimates of errors."""
RECORDS: dict[str, Variable] = {
    "substep": Variable((), "float64", "s", "substep of the skins; normal_displacement is resampled where it differs"),
    "wall_time": Variable((), "float64", "s", "wall time of the point"),
    "failure": Variable((), "str", "", "cause of a failed point"),
    "status": Variable((), "int8", "1", "0 not computed yet, 1 done, 2 failed"),
}
"""Variables that describe the computation."""
COURSES = ("time", "step_time")
"""Dimensions of the time series of a point."""


def size_bytes(design: Design, labels: Labels, errors: bool) -> int:
    """Return the largest size of the dataset on disk, before compression [bytes]."""
    total = 0
    for variable in variables(errors).values():
        one = math.prod(_shape(variable, labels)) * (
            TEXT_BYTES if variable.dtype == "str" else _type(variable).itemsize
        )
        # The time series of each point is a file
        total += design.count * (math.ceil(one / BLOCK_BYTES) * BLOCK_BYTES if _is_course(variable) else one)
    return total


class SweepStore:
    """The dataset of one sweep, open for writing.

    path: path of the Zarr group; status: status of each point, shape of the design (see
    `palmfield.studies.sweeps.store`)
    """

    def __init__(self, out: Path, design: Design, labels: Labels, attributes: Mapping[str, Any], errors: bool) -> None:
        """Create the dataset in a folder, or open that of an interrupted run of the same sweep.

        attributes: attributes of the dataset; the mapping `identity` among them identifies the sweep
        Raises OutputError if the folder cannot be written, or contains another sweep.
        """
        self.path, self.design = Path(out) / DATASET, design
        # A scene without sensors has an empty dimension `sensor`
        self._variables = {
            name: variable for name, variable in variables(errors).items() if 0 not in _shape(variable, labels)
        }
        try:
            if self.path.exists():
                self._check_same(attributes["identity"])
            else:
                self._make(labels, attributes)
            self._open()
        except (OSError, KeyError, ValueError) as error:
            raise OutputError(f"cannot open {self.path}: {reason_of(error)}; choose another folder") from error

    def write(self, results: Mapping[int, Numbers | Failed]) -> None:
        """Write points by their numbers in the design. Raises OutputError if the disk is full, without loss of data."""
        if not results:
            return
        try:
            for number, result in results.items():
                self._add(self.design.index(number), result)
            self._write_courses(results)
            self._flush([self.design.index(number)[0] for number in results])
        except OSError as error:
            raise OutputError(
                f"cannot write {self.path}: {reason_of(error)}; {self.done} points are saved: free some space, and "
                "repeat the command"
            ) from error

    @property
    def done(self) -> int:
        """Return the number of points on the disk."""
        return int((np.asarray(self._groups["status"][...]) == DONE).sum())

    def failure(self, number: int) -> str:
        return str(self._small["failure"][self.design.index(number)])

    def _add(self, index: tuple[int, ...], result: Numbers | Failed) -> None:
        """Copy one point into memory, except its time series."""
        if isinstance(result, Failed):
            self._small["failure"][index] = result.reason
            self.status[index] = FAILED
            return
        self._small["failure"][index] = ""
        for name, values in result.items():
            if name in self._small:
                self._small[name][index] = values
        self.status[index] = DONE

    def _write_courses(self, results: Mapping[int, Numbers | Failed]) -> None:
        """Write time series to the disk. Neighbouring points are written together, so that Zarr works in parallel."""
        done = {number: result for number, result in sorted(results.items()) if not isinstance(result, Failed)}
        runs: list[list[int]] = []
        for number in done:
            index = self.design.index(number)
            last = self.design.index(runs[-1][-1]) if runs else None
            if last is not None and last[:-1] == index[:-1] and last[-1] + 1 == index[-1]:
                runs[-1].append(number)
            else:
                runs.append([number])
        for run in runs:
            *row, first = self.design.index(run[0])
            place = (*row, slice(first, first + len(run)))
            for name in done[run[0]]:
                if name in self._groups and name not in self._small:
                    self._groups[name][place] = np.stack([done[number][name] for number in run])

    def _flush(self, rows: Sequence[int]) -> None:
        """Write the data in memory for some rows of the first dimension."""
        length = _rows_a_chunk(self.design)
        for chunk in sorted({row // length for row in rows}):
            part = slice(chunk * length, (chunk + 1) * length)
            for name, values in self._small.items():
                if name != "status":
                    self._groups[name][part] = values[part]
            self._groups["status"][part] = self.status[part]

    # -- making and opening ----------------------------------------------------------------------------------------

    def _make(self, labels: Labels, attributes: Mapping[str, Any]) -> None:
        """Create the dataset without points. It gets its final name when it is complete."""
        import dask.array

        arrays: dict[str, xr.Variable] = {}
        encoding: dict[str, dict[str, Any]] = {}
        for name, variable in self._variables.items():
            dims, shape = (*self.design.dims, *variable.dims), (*self.design.shape, *_shape(variable, labels))
            chunks = self._chunks(variable, shape)
            empty: Any = "" if variable.dtype == "str" else 0 if variable.dtype == "int8" else np.nan
            # Lazy arrays: only shapes and attributes are written
            made = dask.array.full(shape, empty, dtype=_type(variable), chunks=-1)
            arrays[name] = xr.Variable(dims, made, variable.attributes)
            encoding[name] = {"chunks": chunks}
        dataset = xr.Dataset(
            arrays, self._coordinates(labels), {**attributes, "identity": _text(attributes["identity"])}
        )
        self.path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self.path.with_name(f".{DATASET}.{uuid.uuid4().hex}")
        try:
            dataset.to_zarr(
                temporary, compute=False, encoding=encoding, zarr_format=3, consolidated=False, safe_chunks=False
            )
            os.replace(temporary, self.path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

    def _chunks(self, variable: Variable, shape: tuple[int, ...]) -> tuple[int, ...]:
        points = len(self.design.shape)
        if _is_course(variable):
            return (*(1,) * points, *shape[points:])
        return (_rows_a_chunk(self.design), *shape[1:])

    def _coordinates(self, labels: Labels) -> dict[str, Any]:
        made: dict[str, Any] = {}
        for key, values in self.design.values.items():
            dim = key if self.design.kind == "grid" else "point"
            made[key] = (dim, _column(values), {"long_name": f"key {key}"} | _unit(key))
        if self.design.kind != "grid":
            made["point"] = ("point", np.arange(self.design.count), {"long_name": "number of the point; first 0"})
        for name, label in labels.items():
            about = {"units": "s", "long_name": "time from the start of the run"} if name in COURSES else {}
            made[name] = (name, label.astype(object) if label.dtype.kind == "U" else label, about)
        names, what = LABELS["xyz"]
        made["xyz"] = ("xyz", np.array(names, dtype=object), {"long_name": what})
        return made

    def _check_same(self, identity: Mapping[str, Any]) -> None:
        """Raise OutputError, with the difference, if the folder contains another sweep."""
        import zarr

        there = json.loads(str(zarr.open_group(self.path, mode="r").attrs["identity"]))
        expected = json.loads(_text(identity))
        differing = [name for name in expected if there.get(name) != expected[name]]
        if differing:
            name = differing[0]
            raise OutputError(
                f"{self.path} contains another sweep: its {name} is {_short(there.get(name))}, not "
                f"{_short(expected[name])}; choose another folder, or delete this one"
            )

    def _open(self) -> None:
        import zarr

        group = zarr.open_group(self.path, mode="r+")
        self._groups: dict[str, Any] = {name: group[name] for name in self._variables}
        self._small: dict[str, NDArray[Any]] = {
            name: np.array(self._groups[name][...], dtype=object if variable.dtype == "str" else None)
            for name, variable in self._variables.items()
            if not _is_course(variable)
        }
        self.status: NDArray[np.int8] = self._small["status"]


def open_dataset(path: Path) -> xr.Dataset:
    """Open the dataset of a sweep for lazy reading. Raises OutputError if there is none."""
    try:
        dataset = xr.open_zarr(path, consolidated=False, chunks=None)
        # Zarr does not keep their order
        return dataset[[name for name in variables(True) if name in dataset]]
    except (OSError, KeyError, ValueError) as error:
        raise OutputError(f"{path} is not a dataset of a sweep: {reason_of(error)}") from error


def swept_keys(dataset: xr.Dataset) -> list[str]:
    """Return the swept keys of a dataset, in the order of the design."""
    return list(json.loads(json.loads(dataset.attrs["identity"])["design"])["values"])


def _rows_a_chunk(design: Design) -> int:
    """Return the number of rows of the first dimension in one chunk."""
    return min(design.shape[0], max(1, CHUNK_POINTS // max(1, math.prod(design.shape[1:]))))


def _is_course(variable: Variable) -> bool:
    """Return whether a variable is a time series for each point."""
    return bool(set(variable.dims) & set(COURSES))


def _shape(variable: Variable, labels: Labels) -> tuple[int, ...]:
    return tuple(len(LABELS[dim][0]) if dim in LABELS else len(labels[dim]) for dim in variable.dims)


def _type(variable: Variable) -> np.dtype[Any]:
    return np.dtypes.StringDType() if variable.dtype == "str" else np.dtype(variable.dtype)


def _column(values: Sequence[Any]) -> NDArray[Any]:
    """Return the values of one key as a coordinate. They are numbers, or texts if any value is a text or a vector."""
    if all(isinstance(value, int | float) for value in values):
        return np.array(values, dtype=float)
    words = [" ".join(f"{part:.12g}" for part in value) if isinstance(value, tuple) else str(value) for value in values]
    return np.array(words, dtype=object)


def _unit(key: str) -> dict[str, str]:
    from palmfield.config import unit

    name = key.rpartition(".")[2].partition("[")[0]
    return {"units": unit(name)} if unit(name) else {}


def _text(identity: Mapping[str, Any]) -> str:
    return json.dumps(identity, sort_keys=True)


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) < 200 else f"{text[:200]}..."


def variables(errors: bool) -> dict[str, Variable]:
    """Return all variables of a sweep. errors: whether to include estimates of errors"""
    return VARIABLES | (ERRORS if errors else {}) | RECORDS
