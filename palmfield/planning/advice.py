"""Give warnings for the user before the run, in words."""

import math
from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial import cKDTree

from palmfield.acoustics import validity
from palmfield.acoustics.layouts import LAYOUTS
from palmfield.acoustics.transducer import ANY_P0
from palmfield.config.stimulus import AM_KEYS
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.boards.ideal import BOARD as IDEAL
from palmfield.estimate.array_inputs import stimulus_of
from palmfield.estimate.biases import response_biases
from palmfield.planning.costs import scatterings
from palmfield.planning.facts import first_drive, turn_times, where_it_arrives
from palmfield.planning.obstructions import obstructions
from palmfield.planning.pins import coarse_pins
from palmfield.planning.visibility import hidden_patches
from palmfield.session.duration import step_count
from palmfield.session.preview import Preview
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel, array_instances
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.validate import pitch_m
from palmfield.skin.from_config import cutoff_Hz, quarter_periods
from palmfield.skin.materials.material import Material
from palmfield.stimulus.schedule import frames_at, main_frequencies
from palmfield.types import Float

COURSE, POSES = 64, 16
"""Number of points of a path, and number of poses of scripted hands, at which distances from a skin are computed."""
SOUNDS, NODES = 16, 2000
"""Largest number of points of a path, and of points of a skin, at which the sound of a distant focus is computed."""
HARDLY = 0.05
"""Smallest |p|^2 on a skin that moves it noticeably, relative to the |p|^2 of a focus at the same point."""
ROUNDED = 0.01
"""Largest relative change of the duration, due to rounding to MuJoCo steps, that causes no warning."""
DENSITIES_kg_m3 = 500.0, 3000.0
SHEAR_Pa = 50.0, 1e9
"""Range of the shear modulus of skin and phantoms, from the softest gels to dry stratum corneum."""
LEAST_POISSON = 0.3
"""Poisson's ratio below which a warning is given; soft tissue, gels and rubbers have 0.45 to 0.5."""
TOUCHING = 0.99
"""Smallest distance of two transducers, relative to the piston diameter; closer transducers overlap."""
DRY_PERCENT = 1.0
"""Lowest plausible humidity [%]. A lower value was probably meant as a fraction."""
MEDIAN_GAIN = 2.0
"""Median gain of the transducers above which the level was probably entered as gains instead of p0."""
FAR_OFF_M = 0.05
"""Largest plausible displacement of a board by a calibration [m]. Above it, the frame or the unit is probably wrong."""
WIDE = 10.0
"""Ratio of the ends of a range above which it is not a useful measurement."""
UNLIKELY = 3.0
"""Factor outside the values of real transducers beyond which p0 is implausible."""


def material_advice(model: HapticModel) -> list[str]:
    """Return the warnings in the material sheets of all skins."""
    return [
        f"material '{sheet.material.name}' of skin '{skin.spec.name}' {warning}"
        for skin in model.skins
        for sheet in skin.layer.sheets
        for warning in _material_warnings(sheet.material)
    ]


def _material_warnings(material: Material) -> list[str]:
    result = []
    for what, value, unit, (low, high) in (
        ("density", material.density_kg_m3, "kg/m^3", DENSITIES_kg_m3),
        ("relaxed shear modulus", material.shear_relaxed_Pa, "Pa", SHEAR_Pa),
    ):
        if not low <= value <= high:
            result.append(
                f"has a {what} of {value:.3g} {unit}; skins and phantoms have {low:g} to {high:g}: check the unit"
            )
    bulk, shear = material.bulk_Pa, material.shear_relaxed_Pa
    poisson = (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))
    if poisson < LEAST_POISSON:
        result.append(f"has a Poisson's ratio of {poisson:.2g}; skin, gels and rubbers have 0.45 to 0.5: check bulk_Pa")
    return result


