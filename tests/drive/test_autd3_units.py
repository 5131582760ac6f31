"""Frames for AUTD3 units through their own client, to the units of its own emulator."""

from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.drive import autd3_units
from palmfield.drive.boards import BOARDS
from palmfield.drive.ports import open_port
from palmfield.errors import DeviceError

BOARD = BOARDS["autd3"]


@pytest.fixture
def autd3() -> SimpleNamespace:
    return pytest.importorskip("autd3", reason="the extra [autd3] is not installed: pip install 'palmfield[autd3]'")


@pytest.mark.parametrize("units", [1, 3])
def test_units_emit_what_the_twin_says(units: int, autd3: SimpleNamespace) -> None:
    emulator = pytest.importorskip("autd3_emulator")
    core = pytest.importorskip("autd3_core")
    board, rng = BOARD.sized(249 * units), np.random.default_rng(units)
    asked = rng.random(249 * units) * np.exp(2j * np.pi * rng.random(249 * units))
    frame = board.encode(asked)
    link = autd3_units.open_units("autd3:emulator", "emulator")
    geometry = autd3.geometry.Geometry([autd3.geometry.Autd3() for _ in range(units)])

    def play(recorder: object) -> None:
        recorder.send(autd3.commands.SetSilencer.disable())
        recorder.send(link.pattern(frame))
        recorder.tick(core.Duration.from_micros(50))

    record = emulator.Emulator(geometry).record(play)
    link.close()
    last = record.phase().columns[-1]
    phase = record.phase()[last].to_numpy().astype(float)
    width = record.pulse_width()[record.pulse_width().columns[-1]].to_numpy().astype(float)
    theirs = np.sin(np.pi * width / 512.0) * np.exp(2j * np.pi * phase / 256.0)
    np.testing.assert_allclose(board.decode(frame)[-1], theirs, atol=1e-12)


def test_frames_reach_emulated_units(autd3: SimpleNamespace) -> None:
    board = BOARD.sized(249 * 2)
    transport = open_port("autd3:emulator", None)
    transport.write(board.start)
    before = _processed(transport)
    for _ in range(50):
        transport.write(board.encode(np.ones(498)))
    after = _processed(transport)
    transport.write(board.stop)
    transport.close()
    assert [b - a for a, b in zip(before, after, strict=True)] == [51, 51]  # the question itself is one


def _processed(transport: autd3_units.Autd3Units) -> list[int]:
    told = transport._run(transport._client.read_telemetry)
    assert not any(unit.fifo_drop or unit.dispatch_error or unit.seq_mismatch for unit in told)
    return [unit.processed for unit in told]


def test_a_focus_is_driven(autd3: SimpleNamespace) -> None:
    line = [
        "drive",
        "--focus",
        "0",
        "0",
        "0.15",
        "--board",
        "autd3",
        "--port",
        "autd3:emulator",
        "--duration",
        "0.2",
        "--level",
        "1",
    ]
    said = CliRunner().invoke(app, line)
    assert said.exit_code == 0, said.output
    assert "on autd3:emulator" in said.output


def test_units_that_are_not_there(autd3: SimpleNamespace) -> None:
    for name in ("autd3:emulator:2", "autd3:server:1", "autd3:simulator:1", "autd3:nope0"):
        link = open_port(name, None)
        with pytest.raises(DeviceError, match=f"cannot open {name} with 1 AUTD3 units: network error"):
            link.write(bytes(498))
        link.close()


@pytest.mark.parametrize("name", ["autd3:", "autd3:server:x", "autd3:emulator:two"])
def test_a_way_that_is_none(name: str, autd3: SimpleNamespace) -> None:
    with pytest.raises(DeviceError, match=r"is not a port of AUTD3 units; allowed: autd3:auto"):
        open_port(name, None)


def test_bytes_of_another_board(autd3: SimpleNamespace) -> None:
    link = open_port("autd3:emulator", None)
    with pytest.raises(DeviceError, match=r"first frame has 520 bytes: give board autd3"):
        link.write(BOARDS["sonicsurface"].start)
    link.close()


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "autd3", None)
    with pytest.raises(DeviceError, match=r"pip install 'palmfield\[autd3\]'"):
        open_port("autd3:auto", None)
