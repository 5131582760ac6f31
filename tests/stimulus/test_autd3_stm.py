"""STMs of AUTD3 units as plain data: against autd3's own values, and what can't be one."""

import asyncio
import json

import numpy as np
import pytest

from palmfield.acoustics.arrays import layout
from palmfield.errors import SceneError
from palmfield.stimulus.autd3_stm import (
    FociStm,
    _check,
    autd3_command,
    control_points,
    read_foci_stm,
    stm_of_table,
    table_of_stm,
    write_foci_stm,
)
from palmfield.stimulus.focus_table_file import focus_table


def ring(foci=1, rows=20, rate_Hz=1000.0, **more):
    angle = 2 * np.pi * np.arange(rows) / rows
    places = np.stack([0.02 * np.cos(angle), 0.02 * np.sin(angle), np.full(rows, 0.2)], axis=1)
    shifted = places[:, None] + np.arange(foci)[:, None] * [0.03, 0.0, 0.001]
    loud = np.repeat(np.rint(255 * (0.2 + 0.8 * np.arange(rows) / rows))[:, None] / 255, foci, axis=1)
    keys = {"rate_Hz": rate_Hz, "quantity": "amplitude"} | more
    return focus_table(np.arange(rows) / rate_Hz, shifted, loud, **keys)


@pytest.mark.parametrize("foci", [1, 3])
def test_a_table_comes_back_from_the_file(tmp_path, foci):
    table = ring(foci)
    write_foci_stm(tmp_path / "a.json", stm_of_table(table, again=True))
    stm = read_foci_stm(tmp_path / "a.json")
    back = table_of_stm(stm)
    assert stm.loop == "infinite" and stm.divide == 40 and back.rate_Hz == 1000.0
    assert back.times.tobytes() == table.times.tobytes()
    assert np.abs(back.positions - table.positions).max() < 1e-12
    assert back.intensities == pytest.approx(table.intensities, abs=1e-15)


def test_places_are_autd3s_own():
    """autd3's ControlPoint keeps millimetres from the first transducer as float32; its unit has 249 of them there."""
    pytest.importorskip("autd3", reason="the extra [autd3] is not installed: pip install 'palmfield[autd3]'")
    from autd3 import geometry, value

    table = ring(2)
    stm = stm_of_table(table)
    unit = geometry.Geometry([geometry.Autd3()])[0]
    first = np.array(unit.positions(), dtype=float)
    ours = 1e3 * layout("autd3").positions
    assert np.abs(ours - ours[0] - (first - first[0])).max() < 1e-3
    for entry, row in zip(control_points(stm), range(len(table.times)), strict=True):
        seen = np.array([one.point for one in entry.points], dtype=float)
        assert np.abs(1e-3 * (seen + ours[0]) - table.positions[row]).max() < 1e-6
        assert entry.intensity.value == round(255 * table.intensities[row, 0])
    assert value.SamplingConfig(stm.divide).freq() == value.SamplingConfig.FREQ_4K.freq() / 4


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (ring(rate_Hz=999.0), "rate_Hz is 999; allowed: 40 kHz divided by a whole number, such as 975.61 or 1000"),
        (ring(between="linear"), "between is 'linear'"),
        (ring(frame="skin"), "frame is 'skin'"),
        (ring(9), "there are 9 foci at once; allowed: 8"),
        (
            focus_table(
                np.zeros(1), np.array([[[0.1, 0, 0.2], [0.2, 0, 0.2]]]), np.array([[1.0, 0.5]]), rate_Hz=1000.0
            ),
            "simultaneous foci differ in intensity",
        ),
    ],
)
def test_what_units_cannot_play_is_refused(table, told):
    with pytest.raises(SceneError, match=told):
        stm_of_table(table)


