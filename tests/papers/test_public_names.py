"""What the papers take of palmfield is public, and what they take of others is declared."""

import ast
import re
import sys
import tomllib
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import palmfield_papers

ROOT = Path(__file__).resolve().parents[2]
SOURCE = Path(palmfield_papers.__file__).parent
PROJECT, PAPERS = (
    tomllib.loads((folder / "pyproject.toml").read_text())["project"] for folder in (ROOT, ROOT / "papers")
)


@cache
def imported() -> tuple[tuple[str, str], ...]:
    """Module and name of each import, also of those inside functions; a module alone has an empty name."""
    found = []
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found += [(alias.name, "") for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.module and node.level == 0
                found += [(node.module, alias.name) for alias in node.names]
    return tuple(sorted(set(found)))


OF_PALMFIELD = [(module, name) for module, name in imported() if re.match(r"palmfield(\.|$)", module)]


def test_there_are_imports():
    assert len(OF_PALMFIELD) > 50


@pytest.mark.parametrize(("module", "name"), OF_PALMFIELD)
def test_a_name_of_palmfield_is_public_and_taken_from_its_package_where_that_exports_it(module, name):
    assert not any(part.startswith("_") for part in (*module.split("."), name))
    package = import_module(".".join(module.split(".")[:2]))
    if package.__name__ != module and name in getattr(package, "__all__", ()):
        assert getattr(package, name) is not getattr(import_module(module), name), f"take it from {package.__name__}"


def test_what_is_imported_is_declared_and_its_versions_are_palmfields():
    names = {"markdown_it": "markdown-it-py"}
    others = {module.split(".")[0] for module, _ in imported()} - set(sys.stdlib_module_names) - {"palmfield_papers"}
    declared = {re.match(r"[\w-]+", text)[0] for text in PAPERS["dependencies"]}
    assert declared == {names.get(one, one) for one in others}
    assert declared - {"palmfield"} <= {re.match(r"[\w-]+", text)[0] for text in PROJECT["dependencies"]}


def test_both_distributions_have_one_version():
    assert PAPERS["version"] == PROJECT["version"]
    assert f"palmfield=={PROJECT['version']}" in PAPERS["dependencies"]
    assert PAPERS["requires-python"] == PROJECT["requires-python"]
