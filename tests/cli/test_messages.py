"""What the command line says, and when: the version, the log, quiet runs, completion."""

import json
import logging
import subprocess
import sys
from importlib.metadata import version

import pytest

import palmfield
from palmfield.cli.app import main
from palmfield.cli.options import offered_plugins, offered_settings
from palmfield.config import SkinConfig
from palmfield.session import recorded_run

pytestmark = pytest.mark.usefixtures("kept_operators")


@pytest.fixture(autouse=True)
def log_as_before():
    """The command line sets the log up for its whole process."""
    logger = logging.getLogger("palmfield")
    before = list(logger.handlers), logger.level, logger.propagate
    logger.handlers[:], logger.level, logger.propagate = [], logging.NOTSET, True
    yield
    logger.handlers[:], logger.level, logger.propagate = before


def call(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["palmfield", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code, capsys.readouterr()


def test_version(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "--version")
    assert code == 0 and out.out == f"palmfield {version('palmfield')}\n"


def test_no_command_is_answered_by_help(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys)
    assert code in (0, 2) and "palmfield new first" in out.out + out.err


QUICK = ("--duration", "0.002", "--set", "stimulus.modulation=none", "--no-plots")


@pytest.mark.parametrize("before", [True, False], ids=["before the command", "after it"])
def test_a_quiet_run_says_warnings_only(before, small_scene, tmp_path, monkeypatch, capsys):
    run = ("run", small_scene(), "--out", tmp_path / "out", *QUICK)
    code, out = call(monkeypatch, capsys, *(("--quiet", *run) if before else (*run, "-q")))
    assert code == 0 and out.out == ""
    lines = out.err.splitlines()
    assert lines and all(line.startswith("palmfield: warning: ") for line in lines)
    assert (tmp_path / "out" / "result.nc").exists()


@pytest.mark.parametrize("options", [("-v",), ("--log-level", "debug"), ("--log-level=debug",)], ids=str)
def test_a_verbose_run_says_what_takes_how_long(options, small_scene, tmp_path, monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "run", small_scene(), "--out", tmp_path / "out", *QUICK, *options)
    assert code == 0 and "wrote" in out.out
    assert "palmfield: debug: opened " in out.err and "palmfield: debug: 2 steps took" in out.err
    code, out = call(monkeypatch, capsys, "run", small_scene(), "--out", tmp_path / "second", *QUICK)
    assert code == 0 and "debug" not in out.err


def test_a_log_of_errors_leaves_warnings_out(small_scene, tmp_path, monkeypatch, capsys):
    run = ("run", small_scene(), "--out", tmp_path / "out", *QUICK, "--log-level", "error")
    code, out = call(monkeypatch, capsys, *run)
    assert code == 0 and out.err == ""
    code, out = call(monkeypatch, capsys, "--log-level", "warn", "keys")
    assert code == 2 and "'warn' (did you mean 'warning'?); allowed: debug, info, warning, error" in out.err
    code, out = call(monkeypatch, capsys, "--quiet", "-v", "keys")
    assert code == 2 and "exclude each other" in out.err


def test_the_library_prints_nothing_by_itself(small_scene, tmp_path, monkeypatch, capfd, caplog):
    def fails(*_):
        raise palmfield.OutputError("no room for a picture")

    monkeypatch.setattr(recorded_run, "PICTURES", (("pressure.png", fails),))
    palmfield.run(small_scene(), tmp_path / "out", duration_s=0.002)
    assert capfd.readouterr() == ("", "")
    assert "no pressure.png: no room for a picture" in caplog.text
    assert [record.name for record in caplog.records] == ["palmfield.session"]


def test_a_program_without_a_log_hears_nothing():
    code = "import logging, palmfield\nlogging.getLogger('palmfield.session').warning('heard')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_shells_can_complete(monkeypatch, capsys):
    # What Typer's own script asks after TAB
    asked = {"COMP_WORDS": "palmfield keys sk", "COMP_CWORD": "2", "_PALMFIELD_COMPLETE": "complete_bash"}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    code = "import sys; sys.argv = ['palmfield']\nfrom palmfield.cli.app import app\napp(prog_name='palmfield')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["skin"], done.stderr


def test_keys_and_values_are_offered():
    assert offered_plugins("st") == ["stimulus"] and "skin" in offered_plugins("")
    assert offered_settings("skin.radi") == ["skin.radius_m="]
    assert offered_settings("skin.base=f") == ["skin.base=free_slip", "skin.base=free"]
    assert (
        len(offered_settings("skin.")) == len(SkinConfig.model_fields)
        and offered_settings("nose.") == offered_settings("skin.radius_m=") == []
    )


@pytest.mark.parametrize(("accuracy", "code"), [(0.002, 3), (0.5, 0)])
def test_strict_says_by_its_exit_code_that_an_accuracy_is_not_reached(
    accuracy, code, monkeypatch, capsys, small_scene, tmp_path
):
    """Elements of a size that is given leave the error as it is, whatever accuracy is wanted."""
    out, keys = tmp_path / "out", ("--accuracy", accuracy, "--duration", "0.005", "--json", "--no-plots")
    scene = small_scene()
    ended, said = call(monkeypatch, capsys, "run", scene, "--out", out, *keys, "--strict")
    assert said.out, said.err
    skin = json.loads(said.out)["summary"]["skins"][0]
    assert (ended, skin["accuracy_reached"]) == (code, code == 0), skin
