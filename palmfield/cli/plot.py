"""What `palmfield plot` does with its options."""

from collections.abc import Sequence
from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.outputs.pictures.asked import Asked
from palmfield.outputs.pictures.draw import checked_kinds, draw_pictures
from palmfield.outputs.pictures.kinds import KINDS
from palmfield.outputs.pictures.sheet import draw_sheet
from palmfield.outputs.store import RESULT, open_result

SHEET = "kinds.png"


def list_kinds(run: Path | None, out: Path | None, as_json: bool) -> None:
    """Print the kinds with a line about each; of a run, draw small pictures of all into one, kinds.png."""
    about = {name: kind.about for name, kind in KINDS.items()}
    sheet, missing = None, {}
    if run is not None:
        file = run / RESULT if run.is_dir() else run
        sheet = (out or file.parent / "plots") / SHEET
        with open_result(file) as result:
            missing = draw_sheet(result, sheet)
    if as_json:
        print_json(about if sheet is None else {"kinds": about, "sheet": str(sheet), "missing": missing})
        return
    for name, words in about.items():
        print(f"{name:12} {words}{' (this run has none)' if name in missing else ''}")
    print("small pictures of all: " + ("give a run, palmfield plot DIR --list" if sheet is None else f"wrote {sheet}"))
    print("speed against error: palmfield bench skin --picture FILE, and bench field")


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
