"""Stimuli into scenes and out of them: what is imported is simulated, driven and decoded, and comes back."""

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

import palmfield
from palmfield.cli.app import app
from palmfield.errors import OutputError, SceneError
from palmfield.hardware.decode import decode
from palmfield.hardware.play import Target, play_scene
from palmfield.planning.scene_plan import plan
from palmfield.session.stimulus_export import export_stimulus, exported
from palmfield.session.stimulus_import import import_stimulus
from palmfield.stimulus.autd3_stm import stm_of_table, write_foci_stm
from palmfield.stimulus.focus_table_file import focus_table, read_focus_table, write_focus_table

pytestmark = pytest.mark.usefixtures("kept_operators")

NO_AM = dict.fromkeys(("modulation", "am_quantity", "am_frequency_Hz", "am_depth"))


def table_of(foci=1, rate_Hz=1000.0, rows=12, **more):
    rng = np.random.default_rng(foci)
    places = rng.uniform(-0.006, 0.006, (rows, foci, 3)) * [1, 1, 0] + [0.0, 0.0, 0.12]
    places += 0.02 * np.arange(foci)[:, None] * [1.0, 0.0, 0.0]
    times = np.arange(rows) / rate_Hz
    return focus_table(times, places, rng.uniform(0.2, 1.0, (rows, foci)), rate_Hz=rate_Hz, **more)


def written(path, table):
    write_focus_table(path, table)
    return path


@pytest.mark.parametrize("between", ["held", "linear"])
@pytest.mark.parametrize("foci", [1, 2])
def test_a_table_comes_back_through_a_scene(small_scene, tmp_path, between, foci):
    table = table_of(foci, between=between, quantity="amplitude")
    done = import_stimulus(written(tmp_path / "in.csv", table), small_scene())
    assert done.dropped == ("focus_m", "modulation", "am_quantity", "am_frequency_Hz", "am_depth")
    export_stimulus(exported(done.scene), tmp_path / "out.csv")
    back = read_focus_table(tmp_path / "out.csv")
    assert back == table
    # As samples of what the scene does, too
    sampled = exported(done.scene, rate_Hz=4000.0, duration_s=0.011).table
    assert np.abs(sampled.positions - table.positions_at(sampled.times)).max() < 1e-6
    assert np.abs(sampled.intensities - table.intensities_at(sampled.times)).max() < 1e-9


def test_what_is_imported_is_simulated(small_scene, tmp_path):
    """|p|^2 at a single focus goes with the intensities, where the table says and when, in float64 by the field."""
    table = table_of(quantity="arp")
    done = import_stimulus(written(tmp_path / "in.csv", table), small_scene(array={"response": "off"}))
    sim = palmfield.Simulation(done.scene)
    arrays = sim.runtime.model.arrays
    full = []
    for row in range(len(table.times)):
        drive = sim.drive
        at_focus = abs(arrays.pressure64(table.positions[row], drive)[0]) ** 2
        spot = table.positions[row] + 0.004 * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
        assert (np.abs(arrays.pressure64(spot, drive)) ** 2).max() < 0.8 * at_focus
        full.append(at_focus / table.intensities[row, 0])
        sim.step()
    assert np.ptp(full) < 0.1 * np.mean(full)
    assert not sim.drive.any() and sim.time == pytest.approx(0.012)


def test_foci_at_once_have_the_loudness_that_the_table_asks_for(small_scene, tmp_path):
    """Two foci that cross in loudness, one of them silent at first and the other at last."""
    rows, loud = 11, np.linspace(0.0, 1.0, 11)
    places = np.array([[-0.015, 0.0, 0.12], [0.015, 0.0, 0.12]])
    intensities = np.stack([loud, 1.0 - loud], axis=1)
    table = focus_table(np.arange(rows) / 1e3, np.tile(places, (rows, 1, 1)), intensities, rate_Hz=1e3)
    done = import_stimulus(written(tmp_path / "in.csv", table), small_scene(array={"response": "off"}))
    sim = palmfield.Simulation(done.scene)
    for row in range(rows):
        square = np.abs(sim.runtime.model.arrays.pressure64(places, sim.drive)) ** 2
        quiet, loudest = sorted(intensities[row])
        assert square.min() / square.max() == pytest.approx(quiet / loudest, abs=0.02)
        assert (square[0] > square[1]) == (row > 5) or row == 5
        sim.step()


