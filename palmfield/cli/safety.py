"""What `palmfield safety` does with its options."""

from collections.abc import Mapping
from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.errors import OutputError
from palmfield.hardware.safety.sheet import safety_sheet
from palmfield.hardware.safety.sheet_text import as_dict, as_markdown
from palmfield.outputs.safety_picture import draw_levels
from palmfield.session.preview import preview
from palmfield.whole_files import whole


def show_sheet(
    scene: Path,
    out: Path | None,
    *,
    board: str | None,
    keys: Mapping[str, object],
    duration_s: float | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Print a scene's sheet, or write it with its picture beside it.

    Raises OutputError for a file that is there or can't be written.
    """
    picture = None if out is None else out.with_suffix(".png")
    for file in (out, picture):
        if file is not None and file.exists() and not overwrite:
            raise OutputError(f"--out: {file} is there already; give another file, or --overwrite")
    view = preview(scene, board=board, keys=keys)
    sheet = safety_sheet(view, view.duration_s if duration_s is None else duration_s)
    if out is not None and picture is not None:
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            with whole(out) as part:
                part.write_text(as_markdown(sheet, picture.name), encoding="utf-8")
        except OSError as error:
            raise OutputError(f"--out {out} can't be written: {error.strerror}; give another file") from error
        title = (
            f"{Path(sheet.scene).stem} by board {sheet.board.name}: highest levels of a play of {sheet.duration_s:g} s"
        )
        draw_levels(title, sheet.maps, sheet.course, picture)
    if as_json:
        print_json(as_dict(sheet))
    elif out is None:
        print(as_markdown(sheet), end="")
    else:
        print(f"wrote {out}\nwrote {picture}")
