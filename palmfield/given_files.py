"""Files that a user names: regular ones of a limited size, and TOML and JSON of limited depth and limited numbers.

A device, a pipe or a folder is refused before it is opened: /dev/zero has no end, a pipe may have no begin.
"""

import errno
import json
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from palmfield.errors import PalmfieldError, reason_of

MOST_BYTES = 1 << 30
"""Of a file of data: a 900,000-sample scan of 60 points has 0.5 GB as text."""
MOST_SETTINGS_BYTES = 1 << 24
"""Of a file of settings, which becomes about 20 times as large in memory."""
DEEPEST = 64
"""Nested lists and tables in settings; no format of ours goes below 8."""
LARGEST = 1 << 63
"""Whole numbers end here, as TOML 1.0 has it."""


class Unfit(OSError):
    """A file that is there and is not read; as other OSErrors it has `strerror`."""

    def __str__(self) -> str:
        return str(self.strerror)


@contextmanager
def reading(what: object, error: type[PalmfieldError], wanted: str) -> Iterator[None]:
    """What the system or a decoder says within the block, of a file that can't be read, becomes an `error`.

    what: the file, or that with its option; wanted: what to give instead, such as "a CSV file in UTF-8"
    """
    try:
        yield
    except (OSError, ValueError) as said:
        raise error(f"{what}: cannot be read: {reason_of(said)}; give {wanted}") from None


def regular(path: str | Path, most_bytes: int = MOST_BYTES) -> Path:
    """The path, where it leads to a regular file of at most `most_bytes`. Raises OSError, which says what it is."""
    file = Path(path)
    try:
        facts = file.stat()
    except ValueError:  # a path that holds a zero byte
        raise Unfit(errno.EINVAL, f"'{str(path)[:60]!r}' is not a path") from None
    if not stat.S_ISREG(facts.st_mode):
        kinds = {stat.S_IFDIR: "a folder", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFIFO: "a pipe"}
        kind = kinds.get(stat.S_IFMT(facts.st_mode), "no regular file")
        raise Unfit(errno.EINVAL, f"it is {kind}; allowed: a regular file")
    if facts.st_size > most_bytes:
        raise Unfit(errno.EFBIG, f"it has {facts.st_size / 1e6:.0f} MB; allowed: at most {most_bytes / 1e6:.0f} MB")
    return file


def read_bytes(path: str | Path, most_bytes: int = MOST_BYTES) -> bytes:
    """The content of a regular file. Raises OSError as `regular`."""
    with regular(path, most_bytes).open("rb") as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:  # files of /proc say that they have 0 bytes
        raise Unfit(
            errno.EFBIG, f"it has more than {most_bytes / 1e6:.0f} MB; allowed: at most {most_bytes / 1e6:.0f} MB"
        )
    return data


def read_text(path: str | Path, encoding: str = "utf-8", most_bytes: int = MOST_BYTES) -> str:
    """The text of a regular file, with \\n at the end of lines. Raises OSError as `regular`, UnicodeDecodeError."""
    return read_bytes(path, most_bytes).decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: str | Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises OSError as `regular`, and ValueError for other text, and as `plain`."""
    return plain(tomllib.loads, read_text(path, most_bytes=MOST_SETTINGS_BYTES))


def read_json(path: str | Path) -> Any:
    """The content of a JSON file. Raises OSError as `regular`, and ValueError for other text, and as `plain`."""
    return plain(json.loads, read_text(path, most_bytes=MOST_SETTINGS_BYTES))


def plain(parse: Any, text: str | bytes) -> Any:
    """What a parser makes of a text, once its depth and its whole numbers are checked.

    Raises ValueError for what is nested deeper than `DEEPEST`, and whole numbers of more than 64 bits, which overflow
    wherever they become floats or indices.
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
