"""Experiments from their file to the log: the same trials however often they are cut, times at which boards sound."""

import io
import json
import os
import pty
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import palmfield
from palmfield.drive.frame_log import read_log
from palmfield.drive.virtual import VirtualBoard
from palmfield.errors import DeviceError, OutputError, SceneError
from palmfield.session.preview import preview
from palmfield.studies.experiment.design import read_design
from palmfield.studies.experiment.log import LogWriter, read_experiment_log
from palmfield.studies.experiment.observers import FeelingObserver, Keyboard, Shown, SimulatedObserver
from palmfield.studies.experiment.report import report_of
from palmfield.studies.experiment.run import run_experiment

CONSTANT = """[procedure]
kind = "constant"
levels = [0.02, 0.035, 0.06, 0.1, 0.2, 0.4]
repeats = 30
"""


def run(path, log="log.jsonl", **more):
    keys = {"participant": "p1", "observer": "simulated"} | more
    return run_experiment(path, path.with_name(log), **keys)


def told(path, log="log.jsonl"):
    """What trials say, without what the clock says."""
    trials = read_experiment_log(path.with_name(log)).trials
    return [
        (t.number, t.block, t.condition, t.answered, t.content["target"], t.content["response_time_s"]) for t in trials
    ]


class CutOff(SimulatedObserver):
    """Interrupts the experiment before it answers some trials, each time once."""

    def __init__(self, design, at):
        super().__init__(design)
        self.at = set(at)

    def answer(self, shown):
        if shown.number in self.at:
            self.at.discard(shown.number)
            raise KeyboardInterrupt
        return super().answer(shown)


# -- the log -------------------------------------------------------------------------------------------------------


def test_an_experiment_that_is_cut_off_has_the_trials_of_one_that_is_not(experiment):
    """Ctrl-C before two answers, and a last line of which the disk kept a part."""
    path = experiment()
    whole = run(path)
    assert whole.finished and whole.trials == whole.new > 20
    log, observer = path.with_name("cut.jsonl"), CutOff(read_design(path), [3, 11])
    for cut, number in ((True, 3), (False, 11)):
        with pytest.raises(KeyboardInterrupt):
            run(path, "cut.jsonl", answers=observer)
        assert len(read_experiment_log(log).trials) == number
        if cut:
            last = log.read_bytes()
            log.write_bytes(last + b'{"trial": 3, "block": 0, "cond')
    done = run(path, "cut.jsonl", answers=observer)
    assert done.finished and done.new == whole.trials - 11
    assert told(path, "cut.jsonl") == told(path)
    assert read_experiment_log(log).sessions == 3
    assert run(path, "cut.jsonl").new == 0


@pytest.mark.wall_clock
def test_a_killed_experiment_goes_on_with_all_its_trials(experiment, tmp_path):
    """The command is killed while a virtual board plays; what it had logged is there, the rest is as it would be."""
    path, log = experiment(reversals="3"), tmp_path / "killed.jsonl"
    words = ["experiment", "run", str(path), "--log", str(log), "--participant", "p1", "--observer", "simulated"]
    words = [sys.executable, "-m", "palmfield", *words, "--virtual"]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        ends = time.monotonic() + 60.0
        while time.monotonic() < ends and (not log.exists() or log.read_bytes().count(b'"trial"') < 4):
            time.sleep(0.01)
        process.kill()
    before = len(read_experiment_log(log).trials)
    assert before >= 4
    done = run(path, "killed.jsonl")
    assert done.finished and done.trials - done.new == before
    run(path)
    assert told(path, "killed.jsonl") == told(path)


