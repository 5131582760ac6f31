"""Draw random stimuli and poses after the model of a scene is built, so that its steppers are not prepared for them."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from palmfield.config import StimulusConfig
from palmfield.session.simulation import Simulation
from palmfield.simulation.build import build

ASIDE_m = 0.003
"""Largest shift of a focus in the plane of its path, and of the arrays along each axis [m]."""
TILT_rad = 0.02
"""Largest rotation of the arrays about each axis [rad]."""
LEVELS = (0.5, 1.0)
"""ARP relative to that of the scene."""
SIZES, SPEEDS = (0.8, 1.0), (0.8, 1.2)
"""Path size and speed relative to those of the scene; larger paths would leave the region of fine elements."""


def draw_again(sim: Simulation, seed: int) -> None:
    """Draw other paths, levels and array places for a simulation, and reset it. The steppers are kept.

    seed: seed of the random numbers; equal seeds give equal draws for scenes that differ only in their skins
    Moving the arrays changes their pose relative to bodies, obstacles and scripted motion.
    """
    rng = np.random.default_rng(seed)
    runtime = sim.runtime
    model = runtime.model
    stimuli = tuple(replace(one, config=drawn_stimulus(one.config, rng)) for one in model.spec.stimuli)
    spec = replace(model.spec, stimuli=stimuli)
    other = build(spec, model)
    runtime.exchange(replace(model, spec=spec, stimuli=other.stimuli, marks={}))
    move_arrays(sim.model, runtime.binding.array_sites, rng)
    sim.reset()


def drawn_stimulus(config: StimulusConfig, rng: np.random.Generator) -> StimulusConfig:
    """Return the keys of a stimulus with another focus, level, path size and speed."""
    offset = rng.uniform(-ASIDE_m, ASIDE_m, 2)
    level, size, speed = (rng.uniform(*limits) for limits in (LEVELS, SIZES, SPEEDS))
    changes: dict[str, Any] = {"focus_m": tuple(np.add(config.focus_m, [*offset, 0.0]).tolist())}
    if config.arp_peak_Pa is not None:
        changes["arp_peak_Pa"] = level * config.arp_peak_Pa
    else:
        # The ARP is quadratic in the drive of the transducers.
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
    """Move and rotate all bodies that carry arrays by the same amount.

    If the arrays are in the world, move their sites.
    """
    offset = rng.uniform(-ASIDE_m, ASIDE_m, 3)
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
            positions[number] += offset
            turned = np.zeros(4)
            mujoco.mju_mulQuat(turned, quaternion, quaternions[number])
            quaternions[number] = turned
