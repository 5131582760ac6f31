"""Files that are there whole or not at all: where the disk is full, what had that name before stays as it was."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from palmfield.errors import unwritable


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


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """What the system says within the block of a file or folder that can't be written becomes an OutputError."""
    try:
        yield
    except OSError as error:
        raise unwritable(path, error) from error


def write_text(path: str | Path, text: str) -> None:
    """Write a text as a `whole` file. Raises OutputError if that fails."""
    with writing(path), whole(path) as part:
        part.write_text(text, encoding="utf-8")


def made_folder(path: str | Path) -> Path:
    """The folder, with those around it made where they are missing. Raises OutputError if that fails."""
    with writing(path):
        Path(path).mkdir(parents=True, exist_ok=True)
    return Path(path)