def test_what_is_imported_is_driven_and_decoded(small_scene, tmp_path):
    """Bytes of AUTD3 units through the virtual board: the table's places at its times, a frame's time later."""
    angle = np.arange(6.0)
    places = np.stack([0.002 * np.cos(angle), 0.002 * np.sin(angle), np.full(6, 0.12)], axis=1)[:, None]
    table = focus_table(angle / 500.0, places, np.linspace(0.2, 1.0, 6)[:, None], rate_Hz=500.0)
    done = import_stimulus(written(tmp_path / "in.csv", table), small_scene(array={"layout": "autd3"}))
    log = tmp_path / "sent.jsonl"
    play_scene(done.scene, "autd3", Target(record=tmp_path / "sent.bin", log=log), 0.014)
    result = decode(log)
    seen = [focus for focus in result.foci if focus.sounding]
    begin = seen[0].time_s
    for focus in seen:
        row = int((focus.time_s - begin + 1e-6) * 500.0)
        assert np.abs(np.array(focus.focus) - table.positions[row, 0]).max() < 1e-3
        assert focus.level == pytest.approx(np.sqrt(table.intensities[row, 0]), abs=0.005)
    assert {int((focus.time_s - begin + 1e-6) * 500.0) for focus in seen} == set(range(6))
    assert any("frames/s due" in row.size for row in plan(done.scene, board="autd3").modelled)


def test_boards_refuse_what_they_cannot_play(small_scene, tmp_path):
    for table, told in (
        (table_of(2), "key 'path_file' has 2 foci at once, but board 'autd2018' plays one"),
        (table_of(rate_Hz=4000.0), "needs 4000 frames/s; autd2018 gives any amplitude at 2000 frames/s"),
    ):
        done = import_stimulus(written(tmp_path / "in.csv", table), small_scene(), overwrite=True)
        with pytest.raises(palmfield.DeviceError, match=told):
            play_scene(done.scene, "autd2018", Target(record=tmp_path / "x.bin"))


def test_an_stm_is_imported_and_comes_back(small_scene, tmp_path):
    table = table_of(quantity="amplitude")
    write_foci_stm(tmp_path / "in.json", stm_of_table(table, again=True))
    done = import_stimulus(tmp_path / "in.json", small_scene(duration_s=0.03))
    assert done.keys["path_end"] == "jump"
    twice = exported(done.scene, rate_Hz=1000.0, duration_s=0.024).table
    assert np.abs(twice.positions[:12] - table.positions).max() < 1e-6
    assert np.array_equal(twice.positions[:12], twice.positions[12:])
    export_stimulus(exported(done.scene), tmp_path / "out.json", again=True)
    assert (tmp_path / "out.json").read_text() == (tmp_path / "in.json").read_text()


def test_a_table_in_the_frame_of_the_skin_goes_with_a_site(small_scene, tmp_path):
    table = focus_table(np.arange(3) / 1e3, np.tile(np.array([0.001, 0.002, 0.0]), (3, 1, 1)), np.ones((3, 1)),
                        rate_Hz=1e3, frame="skin")  # fmt: skip
    done = import_stimulus(written(tmp_path / "in.csv", table), small_scene())
    assert done.keys["frame"] == "centre"
    assert exported(done.scene).table.positions[0, 0] == pytest.approx([0.001, -0.002, 0.12], abs=1e-6)
    assert exported(done.scene, frame="skin").table == table
    with pytest.raises(SceneError, match=r"--site has value 'center' .did you mean 'centre'"):
        import_stimulus(tmp_path / "in.csv", small_scene(), site="center", overwrite=True)


