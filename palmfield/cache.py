"""Store results that took long to compute on disk, for later runs with the same inputs.

The cache is a folder of NumPy archives, one for each result. The name of a file is a digest of all inputs and of the
code. The folder is the user's cache folder, or that of environment variable PALMFIELD_CACHE (`off`: no cache). If it
exceeds its limit (2 GB or PALMFIELD_CACHE_MB), the least recently used results are removed. A result is written to a
temporary file, which is then renamed, so no process reads an incomplete file. A file also contains a digest of its
inputs and one of its arrays. If it cannot be read, or a digest does not match, the result is computed again.
"""

import dataclasses
import functools
import hashlib
import importlib.metadata
import os
import secrets
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import filelock
import numpy as np
import platformdirs
from numpy.typing import NDArray
from pydantic import BaseModel
from scipy import sparse

from palmfield.errors import PalmfieldError, reason_of
from palmfield.files import regular
from palmfield.phases import phase

LIMIT_MB = 2048
WAIT_S = 600.0
"""Longest wait for another process that computes the same result [s]. After it, the result is computed here too."""
MODES_S = 30 * 86400.0
"""Extra time for which modes are kept, compared with other entries [s]. They take half a minute to compute."""
OFF = ("off", "0", "none")
MARKS = "palmfield_marks"
"""Name of the array in a file that contains the digest of the inputs and that of the other arrays."""
Arrays = dict[str, NDArray[Any]]

_warned: set[str] = set()


class Entry(NamedTuple):
    """A result on disk. kind: kind of result; used: time of last use [s since the epoch]"""

    path: Path
    kind: str
    size_bytes: int
    used: float


def folder() -> Path | None:
    """Return the folder of the cache, or None if there is none."""
    named = os.environ.get("PALMFIELD_CACHE")
    if named is None:
        return platformdirs.user_cache_path("palmfield")
    return None if named.strip().lower() in OFF or not named.strip() else Path(os.path.expanduser(named))


def limit_bytes() -> int:
    """Return the limit of the folder [bytes]. Raises PalmfieldError if PALMFIELD_CACHE_MB is not a number above 0."""
    named = os.environ.get("PALMFIELD_CACHE_MB", str(LIMIT_MB))
    try:
        megabytes = float(named)
    except ValueError:
        megabytes = -1.0
    if not 0.0 < megabytes < 1e9:
        raise PalmfieldError(f"environment variable PALMFIELD_CACHE_MB is '{named}': give megabytes, a number above 0")
    return round(megabytes * 1e6)


def kept(
    kind: str,
    depends_on: Sequence[Any],
    make: Callable[[], Arrays],
    *,
    where: Path | None = None,
    code: str | None = None,
) -> Arrays:
    """Return the result of `make`, from the cache if an earlier run stored it.

    kind: kind of result, a word for the file name; depends_on: all inputs of the result, see `digest`
    make: function that returns the result as arrays by name, without objects. If it raises an error, nothing is stored
    where: folder that replaces that of the environment; code: digest of the code, None for `code_mark`
    """
    where = where or folder()
    work = phase(kind.replace("-", " "))(make)
    if where is None:
        return work()
    key = phase("cache")(digest)(code or code_mark(), kind, *depends_on)
    path = where / f"{kind}-{key}.npz"
    try:
        where.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(path.with_suffix(".lock"), timeout=WAIT_S)
        lock.acquire()
    except (OSError, NotImplementedError, filelock.Timeout) as error:
        # A folder that is only readable, such as one that several users share
        if (found := phase("cache")(_read)(path, key)) is not None:
            return found
        _warn(f"cache folder {where}: {reason_of(error)}; continuing without a cache")
        return work()
    try:
        answer = phase("cache")(_read)(path, key)
        if answer is None:
            answer = work()
            phase("cache")(_write)(path, key, answer)
        return answer
    finally:
        lock.release()


def entries() -> list[Entry]:
    """Return the entries of the cache, last used first."""
    where = folder()
    if where is None or not os.path.isdir(where):
        return []
    result = []
    for path in where.glob("*.npz"):
        try:
            facts = path.stat()
        except OSError:
            continue  # another process has just removed it
        result.append(Entry(path, path.stem.rpartition("-")[0], facts.st_size, facts.st_mtime))
    return sorted(result, key=lambda entry: -entry.used)


def clear() -> int:
    """Remove all entries; return their number."""
    removed = entries()
    where = folder()
    for entry in removed:
        entry.path.unlink(missing_ok=True)
    if where is not None and os.path.isdir(where):
        for pattern in ("*.lock", "*.part"):
            for path in where.glob(pattern):
                path.unlink(missing_ok=True)
    return len(removed)


def digest(*parts: Any) -> str:
    """Return a hash of numbers, texts, arrays, sparse matrices, dataclasses, models, and of lists and dicts of them.

    Raises TypeError for other types, whose content cannot be compared.
    """
    result = hashlib.blake2b(digest_size=20)
    for part in parts:
        _add(result, part)
    return result.hexdigest()


