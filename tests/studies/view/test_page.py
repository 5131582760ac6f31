"""The page in a process of its own, looked at by a client that is no browser, and how both processes end."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")

from http.client import HTTPConnection

from page_client import InvalidStatus, PageClient, is_picture
from websockets.exceptions import ConnectionClosed

from palmfield.outputs.store import open_result
from palmfield.studies.view.link import Link
from palmfield.studies.view.messages import Address, Pace
from palmfield.studies.view.run import Ending, SceneSource, ShownScene, run_for


def port_of(address):
    return int(re.search(r":(\d+)/", address)[1])


@pytest.fixture(scope="module")
def page(module_scene, tmp_path_factory):
    """A running view of a small scene: the scene and the page's address; the scene is stepped in a thread."""
    sent = []
    live = ShownScene(SceneSource(module_scene(), "cpu", None, None), {}, tmp_path_factory.mktemp("out"), sent.append)
    live.receive(Pace(math.inf))
    end = Ending()
    with Link(Address("127.0.0.1", None, "", 20.0)) as link:
        live.send = link.send
        live.show()
        runner = threading.Thread(target=run_for, args=(live, link, end))
        runner.start()
        yield live, link.address
        end.requested = True
        runner.join()
    assert not link.alive


def test_the_page_comes_over_http_and_its_pictures_over_a_websocket(page):
    _, address = page
    talk = HTTPConnection("127.0.0.1", port_of(address), timeout=10.0)
    talk.request("GET", "/")
    answer = talk.getresponse()
    told = answer.read()
    assert answer.status == 200 and b"<html" in told and b"The view has ended" in told
    talk = HTTPConnection("127.0.0.1", port_of(address), timeout=10.0)
    talk.request("GET", "/alive")
    assert talk.getresponse().status == 204
    with PageClient(address) as client:
        client.until(is_picture)
        began, count = time.monotonic(), 0
        while count < 20:
            count += sum(map(is_picture, client.received(1.0)))
        # 20 a second are asked for; a busy machine may be late, and none comes twice
        assert time.monotonic() - began > 0.5
        client.until_says("dB SL")
        assert {"x [mm]", "frequency [Hz]", "depth", "of full drive"} <= set(client.controls)
        told = " ".join(client.texts)
        assert "times slower" in told and "motion magnified" in told and "phase of each" in told


def test_buttons_and_sliders_reach_the_scene_and_errors_the_page(page):
    live, address = page
    with PageClient(address) as client:
        client.until(is_picture)
        client.press("Pause")
        client.until_says("paused")
        assert not live.playing
        client.press("Play")
        client.until_says("real time")
        client.turn("frequency [Hz]", 1e5)
        client.until_says("am_frequency_Hz")
        assert live.keys == {}
        client.turn("depth", 0.5)
        client.until_says("rebuilt in")
        assert live.keys == {"stimulus.am_depth": "0.5"}
        client.until(is_picture)
        client.press("Record")
        client.until_says("recording to")
        client.until_says("Stop recording")
        client.press("Stop recording")
        client.until_says("wrote ")
        (folder,) = live.out.glob("recording-*")
        assert json.loads((folder / "keys.json").read_text())["keys"] == live.keys


def test_a_page_that_is_left_asks_for_nothing(page):
    live, address = page
    with PageClient(address) as client:
        client.until(is_picture)
    time.sleep(1.0)
    live._requested.clear()
    time.sleep(0.5)
    assert not live._requested


def test_a_strangers_script_is_not_let_in(page):
    _, address = page
    with pytest.raises(InvalidStatus):
        PageClient(address, {"Origin": "http://evil.example"})


def ports_behind(address):
    """Ports of this machine at which the process that serves a page listens, but the page's own: Linux lists them."""
    sockets, own = {}, port_of(address)
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        words = line.split()
        if words[3] == "0A":
            sockets[f"socket:[{words[9]}]"] = int(words[1].split(":")[1], 16)
    for process in Path("/proc").glob("[0-9]*/fd"):
        try:
            ports = {sockets[link] for one in process.iterdir() if (link := os.readlink(one)) in sockets}
        except OSError:
            continue
        if own in ports:
            return ports - {own}
    raise AssertionError(f"nobody listens at port {own}")


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="open ports are listed by Linux")
@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "http://localhost:{gate}"},
        {},
        {"Origin": "http://evil.example", "X-Palmfield-Gate": ""},
    ],
)
def test_nobody_comes_in_past_the_gate(page, headers):
    _, address = page
    behind = ports_behind(address)
    assert behind
    for port in behind:
        own = {name: text.format(gate=port_of(address)) for name, text in headers.items()}
        with pytest.raises(InvalidStatus) as refused:
            PageClient(f"http://127.0.0.1:{port}/", own)
        assert refused.value.response.status_code == 403
        talk = HTTPConnection("127.0.0.1", port, timeout=10.0)
        talk.request("GET", "/", headers=own)
        assert talk.getresponse().status == 403


