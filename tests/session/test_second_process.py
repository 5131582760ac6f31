"""Pictures drawn in a second process are those of the first, and no second process outlives its command."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.usefixtures("kept_operators")

PRELUDE = """
import logging, os, signal, sys, time
from palmfield.estimate.estimated_run import run
from palmfield.session import recorded_run

scene, out = sys.argv[1:]
logging.basicConfig()
signal.signal(signal.SIGINT, signal.default_int_handler)

def begin():
    process = recorded_run._second[0]._process
    print(process.pid, flush=True)
    return process

def slow(tree, path):
    (path.parent / ".unfinished").touch()
    try:
        print("drawing", os.getpid(), flush=True)
        time.sleep(60)
    finally:
        (path.parent / ".unfinished").unlink()

class Unsent:  # an error that cannot be pickled, and whose class needs its arguments
    def __init__(self, first, second):
        super().__init__(f"{first} of {second}")
        self.held = sys.stdout

class Odd(Unsent, ValueError):
    pass

class NoRoom(Unsent, recorded_run.OutputError):
    pass

def fails(tree, path):
    raise Odd("words", "a library")

def no_room(tree, path):
    raise NoRoom("no room", "its own")

def drawn(**more):
    return run(scene, out, estimate="none", **more)

"""


def started(code, scene, out):
    command = [sys.executable, "-c", PRELUDE + code, str(scene), str(out)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(code, scene, out):
    """Output, errors and exit code of a program; its second process must have ended."""
    process = started(code, scene, out)
    said, errors = process.communicate(timeout=120)
    assert gone(int(said.split()[0]))
    return said, errors, process.returncode


def gone(number):
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return True
    return False


def test_pictures_are_those_of_one_process(small_scene, tmp_path):
    path = small_scene()
    code = """
with recorded_run.second_process_draws():
    begin()
    result = drawn()
    print(*result.files)
assert result.summary["peak_memory_MiB"] > recorded_run.peak_bytes() / 2**20 + 100
"""
    said, errors, code = ended(code, path, tmp_path / "two")
    names = ["result.nc", "summary.json", "pressure.png", "displacement.png", "scene.png", "scene.usdc"]
    assert said.split()[1:] == names and code == 0 and errors == ""
    assert started("drawn()", path, tmp_path / "one").wait(timeout=120) == 0
    for name in names[2:]:
        assert (tmp_path / "two" / name).read_bytes() == (tmp_path / "one" / name).read_bytes(), name


def test_a_run_without_pictures_ends_its_second_process(small_scene, tmp_path):
    code = "with recorded_run.second_process_draws():\n    begin()\n    print(*drawn(plots=[], usd=False).files)"
    assert ended(code, small_scene(), tmp_path)[0].split()[1:] == ["result.nc", "summary.json"]


def test_errors_are_those_of_one_process(small_scene, tmp_path):
    code = """
recorded_run.PICTURES = (("pressure.png", no_room), ("displacement.png", fails))
with recorded_run.second_process_draws():
    begin()
    drawn()
"""
    _, errors, code = ended(code, small_scene(), tmp_path)
    assert code == 1 and errors.startswith("WARNING:palmfield.session:no pressure.png: no room of its own\nTraceback")
    assert errors.count("Traceback") == 1 and "in fails" in errors and "\nOdd: words of a library\n" in errors


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_first_process_draws_what_the_second_one_left(number, small_scene, tmp_path):
    code = f"""
from palmfield.session import second_process
second_process.IDLE_S = 1
first, plain = os.getpid(), dict(recorded_run.PICTURES)

def draw(tree, path):
    if os.getpid() != first:
        os.kill(os.getpid(), {number})
    plain[path.name](tree, path)

recorded_run.PICTURES = tuple((plain | {{"displacement.png": draw}}).items())
with recorded_run.second_process_draws():
    begin()
    print(*drawn(usd=False).files)
"""
    said, errors, code = ended(code, small_scene(), tmp_path)
    assert code == 0 and said.split()[-3:] == ["pressure.png", "displacement.png", "scene.png"]
    assert ("no progress" in errors) == (number == signal.SIGSTOP)


SLOW = """
recorded_run.PICTURES = (("pressure.png", slow),)
with recorded_run.second_process_draws():
    begin()
    drawn()
"""


def interrupted(small_scene, out, number):
    """Send a signal to the first process while the second one draws; return both, and the time of the signal."""
    process = started(SLOW, small_scene(), out)
    second = int(process.stdout.readline())
    assert process.stdout.readline() == f"drawing {second}\n"
    process.send_signal(number)
    return process, second, time.monotonic()


def test_ctrl_c_ends_both_processes_at_once(small_scene, tmp_path):
    process, second, began = interrupted(small_scene, tmp_path / "out", signal.SIGINT)
    assert "KeyboardInterrupt" in process.communicate(timeout=20)[1]
    assert time.monotonic() - began < 3.0 and gone(second)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"result.nc", "summary.json"}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_command_takes_its_second_process_along(number, small_scene, tmp_path):
    _, second, began = interrupted(small_scene, tmp_path, number)
    while not gone(second) and time.monotonic() - began < 20.0:
        time.sleep(0.01)
    assert gone(second) and not (tmp_path / ".unfinished").exists()


def test_the_memory_of_a_second_process_is_what_it_does_not_share():
    code = """
import numpy
from palmfield.session.second_process import SecondProcess
shared = numpy.ones(2**25)
second = SecondProcess([], lambda talk: print(numpy.ones(2**24)[0]))
print(second.receive()[0] / 2**20)
second.end()
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert 128.0 < float(said.split()[-1]) < 180.0


def test_a_process_with_threads_or_pictures_is_not_copied(monkeypatch):
    from palmfield.session import second_process

    assert not second_process.possible(["palmfield"])
    with monkeypatch.context() as changed:
        changed.setattr(second_process.threading, "active_count", lambda: 2)
        assert not second_process.possible(["no_such_module"])
