"""What a scene needs to be modelled, what is left out and why, and what it costs; decided before anything runs."""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from palmfield.acoustics import validity
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import LAWS
from palmfield.acoustics.body_scattering import BODY_SOUNDS, boundary_mesh
from palmfield.session.error_budget import (
    RATIO,
    PUBLISHED_P0_Pa_m,
    compares_with_finer,
    p0_band,
    p0_given,
    stimulus_of,
)
from palmfield.session.load import Source
from palmfield.session.preview import Preview, preview
from palmfield.session.simulation import Simulation
from palmfield.simulation.emission import array_drives
from palmfield.simulation.known_load import SHARE
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel
from palmfield.simulation.posed_scene import reference_scene
from palmfield.skin.costs import factor_s
from palmfield.skin.from_config import cutoff_Hz, sheets_in_words
from palmfield.skin.materials.material import shear_wave
from palmfield.stimulus.schedule import frame_rates, frames_at, main_frequencies, turn_rate_Hz
from palmfield.types import Complex, Float

PAIRS_PER_S = 5e8
"""Pairs of transducer and point a second, with gradient, measured on two cores of a server CPU (docs/bench/)."""
START_AND_PICTURES_S = 12.0
SCATTER_PAIR_S = 2e-8
SCATTER_ELEMENT_S = 1e-4
"""One solution of the boundary elements, docs/bench/scattering.md: 20 iterations of all pairs, and set-up."""
COURSE, POSES = 64, 16
"""Points of a path, and poses of hands that scripts move, in which its distance from a skin is looked at."""


@dataclass(frozen=True)
class Row:
    """One decision.

    size: what it amounts to (resolution, error bound or cost); why: the reason, in words
    instance: of which skin, stimulus or array it is, several with commas between; empty for the whole scene
    """

    what: str
    size: str
    why: str
    instance: str = ""


@dataclass(frozen=True)
class Plan:
    """Decisions for a scene. seconds: expected wall time of `palmfield run` on two CPU cores, pictures included."""

    scene: str
    modelled: tuple[Row, ...]
    left_out: tuple[Row, ...]
    error: tuple[Row, ...]
    seconds: float
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        stream = io.StringIO()
        console = Console(file=stream, width=130)
        console.print(f"Plan for {self.scene}", highlight=False)
        parts = (
            ("Modelled", self.modelled),
            ("Left out", self.left_out),
            ("Expected error of the skin displacement", self.error),
        )
        every = [row for _, rows in parts for row in rows]
        # One of each kind needs no names.
        named = any("," in row.instance for row in every) or (
            len({(row.what, row.instance) for row in every}) > len({row.what for row in every})
        )
        for title, rows in parts:
            columns = ("what", "of", "size", "why") if named else ("what", "size", "why")
            grid = Table(*columns, title=title, title_justify="left")
            for row in rows:
                grid.add_row(*((row.what, row.instance) if named else (row.what,)), row.size, row.why)
            console.print(grid)
        for warning in self.warnings:
            console.print(f"Warning: {warning}", highlight=False)
        console.print(f"Expected time on two CPU cores: {self.seconds:.0f} s", highlight=False)
        return stream.getvalue()


def plan(
    scene: Source | Simulation,
    *,
    device: str | None = None,
    accuracy: float | None = None,
    board: str | None = None,
    keys: Mapping[str, object] | None = None,
) -> Plan:
    """Decide what to model, from the scene's stimuli, surfaces and accuracy; simulates nothing.

    scene: a path, an MjSpec, a compiled model or a Simulation; the other arguments as `palmfield.load`
    Raises SceneError as `palmfield.load`, and where a skin layer can't be made.
    """
    view = preview(scene, device=device, accuracy=accuracy, board=board, keys=keys)
    model, duration_s = view.runtime.model, view.duration_s
    pairs = _points_a_step(model) * len(model.arrays) * duration_s / model.spec.timestep_s
    seconds = START_AND_PICTURES_S + pairs / PAIRS_PER_S
    seconds += sum(_estimate_s(skin) + skin.choice.seconds for skin in model.skins)
    seconds += sum(scattering.solutions * scattering.solution_s for scattering in _scatterings(view))
    return Plan(
        view.name,
        _merged(_modelled(model, duration_s)),
        _merged(_left_out(model)),
        _merged(_errors(model)),
        seconds,
        tuple(_warnings(view)),
    )


