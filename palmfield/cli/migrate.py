"""`palmfield migrate`: rewrite a scene of the previous version with the current names."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.options import SceneFile


def migrate(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="file to write [default: SCENE itself]")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace an existing file")] = False,
) -> None:
    """Rewrite a scene of the previous version with the new names of keys and values.

    Comments and layout are preserved; changes are printed. An existing file is replaced only with --overwrite.

    Examples: palmfield migrate old.xml --out new.xml

    palmfield migrate scene.xml --overwrite
    """
    from palmfield.session.migrate import migrate as rewrite

    result = rewrite(scene, out, overwrite=overwrite)
    for change in result.changes:
        print(change)
    print(f"wrote {scene if out is None else out}" if result.changes else f"{scene} contains no renamed keys")
    for other in result.others:
        print(f"it includes {other}, which has renamed keys too: palmfield migrate {other}")