def test_a_page_for_others_asks_for_its_token(module_scene, tmp_path):
    with Link(Address("127.0.0.1", None, "secret", 10.0)) as link:
        assert link.address.endswith("/?token=secret")
        port = port_of(link.address)
        with pytest.raises(InvalidStatus):
            PageClient(link.address)
        with PageClient(link.address, {"Cookie": f"palmfield_{port}=secret"}) as client:
            assert client.received(10.0)


def started(path, out, *options):
    """`palmfield view` in a process of its own, and the page's address."""
    process = subprocess.Popen(
        [sys.executable, "-m", "palmfield", "view", str(path), "--out", str(out), "--device", "cpu", *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    assert process.stdout is not None
    line = process.stdout.readline()
    assert " is at http://localhost:" in line, (line, process.stderr.read() if process.stderr else "")
    return process, line.split(" is at ")[1].split()[0]


def children(pid):
    with open(f"/proc/{pid}/task/{pid}/children") as file:
        return [int(one) for one in file.read().split()]


def gone(pids, within_s=10.0):
    """Whether processes have ended."""
    ends = time.monotonic() + within_s
    while time.monotonic() < ends:
        if not any(os.path.exists(f"/proc/{pid}") for pid in pids):
            return True
        time.sleep(0.1)
    return False


@pytest.mark.wall_clock
def test_ctrl_c_ends_both_processes_and_finishes_the_recording(small_scene, tmp_path):
    out = tmp_path / "out"
    process, address = started(small_scene(), out, "--pace", "max")
    pids = children(process.pid)
    assert pids
    with PageClient(address) as client:
        client.until(is_picture)
        client.press("Record")
        client.until_says("recording to")
        # As a terminal does: to all of its processes
        os.killpg(process.pid, signal.SIGINT)
        with pytest.raises((ConnectionClosed, OSError)):
            for _ in range(200):
                client.received(0.2)
    told = process.communicate(timeout=30.0)[1]
    assert gone(pids)
    assert process.returncode == 0, told
    assert "Traceback" not in told and "recording-001" in told
    with open_result(out / "recording-001" / "result.nc") as result:
        assert result.attrs["complete"] == 1 and result.sizes["step_time"] > 0


ALONE = """
import time
from palmfield.studies.view.link import Link
from palmfield.studies.view.messages import Address
if __name__ == "__main__":
    link = Link(Address("127.0.0.1", None, "", 10.0))
    print(link.pid, flush=True)
    time.sleep(60.0)
"""


@pytest.mark.wall_clock
def test_the_page_ends_with_a_simulation_that_is_killed(tmp_path):
    script = tmp_path / "alone.py"
    script.write_text(ALONE)
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    page = int(process.stdout.readline())
    assert os.path.exists(f"/proc/{page}")
    process.kill()
    process.wait(10.0)
    assert gone([page])


@pytest.mark.wall_clock
def test_a_command_whose_page_is_killed_says_so_and_fails(module_scene, tmp_path):
    process, _ = started(module_scene(), tmp_path / "out")
    for pid in children(process.pid):
        if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes():
            os.kill(pid, signal.SIGKILL)
    told = process.communicate(timeout=30.0)[1]
    assert process.returncode == 2 and "the page process has ended" in told


def test_a_page_is_found_where_it_listens(module_scene, tmp_path):
    with Link(Address("127.0.0.2", None, "", 10.0)) as link:
        assert link.address.startswith("http://127.0.0.2:")
        talk = HTTPConnection("127.0.0.2", port_of(link.address), timeout=10.0)
        talk.request("GET", "/")
        assert talk.getresponse().status == 200


def test_a_view_whose_page_is_killed_ends_too(module_scene, tmp_path):
    live = ShownScene(SceneSource(module_scene(), "cpu", None, None), {}, tmp_path, [].append)
    with Link(Address("127.0.0.1", None, "", 10.0)) as link:
        os.kill(link.pid, signal.SIGKILL)
        run_for(live, link, Ending())
        assert link.closed
