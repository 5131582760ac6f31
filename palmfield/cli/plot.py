"""What `palmfield plot` does with its options."""

from collections.abc import Sequence
from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.errors import OutputError, unwritable
from palmfield.outputs.pictures.asked import Asked
from palmfield.outputs.pictures.draw import DPI, checked_kinds, draw_pictures
from palmfield.outputs.pictures.kinds import KINDS
from palmfield.outputs.pictures.sheet import draw_sheet
from palmfield.outputs.store import RESULT, open_result
from palmfield.outputs.style import FORMATS, save, style

SHEET = "kinds.png"
SPEED = "speed"
"""The kind that is no run's: drawn of a report that a benchmark wrote."""
ABOUT_SPEED = "speed against error, of a table that palmfield bench skin or field wrote (TABLE.md)"


def list_kinds(run: Path | None, out: Path | None, as_json: bool) -> None:
    """Print the kinds with a line about each; of a run, draw small pictures of all into one, kinds.png."""
    about = {name: kind.about for name, kind in KINDS.items()} | {SPEED: ABOUT_SPEED}
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


def plot(
    run: Path, kinds: Sequence[str], asked: Asked, *, out: Path | None, suffix: str, quiet: bool, as_json: bool
) -> None:
    """Draw, and print what was written and what could not be drawn."""
    if run.suffix.lower() == ".md" or SPEED in kinds:
        _plot_speed(run, kinds, asked, out, suffix, as_json)
        return
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


def _plot_speed(run: Path, kinds: Sequence[str], asked: Asked, out: Path | None, suffix: str, as_json: bool) -> None:
    """Draw speed against error of a benchmark's report, beside it or into a folder."""
    from palmfield.studies.bench.read_table import speed_picture

    if run.suffix.lower() != ".md":
        raise OutputError(
            f"picture '{SPEED}' is of a report in Markdown, not of {run}: palmfield bench skin --out FILE.md"
        )
    if set(kinds) - {SPEED} or asked != Asked():
        raise OutputError(f"{run} is a benchmark's report; of that there is picture '{SPEED}' alone, without options")
    if suffix not in FORMATS:
        raise OutputError(f"--format has value '{suffix}'; allowed: {', '.join(FORMATS)}")
    figure = speed_picture(run)
    figure.set_dpi(DPI)
    path = (out or run.parent / "plots") / f"{SPEED}.{suffix}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(path.parent, error) from None
    with style():
        save(figure, path, DPI)
    if as_json:
        print_json({"files": {SPEED: str(path)}, "missing": {}})
    else:
        print(f"wrote {path}")
