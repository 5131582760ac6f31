"""The rules that docs/gallery/tolerances.toml sets itself: kinds, tolerances, readings, controls, first version."""

import copy
import hashlib
import json
import re
import tomllib
from collections import Counter
from pathlib import Path

import pytest

GALLERY = Path(__file__).resolve().parents[2] / "docs" / "gallery"
PAPERS = {"C": "Chilles 2019", "R": "Reardon 2023", "M": "Mizushima 2024", "H": "Hasegawa 2018"}
KINDS = ("INPUT", "CLAIM", "ERRATUM", "CALC")
COLUMNS = {"measured", "simulated", "theory", "input"}
FIELDS = {
    "id",
    "row",
    "paper",
    "quantity",
    "unit",
    "value",
    "column",
    "kind",
    "configuration",
    "tolerance",
    "readings",
    "sensitive_to",
    "testable",
    "reason",
    "source",
}
OPTIONAL = {"corrected", "condition", "why_it_could_fail"}
#: What the owner of the project fixed: rule -> kind and value of the tolerance.
RULES = {
    "given": ("none", 0.0),
    "both_shown": ("none", 0.0),
    "stated_inputs": ("relative", 0.10),
    "missing_inputs": ("relative", 0.25),
    "measured_motion": ("factor", 2.0),
    "angle": ("absolute_degrees", 5.0),
    "angle_exact": ("absolute_degrees", 3.0),
    "level": ("dB", 3.0),
    "depth_ratio": ("relative", 0.25),
    "yes_no": ("inequality", 0.0),
}
#: The fields of an entry that are words: a better sentence is no change of the test.
WORDS = ("reason", "source", "why_it_could_fail")
#: The tables that the digest of the first version covers beside the entries.
HELD = ("tolerance_rules", "configurations", "reading_axes", "controls", "controls_not_used", "metrics", "verdicts")
CHANGE_FIELDS = {"date", "id", "field", "old", "new", "because"}


