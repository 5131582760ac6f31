# Schema 1: for the old recorder, and deleted with it.
"""Results on disk that survive Ctrl-C, kill -9 and a full disk.

A run writes self-contained chunks into `.partial`; `finish` (or, after a kill, `recover`) joins them into `result.nc`.
HDF5 crashes the interpreter when its disk fills up, so every file is made in memory and written with plain file calls.
Each file in `.partial` is a netCDF file with the SHA-256 of its content behind it (which netCDF readers pass over), so
that damage of any kind is seen.
"""

import hashlib
import io
import json
import os
import shutil
import time
import uuid
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import xarray as xr

from palmfield.errors import OutputError
from palmfield.outputs.v1_schema import RECORDS

FLUSH_BYTES = 8_000_000
FLUSH_SECONDS = 2.0
COMPRESSION: dict[str, Any] = {"zlib": True, "complevel": 1}
SEAL_BYTES = hashlib.sha256().digest_size
RESULT_CHUNK_BYTES = 1_000_000
ENGINE: Any = "h5netcdf"


class Store:
    """Files of one run: `static` at once, blocks along `time`, `frame` and `step_time` as they come.

    out: folder of the result, made where missing; an older result.nc in it is replaced only by `finish`
    static: variables without a record dimension; its attributes go into the result
    Raises OutputError where `out` cannot be written or holds an unfinished run.
    """

    def __init__(self, out: Path, static: xr.Dataset) -> None:
        self.out = Path(out)
        self.partial = self.out / ".partial"
        self._state: tuple[int, list[xr.Dataset]] = (0, [])
        self._names: dict[str, set[str]] = {}
        self._sizes = {str(dim): length for dim, length in static.sizes.items()}
        self._lost = ""
        self._flushed_at = time.monotonic()
        try:
            self.partial.mkdir(parents=True)
        except FileExistsError as error:
            if not self.partial.is_dir():
                raise _unwritable(self.out, error) from error
            raise OutputError(
                f"{self.out} holds an unfinished run (or one that still writes); "
                f"`palmfield recover {self.out}` first or choose another folder"
            ) from error
        except OSError as error:
            raise _unwritable(self.out, error) from error
        try:
            _write_sealed(self.partial / "static.nc", _image(static.assign_attrs(run_id=uuid.uuid4().hex)))
        except OSError as error:
            shutil.rmtree(self.partial)
            raise _unwritable(self.out, error) from error

    def append(self, block: xr.Dataset) -> None:
        """Take a block; flushed to disk after 8 MB or 2 s.

        Variables without a record dimension (such as surface_arp) replace earlier ones. All blocks along a dimension
        must hold the same variables, and other dimensions keep the length of `static`. Raises OutputError where they
        do not, and where a flush fails.
        """
        for name, length in block.sizes.items():
            if name not in RECORDS and self._sizes.setdefault(str(name), length) != length:
                raise OutputError(
                    f"a block has {length} along '{name}' where the run has {self._sizes[str(name)]}; "
                    "give blocks of one mesh and one array"
                )
        for dim in RECORDS:
            if block.sizes.get(dim, 0) == 0:
                continue
            names = {str(name) for name, variable in block.variables.items() if dim in variable.dims}
            expected = self._names.setdefault(dim, names)
            if names != expected:
                raise OutputError(
                    f"a block along '{dim}' holds {', '.join(sorted(names))}; "
                    f"earlier ones held {', '.join(sorted(expected))}: give the same variables in every block"
                )
        self._state[1].append(block.copy(deep=True))
        waiting = sum(b.nbytes for b in self._state[1])
        if waiting > FLUSH_BYTES or time.monotonic() - self._flushed_at > FLUSH_SECONDS:
            self._flush()

    def finish(self, attrs: dict[str, Any], complete: bool) -> Path:
        """Join what was appended into out/result.nc and remove .partial; returns the result's path.

        attrs: attributes of the result; `reason` says why the run ended; `complete` becomes 1 or 0
        Raises OutputError where there is no room for the result; .partial then stays for `palmfield recover`.
        """
        try:
            self._flush()
        except OutputError as error:
            self._lost = str(error)
        if self._lost:
            complete = False
            attrs = attrs | {"reason": f"{attrs.get('reason', '')} {self._lost}".strip()}
        return _assemble(self.out, attrs, complete)

    def _flush(self) -> None:
        count, blocks = self._state
        if not blocks:
            return
        path = self.partial / f"chunk_{count + 1:06d}.nc"
        try:
            _write_sealed(path, _image(_join(blocks)))
        except OSError as error:
            raise OutputError(
                f"cannot write {path}: {error.strerror or error}; {count} earlier chunks are safe, "
                f"free some space and run `palmfield recover {self.out}`"
            ) from error
        # One assignment: Ctrl-C must not fall between counting a chunk and letting go of its blocks.
        self._state = (count + 1, [])
        self._flushed_at = time.monotonic()


