"""Write results as netCDF files so that HDF5 never writes to a disk itself.

HDF5 crashes the interpreter if the disk is full. So small files are made in memory. Large files use a file object that
keeps the data that it cannot write. HDF5 then gets no error, and this module raises the error afterwards.
"""

import io
import json
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping
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
"""Size of a compressed chunk [bytes].

A chunk fits in the HDF5 cache of 1 MiB per variable, so it is full when compressed.
"""
SAMPLE, WORTHWHILE = 32_768, 0.67
"""Number of values that are compressed on trial, and size ratio below which a variable is stored compressed.

Fields and motion have a ratio of about 0.8, because their last digits are noise. Compressing and reading them would
take seconds.
"""
COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
NOT_A_VARIABLE = "This is a netCDF dimension but not a netCDF variable."
"""Title of a scale without values."""
UNREADABLE = (OSError, ValueError, KeyError, RuntimeError, TypeError)


class SpillingFile(io.RawIOBase):
    """A file on disk whose writing never fails.

    If the disk is full, data stay in memory, and `lost` contains the reason.
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
        """Do nothing, because no data are buffered."""

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
    """Writes groups, static variables, and successive parts of record variables.

    Each group has its own dimensions. h5py writes the dimension scales with the attributes of netCDF-4, because
    h5netcdf takes three times as long.
    """

    def __init__(self, file: h5py.File, lengths: dict[str, int]) -> None:
        """lengths: number of records along each record dimension"""
        self._file, self._lengths = file, lengths
        self._groups: dict[str, Any] = {"/": file}
        self._variables: dict[tuple[str, str], Any] = {}
        self._scales: dict[tuple[str, str], tuple[Any, int]] = {}
        file.attrs["_NCProperties"] = np.bytes_(f"version=2,hdf5={h5py.version.hdf5_version},h5py={h5py.__version__}")
        for dim, length in lengths.items():
            if length:
                self._scale("/", dim, length)

    def groups(self, paths: Iterable[str], attributes: Attributes) -> None:
        """Make groups in the order of the schema, with attributes; values that netCDF cannot store become JSON text."""
        for path in ordered([*paths, *attributes]):
            pairs = attributes.get(path, {})
            _set_attributes(self._group(path), {name: storable(value) for name, value in pairs.items()})

    def labels(self) -> None:
        """Write the names of components, in the root."""
        for name in LABELS:
            self._scale("/", name, len(LABELS[name][0]))

    def put(self, arrays: Checked, start: dict[str, int]) -> None:
        """Write variables. Of a variable along a record dimension, this writes the part that begins at `start`."""
        for path, variables in arrays.items():
            schema = variables_of(path)
            # Variables that are the coordinates of their dimension come before those that use it
            for name in sorted(variables, key=lambda name: schema[name].dims != (name,)):
                self._fill(self._made(path, name, schema[name], variables[name]), schema[name], variables[name], start)
            if path != "/":
                self._put_times(path, {record_of(schema[name]) for name in variables}, arrays.get("/", {}), start)

    def _put_times(
        self, path: str, dims: set[str | None], times: dict[str, NDArray[Any]], start: dict[str, int]
    ) -> None:
        """Write the record times of a group, so that the group can be opened without the root."""
        for dim in RECORDS:
            if dim in dims and dim in times:
                self._fill(self._made(path, dim, ROOT[dim], times[dim]), ROOT[dim], times[dim], start)

    def _fill(self, made: Any, variable: Variable, array: NDArray[Any], start: dict[str, int]) -> None:
        values, dim = _stored(array), record_of(variable)
        if dim is None:
            made[...] = values
        else:
            made[start[dim] : start[dim] + len(values)] = values

    def _group(self, path: str) -> Any:
        if path not in self._groups:
            outer, _, name = path.rpartition("/")
            self._groups[path] = self._group(outer or "/").create_group(name, track_order=True)
        return self._groups[path]

    def _made(self, path: str, name: str, variable: Variable, array: NDArray[Any]) -> Any:
        """Return a variable of a group; a new variable is created. array: its first part"""
        if (path, name) not in self._variables:
            self._variables[path, name] = self._create(path, name, variable, array)
        return self._variables[path, name]

    def _create(self, path: str, name: str, variable: Variable, array: NDArray[Any]) -> Any:
        dim, dims = record_of(variable), variable.dims
        shape = array.shape if dim is None else (self._lengths[dim], *array.shape[1:])
        extra: dict[str, Any] = {}
        dtype: Any = np.dtype("int8") if variable.dtype == "bool" else variable.dtype
        if dtype == "str":
            dtype = h5py.string_dtype()
        elif dim is not None and variable.dtype == "float32" and _shrinks(array):
            row = 4 * int(np.prod(shape[1:]))
            extra = COMPRESSION | {"chunks": (min(shape[0], max(1, CHUNK_BYTES // row)), *shape[1:])}
        if 0 in shape:
            extra["maxshape"] = tuple(length or None for length in shape)
        scales = [self._scale(path, *one) for one in zip(dims, shape, strict=True)] if dims != (name,) else []
        made = self._group(path).create_dataset(name, shape, dtype, track_order=True, **extra)
        if dims == (name,):
            self._make_scale(path, name, made, name)
        for axis, (scale, _) in enumerate(scales):
            made.dims[axis].attach_scale(scale)
        if scales:
            _set_numbers(made, [number for _, number in scales])
        _set_attributes(made, variable.attributes)
        if "vertex" in dims and name != PLACES:
            made.attrs["coordinates"] = PLACES
        if variable.dtype == "bool":
            made.attrs["dtype"] = "bool"
        return made

    def _scale(self, path: str, dim: str, length: int) -> tuple[Any, int]:
        """Return the scale of a dimension of a group, and its number. A new scale has times, names or no values."""
        if (path, dim) in self._scales:
            return self._scales[path, dim]
        if dim in LABELS:
            names, what = LABELS[dim]
            made = self._group(path).create_dataset(
                dim, data=np.array(names, dtype=object), dtype=h5py.string_dtype(), track_order=True
            )
            self._make_scale(path, dim, made, dim)
            made.attrs["long_name"] = what
        elif dim in RECORDS:
            self._made(path, dim, ROOT[dim], np.zeros(0))
        else:
            # In netCDF a dimension without length is unlimited
            limit = {} if length else {"maxshape": (None,)}
            made = self._group(path).create_dataset(dim, (length,), ">f4", track_order=True, **limit)
            self._make_scale(path, dim, made, f"{NOT_A_VARIABLE}{length:10}")
        return self._scales[path, dim]

    def _make_scale(self, path: str, dim: str, dataset: Any, title: str) -> None:
        number = len(self._scales)
        self._scales[path, dim] = dataset, number
        dataset.make_scale(title)
        _set_numbers(dataset, [number] if title == dim else [], number)


def _set_numbers(dataset: Any, dimensions: list[int], own: int | None = None) -> None:
    """Set the dimension numbers of a variable. own: number of the dimension, if the dataset is itself a scale"""
    if dimensions:
        dataset.attrs["_Netcdf4Coordinates"] = np.array(dimensions, np.int32)
    dataset.attrs["_Netcdf4Dimid"] = np.int32(dimensions[0] if own is None else own)


def _set_attributes(thing: Any, attributes: Mapping[str, Any]) -> None:
    """Set attributes of a group or variable in the way of netCDF: a number becomes an array with one element."""
    for name, value in attributes.items():
        thing.attrs[name] = value if isinstance(value, str) else np.atleast_1d(value)


def image(arrays: Checked, attributes: Attributes) -> bytes:
    """Return an HDF5 file of some groups, as bytes. It has no netCDF dimensions, which would take ten times as long."""
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
    """Read arrays and attributes of a result file, or of a file made by `image`.

    static, records: whether to read arrays without and with a record dimension
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
        with h5py.File(disk, "w", track_order=True) as file:
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
    """Return the record dimension of a variable, which is always its first dimension; None if it has none."""
    return variable.dims[0] if variable.dims and variable.dims[0] in RECORDS else None


def joined(blocks: list[Checked]) -> Checked:
    """Join blocks along the record dimension of each variable. Other variables keep the value of the last block."""
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
    """Return the root and the groups of instances, without the empty groups between them."""
    if path == "/" or path.count("/") == 2:
        yield path, file
    for name, member in file.items():
        if isinstance(member, h5py.Group):
            yield from _groups(member, f"{path.rstrip('/')}/{name}")


def _shrinks(values: NDArray[np.float32]) -> bool:
    """Return whether compression with COMPRESSION is worthwhile. This is tested on the last values."""
    shuffled = values.ravel()[-SAMPLE:].view(np.uint8).reshape(-1, 4).T.tobytes()
    return len(zlib.compress(shuffled, 1)) < WORTHWHILE * len(shuffled)


def _without_values(dataset: Any) -> bool:
    """Return whether a netCDF entry is only the length of a dimension, without a variable."""
    return bytes(dataset.attrs.get("NAME", b"")).startswith(NOT_A_VARIABLE.encode())


def _stored(array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype == np.bool_:
        return array.astype(np.int8)
    return array.astype(object) if array.dtype.kind == "U" else array
