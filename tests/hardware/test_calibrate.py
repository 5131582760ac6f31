"""`palmfield calibrate`: a rehearsal's readings become a calibration that a scene takes."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from palmfield.acoustics.calibration_file import read_calibration
from palmfield.cli.app import app
from palmfield.drive.calibration.readings import MEASUREMENTS
from palmfield.errors import SceneError

pytestmark = pytest.mark.usefixtures("kept_operators")

RUN = CliRunner()


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a rehearsal's readings and the calibration that the printed commands make of them."""
    folder = tmp_path_factory.mktemp("calibration") / "trial"
    said = RUN.invoke(app, ["calibrate", "rehearse", str(folder), "--seed", "3"], catch_exceptions=False).output
    commands = [line for line in said.splitlines() if line.startswith("palmfield calibrate add")]
    assert len(commands) == len(MEASUREMENTS)
    for command in commands:
        result = RUN.invoke(app, shlex.split(command)[1:], catch_exceptions=False)
        assert result.exit_code == 0, result.output
    return folder


def test_the_rehearsals_commands_find_its_truth(trial: Path) -> None:
    truth, found = read_calibration(trial / "truth.json"), read_calibration(trial / "board.json")
    assert found.elements is not None and truth.elements is not None and found.p0 is not None and truth.p0 is not None
    assert found.elements.enabled == truth.elements.enabled
    live = np.array(truth.elements.enabled)
    product = np.array(found.elements.polarity)[live] * np.array(truth.elements.polarity)[live]
    assert abs(product.sum()) == live.sum(), "all polarities, up to one for all"
    gap = np.array(found.elements.phase_rad)[live] - np.array(truth.elements.phase_rad)[live]
    assert np.degrees(gap.std()) < 5.0
    assert found.p0.low < truth.p0.value < found.p0.high
    assert found.pose.offset_m == pytest.approx(truth.pose.offset_m, abs=1e-3)
    assert found.quality is not None and found.quality.value == pytest.approx(22.0, rel=0.1)
    assert found.warm_up is not None and found.level is not None


def test_it_is_shown_and_drawn(trial: Path) -> None:
    result = RUN.invoke(app, ["calibrate", "show", str(trial / "board.json"), "--png", str(trial / "board.png")])
    assert "5 silent" in result.output and "p0: " in result.output and (trial / "board.png").stat().st_size > 10_000


def test_kinds_are_listed_with_their_columns() -> None:
    said = RUN.invoke(app, ["calibrate", "kinds"]).output
    assert all(
        name in said and all(column in said for column in kind.all_columns) for name, kind in MEASUREMENTS.items()
    )


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["elemnts", "{}/elements.csv", "{}/b.json", "--source", "us"], "did you mean 'elements'"),
        (["elements", "{}/elements.csv", "{}/b.json", "--layout", "sonicsurface"], "source is missing"),
        (["elements", "{}/elements.csv", "{}/b.json", "--source", "us"], "give the array layout"),
        (["elements", "{}/elements.csv", "{}/b.json", "--source", "us", "--layout", "autd3"], "give 0 to 248"),
        (
            ["elements", "{}/level.csv", "{}/b.json", "--source", "us", "--layout", "uhev1"],
            "column 'element' is missing",
        ),
        (["plate", "{}/plate.csv", "{}/board.json", "--source", "us"], "plate are missing"),
        (["sweep", "{}/sweep.csv", "{}/board.json", "--source", "us"], "the commanded focus is missing"),
        (["focus", "{}/focus.csv", "{}/board.json", "--source", "us"], "the focus is missing"),
        (
            ["level", "{}/level.csv", "{}/board.json", "--source", "us", "--layout", "uhev1"],
            "is for layout 'sonicsurface'",
        ),
        (["level", "{}/sweep.csv", "{}/board.json", "--source", "us"], "column 'level' is missing"),
    ],
)
def test_what_is_missing_is_told_and_the_file_stays(trial: Path, arguments: list[str], told: str) -> None:
    before = json.loads((trial / "board.json").read_text())
    result = RUN.invoke(app, ["calibrate", "add", *(part.format(trial) for part in arguments)])
    assert isinstance(result.exception, Exception) and told in str(result.exception)
    assert json.loads((trial / "board.json").read_text()) == before and not (trial / "b.json").exists()


def test_a_rehearsal_does_not_write_over_other_files(trial: Path) -> None:
    result = RUN.invoke(app, ["calibrate", "rehearse", str(trial)])
    assert result.exception is not None and "not empty" in str(result.exception)


def test_a_scene_takes_the_calibration(trial: Path) -> None:
    """p0 becomes measured, the bytes make up for polarity and phase, and a second p0 by key is refused."""
    import palmfield
    from palmfield.estimate.summary import array_numbers
    from palmfield.simulation.emission import array_drives

    scene = Path(palmfield.__file__).parents[1] / "mjcf" / "scenes" / "palm_circle_sonicsurface.xml"
    keys = {"array.calibration": str(trial / "board.json")}
    simulation = palmfield.Simulation(scene, keys=keys)
    told = next(iter(array_numbers(simulation.runtime.model).values()))
    assert told["calibrated"] and told["p0_kind"] == "measured"
    model = simulation.runtime.model
    gain = model.arrays.array.gain
    assert gain is not None and np.sum(gain == 0.0) == 5 and np.sum(gain.real < 0.0) > 50
    focus = np.atleast_2d(model.stimuli[0].first_focus)[:1]
    for switch, low, high in (("on", 0.98, 1.0), ("off", 0.0, 0.4)):
        model = palmfield.Simulation(scene, keys={**keys, "driver.compensate": switch}).runtime.model
        drive = array_drives(model, model.arrays)[0].unit_drive(focus[0]).amplitudes
        alone = [abs(model.arrays.pressure64(focus, np.where(np.arange(256) == n, drive, 0))[0]) for n in range(256)]
        together = abs(model.arrays.pressure64(focus, drive)[0])
        assert low < together / sum(alone) < high, "all in phase but for the rounding of 32 phases, or not at all"
    with pytest.raises(SceneError, match="remove one of them"):
        palmfield.Simulation(scene, keys={**keys, "array.p0_Pa_m": "2"})
