"""The command `palmfield hand`: a mesh's report card, printed and written."""

from pathlib import Path

from palmfield.errors import SceneError
from palmfield.hand.reportcard import as_text, report_card, write_card


def show_hand(mesh: Path, unit: str, json_file: Path | None, png: Path | None) -> None:
    """Print the report card of a mesh and write it as JSON and PNG.

    Raises SceneError, after all is written, where the mesh is refused.
    """
    card = report_card(mesh, unit)
    print(as_text(card.facts), end="")
    if json_file is not None:
        write_card(json_file, card.facts)
        print(f"wrote {json_file}")
    if png is not None:
        from palmfield.hand.cardpicture import draw_card

        print(f"wrote {draw_card(card, png)}")
    if card.refusal is not None:
        raise SceneError(card.refusal)
