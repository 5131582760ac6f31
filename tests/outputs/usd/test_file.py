"""The file of a USD scene: endings, sizes, memory, and what a kill leaves."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pxr import Usd, UsdGeom

import palmfield
from palmfield.errors import OutputError
from palmfield.outputs.schema import tree
from palmfield.outputs.usd import Shown, validate_usd, write_usd
from palmfield.outputs.usd.quantise import rounding
from palmfield.outputs.usd.skins import strip_order

PALM = "/Scene/Bodies/palm/Skins/palm"
LONG = """
import sys
import numpy as np
from palmfield.outputs.schema import tree
from palmfield.outputs.usd import Shown, write_usd
count, frames, path = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
x, y = np.meshgrid(np.linspace(-0.03, 0.03, count), np.linspace(-0.03, 0.03, count))
points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
faces = np.concatenate([np.stack([corner, corner + 1, corner + count], axis=1),
                        np.stack([corner + 1, corner + count + 1, corner + count], axis=1)]).astype(np.int32)
times = 1e-4 * np.arange(frames)
centre = 0.015 * np.stack([np.cos(440 * times), np.sin(440 * times)], axis=1)
near = ((points[None, :, :2] - centre[:, None]) ** 2).sum(axis=2)
arp = (12.0 * np.exp(-near / 1.6e-5)).astype(np.float32)
push = (-1e-6 * np.exp(-near / 6e-5) * np.cos(900.0 * np.sqrt(near))).astype(np.float32)
displacement = np.zeros((frames, len(points), 3), np.float32)
displacement[..., 2] = push
result = tree({
    "/": {"time": times},
    "/skin/palm": {
        "rest_position": points, "rest_normal": np.tile([0.0, 0.0, 1.0], (len(points), 1)), "face": faces,
        "displacement": displacement, "arp": arp,
    },
})
"""


@pytest.fixture(scope="module")
def one(whole, keep):
    return tree(keep(whole, ("palm",), ("below",), ("pulse",)))


@pytest.mark.parametrize("suffix", ["usda", "usdz"])
def test_other_endings_hold_the_same(one, tmp_path, suffix):
    for ending in ("usdc", suffix):
        write_usd(one, tmp_path / f"s.{ending}", Shown(frames=7))
    assert validate_usd(tmp_path / f"s.{suffix}") == []
    read = []
    for ending in ("usdc", suffix):
        stage = Usd.Stage.Open(str(tmp_path / f"s.{ending}"))
        arp = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(PALM)).GetPrimvar("arp")
        read.append((stage.GetTimeCodesPerSecond(), arp.GetTimeSamples(), np.array(arp.Get(6))))
    assert read[0][:2] == read[1][:2]
    np.testing.assert_allclose(read[0][2], read[1][2], rtol=1e-6)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["s.usdc", f"s.{suffix}"])


def test_5000_vertices_and_500_frames_are_small(tmp_path):
    """Radiation pressure and displacement of a focus that runs round on the skin: 3 MB, and 5 with one colour."""
    space: dict = {}
    old, sys.argv = sys.argv, ["", "71", "500", ""]
    try:
        exec(compile(LONG, "LONG", "exec"), space)
    finally:
        sys.argv = old
    names = ("arp", "normal_displacement")
    sizes = {}
    for colour in ("none", "arp", "normal_displacement"):
        write_usd(space["result"], tmp_path / "s.usdc", Shown(colour=colour, quantities=names))
        sizes[colour] = (tmp_path / "s.usdc").stat().st_size
    assert sizes["none"] < 3e6 and max(sizes.values()) < 5e6, sizes
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    for name in names:
        attribute = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(PALM)).GetPrimvar(name).GetAttr()
        low, high, bound = (attribute.GetCustomDataByKey(f"palmfield:{key}") for key in ("low", "high", "error_bound"))
        assert attribute.GetNumTimeSamples() == 500 and bound <= (high - low) / 255 * 1.0001


@pytest.mark.slow
def test_a_killed_process_leaves_what_it_has_written(tmp_path):
    """At any moment of writing, within a saving too: the partial file opens and is whole up to its end."""
    program = (
        LONG
        + """
def told(done, of):
    print(done, flush=True)
while True:
    write_usd(result, path, Shown(frames=100000, magnify=0.0), on_frame=told)
