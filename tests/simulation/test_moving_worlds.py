"""Worlds whose bodies move, in one graph on a device (here the CPU as one), against simulations by themselves."""

from typing import Any

import numpy as np
import pytest

import palmfield
from palmfield.data import folder
from palmfield.simulation import moving_worlds

SCENES = folder("mjcf") / "scenes"
COARSE = {"skin.accuracy": 0.5, "skin.max_frequency_Hz": 300}


@pytest.fixture
def by_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    """The CPU is taken for a device whose graphs step worlds."""
    monkeypatch.setattr(moving_worlds, "serves", lambda model: True)


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference over the largest number of the second."""
    return float(np.abs(one - other).max()) / float(np.abs(other).max())


@pytest.mark.parametrize(
    ("scene", "differs", "start_s"),
    [
        (
            "hover_explore",
            {"stimulus.path_diameter_m": [0.02, 0.015, 0.01], "stimulus.drive_amplitude": [1, 0.5, 0.8]},
            0.1,
        ),
        ("follow_fingertip", {"stimulus.am_frequency_Hz": [200, 150, 80]}, 0.1),
    ],
)
def test_worlds_are_what_each_is_by_itself(
    by_graph: None, scene: str, differs: dict[str, list[float]], start_s: float
) -> None:
    path = SCENES / f"{scene}.xml"
    worlds: Any = palmfield.Simulation(path, worlds=3, keys=COARSE | differs)
    worlds.start_at(start_s)
    worlds.step(4)
    assert len(worlds._scenes.moving.joined) == 3
    for world in range(3):
        keys = {name: values[world] for name, values in differs.items()}
        alone = palmfield.Simulation(path, keys=COARSE | keys | {"skin.solver": "modal"})
        alone.start_at(start_s)
        alone.step(4)
        assert apart(worlds.forces[world], alone.forces) < 1e-5
        assert apart(worlds.skin().displacement[world], alone.skin().displacement) < 1e-5
        assert apart(worlds.sensors[world], np.array(alone.data.sensordata)) < 1e-4
        assert apart(worlds.data[world].qpos, alone.data.qpos) < 1e-9
