"""The wake length of scripts/scenarios.py, and the places of a focus on the skin that its runs rest on."""

import importlib.util

import numpy as np
import pytest
import trimesh

from palmfield.hand.triangles import vertex_normals
from palmfield.stimulus.surface_path import through
from palmfield.studies.bench.processes import ROOT
from palmfield.types import Surface


@pytest.fixture(scope="module")
def stories():
    spec = importlib.util.spec_from_file_location("stories", ROOT / "scripts" / "_scenario_stories.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def seen(stories, decay_m, arcs):
    """Velocities that decay exponentially behind each focus, on nodes 1 mm apart, half way between the places."""
    places = np.arange(0.0, 0.138, 0.001)
    nodes = places + 0.0005
    behind = arcs[:, None] - nodes[None]
    return {
        "arc": arcs,
        "velocity": np.where(behind >= -1e-9, -np.exp(-behind / decay_m), 0.0),
        "places": places,
        "near": np.abs(places[:, None] - nodes[None]) < stories.PATH_NEIGHBOURHOOD_M,
    }


@pytest.mark.parametrize("decay_m", [0.005, 0.01, 0.02])
def test_an_exponential_wake_has_the_length_of_its_formula(stories, decay_m):
    """exp(-d/L) is 1/10 at d = L ln 10; nodes within 5 mm reach 4.5 mm on, the next place is the end."""
    lengths, behind, envelope = stories.wake_lengths(seen(stories, decay_m, 0.0905 + 0.005 * np.arange(7)))
    assert lengths == pytest.approx(decay_m * np.log(10.0) + 0.0045 + 0.0005, abs=0.00051)
    assert envelope.max() == 1.0 and behind.min() >= 0.0


def test_a_wake_ends_where_the_skin_is_first_at_rest(stories):
    data = seen(stories, 0.01, np.array([0.1005]))
    data["velocity"][:, (data["places"] < 0.085)] = 0.0
    data["velocity"][:, 10] = -1.0
    lengths, _, _ = stories.wake_lengths(data)
    assert lengths[0] == pytest.approx(0.1005 - 0.0855 + 0.005, abs=0.00051)


def test_places_alone_are_those_with_normals():
    """On a mesh that has moved, at arc lengths beyond the path's ends and at its points."""
    ball = trimesh.creation.icosphere(3, 0.05)
    surface = Surface(ball.vertices, ball.faces.astype(np.int32), vertex_normals(ball.vertices, ball.faces))
    path = through(surface, [ball.vertices[0], ball.vertices[40], ball.vertices[90]])
    arcs = np.concatenate([np.linspace(-0.1, 0.3, 101), path.arc_m])
    moved = surface.vertices * [1.0, 1.3, 0.8]
    together = path.at(arcs, moved, surface.faces)[0]
    assert path.positions(arcs, moved, surface.faces) == pytest.approx(together, abs=1e-15)
    assert path.positions(arcs[7:8], moved, surface.faces) == pytest.approx(together[7:8], abs=1e-15)
