"""Scenes small enough to step in a test."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from palmfield.acoustics import surface_arp
from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.reference import pressure64
from palmfield.engine.host import world_of
from palmfield.types import Air, Array, Complex, Float

# A test computes what it tests, and leaves nothing behind
os.environ["PALMFIELD_CACHE"] = "off"

AIR = Air()
ARRAYS = Path(__file__).parent.parent / "mjcf" / "arrays"

PLAIN = """
<mujoco model="small_plain">
  <include file="{arrays}/uhev1.xml"/>
  <worldbody>
    <body name="pad" pos="0 0 0.12" quat="0 1 0 0" gravcomp="1">
      <joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>
      <site name="centre" size="0.001"/>
      <geom type="cylinder" size="0.02 0.004" pos="0 0 -0.004" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""

HAPTIC = """
<mujoco model="small">
  <include file="plain.xml"/>
  <option timestep="0.001"/>
  <custom>
    <numeric name="palmfield_duration_s" data="{duration_s}"/>
    <text name="palmfield_device" data="{device}"/>
  </custom>
  <extension>
    <plugin plugin="palmfield.array"><instance name="array">{array}</instance></plugin>
    <plugin plugin="palmfield.stimulus"><instance name="stimulus">{stimulus}</instance></plugin>
    <plugin plugin="palmfield.skin"><instance name="skin">{skin}</instance></plugin>
    <plugin plugin="palmfield.driver"><instance name="driver">{driver}</instance></plugin>
  </extension>
  <sensor><plugin name="skin" plugin="palmfield.skin" instance="skin" objtype="site" objname="centre"/></sensor>
</mujoco>
"""

DEFAULTS: dict[str, dict[str, object]] = {
    "array": {},
    "stimulus": {
        "focus_m": "0 0 0.12", "modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": 200, "am_depth": 1,
    },
    "skin": {
        "body": "pad", "shape": "disc", "radius_m": 0.02, "thickness_m": 0.008, "material": "ecoflex_00-10",
        "side": "free", "element_m": 0.006, "step_s": 0.0005,
    },
    "driver": {"board": "ideal"},
}  # fmt: skip

Write = Callable[..., Path]


def _writer(folder: Path) -> Write:
    def write(*, device: str = "cpu", duration_s: float = 0.015, **changes: dict[str, object]) -> Path:
        texts = {}
        for module, defaults in DEFAULTS.items():
            keys = defaults | changes.get(module, {})
            texts[module] = "".join(f'<config key="{k}" value="{v}"/>' for k, v in keys.items() if v is not None)
        (folder / "plain.xml").write_text(PLAIN.format(arrays=ARRAYS))
        path = folder / "small.xml"
        path.write_text(HAPTIC.format(device=device, duration_s=duration_s, **texts))
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


@pytest.fixture(scope="session")
def arp64() -> Callable[..., Float]:
    """ARP [Pa] by the default law in double precision, from velocities, at points with outward normals."""

    def arp(points: Float, normals: Float, array: Array, drive: Complex, air: Air = AIR) -> Float:
        p, slope = pressure64(points, array, drive, air, gradient=True)
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

        sys.setprofile(note)
        try:
            call()
        finally:
            sys.setprofile(None)
        return seen - 1

    return count


@pytest.fixture
def many_threads(monkeypatch: pytest.MonkeyPatch) -> Callable[[mujoco.MjData], int]:
    """Even small fields are shared out among four threads; tells into how many blocks those of a scene were."""
    monkeypatch.setattr(surface_arp, "PAIRS_PER_THREAD", 1)
    monkeypatch.setattr(surface_arp, "SMALL_BLOCK_PAIRS", 1)
    monkeypatch.setattr(surface_arp, "cores", lambda: 4)

    def blocks(data: mujoco.MjData) -> int:
        world = world_of(data)
        assert world is not None
        kept = world.scene.work.radiation._evaluators.values()
        return max(len(evaluator._blocks) if evaluator._threads > 1 else 1 for _, evaluator in kept)

    return blocks
