"""Put known faults into palmfield one at a time; each must make its test fail. Writes docs/bench/mutations.md.

python scripts/verification/mutations.py --write docs/bench/mutations.md
"""

import argparse
import atexit
import gc
import importlib
import importlib.util
import inspect
import multiprocessing
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import Queue
from types import CodeType, FunctionType
from typing import NamedTuple
from unittest import mock
from xml.etree import ElementTree

import pytest
from mutation_table import MUTATIONS, Mutation

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("palmfield", "warp_kernels", "tests", "mjcf", "hand_models", "scripts", "pyproject.toml")
LONGEST_S = 120.0
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
FORKS = multiprocessing.get_context("forkserver")
"""Process that forks after it has imported all packages except palmfield: half the time of a short test."""
FORKS.set_forkserver_preload(["third_party"])
STARTING = threading.Lock()
"""Lock for the environment, which changes while a process starts."""
NOT_BY_FUNCTIONS = 77
"""Exit of a fork without a test, if its fault is not in functions only."""
EXPECTED = re.compile(r"assert |AssertionError|Failed: |palmfield\.errors\.")
"""Valid failures of a test under a mutation: its own assertion, or an error that palmfield raises on purpose."""


class Outcome(NamedTuple):
    """Result of a test under its mutation. red: whether it failed as required; said: its reason, or the problem"""

    mutation: Mutation
    red: bool
    message: str
    seconds: float


def copied(folder: Path) -> Path:
    """Return a copy of the package with its tests below a folder. File times are kept, so bytecode stays valid."""
    tree = folder / "palmfield"
    tree.mkdir()
    for name in COPIED:
        if (ROOT / name).is_dir():
            # Not what another process is just compiling
            shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("*.pyc.*"))
        else:
            shutil.copy2(ROOT / name, tree / name)
    return tree


@contextmanager
def mutated(tree: Path, mutation: Mutation) -> Iterator[None]:
    """Return a copy with one text replaced. Raises ValueError if the text does not occur exactly once."""
    path = tree / mutation.file
    whole = path.read_text(encoding="utf-8")
    if (count := whole.count(mutation.text)) != 1:
        raise ValueError(f"{mutation.name}: {mutation.file} has {mutation.text!r} {count} times; it must have it once")
    # Python takes a compiled file for current by its whole seconds and its size, which a mutation may keep
    compiled = Path(importlib.util.cache_from_source(str(path)))
    try:
        compiled.unlink(missing_ok=True)
        path.write_text(whole.replace(mutation.text, mutation.becomes), encoding="utf-8")
        yield
    finally:
        path.write_text(whole, encoding="utf-8")
        compiled.unlink(missing_ok=True)


class Ended(NamedTuple):
    """End of a pytest process.

    code: exit code, -1 after its time limit, -2 if the process ended without one; output: its printed output
    failures: first line of the message by test, named as on pytest's command line; without errors of fixtures
    """

    code: int
    output: str
    failures: dict[str, str]


def pytest_in(tree: Path, tests: Sequence[str], longest_s: float) -> Ended:
    """Run tests of a copy in another process, and read its exit code and its JUnit file.

    The file is used because printed lines may be cut to the width of a terminal.
    """
    receiver, sender = FORKS.Pipe(duplex=False)
    process = _started(tree, _run_pytest, _options(tree, tests), sender)
    sender.close()
    if not receiver.poll(longest_s):
        process.kill()
        process.join()
        return Ended(-1, f"took more than {longest_s:g} s", {})
    try:
        code = receiver.recv()
    except EOFError:
        code = -2
    process.join()
    return _ended(tree, code)


def pytest_under(tree: Path, fault: Path, was: str, tests: Sequence[str], longest_s: float) -> Ended:
    """Run tests as `pytest_in`, in a fork of a process that imported the copy with the original text `was`.

    The fork replaces the functions that differ, so that it need not import the rest again.
    """
    requests = imported(tree)
    requests.send((_options(tree, tests), fault, was))
    number = requests.recv()
    late = not requests.poll(longest_s)
    if late:
        os.kill(number, signal.SIGKILL)
    code = requests.recv()
    if late:
        return Ended(-1, f"took more than {longest_s:g} s", {})
    return _ended(tree, code)


@cache
def imported(tree: Path) -> Connection:
    """Return a connection to a process that has imported palmfield from a copy, and forks at each request."""
    ours, theirs = FORKS.Pipe()
    _started(tree, _fork_on_request, theirs)
    theirs.close()
    atexit.register(ours.close)
    ours.recv()
    return ours


