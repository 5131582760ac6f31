"""Markers: the moment of emission as Lab Streaming Layer stamps it, and a serial line that goes up then."""

import sys
import time

import pytest
import serial

from palmfield.drive.trigger_line import TriggerLine
from palmfield.errors import DeviceError, OutputError
from palmfield.studies.experiment.presentation import LslMarker, Markers

pytestmark = pytest.mark.wall_clock


class Line:
    """A port whose lines are written down with the time."""

    def __init__(self):
        object.__setattr__(self, "seen", [])

    def __setattr__(self, name, value):
        self.seen.append((name, value, time.monotonic()))

    def write(self, data):
        self.seen.append(("write", data, time.monotonic()))

    def close(self):
        self.seen.append(("close", None, time.monotonic()))


@pytest.mark.parametrize("line", ["dtr", "rts"])
def test_a_line_goes_up_at_the_moment_and_down_again(line):
    port = Line()
    trigger = TriggerLine("COM9", line, pulse_s=0.02, opened=port)
    when = time.monotonic() + 0.05
    with Markers([trigger]) as all_of_them:
        all_of_them.mark("trial 0", when)
        assert port.seen[-1][:2] == (line, False)
    low, up, down, closed = port.seen
    assert [low[:2], up[:2], down[:2], closed[0]] == [(line, False), (line, True), (line, False), "close"]
    assert 0.0 <= up[2] - when < 0.1 and down[2] - up[2] >= 0.02
    assert all_of_them.trigger_late_s == pytest.approx(up[2] - when, abs=0.01)


def test_a_byte_is_sent_through_a_port():
    port = serial.serial_for_url("loop://", timeout=1.0)
    trigger = TriggerLine("loop://", "byte", 7, opened=port)
    trigger.mark("trial 0", time.monotonic() - 1.0)
    assert port.read(1) == b"\x07"
    trigger.close()


def test_a_port_that_is_not_there_is_told():
    with pytest.raises(DeviceError, match=r"trigger.port '/dev/ttyNONE' cannot be opened"):
        TriggerLine("/dev/ttyNONE", "dtr")


def test_lab_streaming_layer_has_the_moment_of_emission():
    """An inlet of the same stream: its stamp is the moment on liblsl's clock, to 1 ms, also of one that is to come."""
    pylsl = pytest.importorskip("pylsl", reason="the extra [lsl] is not installed: pip install 'palmfield[lsl]'")
    marker = LslMarker(f"test {time.time_ns()}")
    found = pylsl.resolve_byprop("source_id", marker.source_id, timeout=5.0)
    if not found:
        pytest.skip("streams can't be found on this machine's network")
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(timeout=5.0)
    when = time.monotonic() + 0.25
    wanted = pylsl.local_clock() + 0.25
    marker.mark("trial 3 interval 1", when)
    sample, stamp = inlet.pull_sample(timeout=3.0)
    assert sample == ["trial 3 interval 1"]
    assert stamp + inlet.time_correction(timeout=3.0) == pytest.approx(wanted, abs=1e-3)
    inlet.close_stream()
    marker.close()


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(OutputError, match=r"pip install 'palmfield\[lsl\]'"):
        LslMarker("x")
