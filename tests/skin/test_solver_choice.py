"""One call for every solver: who is chosen, what is refused, and what happens where an estimate misses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin import Motion, Sheet, Slab, Spot, choices, preset, solve, static
from palmfield.skin import solver_choice as module
from palmfield.skin.analytic.layer_oracle import centre_response, centre_responses
from palmfield.skin.costs import scene_choices
from palmfield.skin.materials.material import bulk_from_poisson, kelvin_voigt
from palmfield.skin.problem import QUANTITIES, SkinProblem
from palmfield.skin.solvers.particles.resolution import choose_spacing, law_error

ECOFLEX = preset("ecoflex_00-10")
ENDLESS = Slab((Sheet(ECOFLEX, 0.02),))
HELD = Spot(0.0103, [0.0, 1e-3], [0.0, 1.0])
CENTRE = [[0.0, 0.0]]
DISC = Slab((Sheet(ECOFLEX, 0.02),), shape="disc", side="fixed", radius_m=0.06)


def test_an_endless_slab_goes_to_lateral_waves_and_comes_to_rest_at_the_exact_answer() -> None:
    motion = solve(ENDLESS, HELD, [0.2], CENTRE, accuracy=0.01, device="cpu")
    assert motion.solver.startswith("lateral_waves")
    assert "auto: predicted" in motion.solver and "spectral_elements" in motion.solver
    assert motion.error <= 0.01
    exact = centre_response(0.0, ECOFLEX, 0.02, 0.0103).real.item()
    assert -motion.displacement_m[0, 0, 2] == pytest.approx(exact, rel=0.005)
    assert motion.displacement_m.shape == motion.velocity_m_s.shape == (1, 1, 3)


def test_choices_are_ranked_and_say_why_not() -> None:
    ranked = choices(ENDLESS, HELD, [0.01], CENTRE, device="cpu")
    assert ranked[0].name == "lateral_waves"
    assert {choice.name for choice in ranked} == set(module.WHERE)
    seconds = [choice.seconds for choice in ranked]
    assert seconds == sorted(seconds)
    for choice in ranked:
        assert (choice.refusal is None) == np.isfinite(choice.seconds)
    disc = next(choice for choice in ranked if choice.name == "axisymmetric")
    assert disc.refusal is not None and "disc" in disc.refusal


def test_a_solver_asked_for_runs_or_says_why_not() -> None:
    body = Slab((Sheet(ECOFLEX, 0.02),), shape="disc", side="fixed", radius_m=0.06)
    motion = solve(body, HELD, [2e-3], CENTRE, solver="axisymmetric", accuracy=0.1, device="cpu")
    assert motion.solver.startswith("axisymmetric") and motion.solver.endswith("(requested)")
    with pytest.raises(SceneError, match="solver 'lateral_waves': a disc with fixed sides"):
        solve(body, HELD, [2e-3], CENTRE, solver="lateral_waves", device="cpu")


def test_a_missed_accuracy_is_solved_finer_and_a_lasting_miss_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def found(error: float) -> Motion:
        still = np.zeros((1, 1, 3))
        return Motion(np.zeros(1), np.zeros((1, 3)), still, still, error, "made up for the test", "fake", 1.0)

    def fake(name: str, what: str):
        def run(problem: SkinProblem, *, step_s: float = 0.0) -> Motion:
            asked.append(problem.accuracy)
            return found(errors[len(asked) - 1])

        return {"solve": run, "refusal": lambda *_: None, "cost": lambda *_: 1.0}[what]

    monkeypatch.setattr(module, "function", fake)
    errors = [0.2, 0.04]
    motion = solve(ENDLESS, HELD, [0.01], CENTRE, accuracy=0.05, device="cpu")
    assert asked == [0.05, pytest.approx(0.05 * 0.7 * 0.25)]
    assert motion.error == 0.04 and "NOT" not in motion.solver
    asked.clear()
    errors = [0.2] * 4
    motion = solve(ENDLESS, HELD, [0.01], CENTRE, accuracy=0.05, device="cpu")
    assert len(asked) == 1 + module.FINER and asked == sorted(asked, reverse=True)
    assert "error 20 % NOT within the target of 5 %" in motion.solver
    asked.clear()
    solve(ENDLESS, HELD, [0.01], CENTRE, solver="wedges", accuracy=0.05, device="cpu", step_s=1e-3)
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"solver": "magic"}, "solver is 'magic'; use auto or one of lateral_waves"),
        ({"solver": "spectral"}, "solver 'spectral' has been renamed: use lateral_waves"),
        ({"solver": "implicit"}, "use wedges"),
        ({"accuracy": 0.0}, "accuracy is 0.0"),
        ({"accuracy": np.nan}, "accuracy is nan"),
        ({"times": [0.1, 0.1]}, "times of shape"),
        ({"times": [np.nan]}, "times of shape"),
        ({"at": [0.0, 0.0]}, "at of shape"),
        ({"at": [[np.inf, 0.0]]}, "at of shape"),
        ({"step_s": 1e-4}, "step_s: resolutions apply to one solver"),
    ],
)
def test_bad_arguments_are_named(changes: dict[str, object], words: str) -> None:
    arguments: dict[str, object] = {"times": [0.01], "at": CENTRE, "device": "cpu"} | changes
    times, at = arguments.pop("times"), arguments.pop("at")
    with pytest.raises(SceneError, match=words):
        solve(ENDLESS, HELD, times, at, **arguments)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Spot(0.0, [0.0], [1.0]), "fwhm_m is 0.0"),
        (lambda: Spot(0.01, [0.0, 0.0], [1.0, 1.0]), "times_s of shape"),
        (lambda: Spot(0.01, [0.0], [np.nan]), "peak_Pa is not finite"),
        (lambda: Spot(0.01, [0.0], [1.0], [[0.0, 0.0, 0.0]]), "centre_m has shape"),
        (lambda: Spot(0.01, [0.0], ["loud"]), "peak_Pa is not an array of numbers"),
        (lambda: Spot(0.01, [0.0], [1.0], law="spline"), "law is 'spline'"),
        (lambda: Sheet(ECOFLEX, -1.0), "thickness_m is -1.0"),
        (lambda: Slab((), side=None), "sheets is empty"),
        (lambda: Slab((Sheet(ECOFLEX, 0.02),), shape="disc", side="free"), "radius_m is None"),
        (lambda: Slab((Sheet(ECOFLEX, 0.02),), side="free"), "infinite slab has no sides"),
        (lambda: Slab((Sheet(ECOFLEX, 0.02),), base="glued"), "base is 'glued'"),
    ],
)
def test_bad_problems_are_named(make, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        make()


def test_static_answers_come_from_lateral_waves_or_elements() -> None:
    exact = centre_response(0.0, ECOFLEX, 0.02, 0.0103).real.item()
    endless = static(ENDLESS, HELD, CENTRE, accuracy=0.01)
    assert endless.solver.startswith("lateral_waves")
    assert -endless.displacement_m[0, 0, 2] == pytest.approx(exact, rel=0.01)
    box = Slab((Sheet(ECOFLEX, 0.02),), shape="box", side="fixed", size_m=(0.12, 0.12))
    held = static(box, HELD, CENTRE, accuracy=0.05)
    assert held.solver.startswith("wedges")
    assert -held.displacement_m[0, 0, 2] == pytest.approx(exact, rel=0.05)
    with pytest.raises(SceneError, match="needs a support"):
        static(Slab(box.sheets, shape="box", base="free", side="free", size_m=(0.12, 0.12)), HELD, CENTRE)


def test_a_solver_that_cannot_price_a_problem_leaves_it_to_others() -> None:
    ranked = choices(ENDLESS, HELD, [0.01], CENTRE, accuracy=2e-5, device="cpu")
    assert ranked[0].name == "lateral_waves" and ranked[0].refusal is None
    assert any(choice.refusal and "accuracy" in choice.refusal for choice in ranked)
    with pytest.raises(
        SceneError, match="solver 'lateral_waves' has no 'order'; allowed: accuracy, accuracy_of, device"
    ):
        solve(ENDLESS, HELD, [0.01], CENTRE, solver="lateral_waves", device="cpu", order=3)


def test_auto_takes_the_next_where_its_choice_refuses_while_it_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []

    def fake(name: str, what: str):
        def run(*_: object, **__: object) -> Motion:
            tried.append(name)
            if name in refusing:
                raise SceneError(f"{name} came apart")
            still = np.zeros((1, 1, 3))
            return Motion(np.zeros(1), np.zeros((1, 3)), still, still, 0.01, "made up for the test", name, 1.0)

        order = {"axisymmetric": 1.0, "wedges": 2.0}
        return {"solve": run, "refusal": lambda *_: None, "cost": lambda *_: order.get(name, 3.0)}[what]

    monkeypatch.setattr(module, "function", fake)
    refusing = {"axisymmetric"}
    motion = solve(ENDLESS, HELD, [0.01], CENTRE, device="cpu")
    assert tried == ["axisymmetric", "wedges"]
    assert motion.solver.startswith("wedges (auto: predicted 2 s")
    assert "axisymmetric refused: axisymmetric came apart" in motion.solver
    refusing = set(module.WHERE)
    with pytest.raises(SceneError, match=r"no solver supports this problem: axisymmetric refused.*; wedges refused"):
        solve(ENDLESS, HELD, [0.01], CENTRE, device="cpu")
    with pytest.raises(SceneError, match="outside the slab"):
        solve(Slab(ENDLESS.sheets, "disc", side="free", radius_m=0.02), HELD, [0.01], [[0.03, 0.0]], device="cpu")


def test_a_body_of_dashpots_is_solved_by_whom_it_does_not_stop() -> None:
    """A viscosity of 1e6 Pa s made steps that are no numbers, and 100 s of wavenumbers that came to nothing."""
    thick = kelvin_voigt("thick", 1000.0, 1e4, 1e6, 0.49)
    slab, times = Slab((Sheet(thick, 0.02),)), 1e-3 * np.arange(1, 9)
    ranked = {choice.name: choice for choice in choices(slab, HELD, times, CENTRE, device="cpu")}
    for name in ("lateral_waves", "spectral_elements"):
        assert "use solver 'wedges'" in str(ranked[name].refusal)
    motion = solve(slab, HELD, times, CENTRE, accuracy=0.2, device="cpu")
    assert motion.solver.startswith("wedges") and motion.error <= 0.2
    disc = Slab(slab.sheets, shape="disc", side="fixed", radius_m=0.06)
    known = solve(disc, HELD, times, CENTRE, solver="axisymmetric", accuracy=1e-3, device="cpu")
    off = np.linalg.norm(motion.displacement_m - known.displacement_m) / np.linalg.norm(known.displacement_m)
    assert known.error < 0.01 and off <= motion.error


@pytest.mark.parametrize("load", [[HELD, HELD], (HELD,), "a spot", None])
def test_what_is_no_load_is_refused_in_one_line(load: object) -> None:
    for call in (
        lambda: solve(ENDLESS, load, [0.01], CENTRE, device="cpu"),
        lambda: static(ENDLESS, load, CENTRE),
        lambda: choices(ENDLESS, load, [0.01], CENTRE),
    ):
        with pytest.raises(SceneError, match=r"give (one|a) Spot or") as refused:
            call()
        assert "\n" not in str(refused.value)


def test_scenes_choose_between_what_steps_in_time() -> None:
    cheap, other, _ = scene_choices(30_000, 1600, 60, None, 1600, "shadows")
    assert (cheap.name, other.name) == ("reduced", "wedges") and cheap.seconds < other.seconds
    brief, *_ = scene_choices(2_000, 10, 400, None, 400, None)
    assert brief.name == "wedges"
    only, *never = scene_choices(30_000, 1600, 60, "the hand moves", 1600, "shadows")
    assert only.name == "wedges" and {choice.refusal for choice in never} == {"the hand moves", "shadows"}
    assert all(choice.seconds == np.inf for choice in never)


def test_scenes_take_modes_where_runs_are_long_or_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Making them is shared by the runs that find them in the cache."""
    choices = [scene_choices(7_000, steps, 0, "the hand moves", 500, None)[0].name for steps in (100, 100_000)]
    assert choices == ["wedges", "modal"]
    kept = []
    for folder in ("off", "somewhere"):
        monkeypatch.setenv("PALMFIELD_CACHE", folder)
        by_name = {choice.name: choice for choice in scene_choices(7_000, 100, 0, "it moves", 500, None)}
        kept.append(by_name["modal"].seconds)
    assert kept[1] < 0.5 * kept[0]


