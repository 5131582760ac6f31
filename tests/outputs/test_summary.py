import json

import numpy as np
import pytest

from palmfield.outputs.schema import tree
from palmfield.outputs.store import Store, open_result
from palmfield.outputs.summary import summary
from palmfield.outputs.summary_table import format_summary
from palmfield.outputs.verdict import verdict


@pytest.fixture
def known(static_arrays, merge, keep):
    """u = -4 um + 5 um sin(2 pi 50 t) along the normal at one vertex over whole periods, and more across it."""
    count = len(static_arrays["/skin/palm"]["rest_position"])
    time = np.arange(1000) * 1e-4
    motion = np.zeros((1000, count, 3), np.float32)
    # The outward normal is -z.
    motion[:, 7, 2] = 4e-6 - 5e-6 * np.sin(2 * np.pi * 50 * time)
    motion[:, 9, 0] = 1e-3
    force = np.zeros((1000, 3))
    force[:, 2] = 3e-3
    force[0] = [0.0, 4e-3, 3e-3]
    blocks = {
        "/": {"time": time, "step_time": time},
        "/skin/palm": {"displacement": motion, "velocity": 2 * motion},
        "/forces/palm": {"force": force, "torque": 0 * force},
    }
    return merge(keep(static_arrays, ("palm",), ("below",), ()), blocks)


def test_numbers_of_a_known_motion(known, tmp_path):
    """rms 5 / sqrt 2 without DC, sqrt(16 + 12.5) with; what lies across the normal does not count."""
    store = Store(tmp_path, {p: v for p, v in known.items() if not p.startswith("/forces")})
    store.append({p: known[p] for p in ("/", "/forces/palm")} | {"/skin/palm": _records(known)})
    with open_result(store.finish({}, True)) as opened:
        found = [summary(result, {"scene": "x"}) for result in (tree(known), opened)]
    assert json.loads(json.dumps(found[0], allow_nan=False)) == found[0]
    for numbers in found:
        skin = numbers["skins"][0]
        assert skin["name"] == "palm"
        assert skin["peak_displacement_vertex"] == 7
        assert skin["peak_displacement_m"] == pytest.approx(9e-6)
        assert skin["peak_displacement_time_s"] == pytest.approx(0.015)
        assert skin["rms_displacement_m"] == pytest.approx(np.sqrt(16 + 12.5) * 1e-6)
        assert skin["rms_displacement_without_dc_m"] == pytest.approx(5e-6 / np.sqrt(2))
        assert skin["peak_velocity_m_s"] == pytest.approx(18e-6)
        assert skin["total_force_peak_N"] == pytest.approx(5e-3)
        assert skin["total_force_mean_N"] == pytest.approx([0.0, 4e-6, 3e-3])
        assert numbers["simulated_time_s"] == pytest.approx(0.0999)
        assert (numbers["scene"], numbers["schema_version"], numbers["skin_steps"]) == ("x", 2, 1000)


def _records(known):
    return {name: known["/skin/palm"][name] for name in ("displacement", "velocity")}


def test_a_list_of_skins_with_what_others_know_of_them(result):
    found = summary(
        result, {"complete": True}, {"tip": {"solver": "reduced, 30 vectors"}}, {"pair": {"drive_level": 0.4}}
    )
    assert [skin["name"] for skin in found["skins"]] == ["palm", "tip"]
    assert [skin["vertices"] for skin in found["skins"]] == [469, 127]
    assert found["skins"][1]["solver"] == "reduced, 30 vectors" and "solver" not in found["skins"][0]
    assert found["arrays"] == [{"name": "below", "transducers": 256}, {"name": "beside", "transducers": 64}]
    assert found["stimuli"] == [
        {"name": "pulse", "focal_points": 1},
        {"name": "pair", "focal_points": 2, "drive_level": 0.4},
    ]
    assert (found["transducers"], found["drive_frames"], found["steps"]) == (320, 500, 500)
    for key in ("peak_displacement_m", "peak_pressure_Pa", "peak_arp_Pa"):
        assert found[key] == max(skin[key] for skin in found["skins"])
    assert list(found)[-1] == "complete"


