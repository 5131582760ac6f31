"""`palmfield papers`: the rows of each paper, its page, figures and rows.json, and an index of all papers."""

import json
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from palmfield.device import resolve
from palmfield.errors import SceneError, did_you_mean, unwritable
from palmfield.outputs.store import write_whole
from palmfield.outputs.style import save, style
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor
from palmfield.terminal import bars
from palmfield_papers.answer import Paper, Picture, Setting
from palmfield_papers.counts import counts, noticed, turned_later, unsure, untested, weightless
from palmfield_papers.entries import Book, book
from palmfield_papers.index import as_html, index
from palmfield_papers.page import page
from palmfield_papers.registry import NAMES, TITLES, paper
from palmfield_papers.rows import Row, row
from palmfield_papers.side_by_side import Report, side_by_side

logger = logging.getLogger("palmfield.papers")
FORMAT = 1
ROWS, PAGE, INDEX = "rows.json", "README.md", "index.html"


@dataclass(frozen=True)
class Done:
    """Result of a paper. verdicts: counts; failed: ids of rows with errors; folder: folder of its files"""

    name: str
    verdicts: dict[str, int]
    failed: tuple[str, ...]
    folder: Path
    seconds: float
    interrupted: bool

    def __str__(self) -> str:
        counts_ = ", ".join(f"{count} {name}" for name, count in self.verdicts.items() if count) or "no claims"
        failed = f"; failed: {', '.join(self.failed)}" if self.failed else ""
        return f"{self.name}: {counts_} in {self.seconds:.0f} s of processor{failed}; {self.folder / PAGE}"


def papers(
    names: Sequence[str] = NAMES,
    *,
    quick: bool = False,
    out: str | Path = "out/papers",
    device: str = "cpu",
    jobs: int = 1,
    progress: bool = False,
) -> list[Done]:
    """Compute the claims of papers, and write out/NAME/{README.md, rows.json, *.png} and out/index.html.

    names: names of the papers
    quick: whether to compute coarser, in minutes
    device: device of kernels that can run on a GPU
    jobs: number of papers computed in parallel, each in a separate process
    rows.json is written after each row, so that completed rows remain readable. A failed row is reported on the page,
    and the next row is computed. Ctrl-C writes the pages of completed rows, then raises KeyboardInterrupt. Raises
    SceneError for an unknown paper, device or number of jobs, OutputError if files cannot be written.
    """
    if jobs < 1:
        raise SceneError(f"jobs is {jobs}; give 1 or more")
    chosen = [paper(name) for name in names]
    sizes = {name: len(book().of_paper(one.paper)) for name, one in zip(names, chosen, strict=True)}
    setting = Setting(quick=quick, device=_device(device))
    with _bar(progress, sizes) as report:
        if min(jobs, len(names)) > 1:
            done = side_by_side(partial(_paper, setting=setting, out=Path(out)), names, jobs, report)
        else:
            done = _in_turn(names, setting, Path(out), report)
    _write_text(Path(out) / INDEX, as_html("Four papers, computed again", index(Path(out)), home=False))
    if len(done) < len(names) or any(one.interrupted for one in done):
        raise KeyboardInterrupt
    return done


def _device(name: str) -> str:
    return resolve("cuda:0" if name == "cuda" else name)


def _in_turn(names: Sequence[str], setting: Setting, out: Path, report: Report) -> list[Done]:
    done = []
    for name in names:
        done.append(_paper(name, report, setting=setting, out=out))
        if done[-1].interrupted:
            break
    return done


def numbers(ids: Sequence[str], *, quick: bool = False, device: str = "cpu") -> list[Row]:
    """Return single numbers by the ids of their entries; no files are written. Raises SceneError for an unknown id."""
    book_ = book()
    entries = {entry.id: entry for entry in book_.entries}
    for name in ids:
        if name not in entries:
            near = did_you_mean(name, entries)
            raise SceneError(f"number '{name}'{near} is unknown; see docs/gallery/tolerances.toml")
    by_title = {title: name for name, title in TITLES.items()}
    chosen = [(entries[name], paper(by_title[entries[name].paper])) for name in ids]
    setting = Setting(quick=quick, device=_device(device))
    return [row(entry, one, book_, setting) for entry, one in chosen]


