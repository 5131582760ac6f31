"""`palmfield cache`: what is kept on disk between runs."""

import time

from palmfield import cache


def show_cache() -> None:
    """Print a line for each answer that is kept, and how much they take together."""
    where, kept = cache.folder(), cache.entries()
    if where is None:
        print("nothing is kept: PALMFIELD_CACHE is off")
        return
    for entry in kept:
        print(f"{entry.size_bytes / 1e6:8.1f} MB  used {_ago(time.time() - entry.used):>9} ago  {entry.path.name}")
    total = sum(entry.size_bytes for entry in kept)
    limit = cache.limit_bytes()
    print(f"{len(kept)} kept in {where}: {total / 1e6:.1f} MB of {limit / 1e6:.0f} MB")


def clear_cache() -> None:
    """Remove all that is kept, and say how much it was."""
    where, kept = cache.folder(), cache.entries()
    if where is None:
        print("nothing is kept: PALMFIELD_CACHE is off")
        return
    total = sum(entry.size_bytes for entry in kept)
    print(f"removed {cache.clear()} from {where}: {total / 1e6:.1f} MB")


def _ago(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(seconds, 0.0):.0f} s"
