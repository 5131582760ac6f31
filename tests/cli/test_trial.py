"""`palmfield trial` on the command line."""

import json

import pytest
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.cli.trial import motion_keys
from palmfield.errors import SceneError

RUN = CliRunner()


def test_a_trial_says_what_is_lost_and_writes_its_files(small_scene, tmp_path):
    out = tmp_path / "out"
    path = small_scene(stimulus={"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None})
    words = ["trial", str(path), "--board", "sonicsurface", "--no-skin", "--out", str(out), "--ahead", "0"]
    done = RUN.invoke(app, words)
    assert done.exit_code == 0, done.output
    for text in ("trial of", "90 samples/s, 10 ms late, without prediction", "focus error", "by latency    1.0000"):
        assert text in done.output
    numbers = json.loads((out / "trial.json").read_text())
    assert numbers["board"] == "sonicsurface" and numbers["frames_dropped"] == 0
    again = RUN.invoke(app, [*words, "--overwrite", "--json"])
    assert json.loads(again.stdout) == numbers


def test_the_kind_of_a_recorded_motion_is_told_by_its_columns(tmp_path):
    poses, joints = tmp_path / "a.csv", tmp_path / "b.csv"
    poses.write_text("time_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n")
    joints.write_text("time_s,palm_x_m,palm_y_m\n0,0,0\n")
    assert motion_keys(poses)["motion.trajectory"] == str(poses)
    assert motion_keys(joints)["motion.tracking"] == str(joints)
    assert motion_keys(joints)["motion.trajectory"] is None
    with pytest.raises(SceneError, match=r"--motion .*c\.csv: cannot be read"):
        motion_keys(tmp_path / "c.csv")


def test_an_ahead_that_is_no_number_is_refused(small_scene):
    done = RUN.invoke(app, ["trial", str(small_scene()), "--ahead", "soon"])
    assert "--ahead has value 'soon'; allowed: auto, or milliseconds" in str(done.exception)
