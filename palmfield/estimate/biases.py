"""Estimate the bias of the motion of skins from effects that a scene omits: sign, and size if known."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.echo import REST
from palmfield.acoustics.nonlinear import Wind, beams, fundamental_left, steepening, wind
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.validity import least_radius_m
from palmfield.config.skin import OF_SHAPES
from palmfield.drive.board import FULL
from palmfield.drive.motion_change import changes_of_motion
from palmfield.estimate.array_inputs import qualities
from palmfield.estimate.bias import Bias
from palmfield.estimate.numerics.base_band import base_band, on_finger
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel, array_instances
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import main_frequencies
from palmfield.types import Complex, Float

if TYPE_CHECKING:
    from palmfield.acoustics.calibration_file import Calibration

HANDS = (*OF_SHAPES["hand"], "rigged")
"""Shapes of hands: results measured on hands are reported only for these."""
FEW_WAVELENGTHS = 2.0
"""Radius of curvature in wavelengths below which a surface is not locally flat for the sound."""
TURNED, CURVED, OPEN_HAND = 0.60, 0.16, 0.04
"""Error of the local ARP law relative to the ARP (docs/bench/scattering.md): on skin that faces away, on skin with a
smaller radius or in a cup, and on an open hand."""
AROUND = 0.7
"""Error relative to the highest ARP on a body with a smaller radius between boards, since sound of the board behind it
diffracts around it (measured 0.62 on a finger of 12 mm with the focus at its side)."""
TURNED_FROM_DEG = 45.0
"""Angle of incidence above which TURNED applies; TURNED was measured at 60 degrees, the others near 0."""
BENDING = ("articulated", "rigged")
"""Shapes of hands that may bend into a cup."""
FACE_BY_FACE = (
    "error of the local law: 4 % of the ARP on an open hand, 8 % on a finger, 16 % in a cupped hand, more than "
    "half on skin that faces away (docs/bench/scattering.md)"
)
ROUND_BODY = 0.2
"""Largest error of |p|^2 behind a rod, relative to the free focus, against boundary elements (bench/shadows.md)."""
TILTED_DEG = 5.0
"""Tilt of a disc above which its echo misses the focus; then no band is reported."""
SHARPENS = 0.9
"""sigma above which harmonics add more ARP than the fundamental loses, from the KZK equation."""
ECHO = "echo between body and array"
ROUND_TRIPS = 8
"""Number of round trips between plate and array in the band; later ones add a tenth or less."""
FINGER_Hz = 400.0
"""Main frequency up to which the bone of a relaxed finger moves by more than 10 % of its skin
(scripts/verification/whole_finger.py)."""
NEAR_M = 6e-3
"""Radius about the focus in which the curvature of the skin is measured: half width of a focus [m]."""
SETTLED = 0.01
"""Relative difference from the final amplitude below which warm-up has ended."""


def biases(
    model: HapticModel,
    skin: int,
    stimulus: int,
    posed: PosedScene,
    drive: Complex,
    focus: Float,
    highest: tuple[Float, Float],
) -> list[Bias]:
    """Return the biases of the motion of a skin from effects that the model omits.

    stimulus: number of the stimulus for which the layer is built. drive: drive of all transducers, shape (N,).
    focus: point of that stimulus, the nearest to the skin if it has several; array frame [m], shape (3,).
    highest: where the ARP on the skin is highest, and the outward normal there; array frame, shapes (3,).
    """
    part = model.stimuli[stimulus]
    return [
        *response_biases(part, model.skins[skin]),
        *_along_beams(posed, part, drive, focus, highest),
        *_scattered(model, skin, posed, drive, focus, highest),
        *_shadows(model, skin),
        *_echo(model, skin, stimulus, posed, drive, highest),
        *array_biases(model, stimulus, drive),
        *_linear(model.skins[skin]),
        *_below(model.skins[skin]),
        *_whole_finger(model.skins[skin]),
    ]


def _below(skin: SkinModel) -> list[Bias]:
    """Return the bias of the tissue below a layer, which is not known: between bone and tissue without end."""
    moved = base_band(skin.layer)
    if moved is None:
        return []
    changes = {name: factor - 1.0 for name, factor in moved.items()}
    each = ", ".join(f"{name} {100.0 * change:+.0f} %" for name, change in changes.items())
    why = f"by key base, now {skin.spec.config.base}: {each}; for an infinite flat layer"
    return [Bias("tissue below the layer", min(0.0, *changes.values()), max(0.0, *changes.values()), why)]


def _whole_finger(skin: SkinModel) -> list[Bias]:
    """Return the motion of a finger as a whole, which is not part of the motion of its skin, if it may exceed 10 %."""
    if skin.layer.demand.main_frequency_Hz > FINGER_Hz or not on_finger(skin.layer):
        return []
    why = (
        "displacements are relative to the bone; the bone of a relaxed finger moves 60 times as far as its skin at "
        "10 Hz, 1 to 2 times at 100 Hz, 0.4 to 0.7 times at 200 Hz (docs/limits.md)"
    )
    return [Bias("motion of the whole finger", None, None, why)]


def _linear(skin: SkinModel) -> list[Bias]:
    """Return the bias of large strain, if the solver of a skin is linear."""
    if skin.solver.large_strain:
        return []
    why = "linear elasticity; the true displacement is smaller where skin stiffens, at strains above about 10 %"
    return [Bias("large strain", None, None, why)]


def response_biases(stimulus: StimulusModel, skin: SkinModel) -> list[Bias]:
    """Return the effect of ignoring ring-up and flight times on the displacement of a skin.

    Stationary focus: error of a damped oscillator at the main frequency or at the highest frequency of the layer,
    whichever error is larger, because the skin responds at several frequencies. Moving focus: twice the error of the
    pressure (ARP is proportional to its square), and at most 1, because late or spread sound is never louder than
    simultaneous sound.
    """
    response, result, own = stimulus.response, [], qualities(stimulus)
    demand = skin.layer.demand
    frequencies = sorted({demand.main_frequency_Hz, demand.max_frequency_Hz})
    which, still = " and ".join(f"{f:.3g}" for f in frequencies), stimulus.config.path == "point"
    changes = tuple(max(-1.0, -2.0 * error.rms) for error in (response.ring_up, response.flight_time))
    if still:
        slowest = min(np.broadcast_to(response.pole.rate, response.delays_s.shape)[stimulus.transducers], key=np.real)
        found = [changes_of_motion(stimulus.config, complex(slowest), response.spread_s, f) for f in frequencies]
        changes = tuple(max(of, key=abs) for of in zip(*found, strict=True))
    for what, there, error, change in (
        ("transducers' ring-up", response.on, response.ring_up, changes[0]),
        ("spread of the flight time", response.delayed, response.flight_time, changes[1]),
    ):
        if not there:
            why = f"{error} of the pressure, estimated from samples of the drive, {own}; "
            why += f"evaluated for oscillators of {which} Hz" if still else "the ARP changes with its square"
            result.append(Bias(what, min(change, 0.0), max(change, 0.0), why))
    return result


def _along_beams(
    posed: PosedScene, stimulus: StimulusModel, drive: Complex, focus: Float, highest: tuple[Float, Float]
) -> list[Bias]:
    """Return biases of the beams up to the skin, for any position of the focus: nonlinear sound and streaming."""
    arrays, frequency = posed.arrays, posed.arrays.array.frequency_Hz
    own, point = np.zeros_like(drive), highest[0]
    own[stimulus.transducers] = drive[stimulus.transducers]
    front = np.where((arrays.array.positions - point) @ highest[1] > 0.0, own, 0.0)
    own = front if front.any() else own
    found = beams(arrays.array, own, focus, arrays.air, until=point)
    sigma = max((steepening(pressures, step_m, arrays.air, frequency) for step_m, pressures in found), default=0.0)
    winds = [wind(step_m, pressures, arrays.air, frequency) for step_m, pressures in found]
    ends = [abs(pressures[-1]) ** 2 / arrays.impedance for _, pressures in found]
    whole = abs(arrays.pressure64(point[None], own)[0]) ** 2 / arrays.impedance
    return [_nonlinear(sigma, winds), _streaming(winds, ends, whole)]


def _nonlinear(sigma: float, winds: Sequence[Wind]) -> Bias:
    """Return the bias of nonlinear sound.

    A Gaussian beam loses half as much as a plane wave, because sigma is reached only on its axis. The lost part of the
    fundamental becomes harmonics on a narrower spot. They exert the same force, less their absorption in air and in a
    shock, and the ARP at the centre grows by the same amount. The KZK equation agrees up to sigma 1.3
    (tests/acoustics/test_focused_beam.py).
    """
    moved = (1.0 - fundamental_left(sigma) ** 2) / 2.0
    # For a Gaussian spot: harmonics have twice this share at the centre, and fall off with the square of the profile
    narrower = 100.0 * moved / (2.0 * math.log(2.0))
    why = (
        f"sigma {sigma:.2f} along the beam to the skin: the 40 kHz component is about {50.0 * moved:.2g} % weaker, "
        f"but its harmonics also exert radiation pressure, on a spot that is up to {narrower:.2g} % narrower with "
        "more ARP at its centre; absorption in air and, above sigma 1, a shock reduce this"
    )
    low = -max((one.harmonics for one in winds), default=0.0)
    return Bias("nonlinear sound", max(low, -1.0), moved * min(max(1.0, (sigma / SHARPENS) ** 2), 2.0), why)


def _streaming(winds: Sequence[Wind], ends: Sequence[float], whole: float) -> Bias:
    """Return an upper bound of the bias of streaming, whose pressure is lower than the ARP, on a larger area.

    The effect on deep skin of a spot with pressure p and force F is proportional to sqrt(p F), its radius to sqrt(F/p).

    ends: ARP of each beam alone at its end; whole: ARP of all beams on the skin [Pa]
    """
    if not winds or whole == 0.0:
        return Bias("streaming", None, None, "no beam reaches the skin, so streaming is not estimated")
    pushes = [math.sqrt(one.pressure_Pa * one.force * end) for one, end in zip(winds, ends, strict=True)]
    fastest = max(winds, key=lambda one: one.speed_m_s)
    why = (
        f"acoustic streaming of {fastest.speed_m_s:.2g} m/s (inviscid estimate): stagnation pressure "
        f"{fastest.pressure_Pa:.2g} Pa, force {100.0 * fastest.force:.2g} % of the acoustic force, which is the "
        f"upper bound of the additional static displacement. It builds up in about {fastest.time_s:.1g} s, so only "
        "its mean matters under modulation and moving foci; it also cools the skin"
    )
    return Bias("streaming", 0.0, float(sum(pushes) / whole), why)


def _scattered(
    model: HapticModel, skin: int, posed: PosedScene, drive: Complex, focus: Float, highest: tuple[Float, Float]
) -> list[Bias]:
    """Return the bias of the local ARP law, which assumes a flat rigid wall."""
    part = model.skins[skin]
    if part.spec.config.body_sound == "scattering":
        return []
    if part.carrier.surface is None:
        why = "the law assumes a flat rigid wall, as this face is; diffraction at its rim is not modelled"
        return [Bias("scattered sound", None, None, why)]
    place = posed.skins[skin]
    length = sound_speed(posed.arrays.air) / posed.arrays.array.frequency_Hz
    radius = least_radius_m(place.nodes[0], focus, NEAR_M)
    if radius is None:
        why = "no focus is near the skin, so its curvature there is not evaluated"
        return [Bias("scattered sound", None, None, why)]
    turned, behind = _turned_deg(posed, drive, *highest)
    curved = radius < FEW_WAVELENGTHS * length or part.spec.config.shape in BENDING
    size = TURNED if turned > TURNED_FROM_DEG else CURVED if curved else OPEN_HAND
    around = behind > 0.0 and radius < FEW_WAVELENGTHS * length
    size = AROUND if around else size
    # The errors were measured on hands; for other bodies only the curvature is evaluated
    measured = "the value was measured on hands with such a curvature and angle (docs/bench/scattering.md)"
    measured = FACE_BY_FACE if part.spec.config.shape in HANDS else measured
    why = (
        f"smallest radius of curvature under the focus {1e3 * radius:.0f} mm, {radius / length:.1f} wavelengths; "
        f"the local law holds from {FEW_WAVELENGTHS:g}; at the highest ARP the angle of incidence is {turned:.0f} "
        f"degrees; {measured}{'; sound from behind diffracts around it' if around else ''}. body_sound "
        "scattering models this"
    )
    return [Bias("scattered sound", -size, size, why)]


def _turned_deg(posed: PosedScene, drive: Complex, point: Float, outward: Float) -> tuple[float, float]:
    """Return the angle between the outward normal of a skin and the direction to the active transducers [degrees], of
    those in front of it if there are any; and the fraction of the drive that is then behind the skin."""
    loud, ways = np.abs(drive), posed.arrays.array.positions - point
    front = np.where(ways @ outward > 0.0, loud, 0.0)
    used = front if front.any() else loud
    whole = max(float(used.sum()), 1e-300)
    back = used @ ways / whole
    angle = math.degrees(math.acos(max(-1.0, min(1.0, float(outward @ back / np.linalg.norm(back))))))
    return angle, 1.0 - whole / max(float(loud.sum()), 1e-300)


def _shadows(model: HapticModel, skin: int) -> list[Bias]:
    """Return the biases of shadows, their edges, and echoes from obstacles."""
    part, bodies = model.skins[skin], len(model.bodies)
    config = part.spec.config
    if config.body_sound == "none":
        if part.carrier.surface is None and bodies == 1:
            return [Bias("cast shadows", 0.0, 0.0, "a flat face casts no shadow on itself")]
        why = "parts of the body cast no shadows on each other"
        if bodies > 1:
            why += ", and bodies cast no shadows on each other"
        if config.shape in HANDS:
            why += "; the effect is 0 on an open hand, and all of the sound behind a finger"
        return [Bias("cast shadows", None, None, f"{why}. body_sound shadows models them")]
    if config.body_sound == "shadows" and config.shadow_edges == "rays":
        why = (
            "at the edge of a shadow the error of |p|^2 is up to three quarters of the free focus, sign unknown, and "
            "elsewhere 0 (docs/bench/shadows.md). shadow_edges knife_edge models diffraction"
        )
        return [Bias("diffraction at edges of shadows", None, None, why)]
    if config.body_sound == "shadows":
        why = (
            "a flat screen with the outline of the body replaces the body: 10 to 20 mm behind a rod 16 mm thick "
            "the error of |p|^2 is up to a fifth of the free focus (sign unknown), a fiftieth rms; 0 where all "
            "transducers are visible (docs/bench/shadows.md). body_sound scattering models this"
        )
        return [
            Bias("bodies approximated by flat screens", -ROUND_BODY, ROUND_BODY, why),
            Bias("echoes from obstacles", None, None, "sound reflected by an obstacle onto nearby skin"),
        ]
    return []


def _echo(
    model: HapticModel, skin: int, stimulus: int, posed: PosedScene, drive: Complex, highest: tuple[Float, Float]
) -> list[Bias]:
    """Return the bias of echoes between a flat body and a rigid array: images at 3, 5, ... times the distance."""
    if model.skins[skin].carrier.surface is not None:
        return [Bias(ECHO, None, None, "sign unknown; smaller than for a flat plate")]
    arrays, (point, outward) = posed.arrays, highest
    normal = arrays.facing[:, 0] / np.linalg.norm(arrays.facing[:, 0])
    if (arrays.array.normals @ normal).min() < math.cos(math.radians(TILTED_DEG)):
        why = "sign unknown; the transducers face several directions, so no single plane returns the sound"
        return [Bias(ECHO, None, None, why)]
    tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, float(-outward @ normal)))))
    if tilt_deg > TILTED_DEG:
        why = f"sign unknown; the disc is tilted by {tilt_deg:.0f} degrees, so its echo misses the focus"
        return [Bias(ECHO, None, None, why)]
    height = float(point @ normal - arrays.heights[0])
    trips = np.arange(ROUND_TRIPS + 1)
    sounds = np.abs(arrays.pressure64(point + 2.0 * height * trips[:, None] * normal, drive))
    shares = sounds[1:] / sounds[0] if sounds[0] > 0.0 else np.zeros(ROUND_TRIPS)
    if arrays.wall_m is not None:
        return _echo_computed(model.stimuli[stimulus], arrays, drive, point, shares)
    together = float(shares.sum())
    why = (
        f"an infinite flat plate at {1e3 * height:.0f} mm, the distance of the disc, and a rigid array face return "
        f"{100 * shares[0]:.1f} % of the pressure after one round trip and {100 * together:.1f} % after "
        f"{ROUND_TRIPS}; these add or cancel as the distance changes by a quarter of a wavelength; smaller on a "
        "narrow disc, 0 if the face absorbs. array_face rigid models this"
    )
    return [Bias(ECHO, (1.0 - min(together, 1.0)) ** 2 - 1.0, (1.0 + together) ** 2 - 1.0, why)]


def _echo_computed(
    stimulus: StimulusModel, arrays: PhasedArray, drive: Complex, point: Float, shares: Float
) -> list[Bias]:
    """Return biases of computed echoes. shares: pressure after 1, 2, ... round trips relative to the direct sound."""
    assert arrays.wall_m is not None
    alone, whole = (abs(of(point[None], drive)[0]) ** 2 for of in (arrays.pressure64, arrays.with_echoes64))
    change = float(alone / whole) - 1.0 if whole > 0.0 else 0.0
    rims = (
        "echoes are computed for infinite planes; a finite disc or board returns less, so the true echo lies "
        f"between this and 0; after {len(arrays.images) // len(arrays.groups)} round trips less than "
        f"{100 * REST:g} % of the pressure is left"
    )
    trip_s = 2.0 * arrays.wall_m / sound_speed(arrays.air)
    fastest_Hz = max(main_frequencies(stimulus.config), default=0.0)
    turned = np.minimum(2.0, 2.0 * np.pi * fastest_Hz * trip_s * np.arange(1, ROUND_TRIPS + 1))
    late = 2.0 * float(shares @ turned)
    why = (
        f"{1e3 * trip_s:.2f} ms per round trip, computed without delay: no error for steady sound; here the change "
        f"of a drive of {fastest_Hz:.3g} Hz in that time"
    )
    return [
        Bias("finite size of disc and board in the echo", min(change, 0.0), max(change, 0.0), rims),
        Bias("delay of the echo", -late, late, why),
    ]


def array_biases(model: HapticModel, stimulus: int, drive: Complex) -> list[Bias]:
    """Return the biases from the arrays of a stimulus. drive: drive of all transducers at the loudest moment, shape
    (N,)
    """
    instances = array_instances(model.spec)
    calibrations = [instances[number].calibration for number in model.stimuli[stimulus].spec.arrays]
    level = float(np.abs(drive[model.stimuli[stimulus].transducers]).max(initial=0.0))
    return [
        _warm_up(calibrations),
        *_level(calibrations, level),
        Bias("coupling of transducers", None, None, "sign unknown: mutual coupling of the transducers is not modelled"),
    ]


def _warm_up(calibrations: "list[Calibration | None]") -> Bias:
    measured = [one.warm_up for one in calibrations if one is not None and one.warm_up is not None]
    if not measured or len(measured) < len(calibrations):
        why = "resonance and level drift over minutes; usually the sound becomes weaker"
        return Bias("warm-up", None, None, f"{why}; not in the calibration")
    starts = [(1.0 + one.drop) ** 2 - 1.0 for one in measured]
    settled_s = max(one.time_s * max(math.log(max(abs(one.drop), SETTLED) / SETTLED), 0.0) for one in measured)
    drops = " and ".join(f"{100 * one.drop:+.1f}" for one in measured)
    why = f"measured: the pressure starts {drops} % from its final value, and is within 1 % after {settled_s:.0f} s"
    return Bias("warm-up", min(0.0, *starts), max(0.0, *starts), why)


def _level(calibrations: "list[Calibration | None]", level: float) -> list[Bias]:
    """Return the bias if the pressure is p0 a^exponent; a run assumes p0 a."""
    measured = [one.level for one in calibrations if one is not None and one.level is not None]
    if not measured or level == 0.0:
        return []
    beyond = [one.linear_to for one in measured if level > FULL * one.linear_to]
    if beyond:
        end = min(beyond)
        why = f"measured: above level {end:.2g} more than 5 % of the pressure is missing; the level here is {level:.2g}"
        return [Bias("saturation of the drive", None, None, why)]
    ends = [
        level ** (2.0 * (one.exponent + side * 1.96 * one.exponent_sd - 1.0)) - 1.0
        for one in measured
        for side in (-1, 1)
    ]
    exponents = " and ".join(f"{one.exponent:.3f}" for one in measured)
    why = (
        f"measured: pressure is proportional to the level to the power {exponents}; the highest level here is "
        f"{level:.2g}"
    )
    return [Bias("level of the drive", min(0.0, *ends), max(0.0, *ends), why)]
