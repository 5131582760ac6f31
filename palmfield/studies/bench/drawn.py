"""What a benchmark draws after a scene's model is built: stimuli and poses that its steppers were not made for."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from palmfield.config import StimulusConfig
from palmfield.session.simulation import Simulation
from palmfield.simulation.build import build

ASIDE_m = 0.003
"""By which a focus is moved in the plane of its path, and the arrays along each axis, at most [m]."""
TILT_rad = 0.02
"""By which the arrays are turned about each axis, at most [rad]."""
LEVELS = (0.5, 1.0)
"""ARP over the scene's own."""
SIZES, SPEEDS = (0.8, 1.0), (0.8, 1.2)
"""Of a path over the scene's own; larger paths would leave the part of the skin that has fine elements."""


def draw_again(sim: Simulation, seed: int) -> None:
    """Give a simulation other paths and levels, and its arrays another place, with the steppers that it has; reset.

    seed: of the random numbers; equal ones draw the same for scenes that differ in their skins only
    The arrays stand in for the start pose: they are moved against bodies, obstacles and MuJoCo's own script.
    """
    rng = np.random.default_rng(seed)
    runtime = sim.runtime
    known = runtime.model
    stimuli = tuple(replace(one, config=drawn_stimulus(one.config, rng)) for one in known.spec.stimuli)
    spec = replace(known.spec, stimuli=stimuli)
    other = build(spec, known)
    runtime.exchange(replace(known, spec=spec, stimuli=other.stimuli, response_on=other.response_on, marks={}))
    move_arrays(sim.model, runtime.binding.array_sites, rng)
    sim.reset()


def drawn_stimulus(config: StimulusConfig, rng: np.random.Generator) -> StimulusConfig:
    """The keys of a stimulus with another focus, level, size of its path and speed along it."""
    aside = rng.uniform(-ASIDE_m, ASIDE_m, 2)
    level, size, speed = (rng.uniform(*limits) for limits in (LEVELS, SIZES, SPEEDS))
    changes: dict[str, Any] = {"focus_m": tuple(np.add(config.focus_m, [*aside, 0.0]).tolist())}
    if config.arp_peak_Pa is not None:
        changes["arp_peak_Pa"] = level * config.arp_peak_Pa
    else:
        # The ARP goes with the square of what transducers are told.
        amplitude = 1.0 if config.drive_amplitude is None else config.drive_amplitude
        changes["drive_amplitude"] = float(np.sqrt(level)) * amplitude
    for factor, keys in (
        (size, ("path_diameter_m", "path_width_m", "path_height_m")),
        (speed, ("path_rate_Hz", "path_speed_m_s")),
    ):
        for key in keys:
            value = getattr(config, key)
            if value is not None:
                changes[key] = factor * value
    return type(config).model_validate(config.model_dump(exclude_unset=True) | changes)


def move_arrays(model: mujoco.MjModel, sites: tuple[int, ...], rng: np.random.Generator) -> None:
    """Move and turn the bodies that carry arrays, all by the same, or the arrays' own sites where they lie in the
    world."""
    aside = rng.uniform(-ASIDE_m, ASIDE_m, 3)
    turn = rng.uniform(-TILT_rad, TILT_rad, 3)
    angle = float(np.linalg.norm(turn))
    quaternion = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, turn / angle, angle)
    for body in sorted({int(model.site_bodyid[site]) for site in sites}):
        if body > 0:
            places = [(model.body_pos, model.body_quat, body)]
        else:
            places = [(model.site_pos, model.site_quat, n) for n in range(model.nsite) if model.site_bodyid[n] == 0]
        for positions, quaternions, number in places:
            positions[number] += aside
            turned = np.zeros(4)
            mujoco.mju_mulQuat(turned, quaternion, quaternions[number])
            quaternions[number] = turned