@functools.cache
def code_mark() -> str:
    """Return a digest of the code of this package and of numerical libraries, on which results depend."""
    result = hashlib.blake2b(digest_size=20)
    package = Path(__file__).parent
    for root in (package, package.parent / "warp_kernels"):
        for path in sorted(root.rglob("*.py")):
            result.update(path.relative_to(root).as_posix().encode())
            result.update(path.read_bytes())
    import scipy
    import warp

    for version in (np.__version__, scipy.__version__, warp.__version__, *_factorises()):
        result.update(version.encode())
    return result.hexdigest()


def _factorises() -> tuple[str, str]:
    """Return the version of pypardiso ("" without it), and whether it is switched on. Rounding depends on both."""
    try:
        installed = importlib.metadata.version("pypardiso")
    except importlib.metadata.PackageNotFoundError:
        installed = ""
    return installed, os.environ.get("PALMFIELD_PARDISO", "") if installed else ""


def _add(result: Any, part: Any) -> None:
    if part is None or isinstance(part, bool | int | float | complex | str | bytes | np.generic | Path):
        _put(result, type(part).__name__, repr(part).encode())
    elif isinstance(part, np.ndarray):
        if part.dtype.hasobject:
            raise TypeError("an array of objects has no digest")
        _put(result, f"array {part.dtype.str} {part.shape}", np.ascontiguousarray(part).tobytes())
    elif sparse.issparse(part):
        rows = sparse.csr_matrix(part)
        if not rows.has_sorted_indices:
            rows = rows.sorted_indices()  # a copy, so that the order of the caller's numbers is unchanged
        _put(result, f"sparse {rows.shape}", b"")
        for numbers in (rows.indptr.astype(np.int64), rows.indices.astype(np.int64), rows.data):
            _add(result, numbers)
    elif isinstance(part, BaseModel):
        _put(result, type(part).__qualname__, part.model_dump_json().encode())
    elif dataclasses.is_dataclass(part) and not isinstance(part, type):
        _put(result, type(part).__qualname__, b"")
        for field in dataclasses.fields(part):
            _add(result, field.name)
            _add(result, getattr(part, field.name))
    elif isinstance(part, Mapping):
        _put(result, f"mapping {len(part)}", b"")
        for key in sorted(part, key=repr):
            _add(result, key)
            _add(result, part[key])
    elif isinstance(part, list | tuple):
        _put(result, f"{type(part).__name__} {len(part)}", b"")
        for item in part:
            _add(result, item)
    else:
        raise TypeError(f"{type(part).__qualname__} has no digest")


def _put(result: Any, kind: str, content: bytes) -> None:
    """Add a part with its kind and length, so that ("ab", "c") differs from ("a", "bc")."""
    result.update(f"{kind} {len(content)}\n".encode())
    result.update(content)


def _read(path: Path, key: str) -> Arrays | None:
    """Return the result for a key. None if the file is missing or damaged, or belongs to another key."""
    try:
        with np.load(regular(path), allow_pickle=False) as archive:
            answer = {name: archive[name] for name in archive.files}
        found, content = answer.pop(MARKS).tolist()
        if found != key:
            raise ValueError("the file contains the result of another key")
        if content != digest(answer):
            raise ValueError("its arrays differ from those that were written")
        with suppress(OSError):  # of another user, or on a disk that is only readable
            os.utime(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except Exception as error:  # NumPy, zipfile and zlib raise nearly any kind on a damaged archive
        _warn(f"cache file {path} is damaged ({reason_of(error)}): its content is recomputed")
        return None
    return answer


def _write(path: Path, key: str, answer: Arrays) -> None:
    part = path.with_name(f"{path.stem}.{os.getpid()}.{secrets.token_hex(4)}.part")
    try:
        try:
            with open(part, "wb") as file:
                np.savez(file, allow_pickle=False, **answer, **{MARKS: np.array([key, digest(answer)])})
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
        _make_room(path)
    except OSError as error:
        _warn(f"cache folder {path.parent}: {reason_of(error)}; continuing without a cache")


def _make_room(newest: Path) -> None:
    """Remove the least recently used entries above the limit, and temporary files of killed processes."""
    total, limit = 0, limit_bytes()

    def removal(entry: Entry) -> tuple[bool, float]:
        return entry.path != newest, -entry.used - MODES_S * (entry.kind == "modes")

    for entry in sorted(entries(), key=removal):
        total += entry.size_bytes
        if total > limit:
            if entry.path == newest:
                _warn(
                    f"cache: {newest.name} takes {entry.size_bytes / 1e6:.0f} MB, more than PALMFIELD_CACHE_MB allows"
                )
            entry.path.unlink(missing_ok=True)
            entry.path.with_suffix(".lock").unlink(missing_ok=True)
    for part in newest.parent.glob("*.part"):
        try:
            if time.time() - part.stat().st_mtime > WAIT_S:
                part.unlink(missing_ok=True)
        except OSError:
            continue  # another process has just removed it


def _warn(text: str) -> None:
    """Log a warning, once per process."""
    if text not in _warned:
        _warned.add(text)
        warnings.warn(text, RuntimeWarning, stacklevel=3)