def test_levels_are_rms_over_20_micropascal(static_arrays, keep, merge):
    """1 Pa rms is 94 dB SPL (IEC 61672)."""
    one = keep(static_arrays, ("palm",), (), ())
    pressure = np.zeros_like(one["/surface/palm"]["loudest_pressure"])
    quiet = {"/skin/palm": {"loudest_pressure": np.zeros_like(one["/skin/palm"]["loudest_pressure"])}}
    silent = merge(one, quiet, {"/surface/palm": {"loudest_pressure": pressure}})
    assert summary(tree(silent), {})["peak_pressure_dB_SPL"] is None
    loud = pressure.copy()
    loud[3] = np.sqrt(2.0)
    found = summary(tree(merge(silent, {"/surface/palm": {"loudest_pressure": loud}})), {})
    assert found["peak_pressure_dB_SPL"] == pytest.approx(93.98, abs=0.005)
    assert found["skins"][0]["peak_pressure_dB_SPL"] == found["peak_pressure_dB_SPL"]


def test_a_run_without_steps_leaves_motion_out(still):
    found = summary(still, {})
    assert found["skins"][0]["vertices"] == 469 and found["skin_steps"] == 0
    assert not [n for n in (*found, *found["skins"][0]) if "displacement" in n or "force" in n or "velocity" in n]


FULL = {
    "dofs": 1512,
    "solver": "wedges",
    "accuracy_wanted_relative": 0.05,
    "accuracy_reached": False,
    "mesh_error_relative": 0.01,
    "step_error_relative": 0.02,
    "reduction_error_relative": 0.0,
    "edge_error_relative": 0.1,
    "displacement_error_relative": 0.1025,
    "main_frequency_Hz": 200.0,
    "level_hasegawa_2018_dB_SL": 3.1,
    "level_hasegawa_2018_why": "applies: mean force 4 mN",
    "level_hasegawa_2018_spread_dB": 10.0,
    "level_hasegawa_2018_spread_of": "people",
    "level_bolanowski_1988_dB_SL": 9.2,
    "level_area_bolanowski_1988_dB_SL": 6.4,
    "level_area_bolanowski_1988_m2": 1.5e-4,
    "level_morioka_griffin_2006_dB_SL": 24.87,
    "level_morioka_griffin_2006_why": "applies: a handle",
    "level_morioka_griffin_2006_spread_dB": None,
    "level_morioka_griffin_2006_spread_of": "not established",
    "level_afferent_human_dB_SL": None,
    "level_afferent_human_why": "refused: its table ends at 350 Hz",
    "p0_band_low": 0.3,
    "p0_band_high": 4.2,
}
LEVELS = ["level, line at 200 Hz"] * 2 + ["with area summation"] + ["level, line at 200 Hz"] * 2
RUN = {"wall_time_s": 12.3, "peak_memory_MiB": 600.0}


def _rows(text):
    return [[cell.strip() for cell in line.strip("│|").split("│")] for line in text.splitlines() if "│" in line]


def test_the_table_tells_what_modes_state_of_the_velocity(one_skin):
    for more, words in (
        ({}, "reduction 0 %, "),
        ({"reduction_velocity_error_relative": 0.034}, "velocity: reduction 3.4 %"),
    ):
        assert words in " ".join(format_summary(summary(one_skin, RUN, {"palm": FULL | more}, {}), True).split())


def test_the_short_table_has_the_error_of_the_velocity(one_skin):
    stated = FULL | {"velocity_error_relative": 0.234}
    shown = " ".join(format_summary(summary(one_skin, RUN, {"palm": stated}, {})).split())
    assert "numerical 10 %, of the velocity 23 %" in shown


