"""Draw requested kinds of pictures of a result into files."""

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from palmfield.errors import MeasurementError, OutputError, did_you_mean, unwritable
from palmfield.outputs.pictures.asked import Asked
from palmfield.outputs.pictures.kinds import KINDS, check_heeded
from palmfield.outputs.style import FORMATS, save, style

DPI = 300


def checked_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return the kinds in order, each once; all for none. Raises OutputError for an unknown one."""
    for kind in kinds:
        if kind not in KINDS:
            raise OutputError(f"picture '{kind}'{did_you_mean(kind, KINDS)} is unknown; allowed: {', '.join(KINDS)}")
    return tuple(dict.fromkeys(kinds)) or tuple(KINDS)


def draw_pictures(
    result: xr.DataTree, out: str | Path, kinds: Sequence[str] = (), asked: Asked | None = None, suffix: str = "png"
) -> tuple[dict[str, Path], dict[str, str]]:
    """Draw kinds of pictures of a result, each to OUT/KIND.SUFFIX at 300 dpi.

    kinds: of KINDS; none for all; suffix: one of FORMATS
    Returns the files by kind, and why others could not be drawn. If all kinds are drawn, those without data are left
    out; of named kinds the first that cannot be drawn raises its OutputError or MeasurementError.
    Raises OutputError for an unknown kind or format, for options that no kind uses, and if a file cannot be written.
    """
    folder = Path(out)
    chosen = checked_kinds(kinds)
    check_heeded(chosen, asked or Asked())
    if suffix not in FORMATS:
        raise OutputError(f"--format has value '{suffix}'; allowed: {', '.join(FORMATS)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from None
    files, missing = {}, {}
    for kind in chosen:
        try:
            with style():
                figure = KINDS[kind].draw(result, asked or Asked())
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
