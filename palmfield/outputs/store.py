"""Results on disk that survive Ctrl-C, kill -9 and a full disk.

A run writes complete chunks into `.partial`; `finish` (or, after a kill, `recover`) joins them into `result.nc`. Each
file in `.partial` is an HDF5 file followed by the SHA-256 of its content (which HDF5 readers ignore), so that damage is
detected. `netcdf.py` describes how files are written without HDF5.
"""

import hashlib
import json
import os
import shutil
import time
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from palmfield.errors import OutputError, reason_of, unwritable
from palmfield.files import writing
from palmfield.interrupts import interrupts_delayed
from palmfield.outputs.netcdf import (
    UNREADABLE,
    image,
    joined,
    read_attributes,
    read_image,
    read_lengths,
    record_of,
    result_file,
)
from palmfield.outputs.schema import (
    RECORDS,
    SCHEMA_VERSION,
    Arrays,
    Attributes,
    Checked,
    check,
    root_attributes,
    tree,
    variables_of,
)
from palmfield.types import json_value

RESULT = "result.nc"
DERIVED = ("summary.json", "pressure.png", "displacement.png", "scene.png", "scene.usdc", "scene.partial.usdc")
"""Files that are made from the result of a run."""
FLUSH_BYTES = 8_000_000
FLUSH_SECONDS = 2.0
SEAL_BYTES = hashlib.sha256().digest_size
ENGINE: Any = "h5netcdf"
WHOLE_BYTES = 100_000_000
"""Size of a new result up to which it is read completely, or stays in memory."""


class _Waiting(NamedTuple):
    """Blocks that are not yet on the disk. chunks: number of files written before"""

    chunks: int
    blocks: list[Checked]


class _Blocks:
    """Checks blocks, for all kinds of stores."""

    def __init__(self, static: Arrays) -> None:
        self._sizes: dict[tuple[str, str], int] = {}
        self._names: dict[tuple[str, str], set[str]] = {}
        self._last = dict.fromkeys(RECORDS, -np.inf)
        self.static = check(static, self._sizes)

    def checked(self, block: Arrays) -> Checked:
        """Check a block against earlier blocks, and return a copy that cannot change.

        The errors are those of `Store.append`.
        """
        sizes, last, names_by_path = dict(self._sizes), dict(self._last), dict(self._names)
        checked = check(block, sizes)
        for dim in RECORDS:
            times = checked.get("/", {}).get(dim)
            if times is None or len(times) == 0:
                continue
            if not (times[0] > last[dim] and (times[1:] > times[:-1]).all()):
                raise OutputError(
                    f"'{dim}' does not rise: a block begins at {times[0]:g} s after {last[dim]:g} s; give rising "
                    "times, each once"
                )
            last[dim] = float(times[-1])
        for path, variables in checked.items():
            schema = variables_of(path)
            for dim in RECORDS if path != "/" else ():
                names = {name for name in variables if record_of(schema[name]) == dim}
                expected = names_by_path.setdefault((path, dim), names) if names else names
                if names != expected:
                    raise OutputError(
                        f"a block contains {', '.join(sorted(names))} of '{path}' along '{dim}', but earlier blocks "
                        f"contained {', '.join(sorted(expected))}: give the same variables in every block"
                    )
        self._sizes, self._last, self._names = sizes, last, names_by_path
        return {path: {n: _constant(a) for n, a in variables.items()} for path, variables in checked.items()}


