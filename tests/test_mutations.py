"""Known faults, put into a copy of the package one at a time, each turn a named test red."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest
from chosen_tests import name_of, slow_tests
from mutation_table import MUTATIONS, Mutation
from mutations import ROOT, Ended, copied, judged, mutated, outcome_of, pytest_in, unmutated


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package."""
    return copied(tmp_path_factory.mktemp("mutations"))


def quick() -> list[Mutation]:
    """One of each stage that has a quick test."""
    slow = slow_tests()
    return list({one.stage: one for one in MUTATIONS if name_of(one.test) not in slow}.values())


@pytest.mark.parametrize(
    "mutations",
    [pytest.param(quick(), id="quick"), pytest.param(MUTATIONS, id="all", marks=pytest.mark.nightly)],
)
def test_all_pass_without_a_fault(tree: Path, mutations: Sequence[Mutation]) -> None:
    """In a copy, as in the clone, where all of them run anyway."""
    passed, output = unmutated(tree, mutations)
    assert passed, output


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda one: f"{one.stage}: {one.name}")
def test_a_fault_turns_its_test_red(tree: Path, mutation: Mutation) -> None:
    outcome = outcome_of(tree, mutation)
    assert outcome.red, outcome.message


def test_no_fault_is_there_twice_and_none_changes_nothing() -> None:
    assert max(Counter((one.file, one.text, one.becomes) for one in MUTATIONS).values()) == 1
    assert max(Counter((one.stage, one.name) for one in MUTATIONS).values()) == 1
    assert all(one.text != one.becomes for one in MUTATIONS)


def test_what_a_fault_replaces_is_there_once() -> None:
    counts = {one.name: (ROOT / one.file).read_text(encoding="utf-8").count(one.text) for one in MUTATIONS}
    assert {name: count for name, count in counts.items() if count != 1} == {}


def test_only_the_named_tests_own_failure_counts() -> None:
    fault = MUTATIONS[0]

    def red(code: int, failures: dict[str, str]) -> bool:
        return judged(fault, Ended(code, "a last line", failures))[0]

    assert judged(fault, Ended(1, "", {fault.test: "assert 1 == 2"})) == (True, "assert 1 == 2")
    assert red(1, {f"{fault.test}[a-0.5]": "AssertionError: off"})
    assert red(1, {fault.test: "palmfield.errors.SceneError: no"})
    assert not red(1, {fault.test: "ImportError: no"})
    assert not red(1, {fault.test: "NameError: no"})
    assert not red(1, {f"{fault.test}_else": "assert 1 == 2"})
    assert not red(2, {})
    assert judged(fault, Ended(1, "1 error", {})) == (False, "pytest ended with 1: 1 error")
    assert judged(fault, Ended(0, "1 passed", {})) == (False, "the test passes all the same")


@pytest.mark.parametrize(
    "environment",
    [{"COLUMNS": "60"}, {"COLUMNS": "200"}, {"COLUMNS": "60", "CI": "true"}, {"TERM": "dumb"}],
    ids=lambda one: " ".join(f"{name}={value}" for name, value in one.items()),
)
def test_a_failure_is_read_whole_whatever_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, environment: dict[str, str]
) -> None:
    for name in ("CI", "BUILD_NUMBER", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    folder = tmp_path / "tests" / "of_a_folder_with_a_long_name"
    folder.mkdir(parents=True)
    test = f"test_{'with_a_name_as_long_as_a_line_' * 4}that_fails"
    (folder / "test_one.py").write_text(
        "import pytest\n\n\n"
        f"@pytest.mark.parametrize('value', ['a - b [c]'])\ndef {test}(value):\n    assert value == 'd'\n\n\n"
        "@pytest.fixture\ndef broken():\n    assert False\n\n\ndef test_never_begun(broken):\n    pass\n"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = --import-mode=importlib\n")
    file = "tests/of_a_folder_with_a_long_name/test_one.py"
    ended = pytest_in(tmp_path, [f"{file}::{test}"], 60.0)
    assert ended.code == 1 and list(ended.failures) == [f"{file}::{test}[a - b [c]]"]
    assert ended.failures[f"{file}::{test}[a - b [c]]"].startswith("AssertionError: assert 'a - b [c]' == 'd'")
    assert pytest_in(tmp_path, [f"{file}::test_never_begun"], 60.0).failures == {}


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
