"""Trials of live hands: another process replays one over a socket while a virtual board follows it."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.acoustics.air import sound_speed
from palmfield.drive.boards import BOARDS
from palmfield.motion.alignment import Touches, align, write_alignment
from palmfield.motion.tracking import Stream, write_stream
from palmfield.session.preview import preview
from palmfield.simulation.frames import Frames
from palmfield.studies.trial import Live, Tracker, trial
from palmfield.studies.trial.latency import measure_latency, scene_stream
from palmfield.types import Air

pytestmark = pytest.mark.wall_clock

SCENE = Path(__file__).parents[3] / "mjcf" / "scenes" / "follow_fingertip.xml"
KEYS = {"stimulus.modulation": "none", "skin.accuracy": 0.5}
SPEED_m_s = np.array([0.1, -0.05, 0.04])


@pytest.fixture(scope="module")
def view():
    return preview(SCENE, board="sonicsurface", keys=KEYS, device="cpu")


@pytest.fixture
def followed(view, tmp_path):
    """Follows what another process replays; replayed: a stream, z up, over and over."""
    started = []

    def follow(replayed, *more, **options):
        file = tmp_path / "hand.npz"
        write_stream(file, replayed)

        def begin(host, port):
            words = ["track", "replay", str(file), "--to", f"{host}:{port}", *more]
            command = [sys.executable, "-c", "from palmfield.cli.app import main; main()", *words]
            started.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

        align_by = options.pop("align", None)
        live = Live(align=align_by, up="z", on_listening=begin)
        return trial(SCENE, board="sonicsurface", keys=KEYS, live=live, skin=False, **options)

    yield follow
    for process in started:
        process.kill()
        process.wait()


def straight(view, seconds):
    """A hand that keeps its shape and goes straight on at a constant speed, as a tracker sees it."""
    first = scene_stream(view, 90.0, 0.1)
    times = np.arange(0.0, seconds, 1 / 90)
    parts = [np.repeat(part[:1], len(times), axis=0) for part in list(vars(first).values())[1:]]
    start = np.array([-0.03, 0.0, 0.0])
    return Stream(times, parts[0] + (start + times[:, None] * SPEED_m_s)[:, None], *parts[1:])


def test_a_live_hand_is_followed_and_missed_by_speed_times_age(view, followed, tmp_path):
    tracker = Tracker(latency_s=0.0, ahead_s=0.0)
    result = followed(straight(view, 1.6), tracker=tracker, duration_s=0.3, out=tmp_path / "out")
    numbers = result.numbers
    assert numbers.frames_sent >= 5 and numbers.without_focus == 0.0
    assert any("samples taken, 0 skipped" in note for note in numbers.notes)
    assert (tmp_path / "out" / "tracked.npz").exists()
    checked = 0
    for one in result.moments:
        # Within the palm's shape, which a live hand knows from five samples only
        np.testing.assert_allclose(one.true - one.believed, SPEED_m_s * one.age_s, atol=0.3e-3)
        way_s = np.linalg.norm(one.true) / sound_speed(Air())
        assert one.age_s > 258 / 23040 + 0.9 * way_s
        checked += one.age_s > 0.02
    assert checked > 10


def test_a_tracker_that_stands_elsewhere_is_placed_by_its_file(view, followed, tmp_path):
    """The same hand seen by a tracker that lies on its side, 0.3 m away."""
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    shift = np.array([0.3, 0.1, -0.2])
    places = np.array([[-0.08, -0.08, 0.0], [0.08, -0.08, 0.0], [0.08, 0.08, 0.0], [-0.08, 0.08, 0.0]])
    write_alignment(tmp_path / "a.json", align(Touches(places, (places - shift) @ turn)))
    hand = straight(view, 1.5)
    array = view.runtime.posed.array_frame
    seen = (array.inverse_points(hand.positions) - shift) @ turn
    elsewhere = Stream(hand.times_s, seen, *list(vars(hand).values())[2:])
    result = followed(elsewhere, align=tmp_path / "a.json", tracker=Tracker(0.0, 0.0, ahead_s=0.0), duration_s=0.15)
    # The fingertip of the straight hand, wherever the tracker stands
    pads = [one.true for one in result.moments]
    start = preview(SCENE, board="sonicsurface", keys=KEYS, device="cpu").runtime.posed.frames[0].position
    along = np.array(pads) - start - np.array([-0.03, 0.0, 0.0])
    across = along - np.outer(along @ SPEED_m_s / (SPEED_m_s @ SPEED_m_s), SPEED_m_s)
    assert np.linalg.norm(across, axis=1).max() < 1.5e-3


def test_frames_are_silent_while_the_hand_is_lost(view, followed):
    result = followed(straight(view, 1.5), tracker=Tracker(0.0, 0.0, ahead_s=0.0), duration_s=2.4)
    silent = [frame for frame in result.sent.frames if not frame.frame.target.any()]
    assert silent and len(silent) < len(result.sent.frames)
    assert silent[0].due_s > 0.1 and any("frames were silent" in note for note in result.numbers.notes)
    assert not BOARDS["sonicsurface"].decode(silent[0].frame.data)[-1].any()


def test_a_focus_that_cannot_be_made_is_silence_and_no_end(view, followed, monkeypatch):
    """As of a hand that is lowered below the board, or a tracker that has lost its way for a while."""
    made = Frames.at

    def at(self, posed, time_s, share=1.0):
        if int(10 * time_s) % 2:
            raise palmfield.SceneError("focus [0.0, 0.0, -0.1] is behind array 'array'")
        return made(self, posed, time_s, share)

    monkeypatch.setattr(Frames, "at", at)
    result = followed(straight(view, 1.6), tracker=Tracker(latency_s=0.0, ahead_s=0.0), duration_s=0.4)
    assert any("silent, because no focus is possible there: focus" in note for note in result.numbers.notes)
    sounds = {one.number: one.frame.sounds for one in result.sent.frames}
    assert set(sounds.values()) == {True, False}
    assert all(on == (int(10 * result.sent.frames[n].due_s) % 2 == 0) for n, on in enumerate(sounds.values()))


def test_the_loop_is_longer_than_a_frame_on_the_line_and_shorter_than_what_is_stale():
    found = measure_latency(SCENE, board="sonicsurface", keys=KEYS, seconds=1.0)
    assert found.line_ms < found.p50_ms <= found.p95_ms <= found.largest_ms
    # A sample waits for the next frame, and that for the line: three frames where nothing is late
    assert found.p50_ms < 6.0 * found.line_ms
    assert found.samples > 45 and "a lag of 40 ms is noticeable" in str(found)


def test_what_cannot_be_followed_is_refused(small_scene):
    with pytest.raises(palmfield.DeviceError, match="takes no bytes"):
        trial(SCENE, keys={"skin.accuracy": 0.5}, live=Live(wait_s=0.1))
    still = {"stimulus.modulation": "none"}
    with pytest.raises(palmfield.SceneError, match=r"has 0 instances of plugin 'palmfield\.motion' with key hand"):
        trial(small_scene(), board="sonicsurface", keys=still, live=Live(wait_s=0.1), skin=False)
    with pytest.raises(palmfield.SceneError, match="no hand was tracked within"):
        trial(SCENE, board="sonicsurface", keys=KEYS, live=Live(wait_s=0.1), skin=False)
