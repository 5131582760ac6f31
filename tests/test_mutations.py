"""Known faults, put into a copy of the package one at a time, each turn a named test red."""

from collections import Counter
from pathlib import Path

import pytest
from mutation_table import MUTATIONS, Mutation
from mutations import copied, judged, mutated, outcome_of, unmutated


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package."""
    return copied(tmp_path_factory.mktemp("mutations"))


@pytest.mark.slow
def test_all_pass_without_a_fault(tree: Path) -> None:
    passed, output = unmutated(tree, MUTATIONS)
    assert passed, output


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda one: f"{one.stage}: {one.name}")
def test_a_fault_turns_its_test_red(tree: Path, mutation: Mutation) -> None:
    outcome = outcome_of(tree, mutation)
    assert outcome.red, outcome.said


def test_no_fault_is_there_twice_and_none_changes_nothing() -> None:
    assert max(Counter((one.file, one.text, one.becomes) for one in MUTATIONS).values()) == 1
    assert max(Counter((one.stage, one.name) for one in MUTATIONS).values()) == 1
    assert all(one.text != one.becomes for one in MUTATIONS)


def test_only_the_named_tests_own_failure_counts() -> None:
    fault = MUTATIONS[0]
    name = fault.test
    assert judged(fault, 1, f"FAILED {name} - assert 1 == 2\n") == (True, "assert 1 == 2")
    assert judged(fault, 1, f"FAILED {name}[a-0.5] - AssertionError: off\n")[0]
    assert judged(fault, 1, f"FAILED {name} - palmfield.errors.SceneError: no\n")[0]
    assert not judged(fault, 1, f"FAILED {name} - ImportError: no\n")[0]
    assert not judged(fault, 1, f"FAILED {name} - NameError: no\n")[0]
    assert not judged(fault, 1, f"FAILED {name}_else - assert 1 == 2\n")[0]
    assert not judged(fault, 1, f"ERROR {name} - assert 1 == 2\n")[0]
    assert not judged(fault, 2, "ERROR tests/conftest.py - SyntaxError\n")[0]
    assert judged(fault, 0, "1 passed") == (False, "the test passes all the same")


def test_a_copy_is_left_as_it_was(tmp_path: Path) -> None:
    fault = MUTATIONS[0]
    path = tmp_path / fault.file
    path.parent.mkdir(parents=True)
    whole = f"before {fault.text} after\n"
    path.write_text(whole)
    with mutated(tmp_path, fault):
        assert path.read_text() == f"before {fault.becomes} after\n"
    assert path.read_text() == whole
    path.write_text(2 * whole)
    with pytest.raises(ValueError, match="2 times"), mutated(tmp_path, fault):
        pass