def test_what_a_cost_has_found_is_not_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bulk modulus that is enough takes up to a second, and was looked for in the cost and in the solution."""
    looked_up: list[int] = []
    monkeypatch.setattr(module, "WHERE", {"spectral_elements": module.WHERE["spectral_elements"]})

    def counted(frequencies: Any, *rest: Any) -> Any:
        looked_up.append(len(frequencies))
        return centre_responses(frequencies, *rest)

    monkeypatch.setattr("palmfield.skin.approximation.reduce_bulk_modulus.centre_responses", counted)
    stiff = replace(ECOFLEX, bulk_Pa=bulk_from_poisson(0.4995, ECOFLEX.shear_instant_Pa))
    asked = (Slab((Sheet(stiff, 0.02),)), HELD, [1e-3, 2e-3], CENTRE)
    motion = solve(*asked, accuracy=0.15, device="cpu")
    once = len(looked_up)
    choices(*asked, accuracy=0.15, device="cpu")
    assert len(looked_up) == 2 * once > 0
    by_name = solve(*asked, solver="spectral_elements", accuracy=0.15, device="cpu")
    assert "bulk modulus" in motion.error_source
    assert motion.error == by_name.error and np.array_equal(motion.displacement_m, by_name.displacement_m)


def test_a_cost_that_cannot_be_computed_ends_no_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever fails in a cost, the solver comes after those whose cost is known, and is taken where it is alone."""
    kept = module.function

    def broken(*_: object) -> float:
        raise ValueError("f(a) and f(b) must have different signs")

    for spoilt in (set(module.WHERE) - {"wedges"}, set(module.WHERE)):
        for cost in (broken, lambda *_: np.nan):

            def chosen(name: str, what: str, spoilt: set[str] = spoilt, cost: Any = cost) -> Any:
                return cost if what == "cost" and name in spoilt else kept(name, what)

            monkeypatch.setattr(module, "function", chosen)
            ranked = choices(DISC, HELD, [2e-3], CENTRE, device="cpu")
            able = [choice for choice in ranked if choice.refusal is None]
            assert {choice.name for choice in able if choice.seconds == np.inf} == spoilt & {c.name for c in able}
            assert ranked[: len(able)] == able and (able[0].name == "wedges" or len(spoilt) == len(module.WHERE))
    motion = solve(DISC, HELD, [2e-3], CENTRE, accuracy=0.3, device="cpu")
    assert "cost unknown" in motion.solver


