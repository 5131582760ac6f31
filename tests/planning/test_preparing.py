"""When a plan proposes to prepare modes, against the cost model and the choice of the solver."""

import re
from pathlib import Path

import pytest

import palmfield
from palmfield.planning import costs as module
from palmfield.planning.costs import preparing, preparing_rows
from palmfield.session.preview import preview
from palmfield.simulation.small_models import mode_estimate
from palmfield.skin.costs import modal_start_s, modal_step_s, modes_s, reduced_s, wedges_s

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
PALM = SCENES / "palm_am200.xml"


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path))


def skin_of(scene, accuracy=0.1, **options):
    view = preview(scene, accuracy=accuracy, **options)
    return view, view.runtime.model.skins[0]


@pytest.mark.parametrize(("scene", "without"), [(PALM, "reduced"), (SCENES / "hover_explore.xml", "wedges")])
def test_from_the_stated_number_of_runs_modes_cost_less(scene, without):
    view, skin = skin_of(scene)
    made = preparing(skin, view.duration_s)
    modes, laws = mode_estimate.expected_modes(skin.spec, skin.layer), mode_estimate.laws(skin.layer)
    steps = view.duration_s / skin.layer.sizes.step_s
    once = modes_s(skin.layer.dofs, modes, laws)
    others = wedges_s(skin.layer.dofs, steps) if without == "wedges" else skin.choice.seconds

    def with_modes(runs):
        return once + runs * (modal_start_s(skin.layer.dofs, modes) + steps * modal_step_s(modes, laws))

    assert skin.choice.name == ("modal" if without == "wedges" else "reduced")
    assert with_modes(made.runs) <= made.runs * others
    assert with_modes(made.runs - 1) > (made.runs - 1) * others
    assert made.modes_s == pytest.approx(once)
    assert made.without == ("full layer" if without == "wedges" else "reduced model")


def test_the_cost_without_modes_is_that_of_a_reduced_model():
    _, skin = skin_of(PALM)
    steps = 0.1 / skin.layer.sizes.step_s
    # Its vectors are predicted from the stimulus: at least 10, at most 200
    assert reduced_s(skin.layer.dofs, steps, 10) < skin.choice.seconds < reduced_s(skin.layer.dofs, steps, 200)


def test_a_row_says_the_command_and_the_numbers():
    view, skin = skin_of(PALM)
    [row] = preparing_rows(view.runtime.model)
    made = preparing(skin, view.duration_s)
    runs, once, less = (
        float(x) for x in re.search(r"from (\d+) runs: modes (\S+) s once, then (\S+) s", row.size).groups()
    )
    assert (runs, once, less) == (made.runs, pytest.approx(made.modes_s, 0.05), pytest.approx(made.saved_s, 0.05))
    assert "palmfield prepare --set skin.solver=modal, also in these runs," in row.why
    view, _ = skin_of(PALM, keys={"skin.solver": "modal"})
    [row] = preparing_rows(view.runtime.model)
    assert "palmfield prepare makes modes" in row.why and "full layer" in row.why


@pytest.mark.parametrize(
    ("scene", "keys"),
    [
        (PALM, {"skin.accuracy": 0.05}),  # its reduced model serves the error estimate, which costs modes as much
        (SCENES / "phantom_am200.xml", {}),  # its modes would be more than the unknowns allow
        (SCENES / "stroke_palm.xml", {}),  # they would pay after thousands of runs
        (PALM, {"skin.body_sound": "scattering", "skin.element_m": 0.01}),
        (PALM, {"skin.side": "absorbing"}),
    ],
    ids=["another estimate", "too many modes", "too many runs", "scattering", "absorbing"],
)
def test_nothing_is_said_where_preparing_has_no_effect(scene, keys):
    view, _ = skin_of(scene, accuracy=None, keys=keys)
    assert preparing_rows(view.runtime.model) == []


def test_nothing_is_said_without_a_cache(monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE", "off")
    view, _ = skin_of(PALM)
    assert preparing_rows(view.runtime.model) == []


def test_the_limit_of_runs(monkeypatch):
    view, skin = skin_of(PALM)
    made = preparing(skin, view.duration_s)
    monkeypatch.setattr(module, "MOST_RUNS", made.runs)
    assert preparing(skin, view.duration_s) == made
    monkeypatch.setattr(module, "MOST_RUNS", made.runs - 1)
    assert preparing(skin, view.duration_s) is None


@pytest.mark.parametrize("scene", ["palm_am200", "follow_fingertip", "palm_circle_sonicsurface", "phantom_stm70"])
def test_the_short_table_has_at_most_20_lines(scene, monkeypatch):
    monkeypatch.setenv("COLUMNS", "110")
    plan = palmfield.plan(SCENES / f"{scene}.xml")
    lines = plan.short().splitlines()
    table = [line for line in lines if line[0] in "┌│└"]
    assert len(table) < 20 and lines[0].startswith("Plan for")
    assert ("preparing" in plan.short()) == any(row.what == "preparing" for row in plan.modelled)
    assert all(f"Warning: {warning}"[:60] in plan.short() for warning in plan.warnings)
    for row in plan.left_out:
        assert row.what in " ".join(re.sub("[│\n]", " ", plan.short()).split())
