"""Draw pictures of a result into files."""

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from palmfield.errors import MeasurementError, OutputError, refuse_unknown
from palmfield.files import made_folder
from palmfield.outputs.pictures.kinds import KINDS, check_options
from palmfield.outputs.pictures.options import Options
from palmfield.outputs.style import FORMATS, save, style

DPI = 300


def checked_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return the kinds without repeats, or all kinds if the list is empty. Raises OutputError for an unknown kind."""
    for kind in kinds:
        refuse_unknown(OutputError, "picture {} is unknown", kind, KINDS)
    return tuple(dict.fromkeys(kinds)) or tuple(KINDS)


def draw_pictures(
    result: xr.DataTree, out: str | Path, kinds: Sequence[str] = (), options: Options | None = None, suffix: str = "png"
) -> tuple[dict[str, Path], dict[str, str]]:
    """Draw pictures of a result, each to OUT/KIND.SUFFIX at 300 dpi.

    kinds: kinds of KINDS, all if empty
    suffix: one of FORMATS
    Returns the files by kind, and the reasons why other kinds could not be drawn. If `kinds` is empty, kinds without
    data are skipped. Otherwise the first kind that cannot be drawn raises its OutputError or MeasurementError.
    Raises OutputError for an unknown kind or format, for options that no kind uses, and if a file cannot be written.
    """
    folder = Path(out)
    chosen = checked_kinds(kinds)
    check_options(chosen, options or Options())
    refuse_unknown(OutputError, "--format has value {}", suffix, FORMATS)
    made_folder(folder)
    files, missing = {}, {}
    for kind in chosen:
        try:
            with style():
                figure = KINDS[kind].draw(result, options or Options())
                figure.set_dpi(DPI)
        except (OutputError, MeasurementError) as problem:
            if kinds:
                raise
            missing[kind] = str(problem)
            continue
        files[kind] = folder / f"{kind}.{suffix}"
        with style():
            save(figure, files[kind], DPI)
    return files, missing