@pytest.mark.parametrize("accuracy", [0.002, 0.03, 0.05, 0.3])
def test_particles_are_spaced_for_loads_that_hop(accuracy: float) -> None:
    """A spot that hops within a microsecond asks for spacings that no bracket holds (it was a raw error of brentq)."""
    times = np.array([0.0, 1e-3, 1.001e-3, 2e-3])
    hops = Spot(0.0087, times, np.ones(4), np.array([[0.0, 0.0], [0.0, 0.0], [0.01, 0.0], [0.01, 0.0]]))
    spacing = choose_spacing(DISC, hops, accuracy)
    assert law_error(DISC, hops, spacing) == pytest.approx(accuracy, rel=1e-6)


def test_choices_go_by_the_quantity_whose_accuracy_is_wanted() -> None:
    ranked = {name: choices(ENDLESS, HELD, [0.01], CENTRE, accuracy_of=name, device="cpu") for name in QUANTITIES}
    cheapest = {name: options[0].seconds for name, options in ranked.items()}
    assert cheapest["velocity"] >= cheapest["displacement"]
    with pytest.raises(SceneError, match="accuracy_of is 'speed'; use one of displacement, velocity, normal"):
        choices(ENDLESS, HELD, [0.01], CENTRE, accuracy_of="speed", device="cpu")  # type: ignore[arg-type]