def warnings(scene: Source | Simulation) -> list[str]:
    """What a user should know before the run, in words."""
    return _warnings(preview(scene))


def _merged(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Rows that say the same of several instances as one."""
    result: dict[tuple[str, str, str], Row] = {}
    for row in rows:
        key = row.what, row.size, row.why
        known = result.get(key)
        if known is None:
            result[key] = row
        elif row.instance not in known.instance.split(", "):
            result[key] = replace(known, instance=f"{known.instance}, {row.instance}")
    return tuple(result.values())


# -- warnings ------------------------------------------------------------------------------------------------------


def _warnings(view: Preview) -> list[str]:
    model = view.runtime.model
    result = [text for number in range(len(model.skins)) for text in _far_focus(view, number)]
    for stimulus in model.stimuli:
        result += _path_off_the_skin(model, stimulus)
    for scattering in _scatterings(view):
        if scattering.moves:
            total_s = scattering.solutions * scattering.solution_s
            result.append(
                f"body_sound scattering on body '{scattering.body}', which can move: each pose takes about "
                f"{scattering.solution_s:.2g} s, {scattering.solutions} poses {total_s:.0f} s"
            )
    for number in range(len(model.skins)):
        result += _below_cutoff(model, number)
    for number, stimulus in enumerate(model.stimuli):
        focus = stimulus.first_focus
        pressure = model.arrays.pressure64(focus[None], _unit(model, number))
        result += validity.warnings(model.arrays.array, focus, pressure, model.arrays.air)
    return list(dict.fromkeys(result))


def _far_focus(view: Preview, number: int) -> list[str]:
    """Whether no focus comes near a skin, now or where scripts take it."""
    model = view.runtime.model
    skin = model.skins[number]
    numbers = range(len(model.stimuli))
    active = [i for i in numbers if not model.stimuli[i].silent] or list(numbers)
    limit = max(skin.layer.demand.spot_fwhm_m, 2 * skin.layer.sizes.edge_coarse_m)
    least, name = math.inf, ""
    for posed in view.poses(POSES):
        nodes = cKDTree(posed.skins[number].nodes[0])
        for i in active:
            places = posed.focal_points(model.stimuli[i], i)
            foci = [np.atleast_2d(places.at(point)) for point in _course(model.stimuli[i])]
            distance = float(nodes.query(np.concatenate(foci))[0].min())
            if distance <= limit:
                return []
            if distance < least:
                least, name = distance, model.stimuli[i].spec.name
    return [
        f"no focus comes near skin '{skin.spec.name}': that of stimulus '{name}' stays {1e3 * least:.0f} mm away from "
        "the skin layer, which then hardly moves"
    ]


def _course(stimulus: StimulusModel) -> Float:
    """Some of a stimulus's points over one turn of its path, shape (k, 3)."""
    config = stimulus.config
    rate = turn_rate_Hz(config)
    count = COURSE if rate else 1
    times: Float = config.start_s + np.arange(count) / (count * (rate or 1.0))
    return frames_at(config, times)[0]


def _path_off_the_skin(model: HapticModel, stimulus: StimulusModel) -> list[str]:
    """Whether a path on the skin leaves the layers on its body."""
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
        f"{100 * beyond.mean():.0f} % of the path's points{whose}, from {first:.0f} mm on, have no skin layer under "
        "them: necks narrower than its coarse edges are left out; set element_m smaller, or another patch_site"
    ]


def _below_cutoff(model: HapticModel, number: int) -> list[str]:
    skin = model.skins[number]
    cutoff = cutoff_Hz(skin.spec.config, skin.layer.sheets, float(np.median(skin.layer.patch.depth)))
    frequencies = main_frequencies(model.stimuli[stimulus_of(model, number)].config)
    low = [f for f in frequencies if cutoff is not None and f < cutoff]
    if not low:
        return []
    layer = "the skin layer" if len(model.skins) == 1 else f"the skin layer of '{skin.spec.name}'"
    return [
        f"no waves are promised at {', '.join(f'{f:g}' for f in low)} Hz: {layer} carries none below its "
        f"cut-off c_s/4h = {cutoff:.0f} Hz, so that the motion stays near the focus"
    ]