def test_another_design_scene_participant_or_observer_is_not_mixed_in(experiment):
    path = experiment(reversals="3")
    run(path)
    before = path.with_name("log.jsonl").read_bytes()
    for changes, words, what in (
        ({"participant": "p2"}, {}, r"another participant .'p1', not 'p2'"),
        ({"observer": "skin"}, {}, r"another design"),
        ({"board": "ideal"}, {}, r"another board .'autd3', not 'ideal'"),
        ({}, {"reversals": "4"}, r"another design .procedure.reversals: 3, not 4"),
        ({}, {"seed": "8"}, r"another design .seed: 7, not 8"),
        ({}, {"spread": "2.0"}, r"another design .simulated.spread: 3.0, not 2.0"),
    ):
        changed = experiment(**({"reversals": "3"} | words))
        with pytest.raises(OutputError, match=what):
            run(changed, **changes)
    experiment(reversals="3")
    scene = path.with_name("small.xml")
    scene.write_text(scene.read_text().replace('timestep="0.001"', 'timestep="0.0005"'))
    with pytest.raises(OutputError, match="another scene"):
        run(path)
    assert path.with_name("log.jsonl").read_bytes() == before


def test_markers_and_ports_may_change_within_a_log(experiment):
    path = experiment(reversals="3")
    run(path)
    path.write_text("lsl = false\n" + path.read_text())
    assert run(path).new == 0


def test_two_runs_do_not_write_one_log(experiment, tmp_path):
    path = experiment()
    design, scene = read_design(path), tmp_path / "small.xml"
    writer = LogWriter(tmp_path / "log.jsonl", design, scene, "p1", "simulated", "none")
    with writer, pytest.raises(OutputError, match="is being written by another run"):
        run(path)
    assert not (tmp_path / "log.jsonl.lock").exists()


def test_a_file_that_is_no_log_is_left_alone(experiment, tmp_path):
    path = experiment()
    (tmp_path / "log.jsonl").write_text('{"my": "data"}\n')
    with pytest.raises(OutputError, match="is not an experiment log"):
        run(path)
    (tmp_path / "log.jsonl").write_text("my notes\n")
    with pytest.raises(OutputError, match="line 1 is not JSON"):
        run(path)
    assert (tmp_path / "log.jsonl").read_text() == "my notes\n"


# -- order and answers ---------------------------------------------------------------------------------------------


def test_conditions_are_interleaved_or_in_blocks_by_the_seed(experiment):
    orders = []
    for name, words in (("a", {}), ("b", {}), ("c", {"seed": "8"})):
        path = experiment(**words)
        run(path, f"{name}.jsonl")
        orders.append([trial.condition for trial in read_experiment_log(path.with_name(f"{name}.jsonl")).trials])
    assert orders[0] == orders[1] != orders[2]
    changes = np.count_nonzero(np.diff(orders[0]))
    assert changes > 5
    path = experiment(seed='7\norder = "blocked"\nblocks = 2', reversals="3")
    run(path, "d.jsonl")
    trials = read_experiment_log(path.with_name("d.jsonl")).trials
    assert [trial.block for trial in trials] == sorted(trial.block for trial in trials)
    for block in (0, 1):
        assert np.count_nonzero(np.diff([trial.condition for trial in trials if trial.block == block])) == 1
    targets = [trial.content["target"] for trial in read_experiment_log(path.with_name("a.jsonl")).trials]
    assert {1, 2} == set(targets) and 0.2 < np.mean(np.array(targets) == 1) < 0.8


@pytest.mark.nightly
def test_thresholds_of_known_observers_are_found(experiment):
    """30 observers: medians of both conditions at the truth, and 95 % intervals of constant stimuli that hold it."""
    found, inside = [], 0
    for seed in range(30):
        path = experiment(procedure=CONSTANT, seed=str(seed))
        run(path, f"{seed}.jsonl")
        report = report_of(path.with_name(f"{seed}.jsonl"))
        fits = [one.fit for one in report.conditions]
        assert all(fit is not None for fit in fits)
        found.append([fit.threshold for fit in fits])
        inside += sum(
            fit.threshold_interval[0] <= truth <= fit.threshold_interval[1]
            for fit, truth in zip(fits, (-20.0, -26.0), strict=True)
        )
    found = np.array(found)
    assert np.median(found, axis=0) == pytest.approx([-20.0, -26.0], abs=0.5)
    assert inside >= 52  # of 60; 95 % of them are 57, below 52 comes by chance once in 100


