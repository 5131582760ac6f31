"""List the effects that a run models, and how, and those that it ignores, and their bias."""

import numpy as np

from palmfield import cache
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.directivities import form_of
from palmfield.config.skin import ENDLESS
from palmfield.estimate.array_inputs import qualities, stimulus_of
from palmfield.estimate.biases import biases
from palmfield.estimate.cost import COARSER, FINER, estimate_s
from palmfield.estimate.sending import offset_words, peak_offset, sending
from palmfield.outputs.budget_text import of_full
from palmfield.planning.facts import first_drive, force_samples, where_it_arrives
from palmfield.planning.rows import Row
from palmfield.session.loudest_moment import nearest_focus
from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel
from palmfield.simulation.posed_scene import reference_scene
from palmfield.simulation.small_models.known_load import SHARE
from palmfield.skin.from_config import cutoff_Hz, sheets_in_words
from palmfield.skin.materials.material import shear_wave
from palmfield.stimulus.modulation import arp_lines

BODY_SOUNDS = {
    "none": "faces turned away from the sound are unlit; parts cast no shadows on each other; no echoes",
    "shadows": "a point is dark if the line back along the energy flux is blocked by another part or the body itself",
    "scattering": "boundary elements on the whole body: total field on a rigid wall, with echoes between its parts",
}


def modelled(model: HapticModel, duration_s: float, feedback: str) -> list[Row]:
    """Return rows of modelled effects in a run of this length [s], in the order of the pipeline.

    feedback: reason why `Simulation.step` cannot take several steps together, or ""
    """
    skin_points = sum(6 * len(skin.layer.mesh.surface_triangles6) for skin in model.skins)
    surface = f"{skin_points} skin points"
    if force_samples(model):
        off = ", ".join(dict.fromkeys(f"{100 * body.force_accuracy:.2g} %" for body in model.bodies if body.surface))
        surface += f", about {force_samples(model)} surface samples for the force, error {off} (rms over foci)"
    directivity = " and ".join(form_of(group.array).words(group.array) for group in model.arrays.groups)
    rows = [
        Row(
            "sound field",
            f"{len(model.arrays)} transducers, {surface}",
            f"pressure and gradient on the surface only, no volume; {directivity}; air absorption; on "
            f"{model.spec.device} (palmfield_device)",
        )
    ]
    for number, stimulus in enumerate(model.stimuli):
        level = array_drives(model, model.arrays)[number].unit_drive(stimulus.first_focus).level
        about = f"board {model.board.name}: {model.board.description}"
        if arp := stimulus.config.foci_arp:
            words = ", ".join(f"{x / max(arp):.3g}" for x in arp)
            rows.append(Row("foci", f"ARP {words} of the loudest", "key foci_arp", stimulus.spec.name))
        rows.append(Row("drive", f"amplitude {of_full(level)}", about, stimulus.spec.name))
        offset = peak_offset(model, number)
        if offset is not None:
            words = "maximum of |p|; it lies closer to the array than the focus, where the spreading loss is smaller"
            rows.append(Row("loudest point", offset_words(*offset), words, stimulus.spec.name))
        rows += _modulation(stimulus, level)
    if not model.board.exact:
        board = model.board
        rows.append(Row("sending", str(sending(board, model.configs)), f"{board.line}; {board.when_host_dies}"))
    for skin in model.skins:
        rows.append(Row("ARP", f"law {skin.spec.config.arp_law}", skin.spec.arp_law.about, skin.spec.name))
    for skin in model.skins:
        sound = skin.spec.config.body_sound
        flat = skin.carrier.surface is None and sound == "none"
        about = "flat face, lit by all transducers in front of it" if flat else BODY_SOUNDS[sound]
        rows.append(Row("sound at the body", f"body_sound {sound}", about, skin.spec.name))
    if model.arrays.wall_m is not None:
        trips = len(model.arrays.images) // len(model.arrays.groups)
        about = f"images of the array after {trips} round trips of {2e3 * model.arrays.wall_m:.1f} mm, reflection 1"
        rows.append(Row("echo", "array_face rigid", about))
    for stimulus in model.stimuli:
        rows += _ring_up(stimulus)
    for skin in model.skins:
        rows += _layer(skin)
    substeps, holds = round(duration_s / model.step_s), any(config.control_rate_Hz > 0.0 for config in model.configs)
    rows.append(
        Row(
            "time",
            f"{substeps} steps of {1e3 * model.step_s:.3g} ms in MuJoCo steps of {1e3 * model.spec.timestep_s:.3g} ms",
            "dynamic, because the sound or the pose changes; Simulation.step takes the MuJoCo steps "
            + (f"one at a time: {feedback}" if feedback else "several at a time, because the sound moves no body")
            + "; a recorded run computes sound and motion at skin nodes "
            + ("one at a time: control_rate_Hz holds foci" if holds else "for many steps together"),
        )
    )
    rows += [_solver(skin, model.still_m[skin.body]) for skin in model.skins]
    about = "by a reduced model; in no sensor, level or error; without gravity, Coriolis load and error of the mesh"
    driven = [skin.spec.name for skin in model.skins if skin.spec.config.inertia == "on"]
    return rows + [Row("acceleration of the body", "from its script, recorded runs", about, name) for name in driven]


