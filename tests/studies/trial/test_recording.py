"""Recordings: read or refused, and held against courses that are known."""

import numpy as np
import pytest

import palmfield
from palmfield.studies.trial import Tracker, read_recording, trial
from palmfield.studies.trial.recording import aligned

pytestmark = pytest.mark.usefixtures("kept_operators")

HEAD = "# quantity: pressure\n# unit: kPa\n# place_m: 0 0 0.12\n"
ROWS = "".join(f"{0.001 * n},{0.1 + 0.01 * n}\n" for n in range(40))


def written(path, text):
    path.write_text(text)
    return path


def test_a_recording_is_read_in_its_unit(tmp_path):
    recording = read_recording(written(tmp_path / "a.csv", f"{HEAD}# by: us\nt,value\n{ROWS}"))
    assert recording.quantity == "pressure" and recording.place_m == (0.0, 0.0, 0.12)
    assert recording.values[3] == pytest.approx(130.0) and recording.times[3] == pytest.approx(0.003)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (HEAD.replace("kPa", "um") + "t,value\n" + ROWS, "unit of pressure is 'um'; allowed: Pa, kPa, mPa"),
        (HEAD.replace("pressure", "presure") + "t,value\n" + ROWS, "did you mean 'pressure'"),
        (HEAD.replace("# unit: kPa\n", "") + "t,value\n" + ROWS, "no '# unit: ...'"),
        (HEAD.replace("0 0 0.12", "0 0 120") + "t,value\n" + ROWS, "three finite numbers in metres"),
        (HEAD + "time,p\n" + ROWS, "line 4 does not contain column names"),
        (HEAD + "t,value\n" + ROWS.replace("0.2,", "x,").replace("0.005,", "nan,"), "line 10, column t: nan"),
        (HEAD + "t,value\n" + ROWS.replace("0.005,", "0.004,"), "t = 0.004 s comes after 0.004 s"),
        (HEAD + "t,value\n0.0,1.0\n", "1 rows; needed: 16 or more"),
        ("", "no '# quantity: ...'"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, text, told):
    with pytest.raises(palmfield.SceneError) as error:
        read_recording(written(tmp_path / "a.csv", text))
    assert told in str(error.value) and "a.csv" in str(error.value)


def test_a_shift_a_ratio_and_noise_are_found():
    random = np.random.default_rng(0)
    times = np.arange(0.0, 1.0, 1e-3)
    course = 100.0 + 20.0 * np.sin(2 * np.pi * 3.0 * times) + 15.0 * np.sin(2 * np.pi * 7.3 * times + 1.0)
    recorded_times = np.arange(0.05, 0.95, 0.7e-3)
    seen = 0.8 * np.interp(recorded_times - 0.0123, times, course) + random.normal(0.0, 2.0, len(recorded_times))
    shift, overlap, rms, correlation, ratio = aligned(recorded_times, seen, times, course)
    assert shift == pytest.approx(0.0123, abs=1e-3)
    assert overlap == pytest.approx(0.9, abs=0.03)
    assert ratio == pytest.approx(0.8, abs=0.003)
    signal, noise = 0.8 * course.std(), 2.0
    assert correlation == pytest.approx(signal / np.hypot(signal, noise), abs=0.02)
    assert rms == pytest.approx(
        np.hypot(0.2 * np.sqrt(np.mean(course**2)), noise) / np.sqrt(np.mean(course**2)), abs=0.005
    )


def test_what_never_changes_cannot_be_aligned():
    times = np.arange(0.0, 0.1, 1e-3)
    with pytest.raises(palmfield.SceneError, match="is constant"):
        aligned(times, np.ones(100), times, np.sin(50 * times))


def test_a_recording_of_a_trial_is_recognised_by_the_next(moving_scene, tmp_path):
    """What a microphone at a place would have had, 0.7 times as loud and 5 ms later, of a board without losses."""
    place, late_s, share = np.array([-0.005, 0.0, 0.123]), 0.005, 0.7
    path = moving_scene()
    tracker = Tracker(0.0, 0.0, ahead_s=0.0)
    first = trial(path, tracker=tracker, skin=False)
    array = palmfield.load(path, device="cpu").runtime.model.arrays
    values = [abs(array.pressure64(place[None], one.frame.target)[0]) for one in first.sent.frames]
    rows = "".join(f"{one.due_s + late_s},{share * p}\n" for one, p in zip(first.sent.frames, values, strict=True))
    text = f"# quantity: pressure\n# unit: Pa\n# place_m: {place[0]} {place[1]} {place[2]}\nt,value\n{rows}"
    recording = read_recording(written(tmp_path / "mic.csv", text))
    found = trial(path, tracker=tracker, skin=False, recording=recording).compared
    # The sound is 0.36 ms under way, so that at each step that of the step before is heard
    assert found.shift_s == pytest.approx(late_s - 1e-3, abs=0.3e-3)
    assert found.correlation > 0.99 and found.ratio == pytest.approx(share, abs=0.02)
    # uhev1: 0.7 to 2.6 Pa m about 1.27
    assert found.band == pytest.approx((0.7 / 1.27, 2.6 / 1.27), rel=1e-6)
    with pytest.raises(palmfield.SceneError, match="needs the motion of the skin"):
        moved = read_recording(
            written(tmp_path / "v.csv", text.replace("pressure", "velocity").replace(": Pa", ": m/s"))
        )
        trial(path, tracker=tracker, skin=False, recording=moved)


@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
def test_a_vibrometers_recording_is_held_against_the_skin_at_its_place(moving_scene, tmp_path, quantity):
    """What the skin did at a place, half as much of it, in other units."""
    path, place = moving_scene(skin={"solver": "wedges"}, stimulus={"ramp_s": 0.01}), np.array([-0.012, -0.01, 0.12])
    tracker = Tracker(0.0, 0.0, ahead_s=0.0)
    text = "# quantity: {}\n# unit: {}\n# place_m: {} {} {}\nt,value\n{}"
    unit, scale = ("um", 1e6) if quantity == "displacement" else ("mm/s", 1e3)
    blank = "".join(f"{0.001 * n},{n % 3}\n" for n in range(60))
    first = trial(
        path, tracker=tracker, duration_s=0.05, recording=read_recording(
            written(tmp_path / "blank.csv", text.format(quantity, unit, *place, blank))
        ),
    )  # fmt: skip
    course = first.skin.motion[1][0 if quantity == "displacement" else 1]
    rows = "".join(f"{t + 0.002},{0.5 * scale * v}\n" for t, v in zip(first.skin.times, course, strict=True))
    recording = read_recording(written(tmp_path / "v.csv", text.format(quantity, unit, *place, rows)))
    found = trial(path, tracker=tracker, duration_s=0.05, recording=recording).compared
    assert found.shift_s == pytest.approx(0.002, abs=0.3e-3)
    assert found.correlation > 0.999 and found.ratio == pytest.approx(0.5, rel=0.01)
    # Motion goes with the square of the pressure
    assert found.band == pytest.approx(((0.7 / 1.27) ** 2, (2.6 / 1.27) ** 2), rel=1e-6)