def advice(view: Preview) -> list[str]:
    """Return all warnings without repeats."""
    model = view.runtime.model
    result = [text for number in range(len(model.skins)) for text in far_focus(view, number)]
    result += hidden_patches(view)
    result += obstructions(view)
    result += _rounded_duration(view)
    result += _disabled_sensors(view)
    result += array_advice(model)
    result += material_advice(model)
    for stimulus in model.stimuli:
        result += silence(view, stimulus)
        result += keys_without_effect(stimulus)
        result += path_off_the_skin(model, stimulus)
        result += hardly_begun(stimulus, view.duration_s)
        result += ticks_too_long(stimulus)
    for scattering in scatterings(view):
        if scattering.moves:
            total_s = scattering.solutions * scattering.solution_s
            result.append(
                f"body_sound scattering on body '{scattering.body}', which can move: about "
                f"{scattering.solution_s:.2g} s per pose, {scattering.solutions} poses take {total_s:.0f} s"
            )
    for skin in model.skins:
        result += _own_mesh(skin, view)
    for number in range(len(model.skins)):
        result += _coarse(model, number)
        result += _below_cutoff(model, number)
    for number in range(len(model.skins)):
        result += _dropped_response(model, number)
    for number, stimulus in enumerate(model.stimuli):
        drive, posed = first_drive(model, number), view.runtime.work.reference
        places = [where_it_arrives(posed, skin, drive) for skin in range(len(model.skins))]
        point, _, pressure = max(places, key=lambda place: place[2])
        beam = drive, stimulus.first_focus
        if pressure == 0.0:
            continue
        result += validity.warnings(model.arrays.array, point, pressure, model.arrays.air, beam)
    return list(dict.fromkeys(result))


def _coarse(model: HapticModel, number: int) -> list[str]:
    """Warn if keys make a skin coarser than its target accuracy needs."""
    skin, pinned = model.skins[number].spec, coarse_pins(model, number)
    if not pinned:
        return []
    return [
        f"keys make skin '{skin.name}' coarser than accuracy {100 * skin.config.accuracy:g} % needs: "
        f"{', '.join(pinned)}; the run estimates the error; remove the keys, or set accuracy larger"
    ]


def _dropped_response(model: HapticModel, number: int) -> list[str]:
    """Warn if a key switches off ring-up or flight time although the effect is larger than the target accuracy."""
    skin, stimulus = model.skins[number], model.stimuli[stimulus_of(model, number)]
    target = skin.spec.config.accuracy
    return [
        f"key response of palmfield.array ignores the {bias.what} of stimulus '{stimulus.spec.name}': the error of "
        f"the displacement of skin '{skin.spec.name}' may be {bias.size}, above the target accuracy of "
        f"{100 * target:g} %; set response to auto or on"
        for bias in response_biases(stimulus, skin)
        if bias.low is not None and -bias.low > target
    ]


def ticks_too_long(stimulus: StimulusModel) -> list[str]:
    """Warn if control_rate_Hz is too low for a modulation. Rectangles are not affected: they get frames at jumps."""
    config = stimulus.config
    rate, frequency = config.control_rate_Hz, config.am_frequency_Hz
    if config.modulation != "am" or config.am_waveform == "rectangle" or not config.am_depth or frequency is None:
        return []
    if not 0.0 < rate <= 2.0 * frequency:
        return []
    played = f"the played frequency is {abs(frequency - rate * round(frequency / rate)):g} Hz"
    if rate == 2.0 * frequency:
        played = "the played depth depends on the phase of the frames"
    return [
        f"stimulus '{stimulus.spec.name}' has {rate:g} frames per second (control_rate_Hz), at most two per period "
        f"of {frequency:g} Hz: {played}; set control_rate_Hz larger, or am_frequency_Hz smaller"
    ]