def test_yes_no_and_adjustment_end_at_the_threshold(experiment):
    """An observer with a spread of 0.2 dB: settings and yes-no answers lie within a step and a half of -20 dB."""
    adjusted = '[procedure]\nkind = "adjustment"\nlow = 0.01\nhigh = 1.0\nstep = 0.5\nsettings = 3\n'
    path = experiment(procedure=adjusted, kind='"yes_no"', spread="0.5")
    text = path.read_text().replace('kind = "yes_no"\nlow', 'kind = "adjustment"\nlow')
    path.write_text(text)
    run(path, "adjusted.jsonl")
    report = report_of(path.with_name("adjusted.jsonl"))
    assert [20 * np.log10(one.estimates[0]) for one in report.conditions] == pytest.approx([-20.0, -26.0], abs=0.75)
    assert report.conditions[0].fit is None and "settings are not answers" in report.conditions[0].why


def test_limits_of_an_experiment_end_at_the_threshold(experiment):
    """As Hasegawa & Shinoda asked: six series, here of 1 dB, an observer with a spread of 0.2 dB."""
    levels = [round(float(10 ** (dB / 20)), 6) for dB in range(-40, 1)]
    limits = f'[procedure]\nkind = "limits"\nlevels = {levels}\nseries = 6\n'
    # No lapses: one "no" far above the threshold ends a falling series there
    path = experiment(procedure=limits, kind='"yes_no"', spread="0.2\nlapse = 0.0")
    path.write_text(path.read_text().replace('kind = "yes_no"\nlevels', 'kind = "limits"\nlevels'))
    run(path, "limits.jsonl")
    report = report_of(path.with_name("limits.jsonl"))
    assert [20 * np.log10(one.estimates[0]) for one in report.conditions] == pytest.approx([-20.0, -26.0], abs=0.75)
    assert report.convergence is None and all(one.fit is not None for one in report.conditions)


def test_limits_need_one_interval(experiment):
    path = experiment(procedure='[procedure]\nkind = "limits"\nlevels = [0.1, 0.2]\n')
    path.write_text(path.read_text().replace('kind = "nafc"\nlevels', 'kind = "limits"\nlevels'))
    with pytest.raises(OutputError, match="allowed with procedure 'limits': yes_no"):
        read_design(path)


def test_answers_of_a_known_observer_have_its_rates(experiment):
    """2AFC: right in 1/2 + (1/2 - lapse) F of 4000 trials at the threshold and far above it, by chance in silence."""
    design = read_design(experiment())
    observer = SimulatedObserver(design)
    level = 10 ** (-20.0 / 20)
    keys = ({}, {})
    for own, wanted in ((level, 0.5 + 0.48 * 0.5), (1.0, 0.98), (0.0, 0.5)):
        right = [observer.answer(Shown(n, "100 Hz", (0.0, own), keys, 2, False))[0] == "2" for n in range(4000)]
        assert np.mean(right) == pytest.approx(wanted, abs=3.0 * np.sqrt(wanted * (1 - wanted) / 4000))


