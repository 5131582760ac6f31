"""What `palmfield papers` does with its options."""

from collections.abc import Sequence
from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.studies.papers.page import told
from palmfield.studies.papers.registry import NAMES
from palmfield.studies.papers.run import INDEX, numbers, papers


def compute_papers(
    names: Sequence[str], *, quick: bool, out: Path, device: str, jobs: int, quiet: bool, as_json: bool
) -> int:
    """Compute, print a line for each paper, and return the exit code: 4 where a row failed."""
    chosen = NAMES if "all" in names or not names else tuple(dict.fromkeys(names))
    done = papers(chosen, quick=quick, out=out, device=device, jobs=jobs, progress=not quiet)
    if as_json:
        print_json({one.name: one.__dict__ | {"folder": str(one.folder)} for one in done})
    else:
        for one in done:
            print(one)
        if not quiet:
            print(f"wrote {out / INDEX}")
    return 4 if any(one.failed for one in done) else 0


def compute_numbers(ids: Sequence[str], *, quick: bool, device: str, as_json: bool) -> int:
    """Compute some numbers alone, print each under its readings and controls, and return the exit code as above."""
    found = numbers(ids, quick=quick, device=device)
    if as_json:
        print_json({one.entry.id: one.as_dict() for one in found})
    else:
        for one in found:
            print(told(one))
    return 4 if any(tried.failed for one in found for tried in one.tried) else 0