def far_focus(view: Preview, number: int) -> list[str]:
    """Warn if no focus comes close to a skin, now or during scripted motion."""
    model = view.runtime.model
    skin = model.skins[number]
    numbers = range(len(model.stimuli))
    active = [i for i in numbers if not model.stimuli[i].silent] or list(numbers)
    limit = max(skin.layer.demand.spot_fwhm_m, 2 * skin.layer.sizes.edge_coarse_m)
    least, nearest = math.inf, (0, view.runtime.posed)
    for posed in view.poses(POSES):
        nodes = cKDTree(posed.skins[number].nodes[0])
        for i in active:
            places = posed.focal_points(model.stimuli[i], i)
            foci = [np.atleast_2d(places.at(point)) for point in _course(model.stimuli[i])]
            distance = float(nodes.query(np.concatenate(foci))[0].min())
            if distance <= limit:
                return []
            if distance < least:
                least, nearest = distance, (i, posed)
    stimulus, spot_mm = model.stimuli[nearest[0]], 1e3 * skin.layer.demand.spot_fwhm_m
    share = 0.0 if stimulus.silent else _share_of_focus(model, number, *nearest)
    moves = (
        "so the skin hardly moves"
        if share < HARDLY
        else (f"whose loudest point has {100 * share:.0f} % of the |p|^2 of a focus there")
    )
    return [
        f"no focus is near skin '{skin.spec.name}': the focus of stimulus '{stimulus.spec.name}' stays "
        f"{1e3 * least:.0f} mm from the skin layer, {moves}; the elements are sized for the {spot_mm:.2g} mm spot "
        "at the focus: move the focus onto the skin, or set element_m and patch_radius_m"
    ]