def test_an_observer_feels_the_skin(experiment):
    """Its level goes with 20 lg of the ARP, the square of the drive; at 0 dB it feels half of all, silence never."""
    path = experiment(duration_s="0.025")
    design = read_design(path)
    observer = FeelingObserver(design, path.with_name("small.xml"), None)
    loud, soft = (observer.level_dB({"skin.accuracy": 0.5, "stimulus.drive_amplitude": a}) for a in (0.5, 0.25))
    assert loud - soft == pytest.approx(40 * np.log10(2.0), abs=0.05)
    assert observer.level_dB({"skin.accuracy": 0.5, "stimulus.drive_amplitude": 0.0}) == -np.inf
    observer.levels = {repr([("a", 1)]): 0.0, repr([("a", 2)]): -np.inf}
    shown = Shown(0, "100 Hz", (0.1, 0.0), ({"a": 1}, {"a": 2}), 1, False)
    assert observer.detected(shown, 0) == pytest.approx(0.5) and observer.detected(shown, 1) == 0.0
    short = FeelingObserver(read_design(experiment(duration_s="0.004")), path.with_name("small.xml"), None)
    with pytest.raises(OutputError, match=r"observer 'bolanowski_1988' has no threshold .*: .*two periods"):
        short.level_dB({"skin.accuracy": 0.5})


# -- boards --------------------------------------------------------------------------------------------------------


def test_logged_times_are_those_at_which_the_board_sounds(experiment):
    """A virtual board's own record: its first sound of each trial's target lies at the time that the log has, within
    what a pseudo-terminal takes, and all frames went out."""
    path = experiment(reversals="2", skipped="0")
    board = preview(path.with_name("small.xml"), board="autd3").runtime.model.board
    with VirtualBoard(board) as virtual:
        done = run(path, port=virtual.port)
        began = time.monotonic() - virtual.clock
        heard = [began + one.time_s for one in virtual.emitted if np.abs(one.amplitudes).max() > 1e-3]
        flags = list(virtual.flags)
    assert done.finished and not flags
    for trial in read_experiment_log(path.with_name("log.jsonl")).trials:
        shown = trial.content["presentations"]
        assert [one["frames"] + one["skipped"] for one in shown] == [30, 30]
        target = shown[trial.content["target"] - 1]
        first = min(heard, key=lambda when: abs(when - target["first_s"]))
        # AM begins at half of the peak's ARP, so that the first frame sounds
        assert abs(first - target["first_s"]) < 0.03
        assert shown[1]["first_s"] - shown[0]["last_s"] > 0.02
        other = shown[2 - trial.content["target"]]
        assert not any(other["first_s"] + 0.01 < when < other["last_s"] - 0.002 for when in heard)
        _, pieces = read_log(path.parent / target["log"])
        begun = [piece.time_s + board.frame_time_s - target["log_s"] for piece in pieces]
        assert min(map(abs, begun)) < 2e-3


def test_a_person_at_the_keyboard_answers_on_a_virtual_board(experiment):
    path = experiment(reversals="2", skipped="0")
    design = read_design(path)
    pressed = io.StringIO("x\n" + "".join(f"{design.target(n)}\n" for n in range(3)) + "q\n")
    screen = io.StringIO()
    done = run(path, observer="keyboard", virtual=True, answers=Keyboard(design, pressed, screen))
    assert not done.finished and done.trials == 3
    assert all(trial.answered.right for trial in read_experiment_log(done.log).trials)
    assert (
        "In which interval was it (1, 2)?" in screen.getvalue()
        and "[x: press one of 1, 2; q ends]" in screen.getvalue()
    )


def test_one_key_is_enough_at_a_terminal(experiment):
    """A pseudo-terminal: the key counts without Enter, the terminal is as before, and earlier keys don't count."""
    import termios

    path = experiment(kind='"yes_no"', procedure='[procedure]\nkind = "constant"\nlevels = [0.1, 0.2]\nrepeats = 1\n')
    path.write_text(path.read_text().replace('[procedure]\nkind = "yes_no"', '[procedure]\nkind = "constant"'))
    design = read_design(path)
    master, slave = pty.openpty()
    with open(slave, encoding="utf-8") as keys:
        before = termios.tcgetattr(slave)
        os.write(master, b"n")
        threading.Timer(0.4, os.write, (master, b"y")).start()
        word, delay_s = Keyboard(design, keys, io.StringIO()).answer(Shown(0, "100 Hz", (0.1,), ({},), 1, False))
        assert termios.tcgetattr(slave) == before
    os.close(master)
    assert word == "yes" and 0.2 < delay_s < 5.0