def test_a_table_in_the_world_is_turned_into_the_arrays_frame(small_scene, tmp_path):
    scene = small_scene()
    plain = scene.with_name("plain.xml")
    text = plain.read_text().replace('pos="0 0 0.12" quat="0 1 0 0"', 'pos="0.3 0 0.12" quat="0 1 0 0"')
    plain.write_text(text.replace("<worldbody>", '<worldbody><site name="turned" pos="0.3 0 0" zaxis="0 0 1"/>'))
    scene.write_text(
        scene.read_text().replace(
            '<instance name="array">', '<instance name="array"><config key="site" value="turned"/>'
        )
    )
    world = focus_table(np.zeros(1), np.array([[[0.301, 0.002, 0.12]]]), np.ones((1, 1)), rate_Hz=1e3, frame="world")
    done = import_stimulus(written(tmp_path / "in.csv", world), scene)
    kept = read_focus_table(done.table)
    assert kept.frame == "array" and kept.positions[0, 0] == pytest.approx([0.001, 0.002, 0.12], abs=1e-12)
    moving = plain.read_text().replace(
        "<worldbody>", '<worldbody><body><joint/><geom size="0.01" mass="1" pos="1 1 0"/>'
    )
    plain.write_text(moving.replace('zaxis="0 0 1"/>', 'zaxis="0 0 1"/></body>'))
    with pytest.raises(SceneError, match=r"array 'array' of .* can move"):
        import_stimulus(tmp_path / "in.csv", scene, overwrite=True)


def test_a_path_of_a_scene_becomes_a_table(small_scene):
    """A circle with AM, sampled: places and levels by their own formulas."""
    keys = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 50, "am_quantity": "arp"}
    result = exported(small_scene(stimulus=keys), rate_Hz=2000.0)
    t = np.arange(30) / 2000.0
    assert result.table.times == pytest.approx(t, abs=1e-15)
    angle = 2 * np.pi * 50 * t
    wanted = np.stack([0.005 * np.cos(angle), 0.005 * np.sin(angle), np.full(30, 0.12)], axis=1)
    assert np.abs(result.table.positions[:, 0] - wanted).max() < 1e-6
    assert np.abs(result.table.intensities[:, 0] - 0.5 - 0.5 * np.sin(2 * np.pi * 200 * t)).max() < 1e-9
    (note,) = exported(small_scene(stimulus=keys | {"path_rate_Hz": 5}), rate_Hz=300.0).warnings
    assert "changes at up to 200 Hz, which 300 samples per second do not resolve" in note


def test_a_sampled_circle_moves_the_skin_as_the_circle_does(small_scene, tmp_path):
    """Displacements under a circle with AM against those under its samples: held ones err by the first power of their
    spacing, those joined by straight lines by the second."""
    keys = {"path": "circle", "path_diameter_m": 0.006, "path_rate_Hz": 50, "am_quantity": "arp"}
    skin = {"solver": "wedges", "max_frequency_Hz": 600, "step_s": 0.00005}
    scene = small_scene(stimulus=keys, skin=skin, array={"response": "off"})

    def course(path):
        sim, seen = palmfield.Simulation(path), []
        for _ in range(15):
            sim.step()
            seen.append(np.array(sim.skin().displacement))
        return np.array(seen)

    wanted, errors = course(scene), {}
    for rate_Hz in (1000.0, 4000.0):
        held = exported(scene, rate_Hz=rate_Hz, duration_s=0.016).table
        for between in ("held", "linear"):
            table = focus_table(held.times, held.positions, held.intensities, rate_Hz=rate_Hz, between=between)
            done = import_stimulus(written(tmp_path / "in.csv", table), scene, overwrite=True)
            errors[between, rate_Hz] = np.linalg.norm(course(done.scene) - wanted) / np.linalg.norm(wanted)
    assert errors["held", 1000.0] / errors["held", 4000.0] == pytest.approx(4.0, rel=0.2)
    assert errors["linear", 1000.0] / errors["linear", 4000.0] == pytest.approx(16.0, rel=0.2)
    assert errors["linear", 4000.0] < 0.01


