"""`palmfield bench` as a user types it."""

import inspect
import re
import sys
from pathlib import Path

import pytest

from palmfield.cli import bench
from palmfield.cli.app import main
from palmfield.studies.bench import field, scene, skin


def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple:
    monkeypatch.setattr(sys, "argv", ["palmfield", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code, capsys.readouterr()


def test_help_lists_what_there_is_and_teaches(monkeypatch, capsys) -> None:
    code, out = call(monkeypatch, capsys, "bench", "--help")
    assert code == 0 and re.search(r"^\W*field\s+Measure speed and error", out.out, re.MULTILINE)
    code, out = call(monkeypatch, capsys, "bench", "field", "--help")
    assert code == 0 and "palmfield bench field --only gradient" in out.out


def test_options_and_defaults_are_those_of_the_benchmark() -> None:
    for command, measured in (
        (bench.field, field.main), (bench.skin, skin.main), (bench.scene, scene.main)
    ):  # fmt: skip
        options = inspect.signature(command).parameters
        parameters = dict(inspect.signature(measured).parameters)
        parameters.pop("peers", None)  # other programs are put beside ours by scripts/bench, not by the command
        assert {name: one.default for name, one in options.items()} == {
            name: one.default for name, one in parameters.items()
        }


def test_it_prints_what_it_writes(tmp_path: Path, monkeypatch, capsys) -> None:
    file = tmp_path / "field.md"
    options = ("--points", "200", "--runs", "1", "--only", "spheres", "--out", str(file))
    code, out = call(monkeypatch, capsys, "bench", "field", *options)
    assert code == 0 and out.out == file.read_text()
    assert "palmfield bench field --points 200 --runs 1 --only 'spheres' --out FILE" in out.out


def test_bad_option_is_one_line_and_exit_code_2(monkeypatch, capsys) -> None:
    code, out = call(monkeypatch, capsys, "bench", "field", "--runs", "0")
    assert code == 2 and out.err == "palmfield: --runs has value 0; allowed: 1 to 63\n"


def test_scenes_and_steps_that_cannot_be_are_refused(monkeypatch, capsys) -> None:
    code, out = call(monkeypatch, capsys, "bench", "scene", "no_such_scene")
    assert code == 2 and out.err.startswith(
        "palmfield: scene no_such_scene does not exist; allowed: a file, or one of "
    )
    assert "palm_am200" in out.err and "plain_palm" not in out.err
    code, out = call(monkeypatch, capsys, "bench", "scene", "--steps", "0")
    assert code == 2 and out.err == "palmfield: --steps has value 0; allowed: 1 to 1000000\n"
