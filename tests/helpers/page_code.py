"""Runs the code of a page as a reader would: every fenced block, in order, in a folder of its own.

| block | what happens |
|---|---|
| `sh`, `bash` | each line is a command; `palmfield ...` runs in this process, all else in a shell |
| `python` | runs in the namespace of the page's blocks before it |
| `text` | right after one of these: what that block prints, see `compare`; elsewhere only shown |
| another, after `<!-- file: NAME -->` | is written to a file of that name |

Right before a block `<!-- not run: REASON -->` leaves it out, and `<!-- exit code: N -->` says how a command ends.
Blocks of other languages without a mark are only shown.
"""

import io
import json
import os
import re
import shlex
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from palmfield.cli.app import main

ROOT = Path(__file__).parents[2]
FENCE = re.compile(
    r"^(?P<marks>(?:<!-- [^\n]* -->\n+)*)```(?P<language>\w*)\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL
)
MARK = re.compile(r"<!-- (file|not run|exit code): (.*?) -->")
FRAME = str.maketrans(dict.fromkeys("┏━┳┓┃┡╇┩│└┴┘─┌┬┐├┼┤╇╭╮╰╯", " "))
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w]*\.\w)")
RUN = ("sh", "bash", "python")
WIDTH = "130"
"""Columns of the terminal for which pages show tables."""


class Block(NamedTuple):
    """language: after the fence; code: its lines; marks: by kind; follows: whether it comes right after the last"""

    language: str
    code: str
    marks: dict[str, str]
    follows: bool


@dataclass
class Page:
    """What came of a page.

    said: by each command line or piece of Python; compared: how many blocks were held against that
    not_run: why blocks were left out; shown: how many blocks say something else
    """

    said: dict[str, str] = field(default_factory=dict)
    compared: int = 0
    not_run: list[str] = field(default_factory=list)
    shown: int = 0


def blocks(text: str) -> list[Block]:
    """The fenced blocks of a page in Markdown."""
    result, end = [], 0
    for found in FENCE.finditer(text):
        marks = {kind: value for kind, value in MARK.findall(found["marks"])}
        follows = not text[end : found.start()].strip()
        result.append(Block(found["language"], found["code"], marks, follows and end > 0))
        end = found.end()
    return result


def cells(path: Path) -> list[Block]:
    """The code cells of a notebook, each with what it printed as a block of its own."""
    result = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            result.append(Block("python", "".join(cell["source"]), {}, False))
            printed = "".join("".join(out["text"]) for out in cell["outputs"] if out["output_type"] == "stream")
            if printed:
                result.append(Block("text", printed, {}, True))
    return result


def run_page(
    listed: list[Block],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    *,
    instead: dict[str, str] | None = None,
    allowed: tuple[int, ...] = (0,),
) -> Page:
    """Run blocks in a folder, which gets links to the repository's scenes and pages.

    instead: what is run in place of what the page says, so that a test is quick or has a port; each must be there
    allowed: exit codes of commands
    """
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", WIDTH)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.syspath_prepend(str(folder))
    for name in ("mjcf", "docs", "examples"):
        (folder / name).symlink_to(ROOT / name)
    page, space, last, used = Page(), {"__name__": "__main__"}, None, set()
    for block in listed:
        code = block.code
        for words, other in (instead or {}).items():
            if words in code:
                used.add(words)
                code = code.replace(words, other)
        if "not run" in block.marks:
            page.not_run.append(block.marks["not run"])
            last = None
        elif "file" in block.marks:
            Path(block.marks["file"]).parent.mkdir(parents=True, exist_ok=True)
            Path(block.marks["file"]).write_text(code, encoding="utf-8")
            last = None
        elif block.language == "python":
            last = page.said[block.code] = _python(code, space)
        elif block.language in RUN:
            wanted = (int(block.marks["exit code"]),) if "exit code" in block.marks else allowed
            told = [(line, _command(line, folder, wanted)) for line in lines(code)]
            page.said.update(told)
            last = "".join(said for _, said in told)
        elif block.language == "text" and block.follows and last is not None:
            compare(block.code, last)
            page.compared += 1
        else:
            page.shown += 1
            last = None
    missing = set(instead or {}) - used
    assert not missing, f"the page no longer says {missing}"
    return page


def lines(code: str) -> list[str]:
    """The commands of a block of shell, without comments and with continued lines joined."""
    joined = code.replace("\\\n", " ").splitlines()
    return [line.strip() for line in joined if line.strip() and not line.strip().startswith("#")]


def _python(code: str, space: dict[str, Any]) -> str:
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(compile(code, "<page>", "exec"), space)
    return printed.getvalue()


def _command(line: str, folder: Path, wanted: tuple[int, ...]) -> str:
    words = shlex.split(line.replace("$PWD", str(folder)), comments=True)
    if words[0] == "palmfield" and not {"|", ">", "&&", ";"} & set(words):
        code, said = _palmfield(words)
    else:
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        ran = subprocess.run(
            ["bash", "-ec", line], cwd=folder, env=os.environ | {"PATH": path, "PYTHONPATH": paths},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300,
        )  # fmt: skip
        code, said = ran.returncode, ran.stdout
    assert code in wanted, f"{line}\nended with {code}:\n{said[-3000:]}"
    return said


def _palmfield(words: list[str]) -> tuple[int, str]:
    """Exit code and all that a palmfield command says, in this process."""
    said, code = io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), redirect_stderr(said):
        patch.setattr(sys, "argv", words)
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return code, said.getvalue()


def compare(shown: str, printed: str) -> None:
    """Hold what a page shows against what was printed: the same lines one after the other, frames of tables apart.

    A line `...` stands for any lines, `…` within a line for any words. Numbers with a fraction may differ by one in the
    last digit that the page shows: what it shows and what is printed are both rounded. Whole numbers are the same.
    """
    said = [words for line in printed.splitlines() if (words := _words(line))]
    at, gap = 0, False
    for line in shown.splitlines():
        told = _words(line)
        if not told:
            continue
        if told == "...":
            gap = True
            continue
        there = range(at, len(said)) if gap else range(at, min(at + 1, len(said)))
        found = next((number for number in there if alike(told, said[number])), None)
        assert found is not None, f"the page shows\n  {told}\nand this came\n  " + "\n  ".join(said[at : at + 30])
        at, gap = found + 1, False
    assert gap or at == len(said), "the page leaves out what came after: " + "\n  ".join(said[at : at + 10])


def _words(line: str) -> str:
    return " ".join(line.translate(FRAME).split())


def alike(shown: str, printed: str) -> bool:
    """Whether a shown line is what was printed, to the digits shown."""
    parts = [re.escape(part) for part in NUMBER.split(shown.replace("…", "\0"))]
    pattern = r"([-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)".join(parts).replace(re.escape("\0"), ".*?").replace("\0", ".*?")
    found = re.fullmatch(pattern, printed)
    if found is None:
        return False
    return all(_near(one, other) for one, other in zip(NUMBER.findall(shown), found.groups(), strict=True))


def _near(shown: str, printed: str) -> bool:
    digits, _, power = shown.partition("e")
    if "." not in digits and not power:
        return shown == printed or ("." in printed and abs(float(shown) - float(printed)) <= 0.5)
    last = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
    return abs(float(shown) - float(printed)) <= last * (1 + 1e-9)
