"""Reports: thresholds of a log that is finished or not, as table, JSON and picture."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.errors import OutputError
from palmfield.studies.experiment.design import read_design
from palmfield.studies.experiment.log import read_experiment_log
from palmfield.studies.experiment.picture import draw_report
from palmfield.studies.experiment.report import as_dict, as_text, report_of
from palmfield.studies.experiment.run import run_experiment

CONSTANT = '[procedure]\nkind = "constant"\nlevels = [0.0, 0.02, 0.035, 0.06, 0.1, 0.2, 0.4]\nrepeats = 12\n'


@pytest.fixture
def logged(experiment):
    def run(**words):
        path = experiment(**words)
        log = path.with_name("log.jsonl")
        run_experiment(path, log, participant="p1", observer="simulated")
        return log

    return run


def test_a_staircases_estimate_is_the_mean_of_its_turns(logged):
    """By hand from the log's lines: levels at which the direction of the moves changed."""
    log = logged()
    report = report_of(log)
    assert report.finished and report.convergence == pytest.approx(2**-0.5)
    for number, condition in enumerate(report.conditions):
        levels = [t.answered.level for t in read_experiment_log(log).trials if t.condition == number]
        moves = [(i, np.sign(b - a)) for i, (a, b) in enumerate(pairwise(levels)) if a != b]
        turns = [levels[i] for (_, before), (i, after) in pairwise(moves) if before != after]
        # The last turn ends the run, so that no further level shows it
        turns = [*turns, levels[-1]][2:]
        assert condition.estimates == (pytest.approx(np.exp(np.mean(np.log(turns[len(turns) % 2 :])))),)


def test_numbers_of_a_fit_are_in_the_varied_keys_unit(logged):
    report = report_of(logged(procedure=CONSTANT))
    told = as_dict(report)
    assert told["guess"] == 0.5 and told["finished"] and told["trials"] == 168
    first, second = told["conditions"]
    for row, fit in zip((first, second), (one.fit for one in report.conditions), strict=True):
        assert row["threshold"] == pytest.approx(10 ** (fit.threshold / 20))
        assert row["threshold_low"] < row["threshold"] < row["threshold_high"]
        assert row["note"].startswith("12 trials with level 0 are excluded")
    assert second["threshold"] < first["threshold"]
    assert f"{first['threshold']:.4g}" in as_text(report) and "75 % right without lapses" in as_text(report)


def test_an_interval_that_leaves_what_can_be_played_is_not_bounded(logged):
    """A threshold at the amplitude's largest value, 1, of which 30 trials tell no upper end."""
    report = report_of(logged(threshold="-1.0"))
    one = as_dict(report)["conditions"][0]
    assert report.conditions[0].fit.threshold_interval[1] > 0.0  # dB re 1: no such amplitude
    assert one["threshold_high"] is None and report.design.playable() == (0.001, 1.0)
    assert "to not bounded" in as_text(report) or "  not bounded" in as_text(report)
    del report.design.procedure["high"]
    assert report.design.playable() == (0.001, 1.0)  # the key's own


@pytest.mark.parametrize(("level_dB", "words"), [(3.0, "> 1 "), (-70.0, "< 0.001 ")])
def test_a_threshold_that_cannot_be_played_is_no_number(level_dB, words, logged):
    report = report_of(logged())
    first, *rest = report.conditions
    function = replace(first.fit.function, threshold=level_dB)
    first = replace(first, fit=replace(first.fit, function=function))
    report = replace(report, conditions=(first, *rest))
    assert as_dict(report)["conditions"][0]["threshold"] is None
    assert words in as_text(report)


def test_levels_counts_and_shares_are_those_of_the_log(logged):
    log = logged(procedure=CONSTANT)
    report = report_of(log)
    trials = [t.answered for t in read_experiment_log(log).trials if t.condition == 1]
    for told, count, share in zip(
        report.conditions[1].levels, report.conditions[1].trials, report.conditions[1].shares, strict=True
    ):
        own = [t.right for t in trials if t.level and abs(20 * np.log10(t.level) - told) < 1e-5]
        assert (len(own), np.mean(own)) == (count, pytest.approx(share))


def test_a_log_that_has_just_begun_has_a_report(experiment):
    path = experiment()
    design = read_design(path)
    log = path.with_name("log.jsonl")

    class Tired:
        def answer(self, shown):
            if shown.number == 2:
                raise KeyboardInterrupt
            return str(shown.target), 0.5

    with pytest.raises(KeyboardInterrupt):
        run_experiment(path, log, participant="p1", observer="simulated", answers=Tired())
    report = report_of(log)
    assert not report.finished and sum(one.answered for one in report.conditions) == 2
    assert all(one.fit is None and one.why for one in report.conditions)
    assert "2 trials in 1 session, not finished" in as_text(report)
    draw_report(report, path.with_name("few.png"))
    assert design.name == report.design.name


def test_the_picture_shows_runs_and_functions(logged, tmp_path):
    report = report_of(logged())
    draw_report(report, tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    assert text.count("<path") > 40
    with pytest.raises(OutputError, match=r"cannot write .*; give a .png, .svg or .pdf"):
        draw_report(report, tmp_path / "none" / "a.png")
    with pytest.raises(OutputError, match=r"cannot write .*; give a .png"):
        draw_report(report, tmp_path / "a.txt3")


def test_the_commands_run_and_report(experiment, tmp_path):
    path, log = experiment(reversals="3"), tmp_path / "log.jsonl"
    words = ["experiment", "run", str(path), "--log", str(log), "--participant", "p1", "--observer", "simulated"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0 and "finished" in done.stdout and "palmfield experiment report" in done.stdout
    assert ", 0 of them new; finished" in CliRunner().invoke(app, words).stdout
    told = CliRunner().invoke(app, ["experiment", "report", str(log), "--json"])
    assert json.loads(told.stdout)["participant"] == "p1"
    shown = CliRunner().invoke(app, ["experiment", "report", str(log), "--png", str(tmp_path / "a.png")])
    assert "condition" in shown.stdout and (tmp_path / "a.png").stat().st_size > 10_000
    bad = CliRunner().invoke(app, ["experiment", "report", str(log), "--shape", "probit"])
    assert "--shape has value 'probit'; allowed: normal, logistic, weibull" in str(bad.exception)
    known = CliRunner().invoke(app, ["experiment", "report", str(log), "--spread", "3", "--lapse", "-1"])
    assert "3 dB" in known.stdout and "--spread" not in known.stdout
    weibull = CliRunner().invoke(app, ["experiment", "report", str(log), "--shape", "weibull"])
    assert "but the scale 'log' of this log is in dB" in str(weibull.exception)
