"""Write the page of a paper in Markdown: claims, what they depend on, controls, and all other numbers."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from palmfield_papers.answer import Paper
from palmfield_papers.counts import WEIGHTLESS, counts, noticed, turned_later, unsure, untested, weightless
from palmfield_papers.entries import Book, Entry
from palmfield_papers.rows import Row, Tried

NONE = "-"
"""Text of an empty cell in a table."""
RULES = {
    "relative": "{:.0%} of it",
    "factor": "a factor of {:g}",
    "absolute_degrees": "{:g} degrees",
    "dB": "{:g} dB",
}


def number(value: object) -> str:
    """Return a value as text: with three digits, as a range, in words, or a dash."""
    if value is None:
        return NONE
    if isinstance(value, list | tuple):
        return " to ".join(number(one) for one in value)
    return f"{value:.3g}" if isinstance(value, int | float) else _cell(str(value))


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    body = ["| " + " | ".join(line) + " |" for line in lines]
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *body, ""] if body else ["None.", ""]


def _printed(entry: Entry) -> str:
    unit = "" if entry.unit == "1" else f" {entry.unit}"
    corrected = "" if entry.corrected is None else f" (right: {number(entry.corrected)})"
    return f"{number(entry.value)}{unit}{corrected}, {entry.column}"


def _tolerance(entry: Entry) -> str:
    if entry.tolerance.kind == "inequality":
        return _cell(entry.condition or "yes or no")
    rule = RULES.get(entry.tolerance.kind)
    return rule.format(entry.tolerance.value) if rule else NONE


def _ours(one: Tried | None) -> list[str]:
    """Return our value, its numerical error and its band."""
    if one is None or one.answer is None:
        return [NONE, NONE, NONE]
    return [number(one.answer.value), number(one.answer.error), number(one.answer.band)]


def _within(one: Tried) -> str:
    if one.comparison is None:
        return NONE
    return "yes" if one.comparison.within else "no"


def _distance(one: Tried | None) -> str:
    if one is None or one.comparison is None:
        return NONE
    return f"{one.comparison.distance:+.2g}"


def _note(one: Tried | None) -> str:
    if one is None:
        return ""
    if one.failed:
        return f"**failed:** {_cell(one.failed)}"
    return "" if one.answer is None else _cell(one.answer.note)


def _share(row: Row) -> str:
    within = [one.comparison.within for one in row.tried if one.comparison is not None]
    return f"{sum(within)} of {len(within)}" if within else NONE


def _by_itself(row: Row, one: Tried) -> str:
    """Return the axis in which a reading differs from the base, and its value."""
    base = row.tried[0].readings
    changed = [f"{axis}: {value}" for axis, value in one.readings.items() if value != base[axis]]
    return _cell(", ".join(changed) or "base (" + "; ".join(base.values()) + ")") if base else "base"


def _claims(rows: Sequence[Row]) -> list[str]:
    head = (
        "id", "what", "paper", "ours", "numerical error", "band of inputs", "tolerance", "distance", "readings within",
        "verdict", "remark",
    )  # fmt: skip
    return _table(
        head,
        (
            (
                row.entry.id, _cell(row.entry.quantity), _printed(row.entry), *_ours(row.base), _tolerance(row.entry),
                _distance(row.base), _share(row), f"**{row.verdict}**",
                _note(row.base) if row.entry.testable else _cell(row.entry.reason),
            )
            for row in rows
        ),
    )  # fmt: skip


def _readings(rows: Sequence[Row]) -> list[str]:
    out: list[str] = []
    for row in rows:
        if len(row.tried) < 2:
            continue
        out += [f"**{row.entry.id}**, {_cell(row.entry.quantity)}: {_printed(row.entry)}", ""]
        out += _table(
            ("reading", "ours", "numerical error", "band", "distance", "within", "remark"),
            (
                (
                    _by_itself(row, one), *_ours(one), _distance(one),
                    _within(one), _note(one),
                )
                for one in row.tried
            ),
        )  # fmt: skip
    return out


def _causes(rows: Sequence[Row]) -> list[str]:
    lines = [
        (row.entry.id, _cell(what), *_ours(one)[:2], _within(one), _note(one))
        for row in rows
        for what, one in row.causes
    ]  # fmt: skip
    return _table(("id", "what was changed", "ours then", "numerical error", "within then", "remark"), lines)


def _controls(book: Book, rows: Sequence[Row]) -> list[str]:
    out: list[str] = []
    for one in noticed(book.controls, rows):
        name = one.control.name
        result = "works" if one.works else "**failed: the claims that it lists are weak evidence**"
        out += [
            f"**{name}**: {_cell(one.control.changes)} Turned {len(one.turned)} of {len(one.control.sensitive)} listed "
            f"claims, {one.wanted} needed: {result}.",
            "",
        ]
        out += _table(
            ("id", "listed", "distance without", "distance with", "ours with", "turned"),
            (
                (
                    row.entry.id, "yes" if row.entry.id in one.control.sensitive else "no", _distance(row.base),
                    _distance(row.controls[name]), _ours(row.controls[name])[0],
                    {True: "yes", False: "no", None: _note(row.controls[name]) or "no answer"}[row.turned(name)],
                )
                for row in rows
                if name in row.controls
            ),
        )  # fmt: skip
    return out


def _later(rows: Sequence[Row]) -> list[str]:
    return _table(
        ("id", "what could make it fail, as fixed beforehand", "what was done, written later", "distance without",
         "distance with", "ours with", "turned"),
        (
            (
                row.entry.id, _cell(row.entry.why_it_could_fail or ""), _cell(what), _distance(row.base),
                _distance(one), _ours(one)[0],
                {True: "yes", False: "no", None: _note(one) or "no answer"}[row.differs(one)],
            )
            for row in rows
            for what, one in row.later
        ),
    )  # fmt: skip


def _found_later(rows: Sequence[Row]) -> list[str]:
    return _table(
        ("id", "what", "paper", "ours at the base reading", "within", "reading found later", "ours then",
         "numerical error", "distance", "within then"),
        (
            (
                row.entry.id, _cell(row.entry.quantity), _printed(row.entry), _ours(row.base)[0],
                NONE if row.base is None else _within(row.base), _cell(what), *_ours(one)[:2], _distance(one),
                _within(one),
            )
            for row in rows
            for what, one in row.found_later
        ),
    )  # fmt: skip


def _others(rows: Sequence[Row]) -> list[str]:
    return _table(
        ("id", "what", "paper", "ours", "numerical error", "band of inputs", "distance", "remark"),
        (
            (
                row.entry.id, _cell(row.entry.quantity), _printed(row.entry),
                *(_ours(row.base) if row.tried else ["as given" if row.entry.kind == "INPUT" else NONE, NONE, NONE]),
                _distance(row.base), _note(row.base),
            )
            for row in rows
        ),
    )  # fmt: skip


def _shown(rows: Sequence[Row]) -> list[str]:
    lines = [
        (row.entry.id, _cell(what), number(value), row.entry.unit)
        for row in rows
        if row.base is not None and row.base.answer is not None
        for what, value in row.base.answer.shown.items()
    ]
    return _table(("id", "what", "ours", "unit of the entry"), lines)


def row_text(row: Row) -> str:
    """Return a row as text for a terminal: the number, and our value under each reading, control and cause."""
    lines = [f"{row.entry.id} {row.entry.quantity}: {_printed(row.entry)}; {row.verdict or row.entry.kind}"]
    tried = [(_by_itself(row, one), one) for one in row.tried]
    tried += [(f"control {name}", one) for name, one in row.controls.items()]
    tried += [(f"cause: {what}", one) for what, one in row.causes]
    tried += [(f"later: {what}", one) for what, one in (*row.later, *row.found_later)]
    for what, one in tried:
        ours, error, band = _ours(one)
        lines.append(f"  {what}: {ours} (error {error}, band {band}), distance {_distance(one)} {_note(one)}".rstrip())
    return "\n".join(lines)


def page(
    paper: Paper, book: Book, rows: Sequence[Row], pictures: Sequence[tuple[Path, str]], notes: str, made: str
) -> str:
    """Return the page. pictures: file next to the page, and caption; notes: Markdown; made: how and when, in words"""
    kinds = {kind: [row for row in rows if row.entry.kind == kind] for kind in ("CLAIM", "ERRATUM", "CALC", "INPUT")}
    claims = kinds["CLAIM"]
    came = counts(rows)
    agreeing = came["agrees"]
    loose, late, near = untested(rows), turned_later(rows), unsure(rows)
    empty = weightless(rows)
    carrying = f"{agreeing - len(empty)} of {agreeing} agreements carry weight. " if agreeing else ""
    verdicts = ", ".join(f"{count} {name}" for name, count in came.items() if count)
    hanging = [row.entry.id for row in claims if row.verdict == "depends"]
    changes = [change for change in book.changes if change["id"] in {row.entry.id for row in rows}]
    out = [
        f"# {paper.title}", "", paper.about, "", made, "",
        "[The page of the gallery](../README.md) describes the comparison and defines the words. *Distance* is "
        "measured from the limit of the tolerance and is positive inside. For numbers its unit is the tolerance (1 if "
        "both are equal, 0 at the limit), for inequalities the unit of the compared quantity.", "",
        f"**{len(claims)} claims: {verdicts}. {carrying.strip()}** "
        + (f"Claims that depend on a reading: {', '.join(hanging)}. " if hanging else "")
        + (f"Of {agreeing} claims that agree, no control turns {len(loose)}: {', '.join(loose)}. " if loose else "")
        + (f"Of these {len(late)} are turned by controls that were written later: {', '.join(late)}. " if late else "")
        + (f"Verdicts that another number within the numerical error would change: {', '.join(near)}." if near else ""),
        "",
        "## Claims", "", *_claims(claims),
        "## Agreements that no result of a run could have turned", "",
        *_table(("id", "why the evidence is weak"), ((name, WEIGHTLESS[name]) for name in empty)),
        "## Figures", "",
        *(line for path, caption in pictures for line in (f"![{caption}]({path.name})", "", caption, "")),
        "## Why claims disagree", "", *_causes(claims),
        "## Readings", "", *_readings(claims),
        "## Controls", "", *_controls(book, claims),
        "## Controls written later", "",
        "For claims that agree and that no control above turns. The change that could make a claim fail was fixed "
        "beforehand in words. Its code was written after the answers were seen: it is weaker evidence than a control.",
        "",
        *_later(claims),
        "## Readings found later", "",
        "These readings were found from the answers and do not count in the verdicts. All claims that they affect are "
        "listed.", "",
        *_found_later(claims),
        "## Shown, not counted", "", *_shown(rows),
        "## Where the paper contradicts itself", "", *_others(kinds["ERRATUM"]),
        "## Our own checks", "", *_others(kinds["CALC"]),
        "## Inputs", "", *_others(kinds["INPUT"]),
    ]  # fmt: skip
    if changes:
        out += ["## Changes after the first version", "", *(f"- {change}" for change in changes), ""]
    if notes:
        out += ["## Notes", "", notes.strip(), ""]
    return "\n".join(out)
