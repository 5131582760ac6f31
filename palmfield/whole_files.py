"""Files that are there whole or not at all: where the disk is full, what had that name before stays as it was."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """A path beside a file, to be written within the block, which gets the file's name at its end.

    On any error, Ctrl-C among them, it is removed, and the error goes on. What is no file, as /dev/stdout, is written
    to at once.
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
