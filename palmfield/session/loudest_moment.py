"""Describe the moment with the highest ARP on a skin, and points of the skin at this moment."""

from dataclasses import dataclass, replace

import numpy as np

from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.small_models import known_load
from palmfield.stimulus.schedule import frame_at
from palmfield.types import Complex, Float


@dataclass(frozen=True)
class LoudestMoment:
    """The moment of a run with the highest ARP on a skin.

    time_s: MuJoCo time [s]
    posed: pose at this time
    drive: emission of all transducers relative to full drive, shape (N,)
    factor: factor of the ARP
    """

    time_s: float
    posed: PosedScene
    drive: Complex
    factor: float


def at_full_level(loudest: LoudestMoment) -> LoudestMoment:
    """Return the moment with the drive scaled so that the loudest transducer is at full drive.

    Relative errors do not depend on the level. The drive is rounded, so that all levels give exactly the same numbers.
    """
    drive, _ = known_load.at_full_level(loudest.drive)
    return replace(loudest, drive=drive, factor=1.0)


def nearest_focus(foci: Float, nodes: Float) -> Float:
    """Return the focus that is closest to the nodes of a skin, shape (3,). foci: (3,) or (k, 3); nodes: (S, 3)"""
    places = np.atleast_2d(foci)
    nearest: Float = places[int(np.argmin([np.linalg.norm(nodes - place, axis=1).min() for place in places]))]
    return nearest


def loudest_place(posed: PosedScene, skin: int, radiation: Radiation, drive: Complex) -> tuple[Float, Float]:
    """Return the node of highest ARP on a skin under a drive of all transducers (N,), and its outward normal.

    Both are in the frame of the first array, shapes (3,) [m]. In silence it is the first node.
    """
    nodes, outwards = posed.skins[skin].nodes
    highest = int(radiation.on(posed, skin, "nodes", drive).arp.argmax())
    return nodes[highest], outwards[highest]


def place_under_focus(model: HapticModel, skin: int, loudest: LoudestMoment) -> Float:
    """Return the point of the resting skin closest to a focus at the loudest moment, body frame [m], shape (3,)."""
    posed = loudest.posed.skins[skin]
    nodes = posed.nodes[0]
    foci = []
    for number, stimulus in enumerate(model.stimuli):
        if not stimulus.silent:
            places = loudest.posed.focal_points(stimulus, number)
            foci += list(np.atleast_2d(places.at(frame_at(stimulus.config, loudest.time_s).focus)))
    focus = nearest_focus(np.array(foci), nodes)
    if posed.body.model.hand is None:
        return posed.body.frame.inverse_points(focus)
    nearest = np.linalg.norm(nodes - focus, axis=1).argmin()
    return model.skins[skin].nodes[0][nearest]
