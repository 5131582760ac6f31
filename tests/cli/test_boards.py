"""Commands about boards: a list, a virtual one, bytes to it, and what they were."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from palmfield.cli.app import main
from palmfield.drive.boards import BOARDS
from palmfield.drive.virtual import VirtualBoard


def call(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["palmfield", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code or 0, capsys.readouterr()


def test_boards_are_listed_with_what_they_cannot_guarantee(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "boards")
    assert code == 0 and [line.split()[0] for line in out.out.splitlines()] == list(BOARDS)
    code, out = call(monkeypatch, capsys, "boards", "sonicsurface")
    assert code == 0 and "keeps emitting its last frame until power is cut" in out.out
    assert re.search(r"^start +`151 192 254 256 x 32 253`, twice \(520 bytes, in decimals\)$", out.out, re.MULTILINE)
    assert max(map(len, out.out.splitlines())) < 400, "bytes by the hundred"
    code, out = call(monkeypatch, capsys, "boards", "--json")
    facts = json.loads(out.out)
    assert facts["sonicsurface"]["stop_hex"] == 2 * ("97c0fe" + 256 * "20" + "fd")
    code, out = call(monkeypatch, capsys, "boards", "toaster")
    assert code == 2 and "'toaster' is unknown" in out.err


@pytest.mark.wall_clock
def test_a_focus_on_a_virtual_board_is_logged_decoded_and_replayed(monkeypatch, capsys, tmp_path):
    received = tmp_path / "received.bin"
    command = [sys.executable, "-m", "palmfield", "board", "sonicsurface", "--virtual", "--duration", "20"]
    process = subprocess.Popen(
        [*command, "--by", "tcp", "--received", str(received)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        port = process.stdout.readline().strip()
        assert port.startswith("socket://127.0.0.1:")
        # The next command is told, and is one that works
        told, command = process.stdout.readline().split(": ", 1)
        assert told == "next, in another terminal" and port in command
        code, out = call(
            monkeypatch, capsys, *shlex.split(command)[1:], "--duration", 0.1, "--log", tmp_path / "n.jsonl"
        )
        assert code == 0 and "the board is off" in out.out, out.err
        log = tmp_path / "sent.jsonl"
        where = ("--focus", 0.01, -0.02, 0.16)
        code, out = call(monkeypatch, capsys, "drive", *where, "--port", port, "--duration", 0.3, "--log", log)
        assert code == 0 and "the board is off" in out.out, out.err
        code, out = call(monkeypatch, capsys, "replay", log, "--port", port)
        assert code == 0 and out.out.startswith("played"), out.err
        said = process.communicate(timeout=120)[0]
    finally:
        process.kill()
    assert "0 of 256 transducers emit at the end" in said
    first, sent = (
        b"".join(bytes.fromhex(json.loads(line)["hex"]) for line in file.read_text().splitlines()[1:])
        for file in (tmp_path / "n.jsonl", log)
    )
    assert received.read_bytes() == first + sent + sent
    png, csv = tmp_path / "foci.png", tmp_path / "foci.csv"
    code, out = call(monkeypatch, capsys, "decode", log, "--png", png, "--csv", csv)
    assert code == 0, out.err
    # Three frames of one focus between two of silence: the focus and the silence after it are other than before
    assert re.search(r": \d+ frames, 2 of them different from the previous one$", out.out.splitlines()[0]), out.out
    assert png.stat().st_size > 5000
    rows = np.genfromtxt(csv, delimiter=",", names=True)
    sounding = rows[np.isfinite(rows["x_m"])]
    assert len(sounding) == 3
    np.testing.assert_allclose(sounding["x_m"], 0.01, atol=3e-4)
    np.testing.assert_allclose(sounding["z_m"], 0.16, atol=1e-3)


def test_all_texts_have_one_frame_rate_of_a_board(monkeypatch, capsys):
    _, listed = call(monkeypatch, capsys, "boards")
    _, page = call(monkeypatch, capsys, "boards", "--markdown")
    _, every = call(monkeypatch, capsys, "boards", "--json")
    for name, facts in json.loads(every.out).items():
        if facts["max_frame_rate_Hz"] is None:
            continue
        rate = f"{facts['max_frame_rate_Hz']:.1f}".removesuffix(".0")
        _, one = call(monkeypatch, capsys, "boards", name)
        assert re.search(rf"^max_frame_rate_Hz +{rate}$", one.out, re.MULTILINE)
        rates = re.findall(r"([0-9.,]+) frames/s", facts["description"])
        assert not rates or rates[0] == rate, facts["description"]
        assert f"| {rate} |" in next(line for line in page.out.splitlines() if line.startswith(f"| {name} "))
        assert facts["description"] in listed.out


def test_drive_says_from_the_beginning_what_it_does(monkeypatch, capsys, tmp_path):
    """As on a terminal, which FORCE_COLOR stands for."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    code, out = call(monkeypatch, capsys, "drive", CIRCLE, "--record", tmp_path / "c.bin", "--duration", 0.1)
    assert code == 0
    phases = [
        out.err.find(words) for words in ("loading palmfield", "loading the scene", "computing the frames for 0.1 s")
    ]
    assert -1 < phases[0] < phases[1] < phases[2]


CIRCLE = Path(__file__).parents[2] / "mjcf" / "scenes" / "palm_circle_sonicsurface.xml"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("board", "ideal", "--virtual"), "board 'ideal' is unknown"),
        (("board", "sonicsurface", "--virtual", "--by", "smoke"), "--by has value 'smoke'; allowed: pty, tcp"),
        (("decode", "none.bin", "--board", "sonicsurface"), "cannot be read"),
        (("drive", "--focus", 0, 0, 0.2, "--record", "x", "--level", 2), "--level has value 2; allowed"),
        (("drive", "--focus", 0, 0, 0.2, "--record", "x", "--layout", "uhev1"), "cannot drive layout 'uhev1'; allowed"),
        (("drive", "--focus", 0, 0, 0.2, "--record", "x", "--board", "sonicsurface_pair"), "give a scene with their"),
        (("drive", CIRCLE, "--record", "x", "--calibration", "b.json"), "use --set array.calibration=VALUE"),
        (("drive", CIRCLE, "--record", "x", "--temperature", 30), "use --set array.temperature_C=VALUE"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, words, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, out = call(monkeypatch, capsys, *arguments)
    assert code == 2 and words in out.err
    assert not list(Path(tmp_path).iterdir())


@pytest.mark.wall_clock
@pytest.mark.skipif(os.name != "posix", reason="the player needs POSIX")
def test_ctrl_c_says_that_the_board_is_off():
    """As at a terminal: by the program itself, which Typer ends for Ctrl-C without a word."""
    with VirtualBoard(BOARDS["sonicsurface"]) as virtual:
        command = [sys.executable, "-m", "palmfield", "drive", "--focus", "0", "0", "0.15", "--port", virtual.port]
        with subprocess.Popen([*command, "--duration", "60"], stderr=subprocess.PIPE, text=True) as drive:
            ends = time.monotonic() + 60.0
            while not virtual.twin.emitted.any() or len(virtual.emitted) < 3:
                assert time.monotonic() < ends and drive.poll() is None
                time.sleep(0.02)
            drive.send_signal(signal.SIGINT)
            told = drive.communicate(timeout=30)[1]
        virtual.settle()
        assert not virtual.twin.emitted.any()
    assert drive.returncode == 130 and "ended by Ctrl-C after" in told and "the board is off" in told