def _options(tree: Path, tests: Sequence[str]) -> list[str]:
    report = tree / "junit.xml"
    report.unlink(missing_ok=True)
    # Without what takes longer than a short test: source lines of a failure, and collections of garbage at the end
    plugins = ["-p", "no:cacheprovider", "-p", "no:unraisableexception"]
    return [*plugins, "-q", "-x", "--tb=line", f"--junitxml={report}", *tests]


def _ended(tree: Path, code: int) -> Ended:
    printed = (tree / "printed.txt").read_text(encoding="utf-8", errors="replace")
    return Ended(code, printed, failures_in(tree / "junit.xml"))


def _started(tree: Path, target: Callable[..., None], *arguments: object) -> BaseProcess:
    """Start a process that was forked before any import of palmfield, and runs a function on a copy."""
    own = {"PYTHONPATH": str(tree), "PALMFIELD_CACHE": "off", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", **ONE_THREAD}
    with STARTING:
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    # The process to fork starts with the first test, and finds its module by this path.
    with STARTING, mock.patch.dict(os.environ, PYTHONPATH=str(Path(__file__).parent), **ONE_THREAD):
        process = FORKS.Process(target=target, args=(tree, inherited | own, *arguments))
        process.start()
    return process


def _run_pytest(tree: Path, environment: dict[str, str], options: list[str], sender: Connection) -> None:
    """Run pytest on a copy; send its exit code."""
    _print_to(tree)
    _import_from(tree, environment)
    sender.send(int(pytest.main(options)))


def _fork_on_request(tree: Path, environment: dict[str, str], requests: Connection) -> None:
    """Send the number of a fork that runs pytest with a fault, and then its exit code, for each request."""
    _import_from(tree, environment)
    package = importlib.import_module("palmfield")
    for name in package.__all__:
        getattr(package, name)
    requests.send(None)
    while True:
        try:
            options, fault, was = requests.recv()
        except EOFError:
            return
        number = os.fork()
        if number == 0:
            code = -2
            try:
                _print_to(tree)
                code = int(pytest.main(options)) if replace_functions(fault, was) else NOT_BY_FUNCTIONS
                sys.stdout.flush()
            finally:
                os._exit(code)
        requests.send(number)
        requests.send(os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]))


