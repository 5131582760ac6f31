"""Who may make a board sound through `palmfield drive --live`, and when: attempts from outside on a virtual board."""

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from fuzz_lines import DOORS, good, sent

from palmfield.drive.boards import BOARDS
from palmfield.drive.live_foci import FocusListener
from palmfield.drive.virtual import VirtualBoard
from palmfield.errors import DeviceError
from palmfield.hardware.live_focus import LiveInput, play_live
from palmfield.hardware.play import Target
from palmfield.motion.line_listener import STALE_S
from palmfield.motion.listening import Listener

pytestmark = [
    pytest.mark.wall_clock,
    pytest.mark.skipif(os.name != "posix", reason="the player needs POSIX"),
]

GOOD = b'{"focus_m": [0, 0, 0.15]}\n'


def played(act, by="tcp", seconds=1.0):
    """What a live play says while `act(host, port)` does its worst; and how many of the frames of its board sound."""
    threads = []

    def begin(host, port):
        threads.append(threading.Thread(target=act, args=(host, port)))
        threads[0].start()

    with VirtualBoard(BOARDS["sonicsurface"], realtime=True) as virtual:
        try:
            said = str(play_live(LiveInput(by=by, on_listening=begin), "sonicsurface", Target(virtual.port), seconds))
        finally:
            threads[0].join()
        virtual.settle()
    assert not virtual.twin.emitted.any()
    return said, sum(one.amplitudes.any() for one in virtual.emitted)


def connected(host, port):
    return socket.create_connection((host, port), timeout=5.0)


@pytest.mark.parametrize("method", ["POST", "OPTIONS"])
def test_no_web_page_makes_a_board_sound(method):
    def act(host, port):
        ends = time.monotonic() + 0.4
        while time.monotonic() < ends:
            page = http.client.HTTPConnection(host, port, timeout=5.0)
            try:
                page.request(method, "/", GOOD * 20, {"Content-Type": "text/plain", "Origin": "http://evil.example"})
                page.getresponse()
            except (OSError, http.client.HTTPException):
                pass
            page.close()

    said, sounding = played(act, seconds=0.6)
    assert sounding == 0 and said.count("0 foci received") == 1 and " garbled)" in said


def test_no_web_page_moves_a_tracked_hand():
    """The door of `trial --live` and `track record`."""
    with Listener(by="tcp") as listener:
        sample = json.dumps(good("hands", 1)).encode() + b"\n"
        page = http.client.HTTPConnection(listener.host, listener.port, timeout=5.0)
        with pytest.raises((OSError, http.client.HTTPException)):
            page.request("POST", "/", sample * 20, {"Content-Type": "text/plain", "Origin": "http://evil.example"})
            page.getresponse()
        page.close()
        assert listener.received == 0 and dict(listener.bad) == {"garbled": 1}
        with connected(listener.host, listener.port) as tracker:
            tracker.sendall(sample)
            assert listener.wait(0, 5.0)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are listed by Linux")
def test_a_player_that_is_killed_while_nothing_sounds_is_said_in_a_sentence():
    def act(host, port):
        time.sleep(0.3)
        for status in Path("/proc").glob("[0-9]*/stat"):
            try:
                ours = int(status.read_text().rpartition(")")[2].split()[1]) == os.getpid()
                player = b"palmfield.drive.player.process" in (status.parent / "cmdline").read_bytes()
            except OSError:
                continue
            if ours and player:
                os.kill(int(status.parent.name), signal.SIGKILL)

    with pytest.raises(DeviceError, match="was ended by signal SIGKILL; the board is off"):
        played(act, seconds=30.0)


BAD = {
    "deep": b'{"a":' * 3000,
    "deep in a key": b'{"focus_m":' + b"[" * 20000 + b"]" * 20000 + b"}",
    "400 digits": b'{"focus_m":[1' + b"0" * 400 + b",0,0.15]}",
    "5000 digits": b'{"level":1' + b"0" * 5000 + b"}",
    "level of 400 digits": b'{"level":1' + b"0" * 400 + b',"focus_m":[0,0,0.15]}',
    "infinite": b'{"focus_m":[0,0,1e400]}',
    "no text": b"\xff\xfe{",
    "half a character": b'{"\\ud800":1}',
    "too long": b'{"focus_m":[0,0,0.15],"a":"' + b"x" * 70000 + b'"}',
}


@pytest.mark.parametrize("by", ["tcp", "udp"])
@pytest.mark.parametrize("name", BAD)
def test_no_line_makes_the_listener_deaf(name, by):
    """Counted as one bad line; the next good line counts, of the same sender or, after a line too long, another one."""
    kind = socket.SOCK_STREAM if by == "tcp" else socket.SOCK_DGRAM
    with FocusListener(np.zeros(3), by=by) as listener, socket.socket(socket.AF_INET, kind) as out:
        out.settimeout(5.0)
        out.connect((listener.host, listener.port))
        out.sendall(GOOD)
        out.sendall(BAD[name][:65000] if by == "udp" else BAD[name] + b"\n")
        ends = time.monotonic() + 5.0
        while not listener.bad and time.monotonic() < ends:
            time.sleep(1e-3)
        if (by, name) == ("tcp", "too long"):
            assert out.recv(1) == b""
            out = connected(listener.host, listener.port)
        out.sendall(GOOD)
        assert listener.wait(1, 5.0)
        out.close()
    assert sum(listener.bad.values()) == 1 and set(listener.bad) <= {"garbled", "numbers", "keys"}
    assert all(text.isprintable() for text in listener.reported)