@pytest.fixture(scope="module")
def table():
    return tomllib.loads((GALLERY / "tolerances.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def entries(table):
    return table["entry"]


@pytest.fixture(scope="module")
def claims(entries):
    return [entry for entry in entries if entry["kind"] == "CLAIM"]


def digest(table):
    """SHA-256 over the entries, less their words, and over the tables that say how they are held."""
    entries = [{key: entry[key] for key in entry if key not in WORDS} for entry in table["entry"]]
    held = {"entry": sorted(entries, key=lambda entry: entry["id"])} | {name: table[name] for name in HELD}
    return hashlib.sha256(json.dumps(held, sort_keys=True).encode()).hexdigest()


def undo(table, changes):
    """The file as it stood before the changes, the latest undone first."""
    before = copy.deepcopy(table)
    by_id = {entry["id"]: entry for entry in before["entry"]}
    for change in reversed(changes):
        name, field = change["id"], change["field"]
        if field == "entry":
            if change["new"]:
                del by_id[name]
            if change["old"]:
                by_id[name] = change["old"]
            continue
        if name in by_id:
            place = by_id[name]
        else:
            section, _, key = name.partition(".")
            place = before[section][key]
        assert place[field] == change["new"], change
        place[field] = change["old"]
    before["entry"] = list(by_id.values())
    return before


def test_each_id_exists_once_and_is_its_row_and_a_letter(entries):
    repeated = [name for name, count in Counter(entry["id"] for entry in entries).items() if count > 1]
    assert not repeated
    for entry in entries:
        assert re.fullmatch(re.escape(entry["row"]) + "[a-z]", entry["id"]), entry["id"]
        assert entry["paper"] == PAPERS[entry["id"][0]]


def test_every_row_is_covered_and_no_other_is_named(table, entries):
    rows = table["row_ids"]
    assert len(rows) == len(set(rows))
    assert {entry["row"] for entry in entries} == set(rows)


def test_fields_are_there_and_known(table, entries):
    for entry in entries:
        assert set(entry) >= FIELDS, entry["id"]
        assert set(entry) <= FIELDS | OPTIONAL, entry["id"]
        assert entry["kind"] in KINDS
        assert entry["column"] in COLUMNS
        assert entry["source"] and entry["reason"] and entry["quantity"]
        assert isinstance(entry["testable"], bool)
        configuration = table["configurations"][entry["configuration"]]
        assert configuration["paper"] == entry["paper"], entry["id"]
        assert set(entry["readings"]) <= set(table["reading_axes"]), entry["id"]
        assert set(entry["sensitive_to"]) <= set(table["controls"]), entry["id"]
    assert set(table["kinds"]) == set(KINDS)


def test_tolerance_rules_are_those_of_the_owner(table):
    assert {name: (rule["kind"], rule["value"]) for name, rule in table["tolerance_rules"].items()} == RULES


def test_every_tolerance_is_its_rule(table, entries):
    loosened = {(change["id"], change["field"]) for change in table["changes"]}
    for entry in entries:
        tolerance = entry["tolerance"]
        assert set(tolerance) == {"rule", "kind", "value"}
        if (entry["id"], "tolerance") not in loosened:
            assert (tolerance["kind"], tolerance["value"]) == RULES[tolerance["rule"]], entry["id"]


def test_tolerances_follow_kind_unit_and_column(entries):
    for entry in entries:
        rule, name = entry["tolerance"]["rule"], entry["id"]
        assert (rule == "given") == (entry["kind"] == "INPUT"), name
        assert (rule == "both_shown") == (entry["kind"] == "ERRATUM"), name
        assert (rule == "yes_no") == ("condition" in entry), name
        if entry["kind"] in ("INPUT", "ERRATUM") or rule == "yes_no":
            continue
        assert (rule == "level") == (entry["unit"] == "dB"), name
        assert (rule in ("angle", "angle_exact")) == (entry["unit"] == "deg"), name
        if entry["unit"] == "deg":
            assert (rule == "angle_exact") == (entry["column"] == "theory"), name
        moved = entry["column"] == "measured" and entry["unit"] in ("um", "mN") and entry["kind"] == "CLAIM"
        assert (rule == "measured_motion") == moved, name


def test_a_tolerance_with_a_number_has_numbers_to_hold(entries):
    for entry in entries:
        if entry["tolerance"]["rule"] in ("stated_inputs", "missing_inputs", "measured_motion", "level", "depth_ratio"):
            values = entry["value"] if isinstance(entry["value"], list) else [entry["value"]]
            assert all(isinstance(value, int | float) and value != 0 for value in values), entry["id"]


def test_a_claim_says_why_it_could_fail(claims):
    for entry in claims:
        why = entry.get("why_it_could_fail", "")
        assert len(why) > 30 and why.endswith("."), entry["id"]
        assert entry["tolerance"]["kind"] != "none"


def test_only_claims_say_why_and_only_errata_correct(entries):
    for entry in entries:
        assert ("why_it_could_fail" in entry) == (entry["kind"] == "CLAIM"), entry["id"]
        assert ("corrected" in entry) == (entry["kind"] == "ERRATUM"), entry["id"]
        if entry["kind"] == "ERRATUM":
            assert entry["corrected"] != entry["value"]
        if entry["kind"] in ("INPUT", "ERRATUM"):
            assert entry["testable"] is False, entry["id"]


def test_readings_have_a_place_and_are_used(table, entries):
    used = {name for entry in entries for name in entry["readings"]}
    assert used == set(table["reading_axes"])
    for name, axis in table["reading_axes"].items():
        assert len(axis["values"]) >= 2 and len(set(axis["values"])) == len(axis["values"]), name
        assert len(axis["place"]) > 30, name


def test_controls_and_entries_name_each_other(table, entries):
    by_id = {entry["id"]: entry for entry in entries}
    for name, control in table["controls"].items():
        assert control["changes"] and control["sensitive"], name
        assert len(set(control["sensitive"])) == len(control["sensitive"])
        for claim in control["sensitive"]:
            entry = by_id[claim]
            assert entry["kind"] == "CLAIM" and entry["testable"], (name, claim)
            assert entry["configuration"] in control["configurations"], (name, claim)
            assert name in entry["sensitive_to"], (name, claim)
    for entry in entries:
        for name in entry["sensitive_to"]:
            assert entry["id"] in table["controls"][name]["sensitive"], (name, entry["id"])
    assert not set(table["controls_not_used"]) & set(table["controls"])


def test_what_was_dropped_beforehand_is_no_claim(claims):
    rows = {entry["row"] for entry in claims}
    assert not rows & {"M14", "M15", "H4", "H5", "H16"}
    for entry in claims:
        if "settling" in entry["quantity"]:
            assert not entry["testable"], entry["id"]


def test_every_metric_names_its_estimator(table):
    for name, metric in table["metrics"].items():
        assert metric["estimator"], name
    assert {"ssim", "mse", "mach_angle"} <= set(table["metrics"])
    assert {"distances_mm", "snapshot"} <= set(table["metrics"]["mach_angle"])


def test_every_change_since_the_first_version_is_written_down(table):
    for change in table["changes"]:
        assert set(change) == CHANGE_FIELDS and change["because"]
    assert digest(undo(table, table["changes"])) == table["original"]["digest"]


@pytest.mark.parametrize(("name", "field", "new"), [("C15c", "value", -2.0), ("metrics.ssim", "k1", 0.1)])
def test_a_silent_change_is_noticed(table, name, field, new):
    changed = copy.deepcopy(table)
    places = {entry["id"]: entry for entry in changed["entry"]} | {"metrics.ssim": changed["metrics"]["ssim"]}
    old, places[name][field] = places[name][field], new
    assert digest(undo(changed, table["changes"])) != table["original"]["digest"]
    written = {"date": "", "id": name, "field": field, "old": old, "new": new, "because": "a test"}
    assert digest(undo(changed, [*table["changes"], written])) == table["original"]["digest"]


def test_the_page_counts_as_the_file_does(entries):
    page = (GALLERY / "README.md").read_text(encoding="utf-8")
    for paper in PAPERS.values():
        of_paper = [entry for entry in entries if entry["paper"] == paper]
        count = Counter(entry["kind"] for entry in of_paper)
        untestable = sum(entry["kind"] == "CLAIM" and not entry["testable"] for entry in of_paper)
        row = f"| {paper} | {count['INPUT']} | {count['CLAIM']} | {untestable} | {count['ERRATUM']} | {count['CALC']} |"
        assert row in page
