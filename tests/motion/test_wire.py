"""Samples as lines: by both conventions, against numbers written by hand, and bad ones."""

import json
from itertools import pairwise

import numpy as np
import pytest

from palmfield.motion.joints import JOINTS
from palmfield.motion.line_listener import BadLine
from palmfield.motion.tracking import stream_of
from palmfield.motion.wire import Sample, read_sample, write_sample


@pytest.fixture(scope="module")
def sample(median, swing):
    stream = stream_of(median, swing, [0.3])
    return Sample(12.25, stream.positions[0], stream.quaternions[0], stream.radii[0], stream.flags[0])


@pytest.mark.parametrize("convention", ["openxr", "leapc"])
def test_a_sample_comes_back_as_it_was(sample, convention):
    again = read_sample(write_sample(sample, convention))
    assert again.time_s == pytest.approx(12.25, abs=1e-6)
    np.testing.assert_allclose(again.positions, sample.positions, atol=1e-12)
    turn = np.abs(np.einsum("ij,ij->i", again.quaternions, sample.quaternions))
    # LeapC has no orientation of a tip: it is that of the last bone
    own = [n for n, name in enumerate(JOINTS) if convention == "openxr" or not name.endswith("tip")]
    np.testing.assert_allclose(turn[own], 1.0, atol=1e-9)
    assert (again.flags == 15).all()


def bone(start, end):
    return {"prev_joint": start, "next_joint": end, "rotation": [0, 0, 0, 1], "width": 18.0}


def leap_line(**changes):
    """A flat hand by LeapC's own words: fingers along -z, 20 mm apart, the wrist at the origin, all in mm."""
    hand = {"convention": "leapc", "timestamp": 2_500_000, "hand": "right", "palm": {"position": [0, 0, -50]},
            "arm": {"next_joint": [0, 0, 0]}}  # fmt: skip
    for n, name in enumerate(("index", "middle", "ring", "pinky")):
        x = 20.0 * (1 - n)
        ends = [-10, -70, -110, -135, -160]
        hand[name] = {"bones": [bone([x, 0, a], [x, 0, b]) for a, b in pairwise(ends)]}
    ends = [-15, -15, -50, -80, -100]
    hand["thumb"] = {"bones": [bone([-30, 0, a], [-30, 0, b]) for a, b in pairwise(ends)]}
    return json.dumps(hand | changes)


def test_leaps_bones_are_openxrs_joints():
    """Millimetres and microseconds; the thumb's bone of no length is left out."""
    sample = read_sample(leap_line())
    at = dict(zip(JOINTS, sample.positions, strict=True))
    assert sample.time_s == 2.5
    np.testing.assert_allclose(at["wrist"], 0.0)
    np.testing.assert_allclose(at["palm"], [0, 0, -0.05])
    np.testing.assert_allclose(at["index_metacarpal"], [0.02, 0, -0.01])
    np.testing.assert_allclose(at["index_proximal"], [0.02, 0, -0.07])
    np.testing.assert_allclose(at["little_tip"], [-0.04, 0, -0.16])
    np.testing.assert_allclose(at["thumb_metacarpal"], [-0.03, 0, -0.015])
    np.testing.assert_allclose(at["thumb_proximal"], [-0.03, 0, -0.05])
    np.testing.assert_allclose(at["thumb_tip"], [-0.03, 0, -0.1])
    assert sample.radii[JOINTS.index("index_distal")] == pytest.approx(0.009)


def test_openxrs_own_names_are_known(sample):
    line = json.loads(write_sample(sample))
    line["joints"] = {f"XR_HAND_JOINT_{name.upper()}_EXT": one for name, one in line["joints"].items()}
    np.testing.assert_allclose(read_sample(json.dumps(line)).positions, sample.positions)


def openxr_line(**changes):
    joints = {"wrist": {"position": [0, 0, 0]}, "middle_tip": {"position": [0, 0, -0.18]}}
    return json.dumps({"convention": "openxr", "time_s": 1.0, "hand": "left", "joints": joints} | changes)


@pytest.mark.parametrize(
    ("line", "kind", "told"),
    [
        ("{nothing", "garbled", "not a JSON"),
        ("[1, 2]", "garbled", "a JSON list"),
        (openxr_line(convention="mano"), "convention", "'mano'; allowed: openxr, leapc"),
        (openxr_line(time_s=float("nan")), "numbers", "time_s is nan"),
        (openxr_line(hand=None), "lost", "sees no hand"),
        (openxr_line(joints={}), "lost", "no joint"),
        (openxr_line(joints={"elbow": {"position": [0, 0, 0]}}), "joints", "'elbow' is not one of the 26"),
        (openxr_line(joints={"wrist": {}}), "joints", "position"),
        (openxr_line(joints={"wrist": {"position": [0, float("nan"), 0]}}), "numbers", "wrist has"),
        (openxr_line(joints={"wrist": {"position": [0, 0]}}), "numbers", "3 finite numbers"),
        (
            openxr_line(joints={"wrist": {"position": [0, 0, 0]}, "middle_tip": {"position": [0, 0, 1.8]}}),
            "unit",
            "1.8 m long",
        ),
        (leap_line(index={"bones": []}), "joints", "index has 0 bones"),
        (leap_line(arm=None), "joints", "leapc lacks"),
        (leap_line().replace("leapc", "openxr"), "numbers", "time_s is None"),
    ],
)
def test_a_bad_sample_is_told(line, kind, told):
    with pytest.raises(BadLine) as error:
        read_sample(line)
    assert error.value.kind == kind and told in str(error.value)