def _print_to(tree: Path) -> None:
    os.dup2(os.open(tree / "printed.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
    os.dup2(1, 2)


def _import_from(tree: Path, environment: dict[str, str]) -> None:
    """Import palmfield from a copy. Raises RuntimeError if a part of palmfield is already imported."""
    if "palmfield" in sys.modules:
        raise RuntimeError("palmfield was imported before the copy that is tested")
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = False
    # As importing mujoco would
    importlib.import_module("palmfield.engine.register").register()


def replace_functions(path: Path, was: str) -> bool:
    """Replace the code of all functions of a module by that in its present file, in all references to them.

    was: text of the file when the module was imported, if it was imported
    Returns whether only functions have changed: the rest of the module has already run, and Warp has read its kernels.
    """
    now = path.read_text(encoding="utf-8")
    before, after = (list(_codes(compile(text, str(path), "exec"))) for text in (was, now))
    pairs = list(zip(before, after, strict=False))
    run_once = [pair for pair in pairs if not pair[0].co_flags & inspect.CO_OPTIMIZED]
    if "@wp." in now or len(before) != len(after) or any(_own(one) != _own(other) for one, other in run_once):
        return False
    code = {(one.co_qualname, one.co_firstlineno): other for one, other in pairs}
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and function.__code__.co_filename == str(path):
            function.__code__ = code[function.__code__.co_qualname, function.__code__.co_firstlineno]
    return True


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Return a code object and the code objects in it, in the order of the text."""
    yield code
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _codes(part)


def _own(code: CodeType) -> tuple[object, ...]:
    """Return the instructions of a code object, without the code objects in it."""
    return code.co_code, code.co_names, [repr(part) for part in code.co_consts if not isinstance(part, CodeType)]


def failures_in(report: Path) -> dict[str, str]:
    """Return first lines of the messages of failed tests in a JUnit file, by test; empty if there is no file."""
    if not report.exists():
        return {}
    found = {}
    for case in ElementTree.parse(report).iter("testcase"):
        if (failure := case.find("failure")) is not None:
            file = case.get("classname", "").replace(".", "/") + ".py"
            found[f"{file}::{case.get('name', '')}"] = failure.get("message", "").partition("\n")[0]
    return found


def judged(mutation: Mutation, ended: Ended) -> tuple[bool, str]:
    """Return whether a test failed as required under its mutation, and why."""
    if ended.code == 0:
        return False, "the test passes all the same"
    own = (message for name, message in ended.failures.items() if mutation.test in (name, name.partition("[")[0]))
    reason = next(own, None)
    if ended.code != 1 or reason is None:
        last = ended.output.strip().splitlines()[-1] if ended.output.strip() else "nothing printed"
        return False, f"pytest ended with {ended.code}: {last}"
    return bool(EXPECTED.match(reason)), reason


def outcome_of(tree: Path, mutation: Mutation) -> Outcome:
    """Return the outcome of a mutation's test in a copy, which is restored afterwards."""
    began = time.perf_counter()
    fault = tree / mutation.file
    was = fault.read_text(encoding="utf-8")
    imported(tree)
    with mutated(tree, mutation):
        red, message = judged(mutation, pytest_under(tree, fault, was, [mutation.test], LONGEST_S))
        if not red:
            # The fault may be in what runs on import, of this module or of those that call it then
            red, message = judged(mutation, pytest_in(tree, [mutation.test], LONGEST_S))
    return Outcome(mutation, red, message, time.perf_counter() - began)


def unmutated(tree: Path, mutations: Sequence[Mutation]) -> tuple[bool, str]:
    """Return whether all tests of mutations pass in a copy without any, and pytest's output."""
    ended = pytest_in(tree, list(dict.fromkeys(one.test for one in mutations)), LONGEST_S * len(mutations))
    return ended.code == 0, ended.output


def outcomes_of(folder: Path, mutations: Sequence[Mutation], jobs: int) -> Iterator[Outcome]:
    """Return the outcomes of mutations in their order; `jobs` run at once, each in its own copy below a folder."""
    trees: Queue[Path] = Queue()
    for number in range(jobs):
        (folder / str(number)).mkdir()
        trees.put(copied(folder / str(number)))

    def one(mutation: Mutation) -> Outcome:
        tree = trees.get()
        try:
            return outcome_of(tree, mutation)
        finally:
            trees.put(tree)

    with ThreadPoolExecutor(jobs) as pool:
        yield from pool.map(one, mutations)


def page(outcomes: Sequence[Outcome]) -> str:
    """Return Markdown for docs/bench/mutations.md."""
    red = sum(one.red for one in outcomes)
    lines = [
        "# Faults that the tests find",
        "",
        "    python scripts/verification/mutations.py --write docs/bench/mutations.md",
        "",
        "For developers. A mutation is a fault that is put into a copy of the package on purpose, one at a time. A "
        f"test is named for each of the {len(outcomes)} faults (`scripts/verification/mutation_table.py`). This "
        "test must fail with the fault, by its own assertion or by an error of palmfield, and pass without it. "
        f"This holds for {red} of {len(outcomes)} faults. CI runs all of them (`tests/test_mutations.py`).",
        "",
        "If there is a test of accuracy for a fault, this test is used. A test of accuracy compares with an exact "
        "solution, a measurement, or an independent float64 code. The other tests are tests of consistency.",
        "",
    ]
    lines += [f"- not found: `{one.mutation.test}`: {one.message}" for one in outcomes if not one.red]
    seconds = sum(one.seconds for one in outcomes)
    load = f"at a load average of {os.getloadavg()[0]:.1f}"
    message = f"All tests together take {seconds:.0f} s. Each test ran in its own process, {load}."
    return "\n".join([*lines, message, ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="words in the names or stages of the mutations to run; all by default")
    parser.add_argument("--list", action="store_true", help="list the mutations and run nothing")
    parser.add_argument("--jobs", type=int, default=2, help="processes at once, 2 by default")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="write the page of results")
    arguments = parser.parse_args()
    chosen = [one for one in MUTATIONS if all(word in f"{one.stage} {one.name}" for word in arguments.names)]
    if not chosen:
        parser.error(f"no mutation has {' '.join(arguments.names)!r} in its name or stage: see --list")
    if arguments.list:
        print("\n".join(f"{one.stage}: {one.name} ({one.file}) -> {one.test}" for one in chosen))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        tree = copied(Path(folder))
        print(f"tests of {len(chosen)} mutations without them", flush=True)
        passed, output = unmutated(tree, chosen)
        if not passed:
            print(output)
            return 1
        outcomes = []
        for one in outcomes_of(Path(folder), chosen, arguments.jobs):
            outcomes.append(one)
            verdict, name = "red" if one.red else "NOT RED", f"{one.mutation.stage}, {one.mutation.name}"
            print(f"{len(outcomes)}/{len(chosen)} {verdict} {one.seconds:.1f} s  {name}: {one.message}", flush=True)
    if arguments.write is not None:
        arguments.write.write_text(page(outcomes), encoding="utf-8")
    return 0 if all(one.red for one in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