@pytest.mark.parametrize("door", DOORS)
def test_ten_thousand_random_and_mutated_lines_are_counted_once_each(door):
    """A million of them by scripts/verification/fuzz_lines.py, whose counts are in docs/bench/fuzzing.md."""
    outcomes, faults, _ = sent(door, 10_000, 29)
    assert not faults and outcomes.total() == 10_000
    assert outcomes["none", "taken"] > 300 and outcomes["noise", "garbled"] > 800


def test_a_listener_that_dies_ends_the_play_with_the_board_off(monkeypatch):
    def act(host, port):
        with connected(host, port) as out:
            for _ in range(10):
                out.sendall(GOOD)
                time.sleep(0.03)
            monkeypatch.setattr(FocusListener, "_line", lambda *_: 1 / 0)
            out.sendall(GOOD)

    with pytest.raises(DeviceError, match=r"receiving at tcp .* has stopped: ZeroDivisionError"):
        played(act, seconds=30.0)


def test_a_second_sender_is_refused_by_name_and_its_lines_never_sound():
    for by in ("tcp", "udp"):
        names = []

        def act(host, port, by=by, names=names):
            kind = socket.SOCK_STREAM if by == "tcp" else socket.SOCK_DGRAM
            with socket.socket(socket.AF_INET, kind) as first, socket.socket(socket.AF_INET, kind) as second:
                first.connect((host, port))
                first.sendall(GOOD)
                time.sleep(0.1)
                second.connect((host, port))
                names.append("{}:{}".format(*second.getsockname()))
                for _ in range(10):
                    try:
                        second.sendall(b'{"focus_m": [0.01, 0, 0.12]}\n')
                    except OSError:
                        break
                    time.sleep(0.01)

        said, _ = played(act, by, 0.5)
        assert "1 foci received" in said and f"{names[0]} is refused, because " in said


def test_who_connects_and_says_nothing_keeps_nobody_out():
    def act(host, port):
        idle = [connected(host, port) for _ in range(30)]
        with connected(host, port) as out:
            for _ in range(5):
                out.sendall(GOOD)
                time.sleep(0.03)
        for one in idle:
            one.close()

    said, sounding = played(act, seconds=0.6)
    assert sounding > 0 and "5 foci received, 0 lines skipped" in said


@pytest.mark.parametrize("by", ["tcp", "udp"])
def test_lines_that_came_while_the_command_was_stopped_never_sound(by):
    """Ctrl-Z, or SIGSTOP: what waits in the system's buffers is old, a whole buffer of it and what its sender holds."""
    command = "from palmfield.cli.app import main; main()"
    with VirtualBoard(BOARDS["sonicsurface"], realtime=True) as virtual:
        words = ["drive", "--live", f"{by}:0", "--board", "sonicsurface", "--port", virtual.port, "--duration", "60"]
        run = subprocess.Popen([sys.executable, "-c", command, *words], stderr=subprocess.PIPE, text=True,
                               stdout=subprocess.PIPE)  # fmt: skip
        try:
            host, port = run.stderr.readline().split(" at ")[1].split(" by ")[0].rsplit(":", 1)
            with socket.socket(socket.AF_INET, socket.SOCK_STREAM if by == "tcp" else socket.SOCK_DGRAM) as out:
                out.connect((host, int(port)))
                out.sendall(GOOD)
                time.sleep(0.5)
                before = len(virtual.emitted)
                assert any(one.amplitudes.any() for one in virtual.emitted)
                os.kill(run.pid, signal.SIGSTOP)
                time.sleep(0.3)
                out.setblocking(False)
                try:
                    for n in range(200_000):
                        out.send(json.dumps({"focus_m": [0, 0, 0.15], "level": n % 2}).encode() + b"\n")
                except BlockingIOError:
                    pass
                time.sleep(2.0 * STALE_S)
                os.kill(run.pid, signal.SIGCONT)
                time.sleep(1.0)
                assert not any(one.amplitudes.any() for one in virtual.emitted[before:])
                # And a new line sounds, by TCP of a new connection
                with socket.socket(socket.AF_INET, out.type) as new:
                    new.connect((host, int(port)))
                    new.sendall(GOOD)
                    time.sleep(0.3)
            assert any(one.amplitudes.any() for one in virtual.emitted[before:])
            run.send_signal(signal.SIGINT)
            said, _ = run.communicate(timeout=20.0)
            assert run.returncode == 0 and "2 foci received" in said and " stale)" in said
        finally:
            run.kill()
            run.wait()
