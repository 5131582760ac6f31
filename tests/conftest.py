"""Scenes small enough to step in a test."""

import functools
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from chosen_tests import FIXTURE, choose, lacks_marker, name_of_fixture
from second_of_something import add_array as add_array
from second_of_something import add_skin as add_skin
from second_of_something import moment as moment
from small_scene import small_scene_texts

from palmfield import threads
from palmfield.acoustics import field, surface_arp
from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.reference import pressure64
from palmfield.engine.host import world_of
from palmfield.outputs import render
from palmfield.types import Air, Array, Complex, Float

# A test computes what it tests, and leaves nothing behind
os.environ["PALMFIELD_CACHE"] = "off"
# Tables are as wide as their words want, whatever terminal the tests run in
os.environ["COLUMNS"] = "130"
# A run draws its scene, which takes two seconds at the quality that users get: `drawn_as_for_users`
QUALITY = render.SUPERSAMPLING, render.AMBIENT_RAYS
render.SUPERSAMPLING, render.AMBIENT_RAYS = 1, 1

AIR = Air()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--nightly", action="store_true", help="also run the long checks marked nightly")


def pytest_configure(config: pytest.Config) -> None:
    """Of processes that share the machine each takes its share of cores, but where times are real, and nightly."""
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if processes > 1 and not config.getoption("--nightly") and config.option.markexpr != "wall_clock":
        threads.limit(max(1, threads.cores() // processes))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    return lacks_marker(config, collection_path) or None


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    choose(config, items)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest) -> Iterator[object]:
    """Write down what a fixture takes that serves several tests: it is not the first test's own time."""
    began = time.perf_counter()
    result = yield
    if fixturedef.scope != "function":
        took = time.perf_counter() - began
        request._pyfuncitem.user_properties.append(
            (FIXTURE, f"{name_of_fixture(fixturedef.baseid, fixturedef.argname)} {took:.2f}")
        )
    return result


def pytest_collection_finish() -> None:
    """What was imported stays: collections of garbage in tests need not go through it again."""
    gc.freeze()


Write = Callable[..., Path]


def _writer(folder: Path) -> Write:
    def write(*, device: str = "cpu", duration_s: float = 0.015, **changes: dict[str, object]) -> Path:
        plain, haptic = small_scene_texts(duration_s, device, **changes)
        (folder / "plain.xml").write_text(plain)
        path = folder / "small.xml"
        path.write_text(haptic)
        return path

    return write


@pytest.fixture
def small_scene(tmp_path: Path) -> Write:
    """Writes a disc of 40 mm over an array; keywords such as skin={"base": "free_slip"} change or (None) drop keys.

    device: where fields are computed; duration_s: of a run
    """
    return _writer(tmp_path)


@pytest.fixture(scope="module")
def module_scene(tmp_path_factory: pytest.TempPathFactory) -> Write:
    """As small_scene, for a fixture that serves a whole file."""
    return _writer(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def kept_operators(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """One cache for the files that use it: what equal scenes need is computed once. Not where a test changes code."""
    base = tmp_path_factory.getbasetemp()
    # Of all processes of a run, not of each
    folder = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PALMFIELD_CACHE", str(folder / "kept_operators"))
        yield


@pytest.fixture
def all_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """No limit of cores, and helpers for all of them, until the test ends."""
    monkeypatch.setattr(threads, "_most", [])
    monkeypatch.setattr(threads, "_helpers", functools.cache(threads._helpers.__wrapped__))


@pytest.fixture
def drawn_as_for_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of scenes have all their rays."""
    monkeypatch.setattr(render, "SUPERSAMPLING", QUALITY[0])
    monkeypatch.setattr(render, "AMBIENT_RAYS", QUALITY[1])


@pytest.fixture(scope="session")
def arp64() -> Callable[..., Float]:
    """ARP [Pa] by the default law in double precision, from velocities, at points with outward normals."""

    def arp(points: Float, normals: Float, array: Array, drive: Complex, air: Air = AIR) -> Float:
        p, slope = pressure64(points, array, drive, air, gradient=True, normals=normals)
        assert slope is not None
        rho, c = density(air), sound_speed(air)
        u = slope / (2j * np.pi * array.frequency_Hz * rho)
        along = np.einsum("ij,ij->i", u, normals)
        tangential = u - along[:, None] * normals
        load = np.abs(p) ** 2 / (rho * c**2) - rho * (np.abs(tangential) ** 2).sum(axis=1)
        return np.where((p * along.conj()).real < 0.0, load, 0.0)

    return arp


@pytest.fixture(scope="session")
def python_calls() -> Callable[[Callable[[], object]], int]:
    """Counts the Python functions that a call runs, C functions left out; the call itself is not counted."""

    def count(call: Callable[[], object]) -> int:
        seen = 0

        def note(frame: object, event: str, argument: object) -> None:
            nonlocal seen
            seen += event == "call"

        # What an earlier test left behind is not collected in the middle
        collects = gc.isenabled()
        gc.disable()
        sys.setprofile(note)
        try:
            call()
        finally:
            sys.setprofile(None)
            if collects:
                gc.enable()
        return seen - 1

    return count


@pytest.fixture
def yardsticks() -> Callable[[Callable[[], object]], float]:
    """How many times as long as a fixed loop in Python a call takes, in seconds of the process; least of three loops.

    One is some 5 ms of a core of 2023. Both are measured at one time, so that a slow or busy machine fails nothing.
    """

    def busy(call: Callable[[], object]) -> float:
        begin = time.process_time()
        call()
        return time.process_time() - begin

    def loop() -> int:
        return sum(i * i for i in range(100_000))

    def count(call: Callable[[], object]) -> float:
        before = [busy(loop) for _ in range(2)]
        taken = busy(call)
        return taken / min(*before, busy(loop))

    return count


@pytest.fixture
def many_threads(monkeypatch: pytest.MonkeyPatch) -> Callable[[mujoco.MjData], int]:
    """Even small fields are shared out among four threads; tells into how many blocks those of a scene were."""
    monkeypatch.setattr(field, "PAIRS_PER_THREAD", 1)
    monkeypatch.setattr(field, "SMALL_BLOCK_PAIRS", 1)
    monkeypatch.setattr(surface_arp, "cores", lambda: 4)

    def blocks(data: mujoco.MjData) -> int:
        world = world_of(data)
        assert world is not None
        kept = [value for _, value in world.scene.work.radiation._shared._last.values()]
        fields = [value for value in kept if isinstance(value, surface_arp.SurfaceArp)]
        return max(len(one._blocks) if one._threads > 1 else 1 for one in fields)

    return blocks
