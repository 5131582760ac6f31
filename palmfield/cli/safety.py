"""What `palmfield safety` does with its options."""

from collections.abc import Mapping
from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.errors import OutputError
from palmfield.session.preview import preview
from palmfield.session.safety.sheet import safety_sheet
from palmfield.session.safety.sheet_text import as_dict, as_markdown


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
    """Print a scene's sheet, or write it. Raises OutputError for a file that is there or can't be written."""
    if out is not None and out.exists() and not overwrite:
        raise OutputError(f"--out {out} is there already; give another file, or --overwrite")
    view = preview(scene, board=board, keys=keys)
    sheet = safety_sheet(view, view.duration_s if duration_s is None else duration_s)
    if out is not None:
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(as_markdown(sheet), encoding="utf-8")
        except OSError as error:
            raise OutputError(f"--out {out} can't be written: {error.strerror}; give another file") from error
    if as_json:
        print_json(as_dict(sheet))
    elif out is None:
        print(as_markdown(sheet), end="")
    else:
        print(f"wrote {out}")
