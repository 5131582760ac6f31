"""What other programs read: JSON alone on standard output, with names that stay and units in them."""

import json
import sys

import pytest

import palmfield
from palmfield.cli.app import main
from palmfield.config import CONFIGS, unit

pytestmark = pytest.mark.usefixtures("kept_operators")


def call(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["palmfield", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code, capsys.readouterr()


def told(monkeypatch, capsys, *arguments):
    code, out = call(monkeypatch, capsys, *arguments, "--json")
    assert code == 0, out.err
    return json.loads(out.out)


def test_a_run_is_told_as_it_is_written(small_scene, tmp_path, monkeypatch, capsys):
    path = small_scene(stimulus={"modulation": "none"})
    facts = told(monkeypatch, capsys, "run", path, "--out", tmp_path / "out", "--duration", "0.003")
    assert set(facts) == {"scene", "out", "files", "warnings", "summary"}
    assert facts["summary"] == json.loads((tmp_path / "out" / "summary.json").read_text())
    assert set(facts["files"]) >= {"result.nc", "summary.json"} and facts["summary"]["steps"] == 3
    assert any("modulation is 'none'" in text for text in facts["warnings"])


def test_a_plan_has_rows_and_numbers(small_scene, monkeypatch, capsys):
    path = small_scene()
    facts = told(monkeypatch, capsys, "plan", path, "--duration", "0.25", "--accuracy", "0.3")
    assert (facts["duration_s"], facts["steps"], facts["timestep_s"]) == (0.25, 250, 0.001)
    assert facts["transducers"] == 256 and facts["skin_step_s"] == 0.0005
    (stimulus,), (skin,) = facts["stimuli"], facts["skins"]
    assert stimulus["focus_m"] == [0.0, 0.0, 0.12] and stimulus["drive_level"] == 1.0
    assert skin["depth_max_m"] == pytest.approx(0.008) and skin["accuracy_wanted_relative"] == 0.3
    assert skin["edge_fine_m"] == 0.006 and skin["unknowns"] > 100
    assert {row["what"] for row in facts["modelled"]} >= {"sound field", "drive", "ARP", "skin layer"}
    assert all(set(row) == {"what", "size", "why", "instance"} for row in facts["left_out"] + facts["expected_error"])


def test_a_plan_is_for_the_duration_that_is_asked_for(small_scene, monkeypatch, capsys):
    path = small_scene()
    steps = {s: str(palmfield.plan(path, duration_s=s)).split(" steps of")[0].split()[-1] for s in (0.01, 1.0)}
    assert steps == {0.01: "20", 1.0: "2000"}
    costs = [palmfield.plan(path, duration_s=s).seconds for s in (0.01, 1.0)]
    assert costs[1] > costs[0]
    code, out = call(monkeypatch, capsys, "plan", path, "--duration", "-1")
    assert code == 2 and "--duration has value -1; allowed: seconds > 0" in out.err
    with pytest.raises(palmfield.SceneError, match="-1"):
        palmfield.plan(path, duration_s=-1.0)


def test_a_scene_is_told_by_its_keys(small_scene, monkeypatch, capsys):
    facts = told(monkeypatch, capsys, "info", small_scene())
    assert facts["skins"][0]["keys"]["radius_m"] == 0.02 and facts["arrays"][0]["keys"]["layout"] == "uhev1"
    # Cramer 1993 at 20 C
    assert facts["air"]["sound_speed_m_s"] == pytest.approx(343.4, abs=0.5)
    (sheet,) = facts["skins"][0]["sheets"]
    assert sheet["material"] == "ecoflex_00-10" and sheet["shear_storage_200_Hz_Pa"] > sheet["shear_loss_200_Hz_Pa"] > 0


def test_keys_are_those_of_the_models(monkeypatch, capsys):
    facts = told(monkeypatch, capsys, "keys")
    assert [one["plugin"] for one in facts["plugins"]] == [config.plugin for config in CONFIGS]
    for one, config in zip(facts["plugins"], CONFIGS, strict=True):
        assert [row["key"] for row in one["keys"]] == list(config.model_fields)
        assert all(row["unit"] == unit(row["key"]) for row in one["keys"])
    assert {"palmfield_duration_s", "palmfield_device"} == {row["key"] for row in facts["scene_keys"]}
    assert [one["plugin"] for one in told(monkeypatch, capsys, "keys", "skin")["plugins"]] == ["palmfield.skin"]


def test_two_forms_at_once_are_refused(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "keys", "--json", "--markdown")
    assert code == 2 and not out.out and "give one of them" in out.err


def test_a_refusal_leaves_standard_output_empty(small_scene, monkeypatch, capsys):
    for command in ("run", "plan", "info"):
        code, out = call(monkeypatch, capsys, command, small_scene(skin={"base": "glued"}), "--json")
        assert code == 2 and not out.out and "'glued'" in out.err
