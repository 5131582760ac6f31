"""Procedures on observers whose psychometric function is known: where they converge, and how they move."""

import numpy as np
import pytest
from scipy.stats import binom, norm

from palmfield.errors import OutputError
from palmfield.perception.psychometric import PsychometricFunction, counts, fit
from palmfield.studies.experiment.procedures import Adjustment, Answered, ConstantStimuli, Limits, Staircase

OBSERVER = PsychometricFunction("normal", 0.0, 4.0, 0.0)


def played(procedure, rng, function=OBSERVER):
    run = []
    while (level := procedure.next_level(run)) is not None:
        run.append(Answered(level, bool(rng.random() < function(level))))
    return run


def moves(procedure, answers):
    """Levels of trials that are answered so, and the one after."""
    run = []
    for right in answers:
        run.append(Answered(procedure.next_level(run), right == "r"))
    return [trial.level for trial in run] + [procedure.next_level(run)]


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("up", "down", "ratio", "level"),
    [(1, 1, 1.0, 0.5), (1, 2, 1.0, 0.7071), (1, 3, 1.0, 0.7937), (1, 4, 1.0, 0.8409), (2, 1, 1.0, 0.2929),
     (3, 1, 1.0, 0.2063), (1, 1, 3.0, 0.75)],
)  # fmt: skip
def test_staircases_converge_where_levitt_says(up, down, ratio, level):
    """Printed levels (Levitt 1971, table I; Kaernbach 1991 for unequal steps), and what 60 long staircases of small
    steps end at: the observer's own function there."""
    procedure = Staircase(6.0, (2.0, 0.5), up, down, ratio, "linear", reversals=60, trials=1000, skipped=10)
    assert procedure.convergence == pytest.approx(level, abs=1e-4)
    rng = np.random.default_rng(up + 10 * down)
    estimates = [procedure.estimate(played(procedure, rng)) for _ in range(60)]
    # By its level, within a tenth of the function's spread: of 0.71 and 0.79, which are its spreads 0.54 and 0.82
    wanted = norm.ppf(level) * OBSERVER.spread
    assert np.mean(estimates) == pytest.approx(wanted, abs=0.1 * OBSERVER.spread)


def test_a_staircase_moves_as_it_is_told():
    """1 up 2 down with steps of 4 and then 1: right answers in a row count, and begin anew after a move."""
    procedure = Staircase(10.0, (4.0, 1.0), scale="linear", reversals=3, skipped=0)
    assert moves(procedure, "rrrwrrw") == [10.0, 10.0, 6.0, 6.0, 7.0, 7.0, 6.0, None]
    assert procedure.turns(
        [Answered(x, a == "r") for x, a in zip([10, 10, 6, 6, 7, 7, 6], "rrrwrrw", strict=True)]
    ) == [3, 5, 6]


def test_steps_of_ratios_bounds_and_the_other_way():
    loud = Staircase(1.0, (6.0,), up=1, down=1, low=0.3, high=1.0)
    assert moves(loud, "rrr") == pytest.approx([1.0, 10**-0.3, 0.3, 0.3], abs=1e-12)
    gap = Staircase(1.0, (1.0,), up=1, down=1, up_ratio=3.0, scale="linear", harder="higher")
    assert moves(gap, "rrw") == pytest.approx([1.0, 2.0, 3.0, 0.0])


def test_thresholds_of_a_staircases_trials_by_a_fit():
    """60 observers of 2AFC staircases: where the spread is known thresholds are without bias, and 95 % intervals hold
    them as often as 95 % of 60 do by chance. Where it is found it comes out too small, as docs/experiments.md says."""
    function = PsychometricFunction("normal", -20.0, 3.0, 0.5, 0.02)
    procedure = Staircase(0.5, (6.0, 3.0, 1.5), reversals=16, trials=200)
    rng, known, found = np.random.default_rng(3), [], []
    for _ in range(60):
        run = []
        while (level := procedure.next_level(run)) is not None:
            run.append(Answered(level, bool(rng.random() < function(20 * np.log10(level)))))
        levels = np.round(20.0 * np.log10([trial.level for trial in run]), 6)
        answers = counts(levels, [trial.right for trial in run])
        known.append(fit(*answers, guess=0.5, spread=3.0, samples=250))
        found.append(fit(*answers, guess=0.5, samples=2).spread)
    thresholds = np.array([one.threshold for one in known])
    assert thresholds.mean() == pytest.approx(-20.0, abs=3.0 * thresholds.std() / np.sqrt(60))
    covered = sum(one.threshold_interval[0] <= -20.0 <= one.threshold_interval[1] for one in known)
    assert covered >= binom.ppf(0.005, 60, 0.95)
    assert all(one.spread == pytest.approx(3.0) for one in known) and np.median(found) < 2.5


def test_constant_stimuli_come_as_often_in_an_order_of_the_seed():
    procedure = ConstantStimuli((0.1, 0.2, 0.4), 5, (3,))
    levels = [trial.level for trial in played(procedure, np.random.default_rng(0))]
    assert sorted(levels) == sorted([0.1, 0.2, 0.4] * 5)
    assert all(sorted(levels[i : i + 3]) == [0.1, 0.2, 0.4] for i in range(0, 15, 3))
    assert levels == ConstantStimuli((0.1, 0.2, 0.4), 5, (3,)).order().tolist()
    assert levels != ConstantStimuli((0.1, 0.2, 0.4), 5, (4,)).order().tolist()