def _paper(name: str, report: Report, *, setting: Setting, out: Path) -> Done:
    one, book_ = paper(name), book()
    folder = out / one.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from None
    found: list[Row] = []
    pictures: list[tuple[Path, str]] = []
    notes, interrupted = "", False
    head = _head(one, setting)
    started = time.process_time()
    try:
        for entry in book_.of_paper(one.paper):
            report(name, entry.id)
            found.append(row(entry, one, book_, setting))
            report(name, "")
            _write_rows(folder / ROWS, head, book_, found)
        pictures += _pictures(one, setting, folder)
        notes = _notes(one, setting)
    except KeyboardInterrupt:
        interrupted = True
    seconds = time.process_time() - started
    _write_rows(folder / ROWS, head | {"seconds": round(seconds, 1)}, book_, found)
    command = f"palmfield papers {one.name}{' --quick' if setting.quick else ''}"
    cut = " The run was interrupted: rows or figures are missing." if interrupted else ""
    made = (
        f"Written by `{command}` at commit {head['commit']}, in {seconds:.0f} s of processor ({head['processor']}, "
        f"kernels on {setting.device}).{cut}"
    )
    text = page(one, book_, found, pictures, notes, made)
    _write_text(folder / PAGE, text)
    _write_text(folder / INDEX, as_html(one.title, text, home=True))
    failed = tuple(row.entry.id for row in found if any(tried.failed for tried in row.tried))
    return Done(one.name, counts(found), failed, folder, seconds, interrupted)


def _notes(one: Paper, setting: Setting) -> str:
    """Return the notes, or the error if writing them failed."""
    if one.notes is None:
        return ""
    try:
        return one.notes(setting)
    except Exception as error:
        logger.exception("notes of %s failed", one.name)
        return f"**failed:** {type(error).__name__}: {error}"


def _head(one: Paper, setting: Setting) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": one.name,
        "paper": one.paper,
        "title": one.title,
        "quick": setting.quick,
        "device": setting.device,
        "commit": git_commit("papers"),
        "processor": processor(),
    }


def _write_rows(path: Path, head: dict[str, Any], book_: Book, found: Sequence[Row]) -> None:
    counts_ = {
        "counts": counts(found),
        "untested": untested(found),
        "weightless": weightless(found),
        "turned_later": turned_later(found),
        "unsure": unsure(found),
        "controls": [
            {"name": one.control.name, "turned": one.turned, "kept": one.kept, "silent": one.silent,
             "wanted": one.wanted, "works": one.works}
            for one in noticed(book_.controls, found)
        ],
    }  # fmt: skip
    text = json.dumps(head | counts_ | {"rows": [one.as_dict() for one in found]}, indent=1, allow_nan=False)
    _write_text(path, text + "\n")


def _write_text(path: Path, text: str) -> None:
    write_whole(path, text.encode())


def _pictures(one: Paper, setting: Setting, folder: Path) -> Iterator[tuple[Path, str]]:
    for picture in one.pictures:
        figure = _drawn(picture, replace(setting, readings=()))
        if figure is not None:
            path = folder / f"{picture.name}.png"
            save(figure, path)
            yield path, picture.caption


def _drawn(picture: Picture, setting: Setting) -> Figure | None:
    """Return the figure. If drawing fails, log an error and return None, because this must not stop the page."""
    try:
        with style():
            return picture.draw(setting)
    except Exception:
        logger.exception("figure %s failed", picture.name)
        return None


@contextmanager
def _bar(show: bool, sizes: Mapping[str, int]) -> Iterator[Report]:
    """Show a bar for each paper. sizes: number of entries by paper"""
    with bars(show) as bar:
        tasks = {name: bar.add_task(name, total=size, start=False) for name, size in sizes.items()}

        def report(name: str, entry: str) -> None:
            if entry:
                bar.start_task(tasks[name])
                bar.update(tasks[name], description=f"{name} {entry}")
            else:
                bar.advance(tasks[name])

        yield report
