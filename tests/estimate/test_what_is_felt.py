"""Levels, bands and the verdict of whole runs, against own sums over lines and runs at the ends of p0's range."""

import numpy as np
import pytest

import palmfield
from palmfield.outputs.motion import normal_component
from palmfield.outputs.schema import instances
from palmfield.perception.observers import OBSERVERS, threshold_m

pytestmark = pytest.mark.usefixtures("kept_operators")

CIRCLE = {"path": "circle", "path_diameter_m": 0.016, "path_rate_Hz": 60, "modulation": "none", "am_frequency_Hz": None}


def own_level(observer, times, course, rate_Hz):
    """All multiples of the rate in the last whole turns, by a Fourier transform; the louder channel counts."""
    step = times[1] - times[0]
    count = round(int((times[-1] - times[0] + step) * rate_Hz + 1e-6) / rate_Hz / step)
    lines = np.arange(0.0, 501.0, rate_Hz)[1:]
    phases = np.exp(-2j * np.pi * lines[:, None] * times[-count:])
    amplitudes = 2.0 * np.abs(phases @ course[-count:]) / count
    ratios = np.nan_to_num(amplitudes / threshold_m(observer, lines)) ** 2
    channels = np.digitize(lines, observer.channels_from_Hz)
    return 10.0 * np.log10(max(ratios[channels == one].sum() for one in set(channels)))


def test_the_level_of_a_moving_focus_is_that_of_all_its_lines(small_scene):
    result = palmfield.run(palmfield.load(small_scene(stimulus=CIRCLE), keys={"stimulus.ramp_s": 0}), duration_s=0.1)
    skin = result.summary["skins"][0]
    data = instances(result.dataset, "skin")["skin"]
    normal, times = np.asarray(normal_component(data), float), data["time"].values.astype(float)
    course = normal[:, np.abs(normal).max(axis=0).argmax()]
    assert len(skin["line_frequencies_Hz"]) >= 8
    for name in ("bolanowski_1988", "afferent_human"):  # too little skin moves for that of a gripped handle
        observer = OBSERVERS[name]
        own = own_level(observer, times, course, 60.0)
        assert skin[f"level_all_lines_{name}_dB_SL"] == pytest.approx(own, abs=0.3), name
    assert skin["verdict"]["level_dB_SL"] == skin["level_all_lines_bolanowski_1988_dB_SL"]


def test_lines_beside_those_of_am_and_path_count(small_scene):
    """AM of 150 Hz on a path of 60: a place feels 150 +- 60, 150 +- 120 ... Hz, all of them multiples of 30."""
    stimulus = CIRCLE | {"modulation": "am", "am_quantity": "arp", "am_frequency_Hz": 150}
    result = palmfield.run(palmfield.load(small_scene(stimulus=stimulus), keys={"stimulus.ramp_s": 0}), duration_s=0.1)
    skin = result.summary["skins"][0]
    data = instances(result.dataset, "skin")["skin"]
    normal, times = np.asarray(normal_component(data), float), data["time"].values.astype(float)
    course = normal[:, np.abs(normal).max(axis=0).argmax()]
    for name in ("bolanowski_1988", "afferent_human"):  # too little skin moves for that of a gripped handle
        observer = OBSERVERS[name]
        own = own_level(observer, times, course, 30.0)
        assert skin[f"level_all_lines_{name}_dB_SL"] == pytest.approx(own, abs=0.3), name
    # Those of path and AM alone are not all of it
    assert {90.0, 210.0, 270.0} <= set(np.round(skin["line_frequencies_Hz"], 6))


def test_am_and_path_that_come_round_too_rarely_have_no_level_and_a_reason(small_scene):
    stimulus = CIRCLE | {"modulation": "am", "am_quantity": "arp", "am_frequency_Hz": 151}
    verdict = palmfield.run(small_scene(stimulus=stimulus), duration_s=0.04).summary["skins"][0]["verdict"]
    assert verdict["felt"] == "not known"
    assert "two repeats of path and modulation together, 1 per second, 2000 ms: run for longer" in verdict["because"]


def test_a_path_too_slow_for_the_run_has_no_level_and_a_reason(small_scene):
    result = palmfield.run(palmfield.load(small_scene(stimulus=CIRCLE | {"path_rate_Hz": 20})), duration_s=0.01)
    verdict = result.summary["skins"][0]["verdict"]
    assert verdict["felt"] == "not known" and "two periods of 20 Hz, 100 ms: run for longer" in verdict["because"]


def test_the_part_of_p0_is_what_runs_at_its_ends_give(small_scene):
    """The ARP goes with the square of p0, and the motion with the ARP."""
    array = {"p0_Pa_m": 1.2, "p0_low_Pa_m": 0.9, "p0_high_Pa_m": 1.7}
    peaks, bands, whole = [], [], []
    for p0 in (1.2, 0.9, 1.7):
        path = small_scene(array=array | {"p0_Pa_m": p0}, skin={"accuracy": 0.3})
        skin = palmfield.run(palmfield.load(path), duration_s=0.02).summary["skins"][0]
        peaks.append(skin["peak_displacement_m"])
        bands.append({one["what"]: (one["low"], one["high"]) for one in skin["input_band_parts"]})
        whole.append([skin[f"input_band_{end}"] for end in ("low", "high")])
    assert bands[0]["p0"] == pytest.approx((peaks[1] / peaks[0], peaks[2] / peaks[0]), rel=1e-3)
    assert set(bands[0]) == {"p0", "material"}
    logs = np.log(np.array(list(bands[0].values())))
    assert np.abs(np.log(whole[0])) == pytest.approx(np.hypot(logs[0], logs[1]))