def test_adjustment_ends_where_it_is_just_felt():
    """An observer without noise of threshold 0.1, who goes weaker while it is felt and stronger while it isn't."""
    procedure, run = Adjustment(0.01, 1.0, 1.0, settings=5), []
    while (level := procedure.next_level(run)) is not None:
        felt = level >= 0.1
        turned = len(run) > 0 and run[-1].word == "stronger" and felt
        run.append(Answered(level, felt, "done" if turned else "weaker" if felt else "stronger"))
    settings = procedure.settings_of(run)
    assert len(settings) == 5 and all(0.1 <= level < 0.1 * 10 ** (1 / 20) * 1.001 for level in settings)
    starts = [run[0].level] + [run[i + 1].level for i, trial in enumerate(run[:-1]) if trial.word == "done"]
    assert len(set(starts)) == 5 and min(settings) <= procedure.estimate(run) <= max(settings)


def test_a_setting_that_never_ends_is_left_after_so_many_presses():
    procedure = Adjustment(1.0, 2.0, 0.1, settings=2, presses=5, scale="linear")
    run = []
    while (level := procedure.next_level(run)) is not None:
        run.append(Answered(level, True, "weaker"))
    assert len(run) == 10 and procedure.settings_of(run) == [] and np.isnan(procedure.estimate(run))


HASEGAWA = tuple(np.round([*np.arange(1, 6) * 0.005, *np.arange(2, 41) * 0.025], 3).tolist())


def test_limits_end_between_the_levels_where_a_sure_answer_changes():
    """Hasegawa & Shinoda's levels and six series, an observer without noise: up to 0.05, down from 1 to 0.025."""
    procedure = Limits(HASEGAWA)
    run = played(procedure, np.random.default_rng(0), lambda level: float(level > 0.03))
    rising, falling = HASEGAWA[:6], HASEGAWA[::-1][:40]
    assert [trial.level for trial in run] == [*rising, *falling] * 3
    assert procedure.estimate(run) == pytest.approx(np.sqrt(0.025 * 0.05))
    # 1 dB below the end of a series: the estimate can't be nearer than half a step
    assert 20 * np.log10(procedure.estimate(run) / 0.03) == pytest.approx(1.4, abs=0.05)


@pytest.mark.parametrize("number", [0, 1])
def test_ends_of_limits_come_as_often_as_products_of_probabilities_say(number):
    """A rising series ends at level j with probability p_j times those of all no's before, a falling one likewise."""
    levels = tuple(np.arange(-12.0, 13.0, 2.0).tolist())
    procedure = Limits(levels, series=2, scale="linear")
    order = np.array(levels if number == 0 else levels[::-1])
    change = OBSERVER(order) if number == 0 else 1.0 - OBSERVER(order)
    ends = change * np.cumprod([1.0, *(1.0 - change[:-1])])
    wanted = float(ends[1:] @ (0.5 * (order[1:] + order[:-1])) / ends[1:].sum())
    rng, found = np.random.default_rng(5), []
    for _ in range(2000):
        run = played(procedure, rng)
        first = next(i for i, trial in enumerate(run) if trial.right) + 1
        part = run[:first] if number == 0 else run[first:]
        alone = Limits(levels, series=1, scale="linear")
        if number == 1:
            # the falling series as a rising one of the other answer on mirrored levels, whose end is mirrored too
            part = [Answered(-trial.level, not trial.right) for trial in part]
            alone = Limits(tuple((-order).tolist()), series=1, scale="linear")
        value = alone.estimate(part)
        found.append(value if number == 0 else -value)
    kept = np.array(found)[np.isfinite(found)]
    assert kept.mean() == pytest.approx(wanted, abs=4.0 * kept.std() / np.sqrt(len(kept)))
    assert (wanted < 0.0) == (number == 0)


def test_series_that_end_at_once_or_never_tell_no_threshold():
    always, never = (Limits((1.0, 2.0, 3.0), series=2, scale="linear") for _ in range(2))
    run = played(always, np.random.default_rng(0), lambda level: 1.0)
    assert [trial.level for trial in run] == [1.0, 3.0, 2.0, 1.0] and np.isnan(always.estimate(run))
    run = played(never, np.random.default_rng(0), lambda level: 0.0)
    assert [trial.level for trial in run] == [1.0, 2.0, 3.0, 3.0] and np.isnan(never.estimate(run))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Limits((1.0,)), "two or more, each above the one before"),
        (lambda: Limits((2.0, 1.0)), "each above the one before"),
        (lambda: Limits((0.0, 1.0)), "allowed with scale 'log': above 0"),
        (lambda: Limits((1.0, 2.0), series=0), "series 0; allowed: 1 or more"),
        (lambda: Staircase(1.0, (1.0,), up=2, down=2), "up 2, down 2; allowed: 1 to 8, one of them 1"),
        (lambda: Staircase(1.0, ()), "one step or more"),
        (lambda: Staircase(0.0, (1.0,)), "start 0; allowed"),
        (lambda: Staircase(1.0, (1.0,), reversals=4, skipped=4), "fewer skipped than reversals"),
        (lambda: ConstantStimuli((1.0,), 3), "two different levels or more"),
        (lambda: Adjustment(0.0, 1.0, 1.0), "low 0, high 1, step 1; allowed"),
    ],
)
def test_procedures_that_cannot_be(make, told):
    with pytest.raises(OutputError, match=told):
        make()