def test_places_follow_what_moves(small_scene):
    """The disc swings on its slide; the focus, carried by its site, is exported where the array sees it."""
    scene = small_scene(stimulus=NO_AM | {"frame": "centre", "focus_m": "0 0 0"}, duration_s=0.05)
    plain = scene.with_name("plain.xml")
    plain.write_text(plain.read_text().replace('stiffness="400"', 'stiffness="400" springref="0.01"'))
    table = exported(scene, rate_Hz=1000.0).table
    sim, seen = palmfield.Simulation(scene), []
    for _ in range(50):
        mujoco.mj_kinematics(sim.model, sim.data)
        seen.append(sim.data.site("centre").xpos[0])
        sim.step()
    assert np.abs(table.positions_at(np.arange(50) / 1e3)[:, 0, 0] - seen).max() < 1e-6 < np.ptp(seen)


def test_nothing_is_replaced_or_written_by_mistake(small_scene, tmp_path):
    file, scene = written(tmp_path / "in.csv", table_of()), small_scene()
    import_stimulus(file, scene)
    with pytest.raises(OutputError, match=r"small_in.xml exists and would be replaced"):
        import_stimulus(file, scene)
    with pytest.raises(OutputError, match=r"--out has value .*; allowed: a file in"):
        import_stimulus(file, scene, tmp_path.parent / "other.xml")
    before = sorted(tmp_path.iterdir())
    far = focus_table(np.zeros(1), np.array([[[0.0, 0.0, -0.1]]]), np.ones((1, 1)), rate_Hz=1e3)
    with pytest.raises(SceneError):
        import_stimulus(written(tmp_path / "in.csv", far), scene, tmp_path / "new.xml")
    assert sorted(tmp_path.iterdir()) == before
    with pytest.raises(SceneError, match=r"the kind of the file is '.txt'; allowed: .csv .a table., .json"):
        import_stimulus(tmp_path / "in.txt", scene)
    with pytest.raises(OutputError, match=r"the kind of the file is '.txt'"):
        export_stimulus(exported(scene), tmp_path / "out.txt")


def test_the_commands_take_a_stimulus_in_and_out(small_scene, tmp_path):
    file, scene = written(tmp_path / "in.csv", table_of()), small_scene()
    done = CliRunner().invoke(app, ["stimulus", "import", str(file), "--scene", str(scene)])
    assert done.exit_code == 0 and "plays small_in_foci.csv: one focus, 12 rows, 0.012 s" in done.stdout
    out = tmp_path / "out.csv"
    done = CliRunner().invoke(app, ["stimulus", "export", str(tmp_path / "small_in.xml"), str(out)])
    assert done.exit_code == 0 and "1 x 12 rows at 1000 Hz, 0.012 s, intensities of arp" in done.stdout
    assert read_focus_table(out) == table_of()
    refused = CliRunner().invoke(app, ["stimulus", "export", str(scene), str(out), "--quantity", "force"])
    assert "--quantity has value 'force'; allowed: duty, amplitude, arp" in str(refused.exception)


def test_worlds_have_tables_of_their_own(small_scene, tmp_path):
    scene = import_stimulus(
        written(tmp_path / "in.csv", table_of()), small_scene(array={"response": "off"}, skin={"solver": "wedges"})
    ).scene
    other = written(tmp_path / "other.csv", table_of(foci=2))
    names = [str(tmp_path / "small_in_foci.csv"), str(other)]
    together = palmfield.Simulation(scene, worlds=2, keys={"stimulus.path_file": names})
    singles = [palmfield.Simulation(scene, keys={"stimulus.path_file": name}) for name in names]
    for _ in range(6):
        together.step()
        for single in singles:
            single.step()
        drives = np.array([single.drive for single in singles])
        assert together.drive == pytest.approx(drives, abs=1e-12)
    assert np.abs(drives[0] - drives[1]).max() > 0.1
