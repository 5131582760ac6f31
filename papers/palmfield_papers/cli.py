"""`palmfield papers`: its options. Modules that compute are imported inside functions, so that --help is quick."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer


def papers(
    context: typer.Context,
    names: Annotated[
        list[str] | None,
        typer.Argument(help="chilles2019, reardon2023, mizushima2024, hasegawa2018, or all", metavar="[PAPER]..."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="coarser runs, which take minutes")] = False,
    out: Annotated[Path, typer.Option(help="folder for pages, figures and rows.json")] = Path("out/papers"),
    device: Annotated[str, typer.Option(help="device of the kernels that can run on a GPU: cpu or cuda")] = "cpu",
    jobs: Annotated[
        int, typer.Option(min=1, help="number of papers computed in parallel, about 3 GB of memory each")
    ] = 1,
    only: Annotated[
        list[str] | None,
        typer.Option(help="only this number of docs/gallery/tolerances.toml, printed; may be repeated", metavar="ID"),
    ] = None,
    scans: Annotated[
        Path | None,
        typer.Option(
            help="folder of measured scans, predicted blind and scored (docs/gallery/scans.md)", metavar="FOLDER"
        ),
    ] = None,
    variable: Annotated[
        list[str] | None,
        typer.Option(
            help="a key of [variables] of these scans, such as velocity=y; may be repeated", metavar="KEY=NAME"
        ),
    ] = None,
    predict_only: Annotated[
        bool, typer.Option("--predict-only", help="register predictions of scans and do not read their velocity")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="print only JSON, with units in the names, for other programs")
    ] = False,
) -> None:
    """Reproduce four papers. Print each number next to the published one, with tolerances that were fixed beforehand.

    Writes a page, figures and rows.json for each paper, and an index.html. The exit code is 4 if a number failed.

    Example: palmfield papers chilles2019 --quick
    """
    if scans is not None:
        given = dict(word.partition("=")[::2] for word in variable or ())
        options = {"quick": quick, "device": device, "names": given, "predict_only": predict_only}
        _scans(names or (), scans, out / "reardon2023_scans", as_json, options)
        return
    if only:
        raise typer.Exit(_numbers(only, quick=quick, device=device, as_json=as_json))
    raise typer.Exit(
        _papers(names or (), quick=quick, out=out, device=device, jobs=jobs, quiet=context.obj, as_json=as_json)
    )


def _scans(names: Sequence[str], folder: Path, out: Path, as_json: bool, options: dict[str, Any]) -> None:
    """Predict and score scans, and print the digest and the table."""
    from palmfield.cli.as_json import print_json
    from palmfield.errors import MeasurementError
    from palmfield_papers.reardon2023.scan_score import score, table

    if list(names) != ["reardon2023"]:
        raise MeasurementError(f"--scans with {' '.join(names) or 'all papers'}; give it with reardon2023 alone")
    digest, verdicts = score(folder, out, **options)
    if as_json:
        print_json({"digest": digest, "folder": str(out), "verdicts": [one.__dict__ for one in verdicts]})
    else:
        print(f"{table(digest, verdicts)}wrote {out}")


def _papers(names: Sequence[str], *, quick: bool, out: Path, device: str, jobs: int, quiet: bool, as_json: bool) -> int:
    """Compute, print a line for each paper, and return the exit code: 4 if a row failed."""
    from palmfield.cli.as_json import print_json
    from palmfield_papers.registry import NAMES
    from palmfield_papers.run import INDEX, papers

    chosen = NAMES if "all" in names or not names else tuple(dict.fromkeys(names))
    done = papers(chosen, quick=quick, out=out, device=device, jobs=jobs, progress=not quiet)
    if as_json:
        print_json({one.name: one.__dict__ | {"folder": str(one.folder)} for one in done})
    else:
        for one in done:
            print(one)
        if not quiet:
            print(f"wrote {out / INDEX}")
    return 4 if any(one.failed for one in done) else 0


def _numbers(ids: Sequence[str], *, quick: bool, device: str, as_json: bool) -> int:
    """Compute single numbers, and print each under its readings and controls.

    Return the exit code as `_papers` does.
    """
    from palmfield.cli.as_json import print_json
    from palmfield_papers.page import row_text
    from palmfield_papers.run import numbers

    found = numbers(ids, quick=quick, device=device)
    if as_json:
        print_json({one.entry.id: one.as_dict() for one in found})
    else:
        for one in found:
            print(row_text(one))
    return 4 if any(tried.failed for one in found for tried in one.tried) else 0
