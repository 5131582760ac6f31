"""A commit that a page names is one of the repository's history."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NAMED = re.compile(r"\b(?:commit|at) `?([0-9a-f]{7,40})\b")


def git(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)


def test_every_commit_that_a_page_names_exists() -> None:
    if git("rev-parse", "--is-shallow-repository").stdout.strip() != "false":
        pytest.skip("no whole git history here")
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    named = {(page.relative_to(ROOT), name) for page in pages for name in NAMED.findall(page.read_text())}
    assert len(named) > 5
    lost = sorted(f"{page}: {name}" for page, name in named if git("cat-file", "-e", f"{name}^{{commit}}").returncode)
    assert not lost, "\n".join(lost)
