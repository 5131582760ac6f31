"""What all pages say: links, names of modules, keys and solvers. Their code: test_page_code.py."""

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

from palmfield.config import CONFIGS
from palmfield.outputs.schema import GROUPS
from palmfield.outputs.schema import ROOT as TIMES
from palmfield.skin.solver_choice import WHERE

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
WRITTEN = [page for page in sorted(DOCS.rglob("*.md")) if page.relative_to(DOCS).parts[0] not in ("bench", "gallery")]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "hand_models" / "README.md", *WRITTEN]
FORMER = {"spectral", "disc", "implicit", "explicit", "full"}
"""Names that solvers had; pages name them only to say what they are now."""
PLUGINS = {config.plugin for config in CONFIGS}


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def words(text: str) -> list[str]:
    """What stands between backticks in the running text."""
    return re.findall(r"`([^`]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL).replace("\n", " "))


def resolves(dotted: str) -> bool:
    module, names = dotted, []
    while module:
        try:
            thing = import_module(module)
        except ModuleNotFoundError:
            module, _, name = module.rpartition(".")
            names.insert(0, name)
            continue
        for name in names:
            if not hasattr(thing, name):
                return False
            thing = getattr(thing, name)
        return True
    return False


@pytest.mark.parametrize("page", [*PAGES, *sorted((DOCS / "bench").glob("*.md"))], ids=name_of)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
        if not target.startswith(("http:", "https:")):
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", [*PAGES, *sorted((DOCS / "bench").glob("*.md"))], ids=name_of)
def test_rows_of_tables_are_whole(page):
    lines = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL).splitlines()
    assert not [line for line in lines if line.startswith("| ") and not line.rstrip().endswith("|")]


@pytest.mark.parametrize("page", [*PAGES, *sorted((DOCS / "bench").glob("*.md"))], ids=name_of)
def test_scripts_that_a_page_names_exist(page):
    for path in re.findall(r"\bscripts/[\w/]+\.py", page.read_text()):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_modules_that_a_page_names_exist(page):
    text = page.read_text()
    before = {word for row in re.findall(r"^\|([^|]*)\|", text, re.MULTILINE) for word in words(row)}
    for word in words(text):
        dotted = re.match(r"palmfield(\.\w+)+", word)
        if dotted and dotted[0] not in PLUGINS and not (page.name == "CHANGELOG.md" and word in before):
            assert resolves(dotted[0]), word
        for path in re.findall(r"^(?:palmfield|warp_kernels|tests|scripts|docs|mjcf)/[\w/]+\.\w+", word):
            assert (ROOT / path).exists(), word
        for file, name in re.findall(r"^((?:\w+/)*\w+\.py):([\w.]+)$", word):
            assert resolves("palmfield." + file.removesuffix(".py").replace("/", ".") + "." + name), word


@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in ("CHANGELOG.md", "keys.md")], ids=name_of)
def test_pages_call_solvers_by_their_names(page):
    assert not FORMER & set(words(page.read_text()))


def test_the_page_on_skin_names_every_solver_and_the_changelog_every_former_name():
    page = (DOCS / "skin.md").read_text()
    table = page.split("| solver |")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == set(WHERE)
    changes = (ROOT / "CHANGELOG.md").read_text()
    assert all(re.search(rf'[`"]{name}[`"]', changes) for name in FORMER)


def test_the_changelog_names_every_renamed_key_and_every_group_of_a_result():
    changes = (ROOT / "CHANGELOG.md").read_text()
    for config in CONFIGS:
        for name in config.renamed:
            key, _, value = name.partition("=")
            assert f"`{config.plugin}`: key `{key}`" in changes and (not value or f"`{value}`" in changes)
    known = {name for variables in GROUPS.values() for name in variables} | set(TIMES)
    rows = re.findall(r"\| `/(\w+)/NAME`: (.*) \|", changes)
    assert {kind for kind, _ in rows} == set(GROUPS)
    for kind, told in rows:
        for word in re.findall(r"`(\w+)`", told):
            assert word in known, f"{kind}: {word}"


def test_hard_cases_are_in_tests_of_these_names():
    page = (DOCS / "hard_cases.md").read_text()
    there = {path.name for path in (ROOT / "tests" / "skin").rglob("test_*.py")}
    named = set(re.findall(r"`(test_\w+\.py)`", page))
    assert len(named) > 10 and named <= there, named - there


def test_the_page_of_scenarios_begins_as_its_script_writes_it():
    script = ast.parse((ROOT / "scripts" / "scenarios.py").read_text())
    (head,) = (node.value for node in script.body if isinstance(node, ast.Assign) and node.targets[0].id == "HEAD")
    assert (DOCS / "scenarios.md").read_text().startswith(ast.literal_eval(head))
