"""What a plan says is left out, and what that costs in error."""

import numpy as np

from palmfield.acoustics import validity
from palmfield.acoustics.air import sound_speed
from palmfield.config.skin import OF_SHAPES
from palmfield.session.planning.facts import first_drive, qualities
from palmfield.session.planning.rows import Row
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel
from palmfield.skin.from_config import cutoff_Hz


def left_out(model: HapticModel) -> list[Row]:
    """Rows of what is left out."""
    rows = [row for skin in model.skins for row in _sound_at_the_body_left_out(skin, len(model.bodies))]
    rows += [row for stimulus in model.stimuli for row in _response_left_out(model, stimulus)]
    for skin in model.skins:
        if skin.spec.moves or skin.carrier.hand is not None:
            rows.append(
                Row(
                    "the body's own acceleration",
                    _inertia(skin),
                    "not modelled: displacements are in the moving frame, and its load is as slow as the motion",
                    skin.spec.name,
                )
            )
        if skin.carrier.hand is not None:
            rows.append(
                Row(
                    "skin bent by joints",
                    "not estimated",
                    "the layer keeps its resting shape, the sound meets the bent one",
                    skin.spec.name,
                )
            )
    for number, stimulus in enumerate(model.stimuli):
        rows += _flight_and_shock(model, number, stimulus)
    if any(skin.choice.name != "particles" for skin in model.skins):
        rows.append(Row("large strain", "not estimated", "linear elasticity; micrometres on a layer of millimetres"))
    for skin in model.skins:
        rows += _cutoff_row(skin)
    for skin in model.skins:
        if skin.carrier.surface is not None:
            why = "only the resultant force acts on the rest of the body"
            rows.append(Row("skin elsewhere", "not modelled", why, skin.spec.name))
    return rows


def _sound_at_the_body_left_out(skin: SkinModel, bodies: int) -> list[Row]:
    rows, name = [], skin.spec.name
    flat = skin.carrier.surface is None
    of_hand = skin.spec.config.shape in OF_SHAPES["hand"]
    if skin.spec.config.body_sound == "none":
        why = "one part of the body does not shade another" + (", nor one body another" if bodies > 1 else "")
        size = (
            "nothing on an open hand there"
            if of_hand
            else "none of its own on a flat face"
            if flat
            else "not estimated"
        )
        rows.append(Row("cast shadows", size, why, name))
    if skin.spec.config.body_sound != "scattering":
        law = "the law takes the wall as locally flat and rigid"
        if flat:
            size, why = "not estimated", f"{law}, as this face is; left out are diffraction at its rim, and echoes "
            why += "between it and the array"
        else:
            size = "4 % of the ARP on an open hand, 8 % on a finger, 16 % in a cup, more than half on skin turned away"
            why = "relative L2, face by face, on the bodies of docs/bench/scattering.md, not on this one: "
            why += f"{law}; no echo between parts, or between body and array"
        rows.append(Row("scattered sound", size, why, name))
    return rows


def _inertia(skin: SkinModel) -> str:
    """Shear on the base of this layer for an acceleration of 1 m/s^2."""
    sheets, depth = skin.layer.sheets, float(np.median(skin.layer.patch.depth))
    density = sum(sheet.material.density_kg_m3 * sheet.thickness_m for sheet in sheets)
    return f"rho a h of shear on the base: {density * depth:.2g} Pa for 1 m/s^2 on {1e3 * depth:.2g} mm"


def _response_left_out(model: HapticModel, stimulus: StimulusModel) -> list[Row]:
    response, rows, name = stimulus.response, [], stimulus.spec.name
    if not response.on:
        delay_s = 1.0 / response.pole.damping[stimulus.transducers].min()
        rows.append(
            Row(
                "transducers' ring-up",
                f"{response.ring_up} of the pressure",
                f"measured on samples of the drive; one pole, {qualities(model, stimulus)}: a delay of "
                f"{1e3 * delay_s:.2f} ms",
                name,
            )
        )
    if not response.delayed:
        rows.append(
            Row(
                "spread of the flight time",
                f"{response.flight_time} of the pressure",
                f"measured on samples of the drive; {1e3 * response.spread_s:.3f} ms between the first and the last "
                "transducer's sound",
                name,
            )
        )
    return rows


def _flight_and_shock(model: HapticModel, number: int, stimulus: StimulusModel) -> list[Row]:
    arrays, focus = model.arrays, stimulus.first_focus
    distances = np.linalg.norm(arrays.array.positions[stimulus.transducers] - focus, axis=1)
    middle_s = 0.5 * (distances.min() + distances.max()) / sound_speed(arrays.air)
    pressure = abs(arrays.pressure64(focus[None], first_drive(model, number))[0])
    shock = validity.shock_distance_m(pressure, arrays.air, arrays.array.frequency_Hz)
    name = stimulus.spec.name
    return [
        Row("common flight time", f"{1e3 * middle_s:.2f} ms", "shifts results in time", name),
        Row(
            "nonlinear sound",
            f"focal distance / shock distance {distances.mean() / shock:.2f}",
            f"a plane wave of the focus's {pressure:.0f} Pa; beyond 0.3 expect less than this linear field gives",
            name,
        ),
    ]


def _cutoff_row(skin: SkinModel) -> list[Row]:
    config, depth = skin.spec.config, float(np.median(skin.layer.patch.depth))
    cutoff = cutoff_Hz(config, skin.layer.sheets, depth)
    if cutoff is None:
        return []
    rigid = config.base == "bonded" and config.foundation is None
    return [
        Row(
            "waves below the cut-off",
            f"c_s/4h = {cutoff:.0f} Hz" + ("" if rigid else " at most"),
            f"h {1e3 * depth:.1f} mm, the median; a layer on a rigid base guides no wave below this, motion there "
            "stays local" + ("" if rigid else "; the springs below it lower it"),
            skin.spec.name,
        )
    ]
