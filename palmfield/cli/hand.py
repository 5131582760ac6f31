"""The command `palmfield hand`: a mesh's report card, printed and written, and its MJCF."""

from pathlib import Path

from rich.console import Console

from palmfield.errors import OutputError, SceneError
from palmfield.hand.reportcard import as_text, refused_facts, report_card, write_card


def show_hand(mesh: Path, unit: str, json_file: Path | None, png: Path | None, mjcf: Path | None = None) -> bool:
    """Print the report card of a mesh and write it as JSON and PNG; write the bodies of a rigged mesh as MJCF.

    Returns whether the mesh was accepted without doubts.

    Raises SceneError, after the card is written, where the mesh is refused or unreadable, and for MJCF without joints;
    OutputError where a file cannot be written.
    """
    try:
        with Console(stderr=True).status(f"examining {mesh}"):
            card = report_card(mesh, unit)
    except SceneError as error:
        facts = refused_facts(mesh, unit, error)
        print(as_text(facts), end="")
        if json_file is not None:
            write_card(json_file, facts)
            print(f"wrote {json_file}")
        raise
    print(as_text(card.facts), end="")
    if json_file is not None:
        write_card(json_file, card.facts)
        print(f"wrote {json_file}")
    if png is not None:
        from palmfield.outputs.report_card_picture import draw_card

        print(f"wrote {draw_card(card, png)}")
    if card.refusal is not None:
        raise SceneError(card.refusal)
    if mjcf is not None:
        from palmfield.hand.rigged_mjcf import rigged_mjcf
        from palmfield.hand.skinning import rigged_file

        text = rigged_mjcf(rigged_file(str(mesh), unit), mesh.stem)
        try:
            mjcf.write_text(text, encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{mjcf} cannot be written: {error}; give another file") from error
        print(f"wrote {mjcf}")
    return not card.doubts
