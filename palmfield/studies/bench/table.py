"""Format the results of the field benchmark as markdown, and write the rows of a page to a file."""

import csv
import os
import platform
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class FieldRow:
    """One method in one range of distances. If `missing` is set, there are no measurements. Seconds are medians.

    model: a key of MODELS
    range: range in words
    setup_s: time of work that need not be repeated for another drive
    clock_s: wall time of one run
    pairs_per_core_s: pairs per second of core time, or None on a GPU
    error, gradient_error: relative L2 difference from float64 of the same model; of magnitudes if `magnitude` is set
    memory_MiB: peak memory minus that for a few points
    """

    name: str
    model: str
    range: str
    missing: str = ""
    version: str = ""
    setup_s: float = 0.0
    clock_s: float = 0.0
    pairs_per_s: float = 0.0
    pairs_per_core_s: float | None = None
    error: float = 0.0
    gradient_error: float | None = None
    magnitude: bool = False
    memory_MiB: float = 0.0


@dataclass(frozen=True)
class Head:
    command: str
    commit: str
    processor: str
    device: str
    yardstick_s: float
    cores: float
    runs: int
    transducers: int
    points: tuple[int, ...]
    picture: str


def processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor()


def cells(line: str) -> list[str]:
    """Return the cells of a row of a markdown table."""
    return [cell.strip() for cell in line.strip()[1:-1].split("|")]


def keep_rows(page: Path, table: list[str], name: str = "") -> str:
    """Write a markdown table as CSV to the folder data next to a page and return the link to it.

    table: lines including the heading and the rule; name: name of the file, default that of the page. Raises OSError.
    """
    file = page.parent / "data" / f"{name or page.stem}.csv"
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream, lineterminator="\n").writerows(cells(line) for line in [table[0], *table[2:]])
    return f"[{file.name}](data/{file.name})"


def ranged(rows: list[str], by: tuple[int, ...], of: tuple[int, ...]) -> list[str]:
    """Return one row for all markdown rows with equal cells in the columns `by`. It has ranges in the columns `of`.

    of: columns of numbers, with or without a unit after a space
    """

    def number(cell: str) -> float:
        return float(cell.split()[0])

    groups: dict[tuple[str, ...], list[list[str]]] = {}
    for own in map(cells, rows):
        groups.setdefault(tuple(own[i] for i in by), []).append([own[i] for i in of])
    lines = []
    for key, some in groups.items():
        ends = [(min(column, key=number), max(column, key=number)) for column in zip(*some, strict=True)]
        spread = (low if number(low) == number(high) else f"{low.split()[0]}-{high}" for low, high in ends)
        lines.append(f"| {' | '.join((*key, *spread))} |")
    return lines


def as_markdown(rows: list[FieldRow], head: Head, models: dict[str, str]) -> str:
    lines = [
        "# Speed and error of the field",
        "",
        f"    {head.command}",
        "",
        f"{head.processor}; palmfield on {head.device}; commit {head.commit}. A yardstick was measured before "
        f"each round: one float64 product of 1000 x 1000 matrices on one thread took {1e3 * head.yardstick_s:.1f} ms, "
        f"{2.0 / head.yardstick_s:.1f} GFLOP/s. {os.cpu_count()} threads of hashing did {head.cores:.2f} times the "
        "work of one thread, which is an upper bound for all cores.",
        "",
        f"All methods compute the same field: {head.transducers} transducers (four AUTD3 units) and "
        f"{' or '.join(str(n) for n in head.points)} points in a box 0.2 m wide, at two ranges of distance from the "
        "plane of the array. Each method runs in its own process, on one thread unless stated. Values are medians of "
        f"{head.runs} runs. A pair is one transducer and one point. Set-up is work that is not repeated for another "
        "drive. The error is the relative L2 difference of the complex pressure from the same model in float64. For "
        "programs without phase, marked (m), it is the difference of the magnitude. Memory is the peak on the host, "
        "minus that for 64 "
        "points.",
        "",
    ]
    for model, text in models.items():
        some = [row for row in rows if row.model == model]
        if some:
            lines += [
                f"## {text[0].upper() + text[1:]}",
                "",
                "| method | distance | time [ms] | set-up [ms] | M pairs/s | M pairs/core-s | error | memory [MiB] |",
                "|---|---|---|---|---|---|---|---|",
                *(line(row) for row in some),
                "",
            ]
    if head.picture:
        lines += [f"![Speed against error]({head.picture})", ""]
    return "\n".join(lines)


def line(row: FieldRow) -> str:
    if row.missing:
        return f"| {row.name} | {row.range} | not installed ({row.missing}) | | | | | |"
    name = row.name + (f" ({row.version})" if row.version else "")
    error = f"{row.error:.1e}" + (" (m)" if row.magnitude else "")
    if row.gradient_error is not None:
        error += f", gradient {row.gradient_error:.1e}"
    per_core = "" if row.pairs_per_core_s is None else f"{row.pairs_per_core_s / 1e6:.0f}"
    return (
        f"| {name} | {row.range} | {1e3 * row.clock_s:.3g} | {1e3 * row.setup_s:.3g} | {row.pairs_per_s / 1e6:.0f} "
        f"| {per_core} | {error} | {max(row.memory_MiB, 0.0):.0f} |"
    )