"""
    )
    path, frames = tmp_path / "s.usdc", 400
    partial = tmp_path / "s.partial.usdc"
    rng = np.random.default_rng(0)
    seen = []
    for _ in range(4):
        child = subprocess.Popen(
            [sys.executable, "-c", program, "40", str(frames), str(path)], stdout=subprocess.PIPE, text=True
        )
        assert child.stdout is not None
        for _ in range(int(rng.integers(1, 8))):
            child.stdout.readline()
        time.sleep(float(rng.uniform(0.0, 0.03)))
        child.send_signal(signal.SIGKILL)
        child.wait()
        left = partial if partial.exists() else path
        assert validate_usd(left) == []
        stage = Usd.Stage.Open(str(left))
        arp = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(PALM)).GetPrimvar("arp")
        last = stage.GetEndTimeCode()
        assert last >= 49.0 and arp.GetTimeSamples()[-1] == last and len(arp.Get(last)) == 1600
        seen.append(left.name)
        partial.unlink(missing_ok=True)
    assert "s.partial.usdc" in seen
    # The next one takes away what was left
    write_usd(tree({}), path)
    assert [one.name for one in tmp_path.iterdir()] == ["s.usdc"]


def test_what_a_killed_writing_leaves_is_named_by_recover(tmp_path, capsys):
    from palmfield.cli.messages import show_log

    show_log("warning")
    (tmp_path / "scene.partial.usdc").write_bytes(b"some")
    (tmp_path / ".scene.tmp.usdc").write_bytes(b"some")
    with pytest.raises(OutputError, match="no unfinished run"):
        palmfield.recover(tmp_path)
    said = capsys.readouterr().err
    assert "scene.partial.usdc is content of an interrupted USD scene" in said
    assert ".scene.tmp.usdc is part of an interrupted USD scene: remove it" in said
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.nightly
def test_memory_does_not_grow_with_frames(tmp_path):
    """From a quarter of the frames on, the process's own memory stays; all that is written would take 27 MB more."""
    program = (
        LONG
        + """
from pathlib import Path
def told(done, of):
    anonymous = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("RssAnon"))
    print(done, int(anonymous.split()[1]) / 1024)
write_usd(result, path, Shown(frames=100000, magnify=0.0), on_frame=told)
"""
    )
    run = [sys.executable, "-c", program, "71", "600", str(tmp_path / "s.usdc")]
    lines = subprocess.run(run, check=True, capture_output=True, text=True).stdout.splitlines()
    memory = {int(done): float(size) for done, size in map(str.split, lines)}
    assert list(memory)[::4] == [50, 250, 450]
    assert memory[600] - memory[150] < 3.0, memory


def test_an_old_scene_stays_until_the_new_one_is_whole(one, tmp_path, still, monkeypatch):
    path = tmp_path / "scene.usdc"
    write_usd(still, path)
    before = path.read_bytes()
    replace = os.replace

    def full(source, target):
        if str(target) == str(path):
            raise OSError(28, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_usd(one, path, Shown(frames=3))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["scene.usdc"]


FLOATS = arrays(np.float32, st.integers(1, 50), elements=st.floats(-1e6, 1e6, width=32, allow_subnormal=False))


@settings(deadline=None)
@given(FLOATS, st.booleans())
def test_rounding_keeps_its_bound_its_sum_and_few_levels(values, keeps_sum):
    weights = 0.5 + np.arange(len(values)) % 3 if keeps_sum else None
    rounded = rounding(float(min(values.min(), 0.0)), float(max(values.max(), 0.0)), weights)
    found = rounded.of(values).astype(float)
    assert np.abs(found - values.astype(float)).max() <= rounded.bound
    assert len(np.unique(found)) <= 257 and (found[values == 0.0] == 0.0).all()
    if weights is not None:
        slack = weights.max() * rounded.step + 1e-6 * np.abs(values).max() * weights.sum()
        assert abs(weights @ (found - values.astype(float))) <= slack


def test_the_order_holds_every_vertex_and_goes_by_small_steps():
    points = np.random.default_rng(1).uniform(0.0, 1.0, (3000, 3)) * [0.06, 0.05, 0.002]
    order = strip_order(points)
    assert sorted(order) == list(range(3000))
    steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1)
    assert np.median(steps) < 0.1 * np.median(np.linalg.norm(np.diff(points, axis=0), axis=1))
    assert list(strip_order(np.zeros((3, 3)))) == [0, 1, 2]
