"""Code of the documentation: every block of shell and Python on every page runs in a test, or says why not."""

from pathlib import Path

import page_code
import pytest
from page_code import ROOT, RUN, blocks, cells, run_page

pytestmark = pytest.mark.usefixtures("kept_operators")
DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if path.relative_to(DOCS).parts[0] not in ("bench", "gallery"))
NOTEBOOKS = sorted(DOCS.rglob("*.ipynb"))
ELSEWHERE = {
    "boards.md": ("test_boards_example.py", "python"),
    "sweeps.md": ("test_sweeps_page.py", "python"),
    "tutorials/drive_your_array.md": ("test_drive_your_array.py", "sh"),
}
"""Pages of which another test runs all blocks of a language, in real time or on workers."""
INSTEAD = {
    "python.md": {
        'palmfield.plan("mjcf/scenes/palm_am200.xml")': 'palmfield.plan("mjcf/scenes/phantom_step.xml")',
        'palmfield.run("mjcf/scenes/palm_am200.xml", "out/palm")': (
            'palmfield.run(palmfield.load("mjcf/scenes/phantom_step.xml", accuracy=0.3), "out/palm", duration_s=0.004)'
        ),
        '"mjcf/scenes/two_hands_both_feel.xml")\nhands.run(0.01)': (
            '"mjcf/scenes/two_hands_both_feel.xml", accuracy=0.5)\nhands.run(0.002)'
        ),
        '"skin.accuracy": 0.2': '"skin.accuracy": 0.5, "skin.patch_radius_m": 0.02',
        "sim.run(0.02)": "sim.run(0.002)",
    },
    "skin.md": {"accuracy=0.01": "accuracy=0.1"},
    "results.md": {
        "palm_am200.xml --out": "palm_am200.xml --accuracy 0.5 --duration 0.02 --set skin.patch_radius_m=0.03 "
        "--no-plots --out"
    },
    "usd.md": {
        "palm_am200.xml --out": "palm_am200.xml --accuracy 0.5 --duration 0.005 --set skin.patch_radius_m=0.02 "
        "--no-plots --out",
        "--from 20 --to 40": "--from 1 --to 4",
        "--field-time 12.5": "--field-time 2.5",
    },
}
"""What is run in place of what a page says, so that the test is quick."""
NOT_RUN = {
    "boards.md": 3,
    "compare.md": 1,
    "experiments.md": 1,
    "installation.md": 2,
    "plots.md": 1,
    "stock_viewer.md": 1,
    "sweeps.md": 1,
    "trials.md": 3,
    "user_meshes.md": 1,
    "view.md": 2,
    "tutorials/drive_your_array.md": 2,
    "tutorials/first_scene.md": 1,
    "tutorials/paper_figure.md": 1,
}
"""How many blocks of a page are marked as not run; each says why in its source."""
NIGHTLY = ("usd.md", "tutorials/paper_figure.md", "tutorials/your_hand.md", "tutorials/your_stimulus.md")
"""Pages of many commands, each of which has tests of its own; that it has these options is in test_readme.py."""


def name_of(page: Path) -> str:
    return str(page.relative_to(DOCS))


def listed(page: Path) -> list[page_code.Block]:
    return cells(page) if page.suffix == ".ipynb" else blocks(page.read_text(encoding="utf-8"))


def to_run(page: Path) -> list[page_code.Block]:
    return [block for block in listed(page) if block.language in RUN and "not run" not in block.marks]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_blocks_that_do_not_run_are_counted(page):
    left_out = [block for block in listed(page) if "not run" in block.marks]
    assert len(left_out) == NOT_RUN.get(name_of(page), 0), [block.code for block in left_out]
    assert all(len(block.marks["not run"]) > 10 for block in left_out)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=name_of(page), marks=[pytest.mark.nightly] if name_of(page) in NIGHTLY else [])
        for page in [*PAGES, *NOTEBOOKS]
        if to_run(page)
    ],
)
def test_the_code_of_a_page_runs_and_prints_what_the_page_shows(page, tmp_path, monkeypatch):
    name = name_of(page)
    if name in ELSEWHERE:
        test, language = ELSEWHERE[name]
        assert page.name in (Path(__file__).parent / test).read_text(encoding="utf-8")
        assert {block.language for block in to_run(page)} == {language}
        return
    done = run_page(listed(page), tmp_path, monkeypatch, instead=INSTEAD.get(name))
    told = sum(block.language == "text" and block.follows for block in listed(page))
    assert done.said and done.compared == told


# -- the runner itself ---------------------------------------------------------------------------------------------


def told(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> page_code.Page:
    return run_page(blocks(text), tmp_path, monkeypatch)


PRINTS = "```python\nprint('a', 1.26, 'b')\nprint(7, 'c')\n```\n\n"


@pytest.mark.parametrize(
    "shown", ["a 1.26 b\n7 c", "a 1.3 b\n...", "...\n7 c", "a … b\n7 c", "│ a │ 1.26   b │\n7 c", "a 1.25 b\n7 c"]
)
def test_what_is_printed_is_shown_to_the_digits_shown(shown, tmp_path, monkeypatch):
    assert told(f"{PRINTS}```text\n{shown}\n```\n", tmp_path, monkeypatch).compared == 1


@pytest.mark.parametrize(
    "shown", ["a 1.28 b\n7 c", "a 1.26 b", "7 c", "a 1.26 b\n8 c", "a 1.5 b\n...", "...\na 1.26 b"]
)
def test_what_is_not_printed_is_noticed(shown, tmp_path, monkeypatch):
    with pytest.raises(AssertionError, match="page"):
        told(f"{PRINTS}```text\n{shown}\n```\n", tmp_path, monkeypatch)


def test_blocks_share_names_write_files_and_run_commands(tmp_path, monkeypatch):
    page = told(
        "<!-- file: in/a.toml -->\n```toml\nx = 2\n```\n```python\ny = 3\n```\n"
        "```sh\ncat in/a.toml\n```\n```text\nx = 2\n```\n```python\nprint(y)\n```\n```text\n3\n```\n"
        "<!-- exit code: 2 -->\n```sh\npalmfield keys nothing\n```\n"
        "<!-- not run: for want of a board -->\n```sh\nfalse\n```\n```xml\n<a/>\n```\n",
        tmp_path,
        monkeypatch,
    )
    assert page.compared == 2 and page.not_run == ["for want of a board"] and page.shown == 1
    assert "palmfield: " in page.said["palmfield keys nothing"]


def test_a_command_that_fails_and_words_that_a_page_lacks_are_noticed(tmp_path, monkeypatch):
    with pytest.raises(AssertionError, match="ended with 1"):
        told("```sh\nfalse\n```\n", tmp_path, monkeypatch)
    (tmp_path / "other").mkdir()
    with pytest.raises(AssertionError, match="no longer says"):
        run_page(blocks("```sh\ntrue\n```\n"), tmp_path / "other", monkeypatch, instead={"absent": "x"})
