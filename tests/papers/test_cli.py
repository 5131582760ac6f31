"""`palmfield papers` as a user types it."""

import json
import sys

import pytest

from palmfield.cli.app import main
from palmfield_papers import run
from palmfield_papers.answer import Answer, Paper


def call(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["palmfield", "papers", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    return stopped.value.code, *capsys.readouterr()


@pytest.fixture
def made_up(monkeypatch):
    """In place of each paper's answers, those of one whose first number comes and whose second fails."""

    def failing(setting):
        raise RuntimeError("no such sound")

    answers = {"M1a": lambda setting: Answer(1.0), "M1b": failing}
    monkeypatch.setattr(run, "paper", lambda name: Paper(name, "Mizushima 2024", "Nobody", "Made up.", answers))


def test_one_number_is_printed(made_up, monkeypatch, capsys):
    code, out, err = call(monkeypatch, capsys, "--only", "M1a")
    assert code == 0 and out.startswith("M1a ") and "error" not in err
    code, out, _ = call(monkeypatch, capsys, "--only", "M1a", "--json")
    assert code == 0 and json.loads(out)["M1a"]["tried"][0]["ours"] == 1.0


def test_one_that_fails_is_in_the_log_and_in_the_exit_code(made_up, monkeypatch, capsys):
    code, out, err = call(monkeypatch, capsys, "--only", "M1a", "--only", "M1b")
    assert code == 4 and "M1a" in out and "no such sound" in out
    assert "palmfield: error: entry M1b failed" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(("--only", "M1z"), "number 'M1z'"), (("nobody2020",), "paper 'nobody2020'"), (("--device", "abacus"), "abacus")],
)
def test_what_is_unknown_is_one_line_and_exit_code_2(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, out, err = call(monkeypatch, capsys, *arguments)
    assert (code, out) == (2, "") and said in err and err.count("\n") == 1
    assert not any(tmp_path.iterdir())
