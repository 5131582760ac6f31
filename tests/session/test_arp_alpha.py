"""Key arp_alpha: the factor of the ARP's alpha form, in runs, plans, results and budgets."""

import json

import pytest

import palmfield
from palmfield.errors import SceneError
from palmfield.outputs.store import open_result
from palmfield.planning.scene_plan import plan

pytestmark = pytest.mark.usefixtures("kept_operators")


def finished(path, out, **keys):
    sim = palmfield.Simulation(path, keys={"skin.solver": "wedges"} | keys)
    result = palmfield.run(sim, out, progress=False, plots=[])
    with open_result(out) as tree:
        (skin,) = tree["skin"].children.values()
        (budget,) = json.loads(tree.attrs["error_budget"]).values()
        told = [one["why"] for one in budget["inputs"] if one["what"] == "alpha of the ARP"]
        return result.summary["peak_displacement_m"], skin.attrs, told


@pytest.mark.nightly
def test_motion_is_in_proportion_to_alpha_and_results_and_budgets_say_it(small_scene, tmp_path):
    path, law = small_scene(), {"skin.arp_law": "alpha"}
    whole, about, told = finished(path, tmp_path / "whole", **law)
    assert whole > 0.0 and about["arp_alpha"] == 2.0
    assert told == ["2 by key arp_law; allowed: 1 to 2; the ARP on the skin is proportional to it"]
    less, about, told = finished(path, tmp_path / "less", **law, **{"skin.arp_alpha": 1.3})
    assert less / whole == pytest.approx(1.3 / 2.0, rel=1e-5)
    assert about["arp_law"] == "alpha" and about["arp_alpha"] == pytest.approx(1.3, rel=1e-12)
    assert told == ["1.3 by key arp_alpha; allowed: 1 to 2; the ARP on the skin is proportional to it"]


def test_the_default_law_has_no_alpha(small_scene, tmp_path):
    _, about, told = finished(small_scene(), tmp_path / "out")
    assert about["arp_law"] == "default" and "arp_alpha" not in about and told == []


@pytest.mark.nightly
@pytest.mark.parametrize("solver", ["reduced", "modal"])
def test_small_models_take_a_factor_too(small_scene, solver):
    peaks = []
    for alpha in (1.0, 2.0):
        keys = {"skin.solver": solver, "skin.arp_law": "alpha", "skin.arp_alpha": alpha}
        sim = palmfield.Simulation(small_scene(), keys=keys)
        peaks.append(palmfield.run(sim, progress=False).summary["peak_displacement_m"])
    assert peaks[0] / peaks[1] == pytest.approx(0.5, rel=1e-3)


def test_a_plan_says_the_factor(small_scene):
    for alpha, words in ((1.3, "1.3 p_rms^2/(rho c^2) on lit points"), (2, "2 p_rms^2/(rho c^2) on lit points")):
        text = str(plan(palmfield.Simulation(small_scene(skin={"arp_law": "alpha", "arp_alpha": alpha}))))
        assert words in text


@pytest.mark.parametrize("alpha", [0.5, 2.5, "nan", "much"])
def test_what_no_skin_does_is_refused(small_scene, alpha):
    with pytest.raises(SceneError, match="arp_alpha"):
        palmfield.load(small_scene(skin={"arp_law": "alpha", "arp_alpha": alpha}))


def test_alpha_without_its_law_is_refused(small_scene):
    with pytest.raises(SceneError, match=r"arp_alpha 1\.5 applies to arp_law 'alpha', but arp_law is 'default'"):
        palmfield.load(small_scene(skin={"arp_alpha": 1.5}))