def test_the_table_of_one_skin(one_skin):
    level = {"calibrated": False, "p0_Pa_m": 1.27, "p0_low_Pa_m": 0.7, "p0_high_Pa_m": 2.6, "p0_kind": "inferred"}
    found = summary(one_skin, RUN, {"palm": FULL}, {"pulse": {"drive_level": 0.989}}, {"below": level})
    rows = [(name, text) for name, text in _rows(format_summary(found, True)) if name]
    assert [name for name, _ in rows] == [
        "peak sound pressure", "peak ARP", "total force", "drive", "p0", "skin", "peak skin displacement per ARP",
        "peak skin displacement", "rms skin displacement", "error, numerical", "accuracy", *LEVELS,
        "wall time, peak memory",
    ]  # fmt: skip
    told = dict(rows)
    assert told["drive"] == "0.989 of full"
    assert told["skin"] == "1512 unknowns, solver wedges"
    assert told["peak sound pressure"] == "1500 Pa (154 dB SPL)"
    assert told["p0"] == "uncalibrated: inferred, 1.27 Pa m (0.7 to 2.6)"
    assert "(numerical 10 %)" in told["peak skin displacement"]
    assert "for p0 x 0.3 to 4.2" in told["peak skin displacement"]
    assert told["accuracy"].startswith("NOT reached: target 5 %; the cut sides of the layer")


def test_each_observer_has_its_level_with_its_own_spread_or_why_it_is_refused(one_skin):
    """Factors of 0.3 and 4.2 are -10.5 and +12.5 dB; with a spread of 10 dB -14.5 and +16.0."""
    text = " ".join(part for _, part in _rows(format_summary(summary(one_skin, RUN, {"palm": FULL}, {}), True)))
    for told in (
        "3 dB SL (-11 to 19), observer 1 (hasegawa_2018: mean force 4 mN; p0 -10 to +12 dB, observer -10 to +10 dB; "
        "spread +-10 dB, people)",
        "9 dB SL (-1 to 22), observer 2 (bolanowski_1988: p0 -10 to +12 dB)",
        "6 dB SL (-4 to 19), observer 2, line at 200 Hz, over the 1.5 cm2 that move by half of the maximum or more",
        "25 dB SL (14 to 37), observer 3 (morioka_griffin_2006: a handle; p0 -10 to +12 dB; spread not established)",
        "refused, observer 4 (afferent_human: its table ends at 350 Hz)",
    ):
        assert told in " ".join(text.split()), (told, text)


STM = FULL | {
    "main_frequency_Hz": 70.0,
    "line_frequencies_Hz": [70.0, 140.0, 210.0],
    "level_hasegawa_2018_dB_SL": None,
    "level_hasegawa_2018_why": "refused: path is 'circle'",
    "level_bolanowski_1988_dB_SL": -12.7,
    "level_all_lines_bolanowski_1988_dB_SL": 14.4,
    "strongest_line_bolanowski_1988_Hz": 210.0,
    "level_strongest_line_bolanowski_1988_dB_SL": 12.1,
    "level_bolanowski_1988_spread_dB": 4.0,
    "level_bolanowski_1988_spread_of": "reading",
}


def test_a_level_of_several_lines_is_shown_before_that_of_one(one_skin):
    """-12.7 dB SL is the fundamental alone; it stands in no output."""
    found = summary(one_skin, RUN, {"palm": STM}, {})
    for details in (False, True):
        text = " ".join(format_summary(found, details).replace("│", " ").split())
        assert "14 dB SL (3 to 27)" in text and "all 3 lines" in text and "-13 dB" not in text
    assert "strongest 12 dB SL at 210 Hz" in text
    assert "6 dB SL (-5 to 19), observer 2, all 3 lines, over" in text


