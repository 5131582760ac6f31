"""Papers in processes of their own: in order, and ended by one Ctrl-C with what is done."""

import signal
import subprocess
import sys
import time

import pytest

PROGRAM = """
import signal, sys, time
from pathlib import Path
from palmfield_papers.side_by_side import side_by_side

FOLDER = Path(sys.argv[1])

def work(name, told):
    told(name, "1a")
    (FOLDER / name).write_text("begun")
    try:
        time.sleep(float(sys.argv[2]))
    except KeyboardInterrupt:
        time.sleep(0.5)
        return name + " cut off"
    told(name, "")
    return name

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell starts in the background ignores Ctrl-C
    heard = []
    print(side_by_side(work, sys.argv[3:], 2, lambda *news: heard.append(news)), sorted(heard))
"""


@pytest.fixture
def started(tmp_path):
    def start(seconds, *names):
        (tmp_path / "program.py").write_text(PROGRAM)
        command = [sys.executable, tmp_path / "program.py", tmp_path, str(seconds), *names]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    return start


def test_results_stand_in_the_order_asked_and_progress_is_told(started):
    out, told = started(0.1, "second", "first").communicate(timeout=60)
    assert told == ""
    heard = [("first", ""), ("first", "1a"), ("second", ""), ("second", "1a")]
    assert out == f"{['second', 'first']} {heard}\n"


def test_ctrl_c_at_one_process_ends_all_with_what_is_done_and_without_tracebacks(started, tmp_path):
    process = started(60, "one", "two", "three", "four")
    while not (tmp_path / "one").exists() or not (tmp_path / "two").exists():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    out, told = process.communicate(timeout=30)
    assert told == ""
    assert out.startswith("['one cut off', 'two cut off']")
