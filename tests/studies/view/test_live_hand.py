"""The live view of a hand that another process sends, without a page."""

import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.motion.live_hand import Live
from palmfield.motion.tracking import Stream, write_stream
from palmfield.session.preview import preview
from palmfield.studies.trial.latency import scene_stream
from palmfield.studies.view.messages import Moment, Notice, Pace, Request
from palmfield.studies.view.run import SceneSource, ShownScene

pytestmark = [pytest.mark.wall_clock, pytest.mark.usefixtures("kept_operators")]

FOLLOW = Path(__file__).parents[3] / "mjcf" / "scenes" / "follow_fingertip.xml"
KEYS = {"stimulus.modulation": "none", "skin.accuracy": 0.5, "skin.solver": "modal"}


@pytest.fixture
def shown(tmp_path):
    """A view of a hand 40 mm to the side of its script, sent for 1.5 s."""
    view = preview(FOLLOW, keys=KEYS, device="cpu")
    hand = scene_stream(view, 90.0, 1.5)
    parts = [np.repeat(part[:1], len(hand.times_s), axis=0) for part in list(vars(hand).values())[1:]]
    stream = Stream(hand.times_s, parts[0] + (0.04, 0.0, 0.03), *parts[1:])
    write_stream(tmp_path / "hand.npz", stream)
    started, sent = [], []

    def begin(host, port):
        words = ["track", "replay", str(tmp_path / "hand.npz"), "--to", f"{host}:{port}"]
        command = [sys.executable, "-c", "from palmfield.cli.app import main; main()", *words]
        started.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

    live = Live(up="z", on_listening=begin)
    scene = ShownScene(SceneSource(FOLLOW, "cpu", None, None), KEYS, tmp_path, sent.append, live)
    scene.receive(Pace(math.inf))
    with scene.followed:
        yield scene, sent
    started[0].kill()
    started[0].wait()


def test_the_hand_of_the_scene_goes_where_the_tracked_hand_is(shown):
    scene, sent = shown
    rest = scene.sim.data.body("hand").xpos.copy()
    scene.followed.wait(30.0)
    end = time.monotonic() + 60.0
    while time.monotonic() < end and np.linalg.norm(scene.sim.data.body("hand").xpos - rest) < 0.049:
        scene.go_on()
    scene.receive(Request("moment"))
    scene.go_on()
    moved, moment = scene.sim.data.body("hand").xpos - rest, sent[-1]
    np.testing.assert_allclose(moved, (0.04, 0.0, 0.03), atol=2e-3)
    assert isinstance(moment, Moment) and (moment.hand_age_s < 1.5 or math.isnan(moment.hand_age_s))
    while not scene.followed.stale:
        time.sleep(0.05)
    scene.receive(Request("moment"))
    scene.go_on()
    assert math.isnan(sent[-1].hand_age_s) and scene.playing
    assert not [one for one in sent if isinstance(one, Notice) and one.kind == "error"]


def test_a_scene_without_an_articulated_hand_is_refused(small_scene, tmp_path):
    with pytest.raises(SceneError, match=r"0 instances of plugin 'palmfield\.motion' with key hand"):
        ShownScene(SceneSource(small_scene(), "cpu", None, None), {}, tmp_path, print, Live())


def test_a_hand_in_the_array_is_reported_once_and_the_view_goes_on(shown, monkeypatch):
    scene, sent = shown

    def step():
        raise SceneError("body 'hand' reaches into array 'array'")

    monkeypatch.setattr(scene, "_step", step)
    for _ in range(20):
        scene.go_on()
    assert scene.playing and len([one for one in sent if isinstance(one, Notice)]) == 1