def broken(**changes):
    entry = {"points": [{"point": [0, 0, 150]}], "intensity": 255}
    return json.dumps({"autd3_foci_stm": 1, "divide": 40, "points": [entry, entry]} | changes)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (broken(divide=0), r"divide: Input should be greater than or equal to 1, not 0"),
        (broken(points=[{"points": [{"point": [0, float("nan"), 1]}]}]), r"points\.0\.points\.0\.point\.1: .*finite"),
        (broken(intensity=3), "intensity: Extra inputs are not permitted"),
        (broken(points=[]), "points has 0 entries; allowed: at least 2"),
        (broken(points=[{"points": [{"point": [0, 0, 150]}]}]), "points has 1 entries; allowed: at least 2"),
        (broken(points=[{"points": [{"point": [0, 0, 150]}] * 8}] * 8193), "points holds 65544 foci; allowed: 65536"),
        (
            broken(points=[{"points": [{"point": [-3105, 0, 150]}]}] * 2),
            r"focus 0: x is -3105 mm .*-3104\.075 to 3276\.775",
        ),
        ('{"autd3_foci_stm": 1,\n "divide": }', "line 2, column 12: Expecting value"),
        (broken(points=[{"points": [{"point": [0, 0, 1], "phase_offset": 256}]}]), r"phase_offset: .*255, not 256"),
    ],
)
def test_bad_files_are_told_with_their_place(tmp_path, text, told):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(SceneError, match=told):
        read_foci_stm(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("second", "told"),
    [
        (
            {"points": [{"point": [0, 0, 1]}, {"point": [9, 0, 1]}]},
            r"points\.1: 2 foci at once, but the first entry has 1",
        ),
    ],
)
def test_stms_that_are_no_table(tmp_path, second, told):
    (tmp_path / "a.json").write_text(broken(points=[{"points": [{"point": [0, 0, 150]}]}, second]))
    with pytest.raises(SceneError, match=told):
        table_of_stm(read_foci_stm(tmp_path / "a.json"))


def test_phases_of_foci_at_once_are_not_taken(tmp_path):
    entry = {"points": [{"point": [0, 0, 150]}, {"point": [20, 0, 150], "phase_offset": 128}]}
    (tmp_path / "a.json").write_text(broken(points=[entry, entry]))
    with pytest.raises(SceneError, match=r"points\.0: phase offsets 0, 128; allowed: equal ones"):
        table_of_stm(read_foci_stm(tmp_path / "a.json"))


async def _answer(command):
    import autd3
    from autd3 import geometry

    emulator = autd3.UdpEmulator(1)
    client = await autd3.Client.open(geometry.Geometry([geometry.Autd3()]), emulator.option(), autd3.ClientConfig())
    try:
        await client.send(command)
    except Exception as error:
        return str(error)
    finally:
        await client.close()
    return "taken"


def unit(points, loop="infinite"):
    """What autd3's emulated unit answers, and what we say, of an STM in millimetres from its first transducer."""
    entries = [{"points": [{"point": list(point)} for point in foci]} for foci in points]
    stm = FociStm.model_validate({"autd3_foci_stm": 1, "divide": 40, "loop": loop, "points": entries})
    try:
        _check(stm)
        ours = "taken"
    except SceneError as error:
        ours = str(error)
    return asyncio.run(_answer(autd3_command(stm, 343.0))), ours


@pytest.mark.parametrize("loop", ["once", "infinite"])
def test_an_emulated_unit_takes_what_is_exported(loop, tmp_path):
    pytest.importorskip("autd3", reason="the extra [autd3] is not installed: pip install 'palmfield[autd3]'")
    write_foci_stm(tmp_path / "a.json", stm_of_table(ring(3), again=loop == "infinite"))
    stm = read_foci_stm(tmp_path / "a.json")
    assert stm.loop == loop and asyncio.run(_answer(autd3_command(stm, 343.0))) == "taken"


@pytest.mark.parametrize(
    "points",
    [
        [[(0, 0, 100)]],
        [[(0, 0, 100)]] * 2,
        [[(0, 0, 100)] * 8] * 8192,
        [[(0, 0, 100)] * 8] * 8193,
        *([[point]] * 2 for point in [(3276.78, 0, 9), (3276.79, 0, 9), (-3104.075, 0, 9), (-3104.1, 0, 9)]),
        *([[point]] * 2 for point in [(0, -3144.72, 9), (0, -3144.75, 9), (0, 0, -3276.8), (0, 0, -3276.82)]),
    ],
    ids=lambda points: f"{len(points)} of {points[0][0]}",
)
def test_we_refuse_what_an_emulated_unit_refuses(points):
    pytest.importorskip("autd3", reason="the extra [autd3] is not installed: pip install 'palmfield[autd3]'")
    theirs, ours = unit(points)
    assert (theirs == "taken") == (ours == "taken"), (theirs, ours)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (ring(rows=1), "points has 1 entries; allowed: at least 2"),
        (ring(foci=2, rows=32769), "it has 32769 samples of 2 foci; allowed: 32768 samples"),
    ],
)
def test_tables_that_units_cannot_hold_are_refused_in_a_line(table, told):
    with pytest.raises(SceneError, match=f"no STM of AUTD3 units can be made of the table: {told}"):
        stm_of_table(table)