def _unit(model: HapticModel, stimulus: int) -> Complex:
    """What all transducers are told for a stimulus's first focus at the loudest moment, shape (N,)."""
    drive = array_drives(model, model.arrays)[stimulus]
    return drive.unit_drive(model.stimuli[stimulus].first_focus).amplitudes


# -- costs ---------------------------------------------------------------------------------------------------------


class _Scattering(NamedTuple):
    """Boundary elements on one skin's body: whether it can move, solutions in a run, and seconds of each."""

    body: str
    moves: bool
    solutions: int
    solution_s: float


def _scatterings(view: Preview) -> list[_Scattering]:
    """What boundary elements cost, for each skin that asks for them."""
    model = view.runtime.model
    asking = [i for i, skin in enumerate(model.skins) if skin.spec.config.body_sound == "scattering"]
    result = []
    for number in asking:
        skin, moves = model.skins[number], _can_move(view, number)
        poses = round(view.duration_s / model.spec.timestep_s) + 1 if moves else 1
        # A disc's other mesh, in the error estimate, is another body.
        solutions = poses + (skin.spec.config.shape == "disc")
        body = reference_scene(model).bodies[skin.body]
        wavelength_m = sound_speed(model.arrays.air) / model.arrays.array.frequency_Hz
        elements = len(boundary_mesh(body.vertices, body.faces, wavelength_m)[1])
        seconds = SCATTER_PAIR_S * elements**2 + SCATTER_ELEMENT_S * elements
        result.append(_Scattering(skin.spec.config.body, moves, solutions, seconds))
    return result


def _can_move(view: Preview, skin: int) -> bool:
    """Whether body or arrays have degrees of freedom or are moved as mocap bodies, or lie on a body that is."""
    scene, binding = view.runtime.view.model, view.runtime.binding
    sites = [*binding.array_sites, *(site for own in binding.transducer_sites for site in own)]
    bodies = {binding.skins[skin].body, *(scene.site_body(site) for site in sites)}
    return any(scene.can_move(part) for body in bodies for part in scene.ancestors(body))


def _estimate_s(skin: SkinModel) -> float:
    """Seconds of the run's error estimate (palmfield/session/error_budget.py)."""
    dofs, more = skin.layer.dofs, RATIO**3
    low, high = (dofs, more * dofs) if compares_with_finer(skin.layer, dofs) else (dofs / more, dofs)
    # A complex factorisation counts twice; the time step's own is left out where a small model steps.
    edge = 0 if skin.spec.config.shape == "disc" else 2
    step = 2 if skin.choice.name == "wedges" else 0
    return (3 + step + edge) * factor_s(low) + 3 * factor_s(high)


def _points_a_step(model: HapticModel) -> float:
    """Points at which the field is computed in one of MuJoCo's steps."""
    skin = sum(6 * len(part.layer.mesh.surface_triangles6) + part.layer.mesh.surface_nodes for part in model.skins)
    configs = [stimulus.config for stimulus in model.stimuli]
    moving = any(config.path != "point" and not frame_rates(config) for config in configs)
    return (model.substeps if moving else 1) * skin + _faces(model)


def _faces(model: HapticModel) -> int:
    """Faces of the surfaces at which the sound pushes bodies; a disc is pushed at its skin's points."""
    return sum(0 if body.surface is None else len(body.surface.faces) for body in model.bodies)


# -- what is modelled ----------------------------------------------------------------------------------------------


