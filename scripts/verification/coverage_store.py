"""Store a coverage run in the repository: a head with seed and frozen commit, and a line per answer.

The lines contain the data of the page: displacements in SI units rounded to DIGITS digits. Cases are drawn again from
the seed. A run can continue in a checkout of the frozen commit, or of a later one with the same CODE.
"""

import json
import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "bench" / "coverage"
DRAWN = ("scripts/verification/coverage_draw.py",)
"""Files that determine the cases of a run, relative to the repository."""
CODE = (
    "palmfield", "warp_kernels", "mjcf", "scripts/verification/coverage_judge.py",
    "scripts/verification/coverage_scenes.py", "scripts/verification/small_scene.py", *DRAWN,
)  # fmt: skip
"""Files that determine answers and palmfield's references; the code with scikit-fem may become more exact later."""
DIGITS = 6
UNUSED = ("velocity_m_s",)
"""Parts of a row that no page uses."""


class ChangedCodeError(Exception):
    """The code differs from that at the start of the run."""


def rounded(value: Any) -> Any:
    """Return plain data with all numbers rounded to DIGITS digits."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    return [rounded(each) for each in value] if isinstance(value, list) else value


def line(row: dict[str, Any]) -> str:
    """Return one row of answers or references as a line of JSON, without UNUSED."""
    kept = {key: value for key, value in row.items() if key not in UNUSED}
    return json.dumps(rounded(kept), separators=(",", ":")) + "\n"


def begin(folder: Path, seed: int, count: int, root: Path = ROOT) -> dict[str, Any]:
    """Write the head of a new run; the code is frozen at the present commit.

    Raises ChangedCodeError if a run exists already, or if the working tree differs from the commit.
    """
    head = folder / "head.json"
    if head.exists():
        raise ChangedCodeError(
            f"{head} holds the run of seed {json.loads(head.read_text())['seed']}: remove its folder"
        )
    frozen = _git(root, "rev-parse", "HEAD")
    check_code(frozen, root)
    folder.mkdir(parents=True, exist_ok=True)
    facts = {"seed": seed, "count": count, "frozen": frozen}
    head.write_text(json.dumps(facts) + "\n")
    return facts


def known_head(folder: Path, root: Path = ROOT, code: tuple[str, ...] = CODE) -> dict[str, Any]:
    """Return the head of the run in a folder. Raises ChangedCodeError if there is none, or if the code differs."""
    head = folder / "head.json"
    if not head.exists():
        raise ChangedCodeError(f"no run in {folder}: begin one with step 'begin'")
    facts: dict[str, Any] = json.loads(head.read_text())
    check_code(facts["frozen"], root, code)
    return facts


def check_code(frozen: str, root: Path = ROOT, code: tuple[str, ...] = CODE) -> None:
    """Raise ChangedCodeError if the code in the working tree differs from that at a commit."""
    changed = _git(root, "diff", "--name-only", frozen, "--", *code).split()
    changed += _git(root, "ls-files", "--others", "--exclude-standard", "--", *code).split()
    if changed:
        names = ", ".join(changed[:3]) + (f" and {len(changed) - 3} more" if len(changed) > 3 else "")
        raise ChangedCodeError(f"the code is not that of commit {frozen[:7]}, with which the run was begun: {names}")


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ChangedCodeError(f"git {words[0]}: {done.stderr.strip()}")
    return done.stdout.strip()
