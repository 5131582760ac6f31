"""Draw speed against error from a report of `palmfield bench skin` or `palmfield bench field`."""

from collections.abc import Iterator
from pathlib import Path

from matplotlib.figure import Figure

from palmfield.errors import OutputError
from palmfield.files import reading
from palmfield.studies.bench import chart, field, skin, table

SKIN = ["method", "size", "seconds", "error at rest", "error at 200 Hz", "stated"]
FIELD = ["method", "distance", "time [ms]", "set-up [ms]", "M pairs/s", "M pairs/core-s", "error", "memory [MiB]"]


def speed_picture(path: Path) -> Figure:
    """Draw speed against error from the table of a Markdown report.

    Raises OutputError for a report that cannot be read or has no measured row of either benchmark.
    """
    with reading(path, OutputError, "a report that palmfield bench wrote"):
        lines = path.read_text(encoding="utf-8").splitlines()
    models = {name[0].upper() + name[1:]: key for key, name in field.MODELS.items()}
    of_skin: list[skin.SkinRow] = []
    of_field: list[table.FieldRow] = []
    for heading, columns, cells in _rows(lines):
        try:
            if columns == SKIN:
                of_skin.append(_skin_row(cells))
            elif columns == FIELD and heading in models:
                of_field.append(_field_row(models[heading], cells))
        except ValueError:
            raise OutputError(
                f"{path}: the row of '{cells[0]}' has cells that are not numbers; write the report again"
            ) from None
    if any(row.worst > 0.0 for row in of_skin):
        return skin.speed_figure([row for row in of_skin if not row.missing])
    if any(not row.missing for row in of_field):
        return chart.speed_figure(of_field, field.MODELS)
    raise OutputError(f"{path} has no table of palmfield bench skin or field; give a report of one of them")


def _rows(lines: list[str]) -> Iterator[tuple[str, list[str], list[str]]]:
    """Return the heading, columns and cells of each row of all tables."""
    heading, columns = "", list[str]()
    for line in lines:
        if not line.startswith("|"):
            columns = []
            heading = line[3:].strip() if line.startswith("## ") else heading
            continue
        cells = table.cells(line)
        if not columns:
            columns = cells
        elif set(line) - set("|-: ") and len(cells) == len(columns):
            yield heading, columns, cells


def _skin_row(cells: list[str]) -> skin.SkinRow:
    name, size, seconds, *errors = cells
    if seconds.startswith("not run"):
        return skin.SkinRow(name, size, missing=seconds)
    static, moving, stated = (0.01 * float(cell.removesuffix("%")) if cell else None for cell in errors)
    return skin.SkinRow(name, size, float(seconds), static, moving, stated)


def _field_row(model: str, cells: list[str]) -> table.FieldRow:
    name, distance, clock_ms, _, pairs, per_core, error, _ = cells
    if not pairs:
        return table.FieldRow(name, model, distance, missing=clock_ms)
    return table.FieldRow(
        name.partition(" (")[0],
        model,
        distance,
        pairs_per_s=1e6 * float(pairs),
        pairs_per_core_s=1e6 * float(per_core) if per_core else None,
        error=float(error.split()[0].rstrip(",")),
    )
