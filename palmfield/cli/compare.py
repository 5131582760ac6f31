"""`palmfield compare`: compare a measured scan with a run."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import AsJson, RunFolder


def compare(
    context: typer.Context,
    run: RunFolder,
    measured: Annotated[Path, typer.Argument(help="file of the measured scan (docs/compare.md)", metavar="MEASURED")],
    instrument: Annotated[
        Path | None,
        typer.Option(help="settings of the instrument: TOML file with a table [vibrometer]", metavar="FILE.toml"),
    ] = None,
    skin: Annotated[str | None, typer.Option(help="name of the skin, if the run has several", metavar="NAME")] = None,
    fiducials: Annotated[
        Path | None,
        typer.Option(
            help="CSV file of points of the scan and their positions on the skin: x_m ... skin_z_m", metavar="FILE.csv"
        ),
    ] = None,
    as_placed: Annotated[
        bool, typer.Option("--as-placed", help="keep the position given by the file or the fiducials")
    ] = False,
    most_delay: Annotated[float, typer.Option(help="largest delay to search, plus or minus [s]")] = 5e-3,
    out: Annotated[Path | None, typer.Option(help="folder of the report [default: DIR/compare]")] = None,
    mode: Annotated[
        float | None, typer.Option(help="fit the guided mode of both scans at this frequency [Hz]", metavar="HZ")
    ] = None,
    source: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            help="source of the mode on the skin [m] [default: point of the largest computed motion]", metavar="X Y Z"
        ),
    ] = None,
    source_radius: Annotated[
        float, typer.Option(help="radius around the source that the fit excludes [m]: 1.5 times the width of the spot")
    ] = 0.016,
    as_uff: Annotated[bool, typer.Option("--as-uff", help="also write the computed scan as computed.uff")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace another comparison in the folder")] = False,
    as_json: AsJson = False,
) -> None:
    """Compare a vibrometer scan with a run: gain, delay, difference and coherence at each point; wavenumbers.

    The scan is moved onto the skin, and the computed motion passes through a model of the same instrument.

    With `force-law` in place of DIR, it judges a data sheet of docs/gallery/force_law.md.

    Example: palmfield compare out/palm scan.csv --instrument head.toml
    """
    from palmfield.outputs.scan_files import write_scan
    from palmfield.studies.compare.force_law import NAME, force_law
    from palmfield.studies.compare.run import FILES
    from palmfield.studies.compare.run import compare as compare_run

    if str(run) == NAME:
        judged = force_law(measured)
        print_json({"ratios": [one.__dict__ for one in judged]}) if as_json else print(*judged, sep="\n")
        return
    out = out or (run if run.is_dir() else run.parent) / "compare"
    done = compare_run(
        run, measured, instrument=instrument, skin=skin, fiducials=fiducials, onto_surface=not as_placed,
        most_delay_s=most_delay, mode_Hz=mode, source_m=source, source_radius_m=source_radius,
        out=out, overwrite=overwrite,
    )  # fmt: skip
    if as_uff:
        write_scan(out / "computed.uff", done.computed)
    if as_json:
        print_json(done.as_dict())
        return
    print(done)
    for name in () if context.obj else (*FILES, *(["computed.uff"] if as_uff else [])):
        print(f"wrote {out / name}")
