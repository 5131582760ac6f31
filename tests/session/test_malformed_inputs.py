"""Two hundred malformed inputs: each is refused in a line, or was right after all; none ends in a traceback or a crash.

More of them by scripts/verification/fuzz.py, whose counts are in docs/bench/fuzzing.md.
"""

import os
from pathlib import Path

import pytest
from fuzz import BAD, Outcome, kinds_of, run_cases
from fuzz_cases import BALL, FORBIDDEN_EDITS, HAPTIC, KINDS, NEEDED, PLAIN, RULES, Case, drawn, written
from fuzz_trees import SMALL, drawn_trees
from small_scene import small_scene_texts

from palmfield.config import CONFIGS, parse

pytestmark = pytest.mark.slow
COUNT, SEED = 200, 20


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    return run_cases(drawn(kinds_of(COUNT), SEED))


def test_two_hundred_malformed_inputs(outcomes):
    assert len({repr(one.case) for one in outcomes}) == COUNT
    bad = [f"{one.outcome}: {one.case.kind}, {one.case.fault} {one.case.values}: {one.message}" for one in outcomes]
    assert not [text for text, one in zip(bad, outcomes, strict=True) if one.outcome in BAD]


def test_most_of_them_break_a_rule(outcomes):
    forbidden = [one for one in outcomes if one.case.forbidden]
    assert len(forbidden) > COUNT / 2 and all(one.outcome == "refused" for one in forbidden)
    assert {one.case.kind for one in forbidden} == {"keys", "rules", "scene", "mesh"}


def test_what_they_are_made_from_is_accepted():
    """Else all of them would be refused for another reason than their fault."""
    whole = [Case("mesh", "none", False, files={f"mesh.{kind}": written(BALL, kind)}) for kind in KINDS]
    whole.append(Case("scene", "none", False, files={"plain.xml": PLAIN.encode(), "scene.xml": HAPTIC.encode()}))
    assert [(one.outcome, one.message) for one in run_cases(whole)] == [("accepted", "")] * len(whole)
    for config in CONFIGS:
        parse(config, NEEDED.get(config.plugin, {}), "it")
    for file, old, _ in FORBIDDEN_EDITS.values():
        assert old in {"plain.xml": PLAIN, "scene.xml": HAPTIC}[file], old
    assert len(RULES) > 30


@pytest.mark.parametrize("count", [30, pytest.param(COUNT, marks=pytest.mark.nightly)])
def test_scenes_that_stay_well_formed(count):
    """Planned, and stepped where they are accepted; shipped scenes, which take longer, by the script only."""
    forms = [small_scene_texts(0.01, **changes) for changes in SMALL]
    whole = [Case("tree", "none", False, {"plain.xml": one.encode(), "scene.xml": two.encode()}) for one, two in forms]
    assert [(one.outcome, one.message) for one in run_cases(whole)] == [("accepted", "")] * len(whole)
    found = run_cases(drawn_trees(count, SEED, share_of_shipped=0.0))
    bad = [f"{one.outcome}: {one.case.fault}: {one.message}\n{one.case.files}" for one in found if one.outcome in BAD]
    assert not bad, "\n".join(bad)
    assert sum(one.outcome == "accepted" for one in found) > 0.15 * count


DIES = """
import os, sys
import fuzz_worker
plain = fuzz_worker.load_case
def load_case(case, folder):
    if case.fault == "dies":
        os._exit(7)
    if case.fault == "fails":
        raise ValueError("of its own")
    plain(case, folder)
fuzz_worker.load_case = load_case
fuzz_worker.main()
"""


def test_a_process_that_dies_is_seen_and_the_others_go_on(monkeypatch, tmp_path):
    import fuzz

    worker = tmp_path / "fuzz_worker.py"
    here = Path(fuzz.__file__).parent
    worker.write_text(f"import sys; sys.path.insert(0, {str(here)!r})\n" + DIES)
    monkeypatch.setattr(fuzz, "HERE", tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(here), os.environ.get("PYTHONPATH", "")]))
    fine = {"plugin": "palmfield.driver", "values": {"board": "ideal"}}
    faults = ("none", "dies", "none", "fails", "dies")
    cases = [Case("keys", fault, False, **fine) for fault in faults] + [Case("keys", "allowed", True, **fine)]
    found = [one.outcome for one in run_cases(cases)]
    assert found == ["accepted", "crash", "accepted", "traceback", "crash", "accepted against a rule"]
