"""`palmfield recover`: assemble the results of an interrupted run."""

from pathlib import Path
from typing import Annotated

import typer


def recover(out: Annotated[Path, typer.Argument(help="folder of an interrupted run", metavar="DIR")]) -> None:
    """Assemble the results of an interrupted run into DIR/result.nc, marked incomplete, and draw its pictures.

    Example: palmfield recover out/palm
    """
    from palmfield.session.recorded_run import recover as finish

    for path in finish(out, progress=True).values():
        print(f"wrote {path}")
