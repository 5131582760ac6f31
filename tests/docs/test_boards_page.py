"""The page docs/boards.md against the registry of boards."""

from pathlib import Path

from palmfield.cli.boards import as_markdown
from palmfield.drive.boards import BOARDS

PAGE = (Path(__file__).parents[2] / "docs" / "boards.md").read_text()


def test_the_page_ends_with_what_the_registry_says():
    assert PAGE.endswith(as_markdown()), "palmfield boards --markdown writes it"


def test_every_board_has_a_section():
    for board in BOARDS.values():
        assert f"| {board.name} |" in PAGE
        assert board.exact or f"\n### {board.name}\n" in PAGE
