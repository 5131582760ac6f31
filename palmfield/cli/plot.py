"""`palmfield plot`: draw pictures of a run."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import AsJson
from palmfield.errors import OutputError, SceneError, refuse_unknown
from palmfield.files import made_folder

if TYPE_CHECKING:
    from palmfield.outputs.pictures.options import Options

SHEET = "kinds.png"
SPEED = "speed"
"""Kind of picture that is drawn from a benchmark report instead of a run."""
ABOUT_SPEED = "speed against error, from a table of palmfield bench skin or field (TABLE.md)"


def plot(
    context: typer.Context,
    run: Annotated[
        Path | None,
        typer.Argument(help="folder of a run, or its result.nc; or a table of palmfield bench", metavar="[DIR]"),
    ] = None,
    kinds: Annotated[
        list[str] | None,
        typer.Argument(
            help="kind of plot, or several: A,B (see --list) [default: all that the run allows]", metavar="[KIND]..."
        ),
    ] = None,
    time_ms: Annotated[
        float | None,
        typer.Option(
            "--time", help="time of maps, field and drives [ms] [default: time of the largest values]", metavar="MS"
        ),
    ] = None,
    place: Annotated[
        list[str] | None,
        typer.Option(help="point of the skin in the world as the run begins [mm]; may be repeated", metavar="X,Y,Z"),
    ] = None,
    limits: Annotated[
        str | None, typer.Option(help="limits of the colour scale or axis, in its unit", metavar="LOW,HIGH")
    ] = None,
    skin: Annotated[str | None, typer.Option(help="name of the skin, if the run has several", metavar="NAME")] = None,
    quantity: Annotated[
        str, typer.Option(help="quantity of the motion of the skin: displacement or velocity")
    ] = "displacement",
    observer: Annotated[str | None, typer.Option(help="observer of the levels [default: all]", metavar="NAME")] = None,
    suffix: Annotated[str, typer.Option("--format", help="file format: png, svg or pdf")] = "png",
    out: Annotated[Path | None, typer.Option(help="folder of the pictures [default: DIR/plots]")] = None,
    listed: Annotated[
        bool, typer.Option("--list", help="list the kinds of plots; with a run, also draw an overview of all")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Draw pictures of a run for a paper: field, drives, maps of motion and levels, time courses, spectra, wavefronts.

    Formats are PNG at 300 dpi, SVG and PDF. If a run lacks the data of a kind, this is reported; for a kind that you
    name, it is an error.

    Examples: palmfield plot out/palm

    palmfield plot out/palm motion wavefronts --time 12.5 --format svg

    palmfield plot skin.md --format pdf  (speed against error, after palmfield bench skin --out skin.md)
    """
    from palmfield.outputs.pictures.draw import checked_kinds, draw_pictures
    from palmfield.outputs.pictures.options import parse_options
    from palmfield.outputs.store import open_result

    if listed:
        list_kinds(run, out, as_json)
        return
    if run is None:
        raise SceneError("plot needs DIR, the folder of a run; `palmfield plot --list` lists the kinds of plots")
    options = parse_options(time_ms, place or (), limits, skin, quantity, observer)
    named = [name for word in kinds or () for name in word.split(",") if name]
    if run.suffix.lower() == ".md" or SPEED in named:
        _plot_speed(run, named, options, out, suffix, as_json)
        return
    checked_kinds(named)
    with open_result(run) as result:
        files, missing = draw_pictures(result, out or _plots(run), named, options, suffix)
    if as_json:
        print_json({"files": {kind: str(path) for kind, path in files.items()}, "missing": missing})
        return
    for path in files.values():
        print(f"wrote {path}")
    for kind, reason in () if context.obj else missing.items():
        print(f"no {kind}: {reason}")


def list_kinds(run: Path | None, out: Path | None, as_json: bool) -> None:
    """Print the kinds of pictures with a description. For a run, also draw an overview of all kinds, kinds.png."""
    from palmfield.outputs.pictures.kinds import KINDS
    from palmfield.outputs.pictures.sheet import draw_sheet
    from palmfield.outputs.store import open_result

    about = {name: kind.about for name, kind in KINDS.items()} | {SPEED: ABOUT_SPEED}
    sheet, missing = None, {}
    if run is not None:
        sheet = (out or _plots(run)) / SHEET
        with open_result(run) as result:
            missing = draw_sheet(result, sheet)
    if as_json:
        print_json(about if sheet is None else {"kinds": about, "sheet": str(sheet), "missing": missing})
        return
    for name, words in about.items():
        print(f"{name:12} {words}{' (this run has none)' if name in missing else ''}")
    print("overview of all plots: " + ("give a run, palmfield plot DIR --list" if sheet is None else f"wrote {sheet}"))


def _plots(run: Path) -> Path:
    """Return the plot folder of a run. run: folder of the run, or a file in it"""
    return (run if run.is_dir() else run.parent) / "plots"


def _plot_speed(
    run: Path, kinds: Sequence[str], options: "Options", out: Path | None, suffix: str, as_json: bool
) -> None:
    """Draw speed against error from a benchmark report. The picture is written next to the report or into a folder."""
    from palmfield.outputs.pictures.draw import DPI
    from palmfield.outputs.pictures.options import Options
    from palmfield.outputs.style import FORMATS, save, style
    from palmfield.studies.bench.read_table import speed_picture

    if run.suffix.lower() != ".md":
        raise OutputError(
            f"picture '{SPEED}' needs a benchmark report in Markdown, not {run}; make one with palmfield bench "
            "skin --out FILE.md"
        )
    if set(kinds) - {SPEED} or options != Options():
        raise OutputError(f"{run} is a benchmark report; allowed: only picture '{SPEED}', without options")
    refuse_unknown(OutputError, "--format has value {}", suffix, FORMATS)
    figure = speed_picture(run)
    figure.set_dpi(DPI)
    path = (out or _plots(run)) / f"{SPEED}.{suffix}"
    made_folder(path.parent)
    with style():
        save(figure, path, DPI)
    if as_json:
        print_json({"files": {SPEED: str(path)}, "missing": {}})
    else:
        print(f"wrote {path}")
