"""`palmfield track` on the command line."""

import json
import socket
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.cli.options import listening_at
from palmfield.errors import DeviceError
from palmfield.hand.articulated import articulate
from palmfield.hand.preset import load_preset
from palmfield.motion.pose import HandPose
from palmfield.motion.tracking import read_stream, stream_of, write_stream

pytestmark = pytest.mark.wall_clock

RUN = CliRunner()


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A hand that goes straight for a second, as a file."""
    hand = articulate(load_preset("open_men_p50"))
    file = tmp_path_factory.mktemp("seen") / "seen.npz"
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    write_stream(
        file, stream_of(hand, lambda t: HandPose(np.array([0.1 * t, 0.0, 0.2]), upright, {}), np.arange(30) / 30)
    )
    return file


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        return line.getsockname()[1]


def test_what_is_replayed_is_recorded(seen, tmp_path):
    port, out = free_port(), tmp_path / "again.npz"

    def play():
        time.sleep(0.5)
        RUN.invoke(app, ["track", "replay", str(seen), "--to", str(port), "--convention", "leapc", "--speed", "2"])

    playing = threading.Thread(target=play)
    playing.start()
    done = RUN.invoke(app, ["track", "record", str(out), "--at", str(port), "--duration", "0.8", "--wait", "10"])
    playing.join()
    assert done.exit_code == 0, done.output
    assert "30 samples taken, 0 skipped" in done.output
    again, first = read_stream(out), read_stream(seen)
    np.testing.assert_allclose(again.positions, first.positions, atol=1e-9)
    np.testing.assert_allclose(again.times_s, first.times_s, atol=1e-6)


def test_a_tracker_is_aligned_by_a_table_of_touches(tmp_path):
    places = np.array([[-0.08, -0.08, 0.0], [0.08, -0.08, 0.0], [0.08, 0.08, 0.0]])
    rows = [",".join(map(repr, row)) for row in np.hstack([places, places - [0.1, 0.2, 0.3]]).tolist()]
    head = "array_x_m,array_y_m,array_z_m,tracker_x_m,tracker_y_m,tracker_z_m"
    (tmp_path / "t.csv").write_text("\n".join([head, *rows]) + "\n")
    done = RUN.invoke(app, ["track", "align", str(tmp_path / "t.csv"), str(tmp_path / "a.json")])
    assert done.exit_code == 0, done.output
    assert "the tracker's origin is at (100.0, 200.0, 300.0) mm in the array frame" in done.output
    assert "assumed for three points, whose residuals carry little" in done.output
    np.testing.assert_allclose(json.loads((tmp_path / "a.json").read_text())["position_m"], [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["replay", "{seen}", "--to", "nowhere"], "'nowhere' is not an address"),
        (
            ["replay", "{seen}", "--to", "1", "--convention", "mano"],
            "--convention has value 'mano'; allowed: openxr, leapc",
        ),
        (
            ["replay", "{seen}", "--to", "1", "--by", "ftp"],
            "--by has value 'ftp' (did you mean 'tcp'?); allowed: udp, tcp",
        ),
        (["replay", "{seen}", "--to", "1", "--speed", "0"], "speed has value 0; allowed"),
        (["record", "x.npz", "--at", "0", "--wait", "0.1"], "only 0 valid samples arrived within 0.1 s"),
        (["latency", "--seconds", "0"], "--seconds has value 0; allowed"),
        (["latency", "--board", "ideal"], "has no line; give another by --board"),
    ],
)
def test_what_cannot_be_is_refused(seen, words, told):
    done = RUN.invoke(app, ["track", *(word.format(seen=seen) for word in words)])
    assert done.exit_code != 0 and told in str(done.exception)


def test_where_a_live_hand_comes_in():
    for text, wanted in (("9100", ("127.0.0.1", 9100, "udp")), ("lab:80", ("lab", 80, "udp")),
                         ("tcp:9100", ("127.0.0.1", 9100, "tcp")), ("udp:lab:80", ("lab", 80, "udp"))):  # fmt: skip
        live = listening_at(text, None)
        assert (live.host, live.port, live.by) == wanted
    with pytest.raises(DeviceError, match="'x' is not an address"):
        listening_at("tcp:x", None)