def _modelled(model: HapticModel, duration_s: float) -> list[Row]:
    skin_points = sum(6 * len(skin.layer.mesh.surface_triangles6) for skin in model.skins)
    surface = f"{skin_points} skin points"
    if _faces(model):
        surface += f", {_faces(model)} faces of the surface for the force"
    rows = [
        Row(
            "sound field",
            f"{len(model.arrays)} transducers, {surface}",
            f"pressure and gradient where the surface is, no volume; {_directivity(model)}; air absorption; on "
            f"{model.spec.device} (palmfield_device)",
        )
    ]
    for number, stimulus in enumerate(model.stimuli):
        level = array_drives(model, model.arrays)[number].unit_drive(stimulus.first_focus).level
        about = f"board {model.board.name}: {model.board.description}"
        rows.append(Row("drive", f"amplitude {level:.3f} of full", about, stimulus.spec.name))
    for skin in model.skins:
        law = skin.spec.config.arp_law
        rows.append(Row("ARP", f"law {law}", LAWS[law].about, skin.spec.name))
    for skin in model.skins:
        sound = skin.spec.config.body_sound
        rows.append(Row("sound at the body", f"body_sound {sound}", BODY_SOUNDS[sound], skin.spec.name))
    for stimulus in model.stimuli:
        rows += _ring_up(model, stimulus)
    for skin in model.skins:
        rows += _layer(skin)
    substeps = round(duration_s / model.step_s)
    rows.append(
        Row(
            "time",
            f"{substeps} steps of {1e3 * model.step_s:.3g} ms in MuJoCo steps of {1e3 * model.spec.timestep_s:.3g} ms",
            "the sound or the pose changes, so a static answer will not do",
        )
    )
    return rows + [_solver(skin, model.still_m[skin.body]) for skin in model.skins]


