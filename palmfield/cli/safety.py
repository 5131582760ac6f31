"""`palmfield safety`: write a safety page for an ethics board."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import AsJson, BoardName, Keys, SceneFile, check_duration, parsed_keys
from palmfield.errors import OutputError
from palmfield.files import made_folder, write_text


def safety(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="Markdown file for the page", metavar="FILE.md")] = None,
    duration: Annotated[float | None, typer.Option(help="duration of one play [s] [default: from the scene]")] = None,
    board: BoardName = None,
    keys: Keys = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace an existing file")] = False,
    as_json: AsJson = False,
) -> None:
    """Write a page for an ethics board: sound levels at head and hand, audible sound, and limits of exposure and of the
    board.

    Each level has a band, which is due to the range of p0. Set the position of a head by driver keys head_m and
    head_radius_m.

    Example: palmfield safety mjcf/scenes/palm_circle_sonicsurface.xml --set driver.head_m="0 -0.3 0.5" --out sheet.md
    """
    from palmfield.hardware.safety.sheet import safety_sheet
    from palmfield.hardware.safety.sheet_text import as_dict, as_markdown
    from palmfield.outputs.safety_picture import draw_levels
    from palmfield.session.preview import preview

    check_duration(duration)
    changed = parsed_keys(keys)
    picture = None if out is None else out.with_suffix(".png")
    for file in (out, picture):
        if file is not None and file.exists() and not overwrite:
            raise OutputError(f"--out {file}: the file already exists; give another file, or --overwrite")
    view = preview(scene, board=board, keys=changed)
    sheet = safety_sheet(view, view.duration_s if duration is None else duration)
    if out is not None and picture is not None:
        made_folder(out.parent)
        write_text(out, as_markdown(sheet, picture.name))
        title = f"{Path(sheet.scene).stem} on board {sheet.board.name}: highest levels in {sheet.duration_s:g} s"
        draw_levels(title, sheet.maps, sheet.course, picture)
    if as_json:
        print_json(as_dict(sheet))
    elif out is None:
        print(as_markdown(sheet), end="")
    else:
        print(f"wrote {out}\nwrote {picture}")
