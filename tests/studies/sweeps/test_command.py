"""`palmfield sweep` on the command line."""

import subprocess
import sys

import pytest
import xarray as xr

from palmfield.cli import sweep as command
from palmfield.cli.app import main
from palmfield.studies.sweeps.whole_sweep import Sweep

pytestmark = pytest.mark.usefixtures("kept_operators")


def palmfield(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "palmfield", *map(str, arguments)], capture_output=True, text=True, check=False
    )


def test_a_sweep_from_the_command_line(small_scene, tmp_path):
    out = tmp_path / "out"
    frequencies = "stimulus.am_frequency_Hz=100:200:2"
    done = palmfield(
        "sweep", small_scene(duration_s=0.002), "--set", frequencies, "--set", "stimulus.drive_amplitude=0.5",
        "--workers", 0, "--out", out,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "2 of 2 points are done" in done.stdout and f"wrote {out / 'sweep.png'}" in done.stdout
    assert "2 points of 0.002 s over stimulus.am_frequency_Hz; about 0.4 GB of memory in this process" in done.stderr
    with xr.open_zarr(out / "sweep.zarr", consolidated=False) as dataset:
        assert dataset["stimulus.am_frequency_Hz"].values.tolist() == [100.0, 200.0]
        assert dataset["drive_level"].values.ravel() == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["stimulus.am_frequency_Hz=1:2:0"], "is empty: it has 0 values; allowed: at least 1"),
        (["stimulus.nose=1:2:3"], "unknown key 'nose'; allowed: arrays"),
        ([], "the sweep has no values; give --set with several values: KEY=a:b:n"),
    ],
)
def test_what_is_refused_is_said_in_one_line(settings, said, small_scene, tmp_path, monkeypatch, capsys):
    options = [part for text in settings for part in ("--set", text)]
    arguments = ["palmfield", "sweep", small_scene(), *options, "--out", tmp_path / "out"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in arguments])
    with pytest.raises(SystemExit, match="2"):
        main()
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and said in told
    assert not (tmp_path / "out").exists()


def test_failures_are_told_by_reason(tmp_path):
    failed = {3: "too near", 5: "too near", 7: "one", 8: "two", 9: "three"}
    said = command.in_words(Sweep(tmp_path, {"sweep.zarr": tmp_path / "sweep.zarr"}, 10, 5, failed))
    assert "5 of 10 points are done" in said and "2 failed; the first is point 3: too near" in said
    assert "1 other reasons" in said and "three" not in said