def _layer(skin: SkinModel) -> list[Row]:
    layer, name = skin.layer, skin.spec.name
    sizes, demand, depth = layer.sizes, layer.demand, layer.patch.depth
    speed, _ = shear_wave(layer.sheets[0].material, demand.max_frequency_Hz)
    share = layer.patch.report.get("share_thinned", 0.0)
    thinned = f", thinner than asked at {100 * share:.0f} % of its vertices (curved rims and webs)" if share else ""
    base = "on a foundation" if skin.spec.config.foundation else skin.spec.config.base
    return [
        Row(
            "skin layer",
            f"radius {1e3 * sizes.radius_m:.0f} mm, {1e3 * depth.min():.1f}-{1e3 * depth.max():.1f} mm deep",
            f"the part of the surface where waves matter at this accuracy{thinned}; sides "
            f"{skin.spec.config.side}, base {base}; of " + sheets_in_words(layer.sheets),
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
        Row(
            "error estimate",
            f"about {_estimate_s(skin):.0f} s",
            f"the same load on elements {RATIO} x smaller or larger, static and harmonic",
            name,
        ),
    ]


def _solver(skin: SkinModel, still_m: float) -> Row:
    """Which stepper steps a skin, and why; still_m: how far its body may move and count as still [m]."""
    choice, config, name = skin.choice, skin.spec.config, skin.spec.name
    if choice.name == "wedges":
        why = f"implicit on the whole layer, factorised once; {choice.why}"
        return Row("skin solver wedges", f"about {choice.seconds:.0f} s", why, name)
    return Row(
        "skin solver reduced",
        f"about {choice.seconds:.0f} s, wedges about {choice.wedges_s:.0f} s",
        f"{choice.why}; made for this stimulus, to {100 * SHARE * config.accuracy:.2g} %, while body, arrays and "
        f"focus move by less than {1e6 * still_m:.0f} um; beyond, "
        + ("the run ends" if config.solver == "reduced" else "the whole layer goes on by wedges"),
        name,
    )


def _directivity(model: HapticModel) -> str:
    """What the transducers are off their axes, in words."""
    words = []
    for group in model.arrays.groups:
        if group.array.directivity_table is not None:
            words.append("measured directivity")
        elif group.array.piston_radius_m == 0.0:
            words.append("point sources")
        else:
            words.append(f"pistons of {1e3 * group.array.piston_radius_m:g} mm radius")
    return " and ".join(words)


def _qualities(model: HapticModel, stimulus: StimulusModel) -> str:
    qualities = {model.spec.arrays[number].config.quality for number in stimulus.spec.arrays}
    return "Q " + " and ".join(f"{quality:g}" for quality in sorted(qualities))


def _ring_up(model: HapticModel, stimulus: StimulusModel) -> list[Row]:
    response = stimulus.response
    if not response.on:
        return []
    spread = f", flight times spread over {1e3 * response.spread_s:.2f} ms" if response.delayed else ""
    return [
        Row(
            "transducers' ring-up",
            f"one pole each, {_qualities(model, stimulus)}{spread}",
            f"without, the pressure would be off by {response.ring_up}, measured on samples of the drive"
            + (f"; without the flight times by {response.flight_time}" if spread else ""),
            stimulus.spec.name,
        )
    ]


# -- what is left out ----------------------------------------------------------------------------------------------


def _left_out(model: HapticModel) -> list[Row]:
    rows = [row for skin in model.skins for row in _sound_at_the_body_left_out(skin, len(model.bodies))]
    rows += [row for stimulus in model.stimuli for row in _response_left_out(model, stimulus)]
    for skin in model.skins:
        if skin.spec.moves or skin.carrier.hand is not None:
            rows.append(
                Row(
                    "the hand's own acceleration",
                    "rho a h of shear on the base: 11 Pa for 1 m/s^2 on 10 mm",
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
    if skin.spec.config.body_sound == "none":
        why = "one part of the body does not shade another" + (", nor one body another" if bodies > 1 else "")
        rows.append(Row("cast shadows", "nothing on the open hand there", why, name))
    if skin.spec.config.body_sound != "scattering":
        rows.append(
            Row(
                "scattered sound",
                "4 % of the ARP on an open hand, 8 % on a finger, 16 % in a cup, more than half on skin turned away",
                "relative L2, face by face, on the bodies of docs/bench/scattering.md, not on this one: the law takes "
                "the wall as locally flat and rigid; no echo between parts, or between hand and array",
                name,
            )
        )
    return rows


def _response_left_out(model: HapticModel, stimulus: StimulusModel) -> list[Row]:
    response, rows, name = stimulus.response, [], stimulus.spec.name
    if not response.on:
        delay_s = 1.0 / response.pole.damping[stimulus.transducers].min()
        rows.append(
            Row(
                "transducers' ring-up",
                f"{response.ring_up} of the pressure",
                f"measured on samples of the drive; one pole, {_qualities(model, stimulus)}: a delay of "
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
    pressure = abs(arrays.pressure64(focus[None], _unit(model, number))[0])
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
            f"h {1e3 * depth:.1f} mm, the median; a layer bonded to rigid bone guides no wave below this, motion there "
            "stays local" + ("" if rigid else "; the springs below it lower it"),
            skin.spec.name,
        )
    ]


# -- errors --------------------------------------------------------------------------------------------------------


def _errors(model: HapticModel) -> list[Row]:
    rows = []
    for skin in model.skins:
        name = skin.spec.name
        rows.append(
            Row(
                "mesh and time step",
                f"{100 * skin.spec.config.accuracy:g} % wanted",
                "sizes follow a convergence study on a disc (docs/bench/skin_c0.md); the run estimates what was "
                "reached",
                name,
            )
        )
        for sheet in skin.layer.sheets:
            source = f"{sheet.material.name}: {sheet.material.source}"
            rows.append(Row("material", "of the order of 50 %", source, name))
    for number, stimulus in enumerate(model.stimuli):
        rows += _p0_row(model, number, stimulus)
    return rows


def _p0_row(model: HapticModel, number: int, stimulus: StimulusModel) -> list[Row]:
    name, band = stimulus.spec.name, p0_band(model, number)
    if stimulus.config.arp_peak_Pa is not None:
        return [Row("p0", "none", "arp_peak_Pa sets the level", name)]
    if band is None:
        return []
    published = "{:g} to {:g} Pa m".format(*PUBLISHED_P0_Pa_m)
    why = "the given range" if p0_given(model, number) else f"where no range is given, published values: {published}"
    return [Row("p0", f"x {band[0]:.2f} to x {band[1]:.2f}", f"displacement goes with p0 squared; {why}", name)]
