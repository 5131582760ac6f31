"""Commands that other distributions bring, and what is said where they are not installed."""

import re
import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest
from typer.testing import CliRunner

from palmfield.cli import brought
from palmfield.cli.app import OF_OTHERS, app, main

MODULE = "a_distribution_of_someone"
OWN = """
import typer

def count(context: typer.Context, number: int, twice: bool = typer.Option(False, "--twice")) -> None:
    \"\"\"Count to a number.\"\"\"
    print(number * (1 + twice), context.obj)

def run() -> None:
    \"\"\"Not palmfield's own.\"\"\"
"""


@pytest.fixture
def entries(monkeypatch, tmp_path):
    """Lets the environment have these entry points and no others."""

    def have(**places):
        (tmp_path / f"{MODULE}.py").write_text(OWN)
        monkeypatch.syspath_prepend(str(tmp_path))
        found = tuple(EntryPoint(name, f"{MODULE}:{place}", brought.GROUP) for name, place in places.items())
        monkeypatch.setattr(brought, "entry_points", lambda group: found if group == brought.GROUP else ())

    yield have
    sys.modules.pop(MODULE, None)


def said(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["palmfield", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    out = capsys.readouterr()
    return stopped.value.code, out.out, out.err


def listed(monkeypatch, capsys, begin="Begin"):
    """What help says of each command, from a group on."""
    code, out, _ = said(monkeypatch, capsys, "--help")
    assert code == 0
    return dict(re.findall(r"^  ([a-z]+)  +(.*)$", out.split(f"\n{begin}:\n")[1], flags=re.MULTILINE))


@pytest.mark.smoke
def test_papers_is_brought_by_its_own_distribution(monkeypatch, capsys):
    assert "not installed" not in listed(monkeypatch, capsys)["papers"]
    code, out, _ = said(monkeypatch, capsys, "papers", "--help")
    assert code == 0 and "--jobs" in out and "Example: palmfield papers" in out


@pytest.mark.parametrize("clone", [True, False])
@pytest.mark.parametrize("arguments", [(), ("chilles2019", "--quick"), ("--only", "C14c", "--json")])
def test_where_it_is_not_installed_one_sentence_says_how(arguments, clone, entries, tmp_path, monkeypatch, capsys):
    entries()
    if clone:
        how = f"pip install -e {brought.CLONE / 'papers'}"
    else:
        monkeypatch.setattr(brought, "CLONE", tmp_path)
        how = "pip install palmfield-papers"
    code, out, err = said(monkeypatch, capsys, "papers", *arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and err.startswith("palmfield: `palmfield papers`") and err.endswith(f" {how}\n")
    assert "papers" in listed(monkeypatch, capsys)
    code, out, _ = said(monkeypatch, capsys, "papers", "--help")
    assert code == 0 and "not installed" in " ".join(out.split()) and "".join(how.split()) in "".join(out.split())


def test_any_distribution_brings_a_command(entries, monkeypatch, capsys):
    entries(count="count")
    assert listed(monkeypatch, capsys, OF_OTHERS)["count"] == "Count to a number."
    assert CliRunner().invoke(app, ["count", "3", "--twice"]).output == "6 False\n"
    assert CliRunner().invoke(app, ["--quiet", "count", "3"]).output == "3 True\n"
    code, _, err = said(monkeypatch, capsys, "cuont")
    assert code == 2 and "Did you mean 'count'?" in err


def test_palmfields_own_commands_are_not_replaced(entries, monkeypatch, capsys):
    entries(run="run")
    assert "run" not in listed(monkeypatch, capsys, OF_OTHERS)
    code, out, _ = said(monkeypatch, capsys, "run", "--help")
    assert code == 0 and "Simulate a scene" in out


@pytest.mark.parametrize("name", ["papers", "count"])
def test_one_that_cannot_be_loaded_costs_no_other(name, entries, monkeypatch, capsys):
    entries(**{name: "nothing"})
    assert {name, "run"} <= set(listed(monkeypatch, capsys))
    code, _, err = said(monkeypatch, capsys, name, "--anything")
    assert code == 2 and err.count("\n") == 1
    assert f"`palmfield {name}` cannot be loaded: AttributeError: " in err and "nothing" in err


def test_own_commands_load_none_that_others_bring(entries, monkeypatch, capsys):
    entries(count="count")
    said(monkeypatch, capsys, "boards", "--help")
    assert MODULE not in sys.modules


def test_help_of_papers_is_quick_to_import():
    slow = ("warp", "mujoco", "numpy", "scipy", "matplotlib")
    code = f"import sys\nimport palmfield_papers.cli\nprint([name for name in {slow} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
