"""Write results as netCDF files without letting HDF5 write to a disk.

HDF5 crashes the interpreter if the disk is full. Small files are made in memory. Large ones use a file object that
keeps data that it cannot write, so that HDF5 gets no error and this module can raise one afterwards.
"""

import io
import json
import os
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray

from palmfield.outputs.schema import LABELS, PLACES, RECORDS, ROOT, Attributes, Checked, Variable, ordered, variables_of
from palmfield.types import json_value

CHUNK_BYTES = 1_000_000
"""Size of a compressed chunk. It fits the HDF5 cache of 1 MiB for each variable, so it is filled before compression."""
SAMPLE, WORTHWHILE = 32_768, 0.67
"""Values that are compressed on trial, and the share of their size below which a variable is compressed. Fields and
motion keep about 0.8: their last digits are noise, which takes seconds to pack and to read."""
COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
UNREADABLE = (OSError, ValueError, KeyError, RuntimeError, TypeError)


class SpillingFile(io.RawIOBase):
    """A file on disk whose writing never fails: if the disk is full, data stay in memory, and `lost` gives the reason.

    The writer must check `lost` and stop soon after a failure.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
        self._at = 0
        self._length = 0
        self._spilled: list[tuple[int, bytes]] = []
        self.lost: OSError | None = None

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        done = 0
        try:
            while done < len(view) and self.lost is None:
                done += os.pwrite(self._file, view[done:], self._at + done)
        except OSError as error:
            self.lost = error
        if done < len(view):
            self._spilled.append((self._at + done, bytes(view[done:])))
        self._at += len(view)
        self._length = max(self._length, self._at)
        return len(view)

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        count = min(len(view), max(0, self._length - self._at))
        content = os.pread(self._file, count, self._at)
        view[:count] = content + bytes(count - len(content))
        for start, data in self._spilled:
            low, high = max(start, self._at), min(start + len(data), self._at + count)
            if low < high:
                view[low - self._at : high - self._at] = data[low - start : high - start]
        self._at += count
        return count

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._length}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def truncate(self, size: int | None = None) -> int:
        self._length = self._at if size is None else size
        try:
            os.ftruncate(self._file, self._length)
        except OSError as error:
            self.lost = self.lost or error
        return self._length

    def flush(self) -> None:
        """Do nothing: no data are buffered."""

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def close(self) -> None:
        if not self.closed:
            try:
                if self.lost is None:
                    os.fsync(self._file)
            except OSError as error:
                self.lost = error
            finally:
                os.close(self._file)
                super().close()


class ResultWriter:
    """Writes groups, static variables, and the parts of record variables in succession."""

    def __init__(self, file: h5netcdf.File, lengths: dict[str, int]) -> None:
        """lengths: number of records along each record dimension"""
        self._file, self._lengths = file, lengths
        for dim, length in lengths.items():
            if length:
                file.dimensions[dim] = length

    def groups(self, paths: Iterable[str], attributes: Attributes) -> None:
        """Make groups in the order of the schema, with attributes; values that netCDF cannot store become JSON text."""
        for path in ordered([*paths, *attributes]):
            pairs = attributes.get(path, {})
            self._group(path).attrs.update({name: storable(value) for name, value in pairs.items()})

    def labels(self) -> None:
        """Write the names of components, in the root."""
        for name in LABELS:
            self._label(self._file, name)

    def _label(self, group: Any, name: str) -> None:
        names, what = LABELS[name]
        group.dimensions[name] = len(names)
        made = group.create_variable(name, (name,), h5py.string_dtype())
        made[...] = np.array(names, dtype=object)
        made.attrs["long_name"] = what

    def put(self, arrays: Checked, start: dict[str, int]) -> None:
        """Write variables; along a record dimension, write the part that begins at `start`."""
        for path, variables in arrays.items():
            schema = variables_of(path)
            group = self._group(path)
            for name, array in variables.items():
                made = group.variables.get(name)
                made = self._create(group, name, schema[name], array) if made is None else made
                self._fill(made, record_of(schema[name]), array, start)
            if path != "/":
                self._put_times(group, {record_of(schema[name]) for name in variables}, arrays.get("/", {}), start)

    def _put_times(
        self, group: Any, dims: set[str | None], times: dict[str, NDArray[Any]], start: dict[str, int]
    ) -> None:
        """Write the times of the records of a group, so that it can be opened without the root."""
        for dim in RECORDS:
            if dim in dims and dim in times:
                made = group.variables.get(dim)
                made = self._create(group, dim, ROOT[dim], times[dim]) if made is None else made
                self._fill(made, dim, times[dim], start)

    def _fill(self, made: Any, dim: str | None, array: NDArray[Any], start: dict[str, int]) -> None:
        values = _stored(array)
        if dim is None:
            made[...] = values
        else:
            made[start[dim] : start[dim] + len(values)] = values

    def _group(self, path: str) -> Any:
        if path == "/":
            return self._file
        return self._file[path] if path in self._file else self._file.create_group(path)

    def _create(self, group: Any, name: str, variable: Variable, array: NDArray[Any]) -> Any:
        """array: the first part of the variable"""
        dim = record_of(variable)
        shape = array.shape if dim is None else (self._lengths[dim], *array.shape[1:])
        for own, length in zip(variable.dims, shape, strict=True):
            if own in group.dimensions:
                continue
            if own in LABELS:
                self._label(group, own)
            else:
                group.dimensions[own] = length
        extra: dict[str, Any] = {}
        dtype: Any = np.dtype("int8") if variable.dtype == "bool" else variable.dtype
        if dtype == "str":
            dtype = h5py.string_dtype()
        elif dim is not None and variable.dtype == "float32" and _shrinks(array):
            row = 4 * int(np.prod(shape[1:]))
            extra = COMPRESSION | {"chunks": (min(shape[0], max(1, CHUNK_BYTES // row)), *shape[1:])}
        made = group.create_variable(name, variable.dims, dtype, **extra)
        made.attrs.update(variable.attributes)
        if "vertex" in variable.dims and name != PLACES:
            made.attrs["coordinates"] = PLACES
        if variable.dtype == "bool":
            made.attrs["dtype"] = "bool"
        return made


def image(arrays: Checked, attributes: Attributes) -> bytes:
    """Return an HDF5 file of some groups, as bytes, without the dimensions of netCDF, which take ten times as long."""
    memory = io.BytesIO()
    with h5py.File(memory, "w", track_order=True) as file:
        for path in ordered(["/", *arrays, *attributes]):
            group = file
            for name in path.split("/")[1:] if path != "/" else ():
                group = group[name] if name in group else group.create_group(name, track_order=True)
            group.attrs.update({name: storable(value) for name, value in attributes.get(path, {}).items()})
            for name, array in arrays.get(path, {}).items():
                values = _stored(array)
                group.create_dataset(name, data=values, dtype=h5py.string_dtype() if values.dtype == object else None)
    return memory.getvalue()


def read_image(
    data: bytes | Path, *, static: bool = True, records: bool = True
) -> tuple[Checked, dict[str, dict[str, Any]]]:
    """Read arrays and attributes of a result file, or of one made by `image`; static, records: which arrays.

    This uses h5py, because h5netcdf takes ten times as long to open a file.
    """
    arrays: Checked = {}
    attributes: dict[str, dict[str, Any]] = {}
    with h5py.File(data if isinstance(data, Path) else io.BytesIO(data), "r") as file:
        for path, group in _groups(file, "/"):
            schema = variables_of(path)
            # netCDF stores a number as an array of one
            attributes[path] = {
                name: value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
                for name, value in group.attrs.items()
                if not name.startswith("_")
            }
            arrays[path] = {}
            for name in [name for name in schema if name in group]:
                requested = static if record_of(schema[name]) is None else records
                if requested and not _without_values(group[name]):
                    node, kind = group[name], schema[name].dtype
                    arrays[path][name] = np.asarray(node.asstr()[...] if kind == "str" else node[...]).astype(kind)
    return arrays, attributes


def read_lengths(data: bytes) -> dict[str, int]:
    """Return the number of records along each record dimension in a file made by `image`."""
    with h5py.File(io.BytesIO(data), "r") as file:
        return {dim: len(file[dim]) if dim in file else 0 for dim in RECORDS}


@contextmanager
def result_file(path: Path, lengths: dict[str, int]) -> Iterator[tuple[ResultWriter, SpillingFile]]:
    """Yield the writer of a new result file, and the file. Raises OSError afterwards if the disk was full."""
    disk = SpillingFile(path)
    try:
        with h5netcdf.File(disk, "w") as file:
            yield ResultWriter(file, lengths), disk
    finally:
        disk.close()
    if disk.lost is not None:
        raise disk.lost


def read_attributes(path: Path) -> dict[str, Any] | None:
    """Return the attributes of the root of a file; None if it is damaged, incomplete, missing or not netCDF."""
    try:
        with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
            return dict(file.attrs) | {"_variables": tuple(file.variables)}
    except UNREADABLE:
        return None


def record_of(variable: Variable) -> str | None:
    """Return the record dimension of a variable, which is its first, or None."""
    return variable.dims[0] if variable.dims and variable.dims[0] in RECORDS else None


def joined(blocks: list[Checked]) -> Checked:
    """Join blocks along the record dimension of each variable; of other variables keep the last."""
    parts: dict[str, dict[str, list[NDArray[Any]]]] = {}
    for block in blocks:
        for path, variables in block.items():
            schema = variables_of(path)
            into = parts.setdefault(path, {})
            for name, array in variables.items():
                if record_of(schema[name]) is None:
                    into[name] = [array]
                elif len(array):
                    into.setdefault(name, []).append(array)
    return {
        path: {name: np.concatenate(list_) if len(list_) > 1 else list_[0] for name, list_ in variables.items()}
        for path, variables in parts.items()
    }


def storable(value: object) -> object:
    """Return a value that netCDF can store as an attribute; other values become JSON text."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, str | int | float | np.number):
        return json.dumps(value, default=json_value)
    return value


def _groups(file: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Return the root and the groups of instances; the groups between them are empty."""
    if path == "/" or path.count("/") == 2:
        yield path, file
    for name, member in file.items():
        if isinstance(member, h5py.Group):
            yield from _groups(member, f"{path.rstrip('/')}/{name}")


def _shrinks(values: NDArray[np.float32]) -> bool:
    """Return whether compression, as of COMPRESSION, is worthwhile, by the last values."""
    shuffled = values.ravel()[-SAMPLE:].view(np.uint8).reshape(-1, 4).T.tobytes()
    return len(zlib.compress(shuffled, 1)) < WORTHWHILE * len(shuffled)


def _without_values(dataset: Any) -> bool:
    """Return whether a netCDF entry is only the length of a dimension, without a variable."""
    return bytes(dataset.attrs.get("NAME", b"")).startswith(b"This is a netCDF dimension but not a netCDF variable")


def _stored(array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype == np.bool_:
        return array.astype(np.int8)
    return array.astype(object) if array.dtype.kind == "U" else array
