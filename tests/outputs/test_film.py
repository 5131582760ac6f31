"""A film of a run: its frames, its times, and what is refused."""

import contextlib
import math
import sys

import numpy as np
import pytest

from palmfield.cli.app import main
from palmfield.errors import OutputError
from palmfield.outputs.film import FPS, Cut, film
from palmfield.outputs.render import cast
from palmfield.outputs.schema import tree

av = pytest.importorskip("av")
SMALL = (192, 144)


def frames_of(path):
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_a_film_has_a_frame_for_each_step_of_its_clock_and_what_moves_is_seen(result, tmp_path):
    cut = Cut(start_s=0.0, end_s=0.005, slow=100.0, size=SMALL)
    told = []
    count = film(result, tmp_path / "a.mp4", cut, lambda done, of: told.append((done, of)))
    assert count == math.ceil(0.005 * 100.0 * FPS) == len(told)
    frames = frames_of(tmp_path / "a.mp4")
    assert len(frames) == count and frames[0].shape == (SMALL[1], SMALL[0], 3)
    # A period of 5 ms: half of it later the skin looks otherwise, and the corner of the picture does not
    half = count // 2
    moved = np.abs(frames[0].astype(float) - frames[half]).mean(axis=2)
    assert moved.max() > 40.0
    assert moved[-10:, -10:].max() < 12.0


def test_other_colours_are_other_pictures(result, tmp_path):
    pictures = []
    for shown in ("displacement", "velocity", "arp"):
        film(result, tmp_path / "b.mp4", Cut(0.001, 0.0014, 100.0, shown=shown, size=SMALL))
        pictures.append(frames_of(tmp_path / "b.mp4")[0].astype(float))
    assert np.abs(pictures[0] - pictures[2]).max() > 40.0
    assert np.abs(pictures[0] - pictures[1]).max() > 40.0


def test_ctrl_c_leaves_a_film_of_what_was_drawn(result, tmp_path):
    def stop(done, of):
        if done == 3:
            raise KeyboardInterrupt

    assert film(result, tmp_path / "c.mp4", Cut(0.0, 0.005, 100.0, size=SMALL), stop) == 3
    assert len(frames_of(tmp_path / "c.mp4")) == 3


def test_a_frame_that_ctrl_c_meets_half_drawn_is_not_counted(result, tmp_path, monkeypatch):
    drawn = []

    def cast_twice(*given):
        if len(drawn) == 2:
            raise KeyboardInterrupt
        drawn.append(0)
        return cast(*given)

    monkeypatch.setattr("palmfield.outputs.film.cast", cast_twice)
    assert film(result, tmp_path / "h.mp4", Cut(0.0, 0.005, 100.0, size=SMALL)) == 2
    assert len(frames_of(tmp_path / "h.mp4")) == 2


def test_the_command_says_that_ctrl_c_ended_the_film(tmp_path, monkeypatch, capsys):
    def cut_short(result, video, cut, on_frame):
        on_frame(2, 5)
        return 2

    monkeypatch.setattr("palmfield.outputs.film.film", cut_short)
    monkeypatch.setattr("palmfield.outputs.store.open_result", contextlib.nullcontext)
    monkeypatch.setattr(sys, "argv", ["palmfield", "--quiet", "render", str(tmp_path), "--video", "a.mp4"])
    with pytest.raises(SystemExit) as stopped:
        main()
    said = capsys.readouterr()
    assert stopped.value.code == 130 and "2 frames" in said.out and "interrupted" in said.err


@pytest.mark.parametrize(
    ("cut", "words"),
    [
        (Cut(start_s=0.002, end_s=0.001), "rising times within 0 to"),
        (Cut(end_s=9.0), "9000 ms"),
        (Cut(slow=0.0), "--slow has value 0"),
        (Cut(magnify=-1.0), "--magnify has value -1"),
        (Cut(shown="preasure"), "--show has value 'preasure'"),
        (Cut(size=(191, 144)), "--size has value 191x144"),
    ],
)
def test_bad_films_are_refused_before_a_frame_is_drawn(result, tmp_path, cut, words):
    with pytest.raises(OutputError, match=words):
        film(result, tmp_path / "d.mp4", cut)
    assert not list(tmp_path.iterdir())


def test_a_film_is_an_mp4_in_a_folder_that_is_there(result, tmp_path):
    with pytest.raises(OutputError, match=r"ends in \.mp4"):
        film(result, tmp_path / "d.avi")
    with pytest.raises(OutputError, match="cannot write"):
        film(result, tmp_path / "no" / "d.mp4", Cut(0.0, 0.001, 100.0, size=SMALL))


def part_of(skin, chosen):
    """The triangles of a skin that have a chosen vertex, as a skin of its own."""
    count = len(chosen)
    used, faces = np.unique(skin["face"][chosen[skin["face"]].any(axis=1)], return_inverse=True)
    part = {}
    for name, values in skin.items():
        along = [axis for axis, size in enumerate(values.shape) if size == count]
        part[name] = np.take(values, used, axis=along[0]) if along else values
    return part | {"face": faces.reshape(-1, 3).astype(np.int32)}


def test_skins_on_one_body_are_seen_where_they_are_pushed_in(whole, keep, tmp_path):
    """Two halves of a skin look like the whole: the body is drawn under neither."""
    one = keep(whole, ("palm",), ("below",), ())
    left = one["/skin/palm"]["rest_position"][:, 0] < 0.0
    halves = dict(one)
    for path in list(one):
        if path.endswith("/palm"):
            halves[path.replace("palm", "right")] = one[path]
    halves |= {"/skin/palm": part_of(one["/skin/palm"], left), "/skin/right": part_of(one["/skin/palm"], ~left)}
    seen = []
    for arrays in (one, halves):
        attributes = {path: {"body": "hand"} for path in arrays if path.startswith("/body")}
        # Half a period of 5 ms, in which the middle is pushed in
        film(tree(arrays, attributes), tmp_path / "f.mp4", Cut(0.0025, 0.005, 40.0, size=SMALL))
        seen.append(np.array(frames_of(tmp_path / "f.mp4"), float))
    assert (np.abs(seen[0] - seen[1]).max(axis=3) > 30.0).mean() < 2e-3


def test_words_fit_into_a_narrow_film(result, tmp_path):
    film(result, tmp_path / "g.mp4", Cut(0.001, 0.0014, 100.0, size=(160, 640)))
    heading = frames_of(tmp_path / "g.mp4")[0][:80]
    assert heading.min() < 120 and heading[:, -4:].min() > 200


def test_a_film_of_what_was_not_recorded_is_refused(whole, keep, tmp_path):
    arrays = keep(whole, ("palm",), ("below",), ())
    arrays["/skin/palm"] = {name: values for name, values in arrays["/skin/palm"].items() if name != "arp"}
    with pytest.raises(OutputError, match="contains no arp of skin 'palm'"):
        film(tree(arrays), tmp_path / "e.mp4", Cut(shown="arp", size=SMALL))
