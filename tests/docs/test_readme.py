"""README.md: its Python runs, its commands and options are the command line's, its scenes are those that ship."""

import re
import shlex
from pathlib import Path

import page_code
import pytest
from typer.testing import CliRunner

from palmfield.cli.app import GROUP_OF, OF_OTHERS, app

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
BARE = CliRunner()

QUICK = {
    '"skin.accuracy": 0.2': '"skin.accuracy": 0.5, "skin.patch_radius_m": 0.02',
    "sim.run(0.02)": "sim.run(0.002)",
}
"""What a snippet says, and what is run in its place so that the test is quick. Everything else runs as it stands."""


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


# -- Python --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_python_snippets_run_one_after_the_other(tmp_path, monkeypatch):
    code = [block for block in page_code.blocks(README) if block.language == "python"]
    assert code
    done = page_code.run_page(code, tmp_path, monkeypatch, instead=QUICK)
    said = "".join(done.said.values())
    assert "um" in said and "Pa" in said


# -- the command line ----------------------------------------------------------------------------------------------


def commands() -> list[list[str]]:
    """Words of each `palmfield ...` that the pages show, in blocks and in the running text."""
    lines = []
    for page in PAGES:
        text = page.read_text()
        in_blocks = [
            line for block in re.findall(r"```\w*\n(.*?)```", text, flags=re.DOTALL) for line in block.split("\n")
        ]
        indented = re.findall(r"^    (palmfield .*)$", text, flags=re.MULTILINE)
        spans = re.findall(r"`(palmfield [^`]*)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL).replace("\n", " "))
        for line in (*in_blocks, *indented, *spans):
            if re.match(r"\s*palmfield [a-z]", line):
                lines.append(shlex.split(line, comments=True)[1:])
    return lines


def help_of(*words: str) -> str:
    done = BARE.invoke(app, [*words, "--help"], env={"COLUMNS": "200"})
    assert done.exit_code == 0, f"palmfield {' '.join(words)}: {done.output}"
    return done.output


def test_every_command_that_the_pages_show_is_one_with_these_options():
    shown = commands()
    assert len(shown) > 15
    for words in shown:
        groups = ("bench", "calibrate", "experiment", "stimulus", "track")
        command = words[:2] if words[0] in groups else words[:1]
        known = help_of(*command)
        for option in (word.split("=")[0] for word in words if word.startswith("--")):
            assert re.search(rf"{option}\b", known), f"palmfield {' '.join(words)}: no option {option}"


def test_the_readme_shows_every_command():
    shown = {words[0] for block in blocks(README, "sh") for line in block.split("\n")
             if (words := shlex.split(line, comments=True)[1:]) and line.startswith("palmfield ")}  # fmt: skip
    others = re.findall(r"^  ([a-z]+)  ", help_of().split(f"\n{OF_OTHERS}:\n")[1], flags=re.MULTILINE)
    assert shown == {*GROUP_OF, *others}


# -- files ---------------------------------------------------------------------------------------------------------


def test_scenes_in_the_readme_are_those_that_ship():
    table = README.split("## Scenes in mjcf/scenes/")[1].split("\n## ")[0]
    named = set(
        re.findall(r"`([a-z0-9_*]+)`", "".join(line.split("|")[1] for line in table.split("\n") if "|" in line))
    )
    shipped = {path.stem for path in (ROOT / "mjcf" / "scenes").glob("*.xml")}
    plain = {name for name in shipped if name.startswith("plain_")}
    assert named - {"plain_*"} == shipped - plain


def test_files_that_the_readme_names_exist():
    for name in re.findall(r"\b(?:mjcf|scripts|docs)/[\w/]+\.\w+", README):
        assert (ROOT / name).exists(), name
