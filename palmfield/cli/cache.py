"""`palmfield cache`: list and clear data stored on disk between runs."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from palmfield.cli.options import group

if TYPE_CHECKING:
    from palmfield.cache import Entry

cache = group(
    "cache",
    "List or clear the cache of reduced skin models and error estimates. It lies in the user's cache folder or in "
    "PALMFIELD_CACHE (off: no cache) and contains up to PALMFIELD_CACHE_MB [2048].\n\nExample: palmfield cache list",
)


@cache.command("list")
def show() -> None:
    """List the entries of the cache, with size and time of last use.

    Example: palmfield cache list
    """
    from palmfield import cache as disk

    where, stored = _entries()
    for entry in stored:
        print(f"{entry.size_bytes / 1e6:8.1f} MB  used {_ago(time.time() - entry.used):>9} ago  {entry.path.name}")
    total = sum(entry.size_bytes for entry in stored)
    limit = disk.limit_bytes()
    print(f"{len(stored)} entries in {where}: {total / 1e6:.1f} MB of {limit / 1e6:.0f} MB")


@cache.command("clear")
def clear() -> None:
    """Remove all entries of the cache; later runs compute them again.

    Example: palmfield cache clear
    """
    from palmfield import cache as disk

    where, stored = _entries()
    total = sum(entry.size_bytes for entry in stored)
    print(f"removed {disk.clear()} from {where}: {total / 1e6:.1f} MB")


def _entries() -> tuple[Path, list["Entry"]]:
    """Return the cache folder and its entries. If the cache is off or empty, print this and raise typer.Exit."""
    from palmfield import cache as disk

    where = disk.folder()
    if where is None:
        print("there is no cache, because PALMFIELD_CACHE is off")
        raise typer.Exit()
    return where, disk.entries()


def _ago(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(seconds, 0.0):.0f} s"
