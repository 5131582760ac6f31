"""Sound along a path that is known ahead, on bodies that keep still: the same numbers from a few fields."""

import numpy as np
import pytest

import palmfield
from palmfield.acoustics import spanned_arp
from palmfield.session.simulation import load
from palmfield.simulation import workspace

CIRCLE = {
    "modulation": "none",
    "am_quantity": None,
    "am_frequency_Hz": None,
    "am_depth": None,
    "path": "circle",
    "path_diameter_m": 0.01,
    "path_rate_Hz": 70,
}
SKIN = {"accuracy": 0.31, "step_s": 0.0001, "solver": "reduced"}
STEPS = 12


def ran(path, steps=STEPS, before=lambda sim: None):
    """Forces, sensors and motion after each of some steps, and the simulation."""
    sim, seen = load(path), []
    before(sim)
    for _ in range(steps):
        sim.step()
        motion = np.concatenate([sim.skin().displacement.ravel(), sim.skin().velocity.ravel()])
        seen.append((np.concatenate([force.ravel() for force in sim.runtime.applied]), motion))
    return [np.array(part) for part in zip(*seen, strict=True)], sim


def fields_of(sound):
    """By skin, role and points."""
    return {name: fields for name, (_, fields) in sound._fields._last.items() if name != "span"}


def largest(differing, expected):
    return np.abs(differing - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("response", ["off", "on"])
def test_a_path_on_a_still_body_gives_what_each_field_by_itself_does(small_scene, monkeypatch, response):
    path = small_scene(stimulus=CIRCLE, array={"response": response}, skin=SKIN)
    (force, motion), sim = ran(path)
    sound = sim.runtime.work.path_sound
    fields = fields_of(sound)
    assert None not in fields.values()
    assert {role for _, role, _ in fields} == {"samples", "load"}
    monkeypatch.setattr(workspace, "has_path", lambda model: False)
    (plain_force, plain_motion), plain = ran(path)
    assert plain.runtime.work.path_sound is None
    assert plain.skin().solver == sim.skin().solver == "reduced"
    assert largest(force, plain_force) < 1e-5 and largest(motion, plain_motion) < 1e-5


def test_a_body_that_moves_leaves_it(small_scene, monkeypatch):
    """It is pushed after some steps: what follows is computed where it is."""
    path = small_scene(stimulus=CIRCLE, skin=SKIN | {"solver": "auto"}, duration_s=5.0)

    def push(sim):
        sim.data.qvel[:] = 0.5

    (force, motion), sim = ran(path, before=push)
    assert sim.runtime.work.path_sound is not None and sim.skin().solver == "wedges"
    assert not sim.runtime.work.path_sound.holds(sim.runtime.posed)
    monkeypatch.setattr(workspace, "has_path", lambda model: False)
    (plain_force, plain_motion), _ = ran(path, before=push)
    np.testing.assert_allclose(force, plain_force, rtol=1e-4, atol=1e-6 * np.abs(plain_force).max())
    assert largest(motion, plain_motion) < 1e-5


def test_copies_share_the_fields(small_scene):
    sim = load(small_scene(stimulus=CIRCLE, skin=SKIN))
    sim.step(3)
    copy = sim.copy()
    for part in (sim, copy):
        part.step(3)
    own, other = fields_of(sim.runtime.work.path_sound), fields_of(copy.runtime.work.path_sound)
    assert own.keys() == other.keys() and own
    assert all(own[key] is other[key] for key in own)
    assert np.array_equal(sim.skin().displacement, copy.skin().displacement)


def test_worlds_of_one_path_share_its_fields(small_scene):
    """Each with buffers of its own: what one has been given does not change under it."""
    sim = palmfield.Simulation(
        small_scene(stimulus=CIRCLE, skin=SKIN), worlds=3, keys={"stimulus.arp_peak_Pa": [10.0] * 3}
    )
    single = palmfield.Simulation(small_scene(stimulus=CIRCLE, skin=SKIN), keys={"stimulus.arp_peak_Pa": 10.0})
    sim.step(3)
    single.step(3)
    first, *others = (runtime.work.path_sound for runtime in sim._scenes.runtimes)
    assert fields_of(first) and all(other._fields is first._fields for other in others)
    own = [part for sound in (first, *others) for _, part in sound._arp._last.values()]
    assert len({id(part) for part in own}) == len(own) == 3 * len(first._arp._last)
    for world in range(3):
        assert largest(sim.skin().displacement[world], single.skin().displacement) < 1e-9


def test_loads_are_computed_ahead_where_a_path_has_no_small_span(small_scene, monkeypatch):
    monkeypatch.setattr(spanned_arp, "drives_span", lambda drives: None)
    sim = load(small_scene(stimulus=CIRCLE, skin=SKIN))
    sim.step(STEPS)
    assert sim.runtime.work.path_sound is not None
    assert "batch" in [name for name, *_ in sim.runtime.work.radiation.cached._last]


@pytest.mark.parametrize(
    "changes",
    [
        {"stimulus": CIRCLE | {"path": "point", "path_diameter_m": None, "path_rate_Hz": None}},
        {"stimulus": CIRCLE, "skin": {"solver": "wedges"}},
        {"stimulus": CIRCLE, "skin": SKIN | {"body_sound": "shadows"}},
    ],
    ids=["is not a path", "not known ahead", "shadows"],
)
def test_where_it_is_not_for(small_scene, changes):
    sim = load(small_scene(**changes))
    assert sim.runtime.work.path_sound is None
