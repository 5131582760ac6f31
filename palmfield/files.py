"""Read users' files, with limits of size and depth. Write files completely or not at all.

Devices, pipes and folders are not read: /dev/zero has no end, and reading a pipe may wait for ever. If the disk is full
while a file is written, an existing file is unchanged.
"""

import errno
import json
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from palmfield.errors import PalmfieldError, reason_of, unwritable

MOST_BYTES = 1 << 30
"""Largest size of a data file: a scan of 60 points with 900,000 samples has 0.5 GB as text."""
MOST_SETTINGS_BYTES = 1 << 24
"""Largest size of a settings file. Reading it takes about 20 times as much memory."""
DEEPEST = 64
"""Largest depth of nested lists and tables in settings. palmfield's own formats use at most 8."""
LARGEST = 1 << 63
"""Largest absolute value of whole numbers, as in TOML 1.0."""


class Unfit(OSError):
    """Error for a file that exists but is not readable input. Like other OSErrors it has `strerror`."""

    def __str__(self) -> str:
        return str(self.strerror)


@contextmanager
def reading(what: object, error: type[PalmfieldError], instead: str) -> Iterator[None]:
    """Convert errors of the system, or of a decoder, to `error`. The block reads a file.

    what: the file, with its option if any; instead: remedy in the message, such as "a CSV file in UTF-8"
    """
    try:
        yield
    except (OSError, ValueError) as cause:
        raise error(f"{what}: cannot be read: {reason_of(cause)}; give {instead}") from None


def regular(path: str | Path, most_bytes: int = MOST_BYTES) -> Path:
    """Return the path of a regular file of at most `most_bytes`. Raises OSError for other kinds of files."""
    file = Path(path)
    try:
        facts = file.stat()
    except ValueError:  # a path with a zero byte
        raise Unfit(errno.EINVAL, f"'{str(path)[:60]!r}' is not a path") from None
    if not stat.S_ISREG(facts.st_mode):
        kinds = {stat.S_IFDIR: "a folder", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFIFO: "a pipe"}
        kind = kinds.get(stat.S_IFMT(facts.st_mode), "no regular file")
        raise Unfit(errno.EINVAL, f"it is {kind}; allowed: a regular file")
    if facts.st_size > most_bytes:
        raise Unfit(errno.EFBIG, f"it has {facts.st_size / 1e6:.0f} MB; allowed: at most {most_bytes / 1e6:.0f} MB")
    return file


def read_bytes(path: str | Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file. Raises OSError like `regular`."""
    with regular(path, most_bytes).open("rb") as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:  # files of /proc have a stated size of 0
        raise Unfit(
            errno.EFBIG, f"it has more than {most_bytes / 1e6:.0f} MB; allowed: at most {most_bytes / 1e6:.0f} MB"
        )
    return data


def read_text(path: str | Path, encoding: str = "utf-8", most_bytes: int = MOST_BYTES) -> str:
    r"""Return the text of a regular file with line ends \n. Raises OSError like `regular`, and UnicodeDecodeError."""
    return read_bytes(path, most_bytes).decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: str | Path) -> dict[str, Any]:
    """Return the tables of a TOML file. Raises OSError like `regular`, ValueError for other text and like `plain`."""
    return plain(tomllib.loads, read_text(path, most_bytes=MOST_SETTINGS_BYTES))


def read_json(path: str | Path) -> Any:
    """Return the content of a JSON file. Raises OSError like `regular`, ValueError for other text and like `plain`."""
    return plain(json.loads, read_text(path, most_bytes=MOST_SETTINGS_BYTES))


def plain(parse: Any, text: str | bytes) -> Any:
    """Return the result of a parser, after a check of nesting depth and whole numbers.

    Raises ValueError for nesting deeper than `DEEPEST` and for integers of more than 64 bits, which would overflow.
    """
    try:
        value = parse(text)
    except RecursionError:
        raise ValueError(f"lists or tables are nested too deeply; allowed: {DEEPEST} levels") from None
    level, depth = [value], 0
    while level:
        depth += 1
        if depth > DEEPEST:
            raise ValueError(f"lists or tables are nested too deeply; allowed: {DEEPEST} levels")
        below: list[Any] = []
        for part in level:
            if isinstance(part, int) and not -LARGEST <= part < LARGEST:
                raise ValueError(f"a whole number has more than {len(str(LARGEST)) - 1} digits; write it as 1e30 is")
            if isinstance(part, dict | list):
                below.extend(part.values() if isinstance(part, dict) else part)
        level = below
    return value


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path, which the block writes. At the end of the block it is renamed to `path`.

    After an error, including Ctrl-C, the temporary file is removed, and the error is raised. If `path` is not a regular
    file, such as /dev/stdout, it is written directly.
    """
    file = Path(path)
    if file.exists() and not file.is_file():
        yield file
        return
    part = file.with_name(file.name + ".part")
    try:
        yield part
        part.replace(file)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Convert system errors to OutputError. The block writes a file or folder."""
    try:
        yield
    except OSError as error:
        raise unwritable(path, error) from error


def write_text(path: str | Path, text: str) -> None:
    """Write a text as a `whole` file. Raises OutputError if that fails."""
    with writing(path), whole(path) as part:
        part.write_text(text, encoding="utf-8")


def made_folder(path: str | Path) -> Path:
    """Create a folder and its missing parents, and return it. Raises OutputError if that fails."""
    with writing(path):
        Path(path).mkdir(parents=True, exist_ok=True)
    return Path(path)