def _modulation(stimulus: StimulusModel, level: float) -> list[Row]:
    """Describe the ARP of a modulated stimulus; level: largest amplitude of its transducers relative to full drive"""
    config, lines = stimulus.config, arp_lines(stimulus.config)
    if lines is None:
        return []
    size = f"ARP: mean {lines.mean:.3f}"
    about = f"{config.am_quantity} by waveform {config.am_waveform}"
    if lines.first is not None and lines.second is not None and config.am_frequency_Hz is not None:
        frequency = config.am_frequency_Hz
        size += f", {lines.first:.3f} at {frequency:g} Hz, {lines.second:.3f} at {2 * frequency:g} Hz"
    if config.am_waveform == "burst":
        about += f" over the period of {config.am_burst_period_s:g} s"
    unmodulated = "" if config.am_depth else ", which changes nothing"
    why = (
        f"relative to the loudest moment, lines as peak amplitudes; {about}, depth "
        f"{config.am_depth:g}{unmodulated}; peak drive {level:.3f} of full drive, by am_normalisation "
        f"{config.am_normalisation}"
    )
    return [Row("modulation", size, why, stimulus.spec.name)]


def _layer(skin: SkinModel) -> list[Row]:
    layer, name = skin.layer, skin.spec.name
    sizes, demand, depth = layer.sizes, layer.demand, layer.patch.depth
    speed, _ = shear_wave(layer.sheets[0].material, demand.max_frequency_Hz)
    share = layer.patch.report.get("share_thinned", 0.0)
    thinned = f", thinner than depth_m at {100 * share:.0f} % of its vertices (curved rims and webs)" if share else ""
    config = skin.spec.config
    base: str = "on a foundation" if config.foundation else config.base
    if config.base in ENDLESS:
        tissue = "muscle" if config.base == "muscle" else layer.sheets[-1].material.name
        base += f" ({tissue} without end)"
    estimate = f"the same load on elements {COARSER} x larger or {FINER} x smaller, static, harmonic and over time"
    whole = "the region in which waves matter at this accuracy"
    if skin.carrier.surface is None:
        whole = "the whole disc"
    elif layer.cover is not None:
        side = "all skin" if config.cover == "whole" else "the palmar side"
        whole = f"{side} of the hand, {1e4 * layer.patch.report['area_m2']:.0f} cm2"
    elif skin.spec.config.patch_radius_m is not None:
        whole = "the region set by key patch_radius_m"
    own = []
    if skin.solver.own_mesh:
        why = "below the same face; loads and results use the wedge mesh"
        own.append(Row(f"mesh of {skin.choice.name}", skin.solver.resolution, why, name))
        estimate = "cut sides; this solver has its own estimate of the other parts"
    return [
        Row(
            "skin layer",
            f"radius {1e3 * sizes.radius_m:.0f} mm, {1e3 * depth.min():.1f}-{1e3 * depth.max():.1f} mm deep",
            f"{whole}{thinned}; sides {skin.spec.config.side}, base {base}; of " + sheets_in_words(layer.sheets),
            name,
        ),
        Row(
            "elements",
            f"{len(layer.mesh.elements)} quadratic wedges, {layer.dofs} unknowns, edge "
            f"{1e3 * sizes.edge_fine_m:.1f}-{1e3 * sizes.edge_coarse_m:.1f} mm, "
            f"{len(sizes.depth_fractions) - 1} through the depth",
            f"spot {1e3 * demand.spot_fwhm_m:.1f} mm wide, shear wave {1e3 * speed / demand.max_frequency_Hz:.0f} mm "
            f"long at {demand.max_frequency_Hz:.0f} Hz",
            name,
        ),
        *own,
        Row("error estimate", f"about {estimate_s(skin):.0f} s", estimate, name),
    ]