def test_the_main_table_has_14_lines_and_the_verdict_first(one_skin):
    """One band of displacement: the root sum of squares of the logarithms of its parts."""
    budget = budget_of([_part("echo", -0.19, 0.0)], [_part("p0", 0.3, 4.2), _part("material", 0.58, 1.6)])
    more = {"accuracy_reached": False, "displacement_error_relative": 0.1025, "accuracy_wanted_relative": 0.02}
    found = summary(one_skin, RUN, {"palm": STM | budget | more | {"peak_displacement_m": 1e-6}}, {})
    lines = format_summary(found).splitlines()
    assert len(lines) <= 14
    assert lines[0].startswith("target accuracy NOT reached: error 10 %, target 2 %; felt: yes, because 14 dB SL")
    rows = told(one_skin, STM | budget | {"peak_displacement_m": 1e-6}, details=False)
    assert list(rows)[-5:] == [
        "total force", "peak skin displacement", "level above threshold", "error", "wall time, peak memory",
    ]  # fmt: skip
    low, high = (np.exp(s * np.hypot(np.log(a), np.log(b))) for s, a, b in ((-1, 0.3, 0.58), (1, 4.2, 1.6)))
    assert rows["peak skin displacement"] == (
        f"1 um ({low:.2g} to {high:.2g} um for p0 x 0.3 to 4.2, material x 0.58 to 1.6)"
    )
    assert (
        "bolanowski_1988" in rows["level above threshold"]
        and "mid-air, afferents, contact" in rows["level above threshold"]
    )


@pytest.mark.parametrize(
    ("level", "spread", "felt"),
    [
        (30.0, 10.0, "yes"),
        (3.0, 10.0, "perhaps"),
        (-30.0, 10.0, "no"),
        (30.0, None, "perhaps"),
        (None, 10.0, "not known"),
    ],
)
def test_the_verdict_goes_by_the_whole_band(level, spread, felt):
    skin = {"main_frequency_Hz": 200.0, "p0_band_low": 0.3, "p0_band_high": 4.2}
    about = {"dB_SL": level, "spread_dB": spread, "why": "refused: 6 ms are too short"}
    skin |= {f"level_hasegawa_2018_{key}": value for key, value in about.items()}
    said = verdict(skin)
    assert said["felt"] == felt
    assert (
        said["because"] == "6 ms are too short" if level is None else said["because"].startswith(f"{level:.0f} dB SL")
    )


def test_the_table_has_a_block_a_skin(result):
    found = summary(result, RUN, {"palm": FULL, "tip": {"displacement_error_missing": "no room"}}, {
        "pulse": {"drive_level": 0.5}, "pair": {"drive_level": 0.25}})  # fmt: skip
    text = format_summary(found, True)
    names = [name for name, _ in _rows(text) if name]
    assert names[:3] == ["drive, pulse", "drive, pair", "SKIN"]
    assert names.count("SKIN") == 2 and names.count("peak ARP") == 2 and names[-1] == "wall time, peak memory"
    assert "none: no room" in text


def test_a_run_cut_off_early_has_a_table(still):
    assert "peak sound pressure" in format_summary(summary(still, {"complete": False}))


def test_what_no_sound_pushes_is_no_silence_while_the_array_runs(one_skin):
    found = summary(one_skin, RUN, {"palm": FULL | {"peak_pressure_Pa": 0.0, "peak_pressure_dB_SPL": None}}, {
        "pulse": {"drive_level": 0.5}})  # fmt: skip
    told = dict(_rows(format_summary(found, True)))["peak sound pressure"]
    assert "silence" not in told and "the array is on, at 0.500 of full" in told
    found["stimuli"][0]["drive_level"] = 0.0
    assert "silence: the array is off" in dict(_rows(format_summary(found, True)))["peak sound pressure"]


def _part(what, low, high):
    return {"what": what, "low": low, "high": high, "kind": "inferred", "why": ""}


def budget_of(left_out=(), inputs=()):
    """A skin's numbers with an error of 0.1 % and further bands."""
    errors = {f"{name}_error_relative": 1e-3 for name in ("mesh", "step", "reduction", "edge", "displacement")}
    budget = {
        "quantity": "",
        "estimate": "quick",
        "numerical": errors,
        "left_out": list(left_out),
        "inputs": list(inputs),
    }
    return errors | {"accuracy_wanted_relative": 0.05, "error_budget": budget}


