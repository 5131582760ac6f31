"""`palmfield hand`: check a hand mesh, write its report card, and convert it to MJCF."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.errors import SceneError
from palmfield.files import write_text


def hand(
    mesh: Annotated[Path, typer.Argument(help="GLB, glTF, OBJ, PLY, STL or MANO .pkl file", metavar="MESH")],
    units: Annotated[str, typer.Option(help="length unit of the file: auto, m, dm, cm, mm or in")] = "auto",
    json: Annotated[Path | None, typer.Option(help="write the report card to this file", metavar="FILE")] = None,
    png: Annotated[
        Path | None, typer.Option(help="picture of the mesh with its faults in colour", metavar="FILE")
    ] = None,
    mjcf: Annotated[
        Path | None, typer.Option(help="MJCF file of bodies for the joints of the mesh", metavar="FILE")
    ] = None,
) -> None:
    """Check a hand mesh: unit, size, side, faults (repaired or fatal), and the skin layers that fit on it.

    Exit code 0: accepted; 3: accepted with doubts, for example about whether it is a hand; 2: refused.

    Examples: palmfield hand my_hand.glb --json card.json --png card.png

    palmfield hand my_hand.glb --mjcf my_hand.xml
    """
    from rich.console import Console

    from palmfield.hand.reportcard import as_text, refused_facts, report_card, write_card

    try:
        with Console(stderr=True).status(f"examining {mesh}"):
            card = report_card(mesh, units)
    except SceneError as error:
        facts = refused_facts(mesh, units, error)
        print(as_text(facts), end="")
        if json is not None:
            write_card(json, facts)
            print(f"wrote {json}")
        raise
    print(as_text(card.facts), end="")
    if json is not None:
        write_card(json, card.facts)
        print(f"wrote {json}")
    if png is not None:
        from palmfield.outputs.report_card_picture import draw_card

        print(f"wrote {draw_card(card, png)}")
    if card.refusal is not None:
        raise SceneError(card.refusal)
    if mjcf is not None:
        from palmfield.hand.rigged_mjcf import rigged_mjcf
        from palmfield.hand.skinning import rigged_file

        write_text(mjcf, rigged_mjcf(rigged_file(str(mesh), units), mesh.stem))
        print(f"wrote {mjcf}")
    if card.doubts:
        raise typer.Exit(3)
