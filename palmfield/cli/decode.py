"""`palmfield decode`: compute which foci a file of bytes produces."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.options import BoardOfBytes, SentFile


def decode(
    file: SentFile,
    board: BoardOfBytes = None,
    layout: Annotated[
        str | None, typer.Option(help="for raw bytes: layout of the array [default: that of the board]")
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="calibration file of the transducers [default: the calibration of the logged scene]", metavar="FILE"
        ),
    ] = None,
    png: Annotated[Path | None, typer.Option(help="draw the foci", metavar="FILE")] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV file for the table of all foci", metavar="FILE")] = None,
) -> None:
    """Show the foci that a file of bytes produces. They are fitted to the emission of the board's virtual twin.

    Example: palmfield drive mjcf/scenes/palm_circle_sonicsurface.xml --record c.bin && palmfield decode c.bin --board
    sonicsurface --png c.png
    """
    import numpy as np

    from palmfield.hardware.decode import as_table, draw_foci, write_csv
    from palmfield.hardware.decode import decode as decoded_file

    decoded = decoded_file(file, board, layout, calibration)
    print(as_table(decoded, most=40))
    if csv is not None:
        write_csv(decoded, csv)
    if png is not None:
        foci = np.array([row.focus for row in decoded.foci]).reshape(-1, 3)
        draw_foci([row.time_s for row in decoded.foci], foci, png)