def recover(out: Path) -> Path:
    """Join what a killed run left in out/.partial into out/result.nc, marked as incomplete; returns its path.

    Chunks that cannot be read are left out; the attributes `reason` and `unreadable_chunks` say how many.
    Raises OutputError where there is nothing to recover or no room for the result.
    """
    out = Path(out)
    partial = out / ".partial"
    if not partial.is_dir():
        raise OutputError(f"{out} holds no unfinished run (no .partial folder in it); name the folder of the run")
    static = _read_sealed(partial / "static.nc")
    if static is None:
        raise OutputError(
            f"{partial} has no readable static.nc: the run ended before its first data; delete {partial} to go on"
        )
    result = out / "result.nc"
    finished = _read(result) if result.exists() else None
    if finished is not None and finished.attrs.get("run_id") == static.attrs["run_id"]:
        shutil.rmtree(partial)
        return result
    return _assemble(out, {"reason": "recovered after the run was cut off"}, complete=False)


def load(path: Path) -> xr.Dataset:
    """Read a result file into memory, times as plain seconds. Raises OutputError where it cannot be read."""
    found = _read(Path(path))
    if found is None:
        raise OutputError(f"{path} is not a readable result file; name a result.nc that palmfield wrote")
    return found


def write_json(path: Path, obj: object) -> None:
    """Write JSON in one atomic step; NumPy scalars and arrays become numbers and lists.

    Raises OutputError for what JSON cannot hold (NaN included) and where the file cannot be written.
    """
    try:
        text = json.dumps(obj, indent=2, default=_plain, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise OutputError(
            f"cannot write {path} as JSON: {error}; give finite numbers, text, lists and dicts"
        ) from error
    try:
        _write(Path(path), text.encode() + b"\n")
    except OSError as error:
        raise _unwritable(Path(path), error) from error


def _unwritable(path: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write {path}: {error.strerror or error}; choose a folder on a disk with room for it")


def _plain(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")


def _safe(value: object) -> object:
    """Value that netCDF can hold as an attribute; what it cannot becomes JSON text."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, str | int | float | np.number):
        return json.dumps(value, default=_plain)
    return value


def _write(path: Path, data: bytes | memoryview) -> None:
    temporary = path.with_name(path.name + ".tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def _write_sealed(path: Path, data: bytes | memoryview) -> None:
    _write(path, bytes(data) + hashlib.sha256(data).digest())


def _image(ds: xr.Dataset) -> bytes | memoryview:
    """The netCDF file of a dataset, as bytes."""
    safe = ds.copy()
    safe.attrs = {key: _safe(value) for key, value in ds.attrs.items()}
    packed = {
        name: COMPRESSION
        for name, variable in ds.variables.items()
        if variable.dtype == np.float32 and variable.size and set(variable.dims) & set(RECORDS)
    }
    return safe.to_netcdf(None, engine=ENGINE, encoding=packed)


def _read(path: Path) -> xr.Dataset | None:
    """Dataset of a file, or None where it is damaged, half written or missing."""
    try:
        with xr.open_dataset(path, engine=ENGINE, decode_times=False) as ds:
            return ds.load()
    except (OSError, ValueError, KeyError, RuntimeError):
        return None


def _read_sealed(path: Path) -> xr.Dataset | None:
    """Dataset of a file in .partial, or None where it is missing or not what was written."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    content, seal = data[:-SEAL_BYTES], data[-SEAL_BYTES:]
    if hashlib.sha256(content).digest() != seal:
        return None
    with xr.open_dataset(io.BytesIO(content), engine=ENGINE, decode_times=False) as ds:
        return ds.load()


def _record(variable: xr.Variable) -> str | None:
    return next((dim for dim in RECORDS if dim in variable.dims), None)


def _join(blocks: list[xr.Dataset]) -> xr.Dataset:
    """One dataset of many: joined along each variable's record dimension, the last one kept where there is none."""
    parts: dict[str, list[xr.Variable]] = {}
    for block in blocks:
        for name, variable in block.variables.items():
            dim = _record(variable)
            if dim is None:
                parts[str(name)] = [variable]
            elif variable.sizes[dim]:
                parts.setdefault(str(name), []).append(variable)
    joined = {
        name: xr.Variable.concat(list_, _record(list_[0])) if _record(list_[0]) else list_[0]
        for name, list_ in parts.items()
    }
    coords = {str(name) for block in blocks for name in block.coords} & joined.keys()
    return xr.Dataset({k: v for k, v in joined.items() if k not in coords}, {k: joined[k] for k in coords})


def _assemble(out: Path, attrs: dict[str, Any], complete: bool) -> Path:
    partial = out / ".partial"
    static = _read_sealed(partial / "static.nc")
    if static is None:
        raise OutputError(f"{partial}/static.nc is gone or damaged; the chunks beside it are plain netCDF files")
    found = sorted(partial.glob("chunk_*.nc"))
    chunks: list[Path] = []
    lengths = dict.fromkeys(RECORDS, 0)
    head = static
    for path in found:
        ds = _read_sealed(path)
        if ds is None:
            continue
        chunks.append(path)
        for dim in RECORDS:
            lengths[dim] += ds.sizes.get(dim, 0)
        head = _join([head, ds.drop_dims(set(RECORDS) & set(ds.dims))])
    bad = len(found) - len(chunks) + len(list(partial.glob("chunk_*.nc.tmp")))
    reason = str(attrs.get("reason", ""))
    if bad:
        reason = f"{reason}; {bad} of {len(chunks) + bad} chunks could not be read".strip("; ")
    head.attrs = static.attrs | attrs
    head.attrs |= {"complete": int(complete and not bad), "reason": reason, "unreadable_chunks": bad}
    try:
        _write(out / "result.nc", _concatenated(head, chunks, lengths))
    except OSError as error:
        raise OutputError(
            f"cannot write {out / 'result.nc'}: {error.strerror or error}; {len(chunks)} chunks are safe in {partial}: "
            f"free some space and run `palmfield recover {out}`"
        ) from error
    shutil.rmtree(partial)
    return out / "result.nc"


def _concatenated(head: xr.Dataset, chunks: list[Path], lengths: dict[str, int]) -> memoryview:
    """The result file's bytes: `head`, then the record variables of one chunk after the other."""
    image = io.BytesIO(bytes(_image(head)))
    with h5netcdf.File(image, "a", decode_vlen_strings=True) as file:
        start = dict.fromkeys(RECORDS, 0)
        for path in chunks:
            ds = _read_sealed(path)
            if ds is None:
                raise OutputError(f"{path} changed while it was read; stop what writes there and try again")
            for name, variable in ds.variables.items():
                dim = _record(variable)
                if dim is not None:
                    _put(file, str(name), variable, start[dim], lengths[dim])
            for dim in RECORDS:
                start[dim] += ds.sizes.get(dim, 0)
    return image.getbuffer()


def _put(file: Any, name: str, variable: xr.Variable, start: int, total: int) -> None:
    """Write one chunk's part of a record variable into the open result, making the variable on first use."""
    if name not in file.variables:
        for dim, length in zip(variable.dims, (total, *variable.shape[1:]), strict=True):
            if dim not in file.dimensions:
                file.dimensions[dim] = length
        row = variable.dtype.itemsize * int(np.prod(variable.shape[1:]))
        rows = min(total, max(1, RESULT_CHUNK_BYTES // row))
        packing = {"compression": "gzip", "compression_opts": COMPRESSION["complevel"], "shuffle": True}
        created = file.create_variable(
            name,
            variable.dims,
            variable.dtype,
            chunks=(rows, *variable.shape[1:]),
            **(packing if variable.dtype == np.float32 else {}),
        )
        created.attrs.update(variable.attrs)
        if "frame" in variable.dims and name != "frame_time":
            created.attrs["coordinates"] = "frame_time"
    file.variables[name][start : start + len(variable)] = variable.values