def test_what_cannot_be_played_is_refused_before_anything_begins(experiment, tmp_path):
    log = tmp_path / "log.jsonl"
    path = experiment()
    for more, kind, what in (
        ({"observer": "keyboard"}, DeviceError, "a person needs a board to feel anything"),
        ({"virtual": True, "port": "/dev/null"}, DeviceError, r"port /dev/null and --virtual exclude"),
        ({"virtual": True, "board": "sonicsurface"}, DeviceError, "condition '100 Hz': .*frames/s"),
        ({"virtual": True, "board": "ideal"}, DeviceError, "takes no bytes; give another by --board"),
        ({"observer": "cat"}, OutputError, "--observer has value 'cat'; allowed: keyboard, simulated, skin"),
    ):
        with pytest.raises(kind, match=what):
            run(path, **more)
    bad = experiment(key='"stimulus.drive_amplitud"')
    with pytest.raises(SceneError, match=r"condition '100 Hz': .*drive_amplitud.*did you mean 'drive_amplitude'"):
        run(bad)
    high = experiment(start="2.0", high="3.0")
    with pytest.raises(palmfield.PalmfieldError, match=r"condition '100 Hz'.*drive_amplitude"):
        run(high)
    assert not log.exists() or not read_experiment_log(log).trials


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ('"driver.head_m" = "0 0 0.3", "driver.head_limit_dB" = 100', "head_limit_dB allows 100"),
        ('"driver.on_time_s" = 0.01', "on_time_s allows 0.01"),
        ('"driver.duty_limit" = 0.2', "duty_limit allows 20 %"),
    ],
)
def test_what_a_driver_does_not_allow_is_refused_at_its_loudest_level_before_anything_begins(experiment, keys, what):
    path = experiment(start="0.02")
    path.write_text(path.read_text().replace("[varied]", f"[keys]\n{keys.replace(', ', chr(10))}\n\n[varied]"))
    with pytest.raises(DeviceError, match=rf"condition '100 Hz', level 1: .*{what}"):
        run(path, virtual=True)
    # Nothing is played to an observer that needs no board
    assert run(path).trials > 0


# -- designs -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ({"seed": "-1"}, "seed: Input should be greater than or equal to 0, not -1"),
        ({"duration_s": '"long"'}, "duration_s: .*not long"),
        ({"scene": '"small.xml"\nscenes = 1'}, "scenes: Extra inputs are not permitted"),
        ({"start": "2.0"}, "procedure: start 2; allowed: 0.001 to 1"),
        ({"steps": "[6.0]\nspeed = 3"}, "procedure.speed: Unexpected keyword argument|procedure.speed: Extra"),
        ({"steps": "[6.0]\nscale = 'linear'"}, "procedure.scale is 'linear' and varied.scale 'log'"),
        ({"threshold": "-20.0\nthresholds = {}\nlapse = 0.5"}, "cannot be read|simulated.lapse"),
        ({"name": '"200 Hz"'}, "conditions"),
    ],
)
def test_designs_that_cannot_be_are_told_with_their_key(experiment, words, what):
    path = experiment(**words)
    if words == {"name": '"200 Hz"'}:
        path.write_text(path.read_text().replace('name = "100 Hz"', 'name = "200 Hz"'))
    with pytest.raises(OutputError, match=what):
        read_design(path)


def test_json_says_the_same(experiment, tmp_path):
    design = read_design(experiment())
    (tmp_path / "experiment.json").write_text(json.dumps(design.model_dump(mode="json")))
    assert read_design(tmp_path / "experiment.json") == design
    assert (
        read_design(tmp_path / "experiment.json").digest("skin") == design.digest("skin") != design.digest("simulated")
    )
