"""What `palmfield plot` does with its options."""

from collections.abc import Sequence
from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.outputs.pictures.asked import Asked
from palmfield.outputs.pictures.draw import checked_kinds, draw_pictures
from palmfield.outputs.pictures.kinds import KINDS
from palmfield.outputs.store import RESULT, open_result


def list_kinds(as_json: bool) -> None:
    """Print the kinds with a line about each."""
    if as_json:
        print_json({name: kind.about for name, kind in KINDS.items()})
        return
    for name, kind in KINDS.items():
        print(f"{name:12} {kind.about}")
    print("small pictures of all: docs/plots.md")


def plot(
    run: Path, kinds: Sequence[str], asked: Asked, *, out: Path | None, suffix: str, quiet: bool, as_json: bool
) -> None:
    """Draw, and print what was written and what could not be drawn."""
    checked_kinds(kinds)
    file = run / RESULT if run.is_dir() else run
    with open_result(file) as result:
        files, missing = draw_pictures(result, out or file.parent / "plots", kinds, asked, suffix)
    if as_json:
        print_json({"files": {kind: str(path) for kind, path in files.items()}, "missing": missing})
        return
    for path in files.values():
        print(f"wrote {path}")
    for kind, reason in () if quiet else missing.items():
        print(f"no {kind}: {reason}")
