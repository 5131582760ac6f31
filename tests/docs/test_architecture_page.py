"""The page docs/architecture.md against the tree that it describes."""

import ast
import configparser
import re
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest

from palmfield.acoustics.arp import LAWS
from palmfield.acoustics.layouts import LAYOUTS
from palmfield.config import CONFIGS, ArpLaw, DriverConfig
from palmfield.config.array import Layout
from palmfield.config.skin import Solver
from palmfield.drive.boards import BOARDS
from palmfield.session.simulation import Simulation
from palmfield.skin.costs import scene_choices
from palmfield.skin.explicit_layer import OWN

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
REFERENCE = re.compile(r"`((?:\w+/)*\w+\.py):([\w.]+)`")
WAYS = "The way of a pose through the code", "The way of a focus through the code"


def section(heading: str) -> str:
    return PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]


def table(first_heading: str) -> list[list[str]]:
    """Cells of the table whose first column has this heading."""
    rows = PAGE.split(f"\n| {first_heading} |")[1].split("\n\n")[0].split("\n")[2:]
    return [[cell.strip().replace("\\|", "|") for cell in row.strip().strip("|").split(" | ")] for row in rows]


def code_words(text: str) -> list[str]:
    return re.findall(r"`([^`\n]+)`", text)


def source(name: str) -> Path:
    """A file that the page names: in palmfield/, or from the root."""
    return ROOT / name if (ROOT / name).exists() else ROOT / "palmfield" / name


# -- references ----------------------------------------------------------------------------------------------------


def test_every_file_and_name_that_the_page_refers_to_exists():
    references = REFERENCE.findall(PAGE)
    assert len(references) > 80
    for file, name in references:
        path = source(file)
        assert path.exists(), file
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        thing = import_module(module)
        for part in name.split("."):
            thing = getattr(thing, part)
    for word in code_words(PAGE):
        if re.fullmatch(r"[\w.]+/[\w./]*", word):
            assert source(word).exists(), word


def test_every_module_and_class_that_the_page_names_exists():
    plugins = {config.plugin for config in CONFIGS}
    # In a row such as "`--help` and `a : b`" each part is a name.
    words = {part.strip("() ") for word in code_words(PAGE) for part in re.split(r" : | \\?\| ", word)}
    classes = {
        node.name
        for path in (ROOT / "palmfield").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
    }
    absent = optional_layers() - {f"palmfield.{path.name}" for path in (ROOT / "palmfield").iterdir()}
    for word in words - plugins - absent:
        if re.fullmatch(r"(palmfield|warp_kernels)(\.\w+)*", word):
            assert resolves(word), word
        elif re.fullmatch(r"[A-Z][a-z]+[A-Z]\w*|World|Module", word):
            assert word in classes, word