def _constant(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array itself if it is read-only, and otherwise a copy."""
    return array.copy() if array.flags.writeable else array


def refuse_occupied(out: Path, overwrite: bool) -> None:
    """Raise OutputError for a folder with an unfinished run or, without `overwrite`, with results of another run."""
    if (out / ".partial").is_dir():
        raise OutputError(
            f"{out} contains an unfinished run, or one that is still running; use `palmfield recover {out}` first, or "
            "choose another folder"
        )
    present = [name for name in (RESULT, *DERIVED) if (out / name).exists()]
    if present and not overwrite:
        raise OutputError(
            f"{out} contains {', '.join(present)} of another run; choose another folder, or replace the files with "
            "--overwrite (overwrite=True)"
        )


class Store:
    """Files of one run: `static` data first, then blocks along `time`, `step_time` and `frame_time`.

    out: folder of the result, created if missing
    static: arrays by group and variable from before the first step (outputs/schema.py)
    attributes: attributes of groups; those of "/" are of the whole result: settings, versions
    overwrite: whether `finish` may replace results of another run in the folder
    lost: reason why blocks are missing from the result of `finish`, or None
    Raises OutputError if `out` cannot be written, and if it contains an unfinished run or, without `overwrite`, results
    of another run.
    """

    def __init__(
        self, out: Path, static: Arrays, attributes: Attributes | None = None, overwrite: bool = False
    ) -> None:
        self.out = Path(out)
        self.partial = self.out / ".partial"
        self._blocks = _Blocks(static)
        self._waiting = _Waiting(0, [])
        self._waiting_bytes = 0
        self.lost: OutputError | None = None
        self._flushed_at = time.monotonic()
        refuse_occupied(self.out, overwrite)
        try:
            self.partial.mkdir(parents=True)
        except FileExistsError as error:
            refuse_occupied(self.out, overwrite)
            raise unwritable(self.out, error) from error
        except OSError as error:
            raise unwritable(self.out, error) from error
        own = dict(attributes or {})
        own["/"] = root_attributes() | {"run_id": uuid.uuid4().hex} | dict(own.get("/", {}))
        try:
            _write_sealed(self.partial / "static.nc", image(self._blocks.static, own))
        except OSError as error:
            shutil.rmtree(self.partial)
            raise unwritable(self.out, error) from error

    def append(self, block: Arrays) -> None:
        """Append a block; writable arrays are copied. Blocks are flushed to disk after 8 MB or 2 s.

        block: plain arrays by group and variable; those along `time`, `step_time` or `frame_time` need these times in
            the root ("/"). Other variables (such as loudest_arp) replace their earlier values
        All blocks must have the same variables along a dimension, equal lengths of other dimensions, and rising times.
        Raises OutputError otherwise, and if a flush fails.
        """
        checked = self._blocks.checked(block)
        self._waiting.blocks.append(checked)
        self._waiting_bytes += sum(array.nbytes for variables in checked.values() for array in variables.values())
        if self._waiting_bytes > FLUSH_BYTES or time.monotonic() - self._flushed_at > FLUSH_SECONDS:
            self._flush()

    def finish(self, attributes: Mapping[str, Any], complete: bool) -> Path:
        """Join all blocks into out/result.nc and remove .partial; return the path of the result.

        attributes: additional attributes of the result; `reason` describes why the run ended; `complete` becomes 1 or
        0. If the last blocks cannot be flushed, they are lost. The result is then marked incomplete and reports this,
        and `lost` is set. Files that were made from the result of an earlier run are removed. Raises OutputError if the
        disk is full; .partial then remains for `palmfield recover`.
        """
        try:
            self._flush()
        except OutputError as error:
            cause = reason_of(error.__cause__ or error)
            self.lost = OutputError(
                f"the last blocks of {self.out} are lost: {cause}; free some space and run the scene again"
            )
            self.lost.__cause__ = error
        attributes = dict(attributes)
        if self.lost is not None:
            complete = False
            reason = str(attributes.get("reason", ""))
            attributes["reason"] = f"{reason}; {self.lost}".strip("; ")
        return _assemble(self.out, attributes, complete)

    def _flush(self) -> None:
        count, blocks = self._waiting
        if not blocks:
            return
        path = self.partial / f"chunk_{count + 1:06d}.nc"
        try:
            _write_sealed(path, image(joined(blocks), {}))
        except OSError as error:
            raise OutputError(
                f"cannot write {path}: {reason_of(error)}; {count} earlier chunks are safe, "
                f"free some space and run `palmfield recover {self.out}`"
            ) from error
        # One assignment, so that Ctrl-C cannot occur between counting a chunk and releasing its blocks
        self._waiting = _Waiting(count + 1, [])
        self._waiting_bytes = 0
        self._flushed_at = time.monotonic()


class MemoryStore:
    """A `Store` for results in memory. lost: always None"""

    lost: OutputError | None = None

    def __init__(self, static: Arrays, attributes: Attributes | None = None) -> None:
        self._blocks = _Blocks(static)
        self._attributes = dict(attributes or {})
        self._blocks_in_memory: list[Checked] = []

    def append(self, block: Arrays) -> None:
        """Append a block as in `Store.append`, without a flush."""
        self._blocks_in_memory.append(self._blocks.checked(block))

    def finish(self, attributes: Mapping[str, Any], complete: bool) -> xr.DataTree:
        """Return the result as `open_result` does, completely in memory."""
        own = dict(self._attributes.get("/", {})) | dict(attributes) | {"complete": int(complete)}
        whole = joined([self._blocks.static, *self._blocks_in_memory])
        for variables in whole.values():
            variables |= {name: np.require(array, requirements="W") for name, array in variables.items()}
        return tree(whole, self._attributes | {"/": own})


def recover(out: Path) -> Path:
    """Join the data of a killed run in out/.partial into out/result.nc, marked as incomplete; return its path.

    Chunks that cannot be read are skipped; the attributes `reason` and `unreadable_chunks` give their number.
    Raises OutputError if there is no data to recover or the disk is full.
    """
    out = Path(out)
    partial = out / ".partial"
    if not partial.is_dir():
        raise OutputError(f"{out} contains no unfinished run (it has no .partial folder); give the folder of the run")
    _, attributes = _static(partial)
    finished = read_attributes(out / RESULT)
    if finished is not None and finished.get("run_id") == attributes["/"]["run_id"]:
        shutil.rmtree(partial)
        return out / RESULT
    return _assemble(out, {"reason": "recovered after the run was interrupted"}, complete=False)


def open_result(path: str | Path) -> xr.DataTree:
    """Open a result file, or that in the folder of a run; arrays are read on use.

    `tree["skin/palm"]["displacement"].isel(time=-1).values` reads one time; times are in seconds. Close it with
    `.close()`, or use it in a `with`. Raises OutputError for a file that cannot be read or has another schema.
    """
    path = Path(path)
    path = path / RESULT if path.is_dir() else path
    attributes = read_attributes(path)
    if attributes is None:
        raise OutputError(f"{path} is not a readable result file; give a {RESULT} that palmfield wrote")
    version = attributes.get("schema_version")
    if version is None and "skin_position" in attributes["_variables"]:
        raise OutputError(
            f"{path} has schema 1 (one skin per scene), but this palmfield reads schema {SCHEMA_VERSION}; run its "
            "scene again, or read the file with xarray.open_dataset"
        )
    if version is None:
        raise OutputError(f"{path} is a netCDF file that palmfield did not write; give a {RESULT} of a run")
    if int(version) != SCHEMA_VERSION:
        raise OutputError(
            f"{path} has schema {version}, but this palmfield reads schema {SCHEMA_VERSION}; use the palmfield "
            "version that wrote it, or run its scene again"
        )
    try:
        return xr.open_datatree(path, engine=ENGINE, decode_times=False)
    except UNREADABLE as error:
        raise OutputError(f"{path} is damaged: {error}; run its scene again") from error


def finished_result(path: Path) -> xr.DataTree:
    """Return the result of a run that has just ended, as `open_result` does. A small result is read completely.

    Reading it completely takes a fifth of the time.
    """
    return tree(*read_image(path)) if path.stat().st_size <= WHOLE_BYTES else open_result(path)


def write_json(path: Path, obj: object) -> None:
    """Write a JSON file in one atomic step. NumPy scalars and arrays become numbers and lists.

    Raises OutputError for values that JSON cannot store (such as NaN) and if the file cannot be written.
    """
    try:
        text = json.dumps(obj, indent=2, default=json_value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise OutputError(
            f"cannot write {path} as JSON: {error}; give finite numbers, text, lists and dicts"
        ) from error
    write_whole(Path(path), text.encode() + b"\n")


def write_whole(path: Path, data: bytes) -> None:
    """Write a file in one atomic step. Raises OutputError if that fails."""
    with writing(path):
        _write(path, data)


def _write(path: Path, data: bytes) -> None:
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


def _write_sealed(path: Path, data: bytes) -> None:
    _write(path, data + hashlib.sha256(data).digest())


def _sealed(path: Path) -> bytes | None:
    """Return the content of a file in .partial, or None if it is missing or damaged."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    content, seal = data[:-SEAL_BYTES], data[-SEAL_BYTES:]
    return content if hashlib.sha256(content).digest() == seal else None


def _static(partial: Path) -> tuple[Checked, dict[str, dict[str, Any]]]:
    """Return data from before the first step. Raises OutputError if missing, damaged or of another schema."""
    content = _sealed(partial / "static.nc")
    if content is None:
        raise OutputError(
            f"{partial} has no readable static.nc, because the run ended before its first data; delete {partial} "
            "to continue"
        )
    version = read_image(content, static=False, records=False)[1]["/"].get("schema_version", 1)
    if version != SCHEMA_VERSION:
        raise OutputError(
            f"{partial} was written by a palmfield version with schema {version}, but this version has "
            f"{SCHEMA_VERSION}; recover it with the earlier version, or delete {partial}"
        )
    return read_image(content)


def _assemble(out: Path, attributes: dict[str, Any], complete: bool) -> Path:
    partial = out / ".partial"
    head, own = _static(partial)
    paths = sorted(partial.glob("chunk_*.nc"))
    chunks: list[tuple[Path, bytes | None]] = []
    total = 0
    lengths = dict.fromkeys(RECORDS, 0)
    for path in paths:
        content = _sealed(path)
        if content is None:
            continue
        total += len(content)
        chunks.append((path, content if total <= WHOLE_BYTES else None))
        lengths = {dim: lengths[dim] + length for dim, length in read_lengths(content).items()}
        head = joined([head, read_image(content, records=False)[0]])
    bad = len(paths) - len(chunks) + len(list(partial.glob("chunk_*.nc.tmp")))
    reason = str(attributes.get("reason", ""))
    if bad:
        reason = f"{reason}; {bad} of {len(chunks) + bad} chunks could not be read".strip("; ")
    own["/"] |= attributes | {"complete": int(complete and not bad), "reason": reason, "unreadable_chunks": bad}
    temporary = out / f"{RESULT}.tmp"
    try:
        _join_chunks(temporary, head, own, chunks, lengths)
        for name in DERIVED:
            (out / name).unlink(missing_ok=True)
        os.replace(temporary, out / RESULT)
    except OSError as error:
        raise OutputError(
            f"cannot write {out / RESULT}: {reason_of(error)}; {len(chunks)} chunks are safe in {partial}: "
            f"free some space and run `palmfield recover {out}`"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
    shutil.rmtree(partial)
    return out / RESULT


def _join_chunks(
    path: Path,
    head: Checked,
    attributes: dict[str, dict[str, Any]],
    chunks: list[tuple[Path, bytes | None]],
    lengths: dict[str, int],
) -> None:
    """Write the result: variables without records, then the records of one chunk after the other.

    chunks: files with their contents, or with None for contents that must be read first
    """
    with interrupts_delayed() as check_interrupt, result_file(path, lengths) as (writer, disk):
        writer.labels()
        writer.groups(head, attributes)
        writer.put(head, dict.fromkeys(RECORDS, 0))
        start = dict.fromkeys(RECORDS, 0)
        for chunk, content in chunks:
            if disk.lost is not None:
                break
            check_interrupt()
            content = content or _sealed(chunk)
            if content is None:
                raise OutputError(f"{chunk} changed during reading; stop the program that writes there, and try again")
            writer.put(read_image(content, static=False)[0], start)
            start = {dim: start[dim] + length for dim, length in read_lengths(content).items()}
