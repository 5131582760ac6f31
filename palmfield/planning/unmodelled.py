"""List the effects that a run ignores, and their bias."""

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.estimate.array_inputs import stimulus_of
from palmfield.estimate.biases import biases
from palmfield.planning.facts import first_drive, where_it_arrives
from palmfield.planning.rows import Row
from palmfield.session.loudest_moment import nearest_focus
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel
from palmfield.simulation.posed_scene import reference_scene
from palmfield.skin.from_config import cutoff_Hz


def effects_on_skin(model: HapticModel) -> list[Row]:
    """Return rows of ignored effects, with their bias of the displacement of each skin under the focus."""
    rows, posed = [], reference_scene(model)
    for number, skin in enumerate(model.skins):
        stimulus = stimulus_of(model, number)
        focus = nearest_focus(model.stimuli[stimulus].reference_foci, posed.skins[number].nodes[0])
        drive = first_drive(model, stimulus)
        point, outward, _ = where_it_arrives(posed, number, drive)
        found = biases(model, number, stimulus, posed, drive, focus, (point, outward))
        rows += [Row(one.what, one.size, one.why, skin.spec.name) for one in found]
    return rows


def other_effects(model: HapticModel) -> list[Row]:
    """Return rows of other ignored effects, without an estimated bias."""
    rows = []
    for skin in model.skins:
        name = skin.spec.name
        if skin.spec.config.inertia == "off" and (skin.spec.moves or skin.carrier.hand is not None):
            why = (
                "not modelled: displacements are relative to the moving frame, and the inertial load changes as slowly "
                "as the motion; key inertia computes it for smooth scripts"
            )
            rows.append(Row("acceleration of the body", _inertia(skin), why, name))
        if skin.carrier.hand is not None:
            why = "the layer keeps its shape at rest, but the sound meets the bent surface"
            rows.append(Row("bending of the skin at joints", "not estimated", why, name))
    rows += [_common_flight(model, part) for part in model.stimuli]
    for skin in model.skins:
        rows += _cutoff_row(skin)
    for skin in model.skins:
        if skin.carrier.surface is not None:
            why = "the rest of the body feels only the resultant force"
            rows.append(Row("skin elsewhere", "not modelled", why, skin.spec.name))
    return rows


def _inertia(skin: SkinModel) -> str:
    """Describe the shear stress at the base of a layer for an acceleration of 1 m/s^2."""
    sheets, depth = skin.layer.sheets, float(np.median(skin.layer.patch.depth))
    density = sum(sheet.material.density_kg_m3 * sheet.thickness_m for sheet in sheets)
    return f"shear rho a h at the base: {density * depth:.2g} Pa for 1 m/s^2 and {1e3 * depth:.2g} mm"


def _common_flight(model: HapticModel, stimulus: StimulusModel) -> Row:
    """Return the row of the common flight time of all sound, which results omit."""
    arrays, focus = model.arrays, stimulus.first_focus
    distances = np.linalg.norm(arrays.array.positions[stimulus.transducers] - focus, axis=1)
    middle_s = 0.5 * (distances.min() + distances.max()) / sound_speed(arrays.air)
    return Row("common flight time", f"{1e3 * middle_s:.2f} ms", "shifts results in time", stimulus.spec.name)


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
            f"median h {1e3 * depth:.1f} mm; below this frequency a layer on a rigid base guides no wave, and the "
            "motion stays local" + ("" if rigid else "; springs below the layer lower it"),
            skin.spec.name,
        )
    ]