def _solver(skin: SkinModel, still_m: float) -> Row:
    """Return the row for the stepper of a skin.

    still_m: largest displacement of its body that counts as no motion [m]
    """
    choice, solver, config = skin.choice, skin.solver, skin.spec.config
    size, why = f"about {choice.seconds:.0f} s", f"{choice.why}; {solver.steps}"
    if not solver.factorises:
        size += f", wedges about {choice.wedges_s:.0f} s" + " on the CPU" * solver.own_mesh
    leaves = "the full wedge model takes over"
    if solver.of_class:
        stored = "stored in the cache" if cache.folder() is not None else "not stored, because there is no cache"
        beyond = leaves if config.solver == "auto" else "the error of the run reports it"
        why += (
            f", {stored}; the part of the load outside the modes is measured in every step; above "
            f"{100 * config.accuracy:g} % {beyond}"
        )
    elif not solver.any_pose:
        beyond = leaves if config.solver == "auto" else "the run ends"
        why += (
            f", error {100 * SHARE * config.accuracy:.2g} %; if body, arrays or focus move by more than "
            f"{1e6 * still_m:.0f} um, {beyond}"
        )
    return Row(f"skin solver {choice.name}{', a preview' * solver.preview}", size, why, skin.spec.name)


def _ring_up(stimulus: StimulusModel) -> list[Row]:
    response = stimulus.response
    if not response.on:
        return []
    spread = f", flight times span {1e3 * response.spread_s:.2f} ms" if response.delayed else ""
    return [
        Row(
            "transducers' ring-up",
            f"one pole each, {qualities(stimulus)}{spread}",
            f"error of the pressure without it: {response.ring_up}, from samples of the drive"
            + (f"; without the flight times: {response.flight_time}" if spread else ""),
            stimulus.spec.name,
        )
    ]


def effects_on_skin(model: HapticModel) -> list[Row]:
    """Return rows of ignored effects, each with its bias of the displacement of each skin under the focus."""
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
    """Return rows of other ignored effects, whose bias is not estimated."""
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
    """Describe the shear stress at the base of a layer that an acceleration of 1 m/s^2 causes."""
    sheets, depth = skin.layer.sheets, float(np.median(skin.layer.patch.depth))
    density = sum(sheet.material.density_kg_m3 * sheet.thickness_m for sheet in sheets)
    return f"shear rho a h at the base: {density * depth:.2g} Pa for 1 m/s^2 and {1e3 * depth:.2g} mm"


def _common_flight(model: HapticModel, stimulus: StimulusModel) -> Row:
    """Return the row for the flight time that all sound has in common, which results omit."""
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
