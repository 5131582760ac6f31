"""What a scene leaves out, as estimated bias of its skins' motion: which way, and by how much where that is known."""

from dataclasses import dataclass

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.nonlinear import arp_left, beam_steepening, fundamental_left
from palmfield.acoustics.validity import least_radius_m
from palmfield.config.skin import OF_SHAPES
from palmfield.outputs.budget_text import bias_text
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.types import Complex, Float

FEW_WAVELENGTHS = 2.0
"""Radius of curvature in wavelengths below which a wall is not locally flat for the sound."""
CURVED, OPEN_HAND = 0.10, 0.04
"""Error of the local law on less than that, and on an open hand, of the ARP (docs/bench/scattering.md)."""
FACE_BY_FACE = (
    "face by face 4 % of the ARP on an open hand, 8 % on a finger, 16 % in a cup, more than half on skin turned away "
    "(docs/bench/scattering.md)"
)
NEAR_M = 6e-3
"""Half of a focus: the skin's curvature is looked at so far round it [m]."""


@dataclass(frozen=True)
class Bias:
    """What leaving something out does to the displacement of the skin under the focus.

    low, high: the true displacement's least and largest difference from the computed one, over the computed one; None
        where it is not estimated
    why: how the figure was found, or which way it goes
    """

    what: str
    low: float | None
    high: float | None
    why: str

    @property
    def size(self) -> str:
        """The range in words, with its sign."""
        return "not estimated" if self.low is None or self.high is None else bias_text(self.low, self.high)


def biases(model: HapticModel, skin: int, stimulus: int, posed: PosedScene, drive: Complex, focus: Float) -> list[Bias]:
    """What is left out of a skin's motion.

    stimulus: number of the one that the skin is made for; drive: of all transducers, shape (N,)
    focus: that stimulus's point, of several the nearest to the skin; array frame [m], shape (3,)
    """
    part = model.stimuli[stimulus]
    return [
        *response_biases(part),
        *_nonlinear(posed, part, drive, focus),
        *_scattered(model, skin, posed, focus),
        *_shadows(model, skin),
        *_echo(model, skin, posed, drive, focus),
        Bias("streaming", None, None, "a wind of about 1 m/s: some 0.6 Pa more, slow, and cooling"),
        Bias("warm-up", None, None, "resonance and level drift over minutes: usually less sound than at the start"),
        Bias("coupling of transducers", None, None, "each sounds as if alone: either way"),
        *_linear(model.skins[skin]),
    ]


def _linear(skin: SkinModel) -> list[Bias]:
    """Particles are followed wherever they go; elements are not."""
    if skin.choice.name == "particles":
        return []
    return [Bias("large strain", None, None, "linear elasticity: less, where skin stiffens at strains above some 10 %")]


def response_biases(stimulus: StimulusModel) -> list[Bias]:
    """ARP goes with the pressure's square; sound that comes late or spread is never more than sound at once."""
    response, result = stimulus.response, []
    qualities = " and ".join(
        f"{quality:g}"
        for quality in np.unique(np.broadcast_to(response.pole.Q, response.delays_s.shape)[stimulus.transducers])
    )
    for what, there, error in (
        ("transducers' ring-up", response.on, response.ring_up),
        ("spread of the flight time", response.delayed, response.flight_time),
    ):
        if not there:
            why = f"{error} of the pressure, measured on samples of the drive, Q {qualities}; the ARP has its square"
            result.append(Bias(what, -2.0 * error.rms, 0.0, why))
    return result


def _nonlinear(posed: PosedScene, stimulus: StimulusModel, drive: Complex, focus: Float) -> list[Bias]:
    arrays = posed.arrays
    own = np.zeros_like(drive)
    own[stimulus.transducers] = drive[stimulus.transducers]
    sigma = beam_steepening(arrays.array, own, focus, arrays.air)
    lost = arp_left(sigma) - 1.0
    line = 100.0 * (fundamental_left(sigma) - 1.0)
    why = (
        f"sigma {sigma:.2f} along the beam; the 40 kHz line is {line:+.2g} %, but its harmonics press too, so "
        "that the ARP loses only behind a shock, beyond sigma 1"
    )
    return [Bias("nonlinear sound", lost, 0.0, why)]


def _scattered(model: HapticModel, skin: int, posed: PosedScene, focus: Float) -> list[Bias]:
    """The law takes the wall as flat and rigid."""
    part = model.skins[skin]
    if part.spec.config.body_sound == "scattering":
        return []
    if part.carrier.surface is None:
        why = "the law takes the wall as flat and rigid, as this face is; left out is diffraction at its rim"
        return [Bias("scattered sound", None, None, why)]
    place = posed.skins[skin]
    length = sound_speed(posed.arrays.air) / posed.arrays.array.frequency_Hz
    radius = least_radius_m(place.nodes[0], focus, NEAR_M)
    if radius is None:
        return [Bias("scattered sound", None, None, "no focus is near the skin, so that no curvature is there to tell")]
    size = CURVED if radius < FEW_WAVELENGTHS * length else OPEN_HAND
    why = (
        f"least radius of curvature under the focus {1e3 * radius:.0f} mm, {radius / length:.1f} wavelengths; the "
        f"local law holds from {FEW_WAVELENGTHS:g}; {FACE_BY_FACE}. body_sound scattering computes it"
    )
    return [Bias("scattered sound", -size, size, why)]


def _shadows(model: HapticModel, skin: int) -> list[Bias]:
    """What stands in the way of the sound, and the edges of what does."""
    part, bodies = model.skins[skin], len(model.bodies)
    config = part.spec.config
    if config.body_sound == "none":
        if part.carrier.surface is None and bodies == 1:
            return [Bias("cast shadows", 0.0, 0.0, "a flat face casts none on itself")]
        why = "one part of the body does not shade another" + (", nor one body another" if bodies > 1 else "")
        if config.shape in OF_SHAPES["hand"]:
            why += "; nothing on an open hand, all of the sound behind a finger"
        return [Bias("cast shadows", None, None, f"{why}. body_sound shadows computes them")]
    if config.body_sound == "shadows" and config.shadow_edges == "rays":
        why = (
            "at the edge of a shadow |p|^2 is off by up to three quarters of the free focus, either way, and elsewhere "
        )
        why += "by nothing (docs/bench/shadows.md). shadow_edges knife_edge bends the sound"
        return [Bias("sound bent round edges", None, None, why)]
    return []


def _echo(model: HapticModel, skin: int, posed: PosedScene, drive: Complex, focus: Float) -> list[Bias]:
    """Sound that a flat body returns to a rigid array face comes again as from three times the distance."""
    if model.skins[skin].carrier.surface is not None:
        return [Bias("echo between body and array", None, None, "either way; less than on a flat plate")]
    arrays = posed.arrays
    normal = arrays.facing[:, 0]
    height = float(focus @ normal - arrays.heights[0])
    there, again = np.abs(arrays.pressure64(np.array([focus, focus + 2.0 * height * normal]), drive))
    size = 2.0 * float(again / there) if there > 0.0 else 0.0
    why = (
        f"a flat plate at {1e3 * height:.0f} mm and a rigid array face return {100 * again / max(there, 1e-300):.1f} % "
        "of the pressure, either way as the distance changes by a quarter of a wavelength; nothing if the face absorbs"
    )
    return [Bias("echo between body and array", -size, size, why)]
