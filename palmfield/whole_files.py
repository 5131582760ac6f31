"""Write files completely or not at all: if the disk is full, an existing file is unchanged."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from palmfield.errors import unwritable


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path to be written in the block, which is renamed to `path` at its end.

    After an error, including Ctrl-C, it is removed, and the error is raised. If `path` is not a regular file, such as
    /dev/stdout, it is written directly.
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
    """Convert system errors in the block, which writes a file or folder, to OutputError."""
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