def resolves(dotted: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one."""
    if dotted == "palmfield.__init__":
        return True
    try:
        import_module(dotted)
    except ModuleNotFoundError:
        module, _, name = dotted.rpartition(".")
        return bool(module) and hasattr(import_module(module), name)
    return True


# -- layers and imports --------------------------------------------------------------------------------------------


def contract() -> list[str]:
    parser = configparser.ConfigParser()
    parser.read(ROOT / ".importlinter")
    return parser["importlinter:contract:layers"]["layers"].split("\n")[1:]


def optional_layers() -> set[str]:
    return {line.strip("()") for line in contract() if line.startswith("(")}


def test_layers_are_those_of_the_contract():
    assert [row[0].strip("`") for row in table("layer")] == contract()


def test_an_optional_layer_is_said_to_be_empty_exactly_while_it_is():
    for layer, words in ((row[0].strip("`()"), row[1]) for row in table("layer")):
        if layer in optional_layers():
            there = (ROOT / layer.replace(".", "/")).is_dir()
            assert there != ("empty today" in words), layer


@cache
def imports() -> dict[str, set[str]]:
    """What each module imports, also for type checking and inside functions; names taken from modules too."""
    result = {}
    for package in ("palmfield", "warp_kernels"):
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            if parts[-1] == "__init__" and len(parts) > 2:
                parts = parts[:-1]
            result[".".join(parts)] = set(imported(ast.parse(path.read_text())))
    return result


def imported(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def inside(name: str, whole: str) -> bool:
    return name == whole or name.startswith(f"{whole}.")


def importers(of: str) -> set[str]:
    """Modules, without its own, that import something."""
    return {
        module
        for module, names in imports().items()
        if not inside(module, of) and any(inside(name, of) for name in names)
    }


@pytest.mark.parametrize("row", table("module"), ids=lambda row: row[0].strip("`"))
def test_what_the_page_says_of_imports(row: list[str]):
    module, yes, no = (code_words(cell) for cell in row)
    mine = {m for m in imports() if inside(m, module[0])}
    assert mine and yes and no
    for other in yes:
        assert importers(other) & mine, f"{module[0]} does not import {other}"
    for other in no:
        assert not importers(other) & mine, f"{module[0]} imports {other}: {sorted(importers(other) & mine)}"


@pytest.mark.parametrize("row", table("what"), ids=lambda row: row[0].strip("`"))
def test_what_is_imported_in_one_place_only(row: list[str]):
    what, only = code_words(row[0])[0], code_words(row[1])
    by = importers(what)
    assert by
    assert {m for m in by if not any(inside(m, place) for place in only)} == set()
    assert all(any(inside(m, place) for m in by) for place in only), f"not all of {only} import {what}"


def test_keys_allow_what_the_registries_of_the_seams_hold():
    assert set(get_args(Layout)) == {*LAYOUTS, "sites", "csv"}
    assert set(get_args(ArpLaw)) == set(LAWS)
    assert set(get_args(DriverConfig.model_fields["board"].annotation)) == set(BOARDS)
    assert set(get_args(Solver)) == {"auto", *OWN}
    assert {choice.name for choice in scene_choices(1000.0, 100.0, 10.0, None, 100.0, None)} < set(OWN)


# -- the two ways through the code ---------------------------------------------------------------------------------


def lines_of(heading: str) -> list[str]:
    """The numbered lines of a section, each with what goes on below it."""
    return re.split(r"\n(?=\d+\. )", section(heading).strip())


def calls_of(work: Callable[[], object]) -> list[str]:
    """FILE:NAME of every function of palmfield that is called, in order."""
    seen = []
    folder = str(ROOT / "palmfield") + "/"

    def note(frame, event, argument):
        if event == "call" and frame.f_code.co_filename.startswith(folder):
            seen.append(f"{frame.f_code.co_filename.removeprefix(folder)}:{frame.f_code.co_qualname}")

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return seen


def first_missing(lines: list[str], calls: list[str]) -> str | None:
    """The first line whose function is not called after those of the lines before; None where all are."""
    rest = iter(calls)
    for line in lines:
        file, name = REFERENCE.findall(line)[0]
        if f"{file}:{name}" not in rest:
            return line
    return None


@pytest.mark.parametrize("heading", WAYS)
def test_a_way_has_ten_lines_and_each_names_a_function(heading):
    lines = lines_of(heading)
    assert [line.split(".")[0] for line in lines] == [str(i) for i in range(1, 11)]
    assert all(REFERENCE.search(line) for line in lines)


def test_a_pose_goes_the_way_that_the_page_tells(small_scene):
    sim = Simulation(small_scene(skin={"body_sound": "shadows"}))
    sim.step()
    sim.data.qpos[0] += 1e-3
    assert first_missing(lines_of(WAYS[0]), calls_of(sim.step)) is None


def test_a_focus_goes_the_way_that_the_page_tells(small_scene):
    circle = {
        "focus_m": "0 0 0.1203", "path": "circle", "path_diameter_m": 0.02, "path_rate_Hz": 50, "modulation": "none",
        "am_quantity": None, "am_frequency_Hz": None, "am_depth": None, "control_rate_Hz": 100,
    }  # fmt: skip
    path = small_scene(stimulus=circle, array={"response": "on"})
    calls = calls_of(lambda: Simulation(path).step())
    assert first_missing(lines_of(WAYS[1]), calls) is None