def told(one_skin, more, details=True):
    """The table's rows of a skin of 1.23456 um for 12.3456 Pa."""
    numbers = {"peak_displacement_m": 1.23456e-6, "peak_arp_Pa": 12.3456, "displacement_per_arp_m_Pa": 1e-7 * 1.000321}
    texts: dict[str, str] = {}
    last = ""
    for name, text in _rows(format_summary(summary(one_skin, RUN, {"palm": numbers | more}, {}), details)):
        last = name or last
        texts[last] = f"{texts.get(last, '')} {text}".strip()
    return texts


@pytest.mark.parametrize(
    ("more", "moved", "pressed", "per_pascal"),
    [
        (budget_of(), "1.235 um", "12.35 Pa", "0.1 um/Pa"),
        (budget_of(inputs=[_part("material", 0.98, 1.02)]), "1.23 um", "12.35 Pa", "0.1 um/Pa"),
        (budget_of(inputs=[_part("material", 0.6, 1.6)]), "1.2 um", "12.35 Pa", "0.1 um/Pa"),
        (budget_of(left_out=[_part("echo", -0.19, 0.0)]), "1.2 um", "12 Pa", "0.1 um/Pa"),
        (budget_of(inputs=[_part("p0", 0.3, 4.2)]) | {"p0_band_low": 0.3, "p0_band_high": 4.2}, "1.2 um", "12 Pa",
         "0.1 um/Pa"),
        ({}, "1.2 um", "12 Pa", "0.1 um/Pa"),
    ],
)  # fmt: skip
def test_digits_follow_the_widest_band_that_is_known(one_skin, more, moved, pressed, per_pascal):
    rows = told(one_skin, more)
    assert rows["peak skin displacement"].startswith(moved), rows
    assert rows["peak ARP"] == pressed
    assert rows["peak skin displacement per ARP"].startswith(per_pascal)


def test_the_band_of_p0_leaves_digits_per_pascal(one_skin):
    known = {"p0_band_low": 0.3, "p0_band_high": 4.2, "displacement_per_arp_m_Pa": 1.23456e-7}
    rows = told(one_skin, budget_of(inputs=[_part("p0", 0.3, 4.2)]) | known)
    assert rows["peak skin displacement per ARP"].startswith("0.1235 um/Pa")


def test_small_numbers_are_small_and_not_0(one_skin):
    rows = told(one_skin, {"peak_displacement_m": 2.345e-11, "peak_arp_Pa": 3.12e-4, "total_force_peak_N": 4.56e-9})
    assert rows["peak skin displacement"].startswith("2.3e-05 um")
    assert rows["total force"] == "4.6e-06 mN"
    drive = format_summary(summary(one_skin, RUN, {"palm": FULL}, {"pulse": {"drive_level": 1e-4}}), True)
    assert dict(_rows(drive))["drive"] == "0.0001 of full"


def test_large_errors_have_two_digits(one_skin):
    rows = told(one_skin, budget_of() | {"displacement_error_relative": 0.8093, "mesh_error_relative": 1.234})
    assert "(numerical 81 %)" in rows["peak skin displacement per ARP"]
    assert "mesh 120 %" in rows["error, numerical"]


def test_the_largest_source_of_an_error_has_its_advice(one_skin):
    """Each of the five."""
    words = []
    for source in ("mesh", "step", "reduction", "edge", "field"):
        more = budget_of() | {
            f"{source}_error_relative": 0.2,
            "displacement_error_relative": 0.2,
            "accuracy_reached": False,
        }
        words.append(told(one_skin, more)["accuracy"])
    assert len(set(words)) == 5 and "double precision" in words[4]


def test_motion_without_sound_on_the_skin_says_that_nothing_stands_behind_it(one_skin):
    rows = told(one_skin, {"peak_arp_Pa": 0.0})
    assert "there is no error estimate" in rows["peak skin displacement"]