def _share_of_focus(model: HapticModel, skin: int, stimulus: int, posed: PosedScene) -> float:
    """Return the highest free-field |p|^2 on a skin, relative to that of a focus at the same point, along a path.

    Both values are for full drive of the same transducers, so the ratio does not depend on the level. A level that the
    transducers can reach at the focus may be impossible at the skin.
    """
    nodes = posed.skins[skin].nodes[0]
    nodes = nodes[:: -(-len(nodes) // NODES)]
    part, board = model.stimuli[stimulus], replace(IDEAL, compensate=model.board.compensate)
    drive = ArrayDrive(posed.arrays, part.transducers, None, None, board)
    course, share = _course(part), 0.0
    places = posed.focal_points(part, stimulus)
    for point in course[:: -(-len(course) // SOUNDS)]:
        pressures = np.abs(posed.arrays.pressure64(nodes, drive.unit_drive_at(places, point).amplitudes))
        loudest = nodes[pressures.argmax()]
        in_front = np.any((loudest @ drive.normals) > np.einsum("ij,ij->j", drive.places, drive.normals))
        if in_front and pressures.max() > 0.0:
            focused = np.abs(posed.arrays.pressure64(loudest[None], drive.unit_drive(loudest).amplitudes)[0])
            share = max(share, float(pressures.max() / focused) ** 2)
    return share


def silence(view: Preview, stimulus: StimulusModel) -> list[str]:
    """Warn if a stimulus is silent in the run because of its level or its times."""
    config, name = stimulus.config, stimulus.spec.name
    begin, end = float(view.data.time), float(view.data.time) + view.duration_s
    if stimulus.silent:
        level = "" if config.drive_amplitude is None else f": its drive_amplitude is {config.drive_amplitude:g}"
        return [f"stimulus '{name}' emits no sound{level}"]
    if config.start_s >= end:
        return [
            f"stimulus '{name}' emits no sound in this run: it starts at {config.start_s:g} s, and the run ends at "
            f"{end:g} s; set start_s smaller, or run longer"
        ]
    if config.stop_s is not None and config.stop_s <= begin:
        return [
            f"stimulus '{name}' emits no sound in this run: it stops at {config.stop_s:g} s, and the run begins at "
            f"{begin:g} s"
        ]
    return []


def _rounded_duration(view: Preview) -> list[str]:
    """Warn if rounding to MuJoCo steps makes the run longer or shorter than requested."""
    step_s = view.runtime.model.spec.timestep_s
    steps = step_count(view.duration_s, step_s)
    if abs(steps * step_s - view.duration_s) <= ROUNDED * view.duration_s:
        return []
    count = "one MuJoCo step" if steps == 1 else f"{steps} MuJoCo steps"
    return [
        f"the run takes {steps * step_s:.3g} s instead of {view.duration_s:.3g} s, which is {count}: "
        f"option timestep is {step_s:g} s; set a timestep that divides the duration"
    ]


def _disabled_sensors(view: Preview) -> list[str]:
    """Warn if MuJoCo options leave the sensors of skins at 0."""
    if not view.data.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_SENSOR:
        return []
    own = view.data.model.sensor_plugin >= 0
    return [f"flag 'sensor' is disabled, so {own.sum()} plugin sensors stay at 0: remove the flag"] if own.any() else []


def _course(stimulus: StimulusModel) -> Float:
    """Return some of the points of a stimulus over one turn of its path, shape (k, 3)."""
    return frames_at(stimulus.config, turn_times(stimulus, COURSE))[0]


def keys_without_effect(stimulus: StimulusModel) -> list[str]:
    """Warn of keys of a modulation that is off."""
    config = stimulus.spec.config
    present = [key for key in AM_KEYS if key in config.model_fields_set and getattr(config, key) is not None]
    if config.modulation != "none" or not present:
        return []
    which, have = ("key", "has") if len(present) == 1 else ("keys", "have")
    return [
        f"{which} {', '.join(present)} of stimulus '{stimulus.spec.name}' {have} no effect, because its modulation is "
        "'none': set modulation to am, or remove them"
    ]


def hardly_begun(stimulus: StimulusModel, duration_s: float) -> list[str]:
    """Warn if the run ends while the sound still grows. duration_s: duration of the run, from time 0 of MuJoCo"""
    config = stimulus.config
    lasts_s = duration_s - config.start_s
    if not 0.0 < lasts_s < config.ramp_s:
        return []
    reached = 0.5 - 0.5 * math.cos(math.pi * lasts_s / config.ramp_s)
    return [
        f"the ramp of stimulus '{stimulus.spec.name}' takes {config.ramp_s:g} s, but the run contains only "
        f"{lasts_s:g} s of it, so the ARP reaches {100 * reached:.2g} % of its full value: set ramp_s shorter, or "
        "the duration longer"
    ]


def path_off_the_skin(model: HapticModel, stimulus: StimulusModel) -> list[str]:
    """Warn if a path on the skin leaves the layers on its body."""
    if stimulus.path is None or stimulus.spec.on_skin is None:
        return []
    body = model.skins[stimulus.spec.on_skin].body
    carrier = model.bodies[body]
    assert carrier.surface is not None
    layers = [model.skins[number] for number in model.carried(body)]
    path = stimulus.path.positions(stimulus.path.arc_m, carrier.surface.vertices, carrier.surface.faces)
    distances = np.array([cKDTree(skin.nodes[0]).query(path)[0] / skin.layer.sizes.edge_coarse_m for skin in layers])
    beyond = distances.min(axis=0) > 2.0
    if not beyond.any():
        return []
    first = 1e3 * stimulus.path.arc_m[beyond.argmax()]
    whose = f" of stimulus '{stimulus.spec.name}'" if len(model.stimuli) > 1 else ""
    return [
        f"{100 * beyond.mean():.0f} % of the path points{whose}, from {first:.0f} mm on, have no skin layer below, "
        "because the layer omits necks narrower than its coarse edges: set element_m smaller, or another "
        "patch_site"
    ]


def _own_mesh(skin: SkinModel, view: Preview) -> list[str]:
    """Describe the cost on a CPU of a solver with its own mesh, and what a preview would give."""
    solver, device = skin.choice.name, view.runtime.model.spec.device
    own, result = skin.solver, list[str]()
    if own.preview and own.expected_error is not None:
        result.append(
            f"solver '{solver}' of skin '{skin.spec.name}' is a preview: the expected error of its displacement is "
            f"about {100 * own.expected_error:.2g} %"
        )
    cpu_s, gpu_s = (own.seconds(view.duration_s, where) for where in ("cpu", "cuda:0"))
    if not own.preview and device == "cpu" and gpu_s < cpu_s:
        result.append(
            f"solver '{solver}' of skin '{skin.spec.name}' is designed for a GPU: about {cpu_s:.2g} s on the CPU, "
            f"{gpu_s:.2g} s on a GPU (palmfield_device)"
        )
    return result


def _below_cutoff(model: HapticModel, number: int) -> list[str]:
    skin = model.skins[number]
    sheets, depth_m = skin.layer.sheets, float(np.median(skin.layer.patch.depth))
    frequencies = main_frequencies(model.stimuli[stimulus_of(model, number)].config)
    # Without the cut-off itself, for which SciPy would load its optimizers in 0.1 s
    low = [f for f in frequencies if f > 0.0 and quarter_periods(sheets, depth_m, f) < 1.0]
    cutoff = cutoff_Hz(skin.spec.config, sheets, depth_m) if low else None
    if cutoff is None:
        return []
    layer = "the skin layer" if len(model.skins) == 1 else f"the skin layer of '{skin.spec.name}'"
    return [
        f"at {', '.join(f'{f:g}' for f in low)} Hz {layer} carries no waves on its rigid base, so the motion stays "
        f"near the focus: the cut-off c_s/4h is {cutoff:.0f} Hz; base deep or muscle has none"
    ]


def array_advice(model: HapticModel) -> list[str]:
    """Return warnings on arrays."""
    return _unlikely_p0(model) + _crowded(model) + _dry(model) + _calibrations(model)


def _unlikely_p0(model: HapticModel) -> list[str]:
    """Warn if p0 is far from that of any real transducer. The usual reason is a wrong unit."""
    result = []
    typical = [ANY_P0, *(layout.p0 for layout in LAYOUTS.values())]
    least, most = min(one.low for one in typical), max(one.high for one in typical)
    for array, instance in zip(model.spec.arrays, array_instances(model.spec), strict=True):
        p0, whence = instance.p0.value, instance.p0.source
        if least / UNLIKELY <= p0 <= UNLIKELY * most:
            continue
        result.append(
            f"p0 of array '{array.name}' is {p0:g} Pa m ({whence}); known transducers have {least:g} to {most:g}: "
            "check the unit (peak pressure in Pa at 1 m at full drive)"
        )
    return result


def _crowded(model: HapticModel) -> list[str]:
    """Warn if transducers of an array overlap.

    The usual reason is a wrong unit of the positions or the piston radius.
    """
    result = []
    for array, part in zip(model.spec.arrays, model.arrays.parts, strict=True):
        pitch, wide = pitch_m(part.positions), 2.0 * part.piston_radius_m
        if pitch < TOUCHING * wide:
            result.append(
                f"transducers of array '{array.name}' are {1e3 * pitch:.3g} mm apart, but their pistons are "
                f"{1e3 * wide:.3g} mm wide: check the unit of the positions, or set piston_radius_m"
            )
    return result


def _dry(model: HapticModel) -> list[str]:
    """Warn if the air is drier than in any room. The humidity was probably entered as a fraction."""
    return [
        f"humidity_percent of array '{array.name}' is {array.config.humidity_percent:g}, drier than any room: "
        "check the unit (percent)"
        for array in model.spec.arrays
        if 0.0 < array.config.humidity_percent <= DRY_PERCENT
    ]


def _calibrations(model: HapticModel) -> list[str]:
    """Warn if a calibration has implausible values. The usual reason is a wrong unit of levels or positions."""
    result = []
    for array, instance in zip(model.spec.arrays, array_instances(model.spec), strict=True):
        one = instance.calibration
        if one is None:
            continue
        what = f"the calibration of array '{array.name}'"
        if one.elements is not None:
            middle = float(np.median(np.array(one.elements.gain)[np.array(one.elements.enabled)]))
            if not 1.0 / MEDIAN_GAIN <= middle <= MEDIAN_GAIN:
                result.append(
                    f"{what} has gains of about {middle:.3g}; gains are relative to p0: put the level into p0, and "
                    "keep gains near 1"
                )
        off_m = float(np.linalg.norm(one.pose.offset_m))
        if off_m > FAR_OFF_M:
            result.append(f"{what} displaces the board by {off_m:.3g} m: check the unit (metres) and the frame")
        if one.p0 is not None and one.p0.high > WIDE * one.p0.low:
            result.append(
                f"{what} has a p0 of {one.p0.low:g} to {one.p0.high:g} Pa m, which is too wide to be useful: "
                "measure it again"
            )
    return result
