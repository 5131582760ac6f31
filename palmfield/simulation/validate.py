"""Refuse, before the run, scenes that the board, the boundary elements, the bodies or the machine cannot handle."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
import scipy  # loads its parts at first use

from palmfield.acoustics.phased_array import HOUSING_M, PhasedArray
from palmfield.acoustics.surface_load import CLEARANCE_M
from palmfield.config.skin import BODIES, OF_SHAPES
from palmfield.device import available_bytes
from palmfield.drive.board import Board, check
from palmfield.drive.boards import boards_for
from palmfield.errors import DeviceError, SceneError
from palmfield.simulation.model import SkinModel, StimulusModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.spec import ArraySpec, SceneSpec, SkinSpec, StimulusSpec
from palmfield.skin.scene_layer import SceneLayer
from palmfield.stimulus.resolved import resolved
from palmfield.stimulus.schedule import frame_rates, turn_rate_Hz
from palmfield.types import Float

MOST_UNKNOWNS = 2_000_000
"""Largest number of unknowns of a layer. With more, the factors of its matrix take more than 100 GB."""
FACTOR_BYTES = 180.0
"""Size of the factors of a layer with n unknowns over n^1.4: two by SuperLU and the blocks; for n of 1.5 k to 13 k."""
MOST_SUBSTEPS = 10_000
"""Largest number of substeps of a skin in one MuJoCo step."""
LEAST_APART_M = 1e-3
"""Smallest distance between transducers [m]. Those of different arrays may be point sources without width."""
STILL_ECHO_M = 1e-5
"""Largest movement of a disc in front of a rigid array face: 1/200 of the distance that changes the sign of an echo."""
FACING = np.diag([1.0, -1.0, -1.0])
"""Orientation of an array that faces another array from above: a rotation by 180 degrees about x."""
LEAST_POINTS = 3
"""Smallest number of frames in one turn of a path. Fewer frames do not define a path."""
SURFACE_KEYS = ("shape", *(key for key, shapes in OF_SHAPES.items() if shapes != BODIES))
"""Keys that define the surface of a body. They must be equal for all skins on a body."""


def check_bodies(spec: SceneSpec) -> None:
    """Raise SceneError for skins on one body whose keys define different surfaces, and for two discs on one body."""
    first: dict[str, SkinSpec] = {}
    for skin in spec.skins:
        other = first.setdefault(skin.config.body, skin)
        if other is skin:
            continue
        element = skin.element
        if skin.config.shape == "disc":
            raise SceneError(
                f"{element}: key 'body' has value '{skin.config.body}', which instance '{other.name}' already uses "
                "as its disc; allowed: a separate body for each disc"
            )
        for key in (*SURFACE_KEYS, "body_sound", "arp_law", "arp_alpha"):
            if getattr(skin.config, key) != getattr(other.config, key):
                raise SceneError(
                    f"{element}: key '{key}' has value '{getattr(skin.config, key)}', and "
                    f"'{getattr(other.config, key)}' at instance '{other.name}' on the same body "
                    f"'{skin.config.body}'; allowed: the same for all skins on a body"
                )


def check_apart(names: Sequence[str], arrays: PhasedArray) -> None:
    """Raise SceneError for transducers of two arrays that are closer than their faces allow.

    Within one array, positions come from one file or model. So only distances that are impossible for any transducer
    are errors.
    """
    positions = [arrays.array.positions[part] for part in arrays.slices]
    for number, name in enumerate(names):
        own = pitch_m(positions[number])
        if own < LEAST_APART_M:
            raise SceneError(
                f"plugin 'palmfield.array' instance '{name}': two of its transducers are {1e3 * own:.3g} mm apart; "
                f"allowed: at least {1e3 * LEAST_APART_M:.1f} mm: check the unit of their positions"
            )
        for other in range(number):
            distance = float(scipy.spatial.cKDTree(positions[other]).query(positions[number])[0].min())
            radii = arrays.parts[number].piston_radius_m + arrays.parts[other].piston_radius_m
            least = max(radii, LEAST_APART_M)
            if distance < least:
                raise SceneError(
                    f"plugin 'palmfield.array' instance '{name}': its transducers overlap those of instance "
                    f"'{names[other]}' (two are {1e3 * distance:.1f} mm apart; allowed: at least {1e3 * least:.1f} "
                    "mm); give it its own site by key 'site', or remove one of the two"
                )


def pitch_m(positions: Float) -> float:
    """Return the smallest distance of two transducers [m]; infinite for a single one. positions: shape (n, 3)"""
    return float(scipy.spatial.cKDTree(positions).query(positions, k=[2])[0].min()) if len(positions) > 1 else math.inf


def check_overlaps(skins: Sequence[SkinModel]) -> None:
    """Raise SceneError for overlapping layers on one body, because the same skin would exist twice."""
    for number, skin in enumerate(skins):
        for other in skins[:number]:
            if other.body != skin.body:
                continue
            distance = scipy.spatial.cKDTree(other.nodes[0]).query(skin.nodes[0])[0].min()
            least = 0.5 * max(skin.layer.sizes.edge_coarse_m, other.layer.sizes.edge_coarse_m)
            if distance < least:
                raise SceneError(
                    f"{skin.spec.element}: its layer overlaps that of instance '{other.spec.name}' on body "
                    f"'{skin.spec.config.body}' (distance of the surfaces {1e3 * distance:.1f} mm); set patch_site or "
                    "patch_radius_m to separate them, or use one layer"
                )


def check_cost(skin: SkinSpec, layer: SceneLayer, timestep_s: float, stimulus: StimulusModel) -> None:
    """Raise SceneError for elements and steps so small that the run would not end. This needs sizes, but no mesh.

    stimulus: the stimulus whose spot determines the sizes
    """
    element = skin.element
    substeps = timestep_s / layer.sizes.step_s
    if substeps > MOST_SUBSTEPS:
        raise SceneError(
            f"{element}: the step of {layer.sizes.step_s:.2g} s gives {substeps:.2g} substeps per MuJoCo step; "
            f"allowed: at most {MOST_SUBSTEPS:,}; set step_s larger, or timestep smaller"
        )
    unknowns = layer.expected_dofs
    if unknowns > MOST_UNKNOWNS:
        raise SceneError(
            f"{element}: elements of {1e3 * layer.sizes.edge_fine_m:.3g} mm give about {unknowns:.2g} unknowns, "
            f"whose factors exceed the memory{_missed(skin, layer, stimulus)}; allowed: at most "
            f"{MOST_UNKNOWNS:.2g}; set element_m or accuracy larger, or patch_radius_m smaller"
        )
    needed, there = FACTOR_BYTES * unknowns**1.4, available_bytes()
    if needed > there:
        raise SceneError(
            f"{element}: elements of {1e3 * layer.sizes.edge_fine_m:.3g} mm give about {unknowns:.2g} unknowns, "
            f"whose factors need about {needed / 1e9:.3g} GB; free: {there / 1e9:.3g} "
            f"GB{_missed(skin, layer, stimulus)}; set element_m or accuracy larger, or patch_radius_m smaller"
        )


def _missed(skin: SkinSpec, layer: SceneLayer, stimulus: StimulusModel) -> str:
    """Return the message that the focus misses the skin, if the sizes come from such a spot; otherwise ""."""
    centre = skin.body.transform.points(np.array(skin.patch_centre))
    off_m, spot_m = float(np.linalg.norm(stimulus.first_focus - centre)), layer.demand.spot_fwhm_m
    if off_m <= max(spot_m, sum(layer.demand.path_reach_m)):
        return ""
    return (
        f" (the focus of stimulus '{stimulus.spec.name}' misses the skin: it is {1e3 * off_m:.3g} mm from the "
        f"centre, and the layer is sized for a spot {1e3 * spot_m:.3g} mm wide; move it onto the skin)"
    )


def check_body_sound(skin: SkinSpec, stimuli: Sequence[StimulusModel]) -> None:
    """Raise SceneError for stimuli that need too many boundary-element solutions: one for each focus and pose."""
    if skin.config.body_sound != "scattering":
        return
    name = f"{skin.element}: key 'body_sound' has value 'scattering'; allowed:"
    if any(stimulus.config.path != "point" for stimulus in stimuli):
        raise SceneError(f"{name} with path 'point' only, because each focus needs its own solution; use shadows")
    if len(stimuli) > 1:
        raise SceneError(f"{name} with one stimulus only, because levels of several change independently; use shadows")
    if skin.config.arp_law != "default":
        raise SceneError(f"{name} with arp_law 'default' only, because scattering computes the total field")
    response = stimuli[0].response
    if response.on and np.ptp(np.abs(response.pole.rate)) > 0.0:
        raise SceneError(f"{name} with equal transducer responses only; set key 'response' of the array to off")


def check_arrays(board: Board, arrays: Sequence[ArraySpec]) -> None:
    """Raise SceneError for a board with arrays that it does not drive."""
    if board.exact:
        return
    least, most = board.arrays
    if not least <= len(arrays) <= most:
        drives = "one array" if most == 1 else f"{least} arrays" if least == most else f"{least} to {most} arrays"
        raise SceneError(
            f"plugin 'palmfield.driver': board '{board.name}' drives {drives}; the scene has {len(arrays)} of "
            "'palmfield.array': use board ideal"
        )
    for array in arrays:
        layout = array.config.layout
        if layout not in board.layouts:
            own = "' or '".join(board.layouts)
            raise SceneError(
                f"plugin 'palmfield.driver': board '{board.name}' drives the layout '{own}' only; "
                f"{array.element} has layout '{layout}': set it to '{board.layouts[0]}'"
            )
    if least == 2:
        turn = arrays[1].placement.transform.rotation
        if np.abs(turn - FACING).max() > 1e-3:
            raise SceneError(
                f"plugin 'palmfield.driver': board '{board.name}' needs its second board to face the first; "
                f"{arrays[1].element}: give its site quat='0 1 0 0' relative to the first"
            )


def check_envelope(stimulus: StimulusSpec, board: Board) -> None:
    """Raise DeviceError for a stimulus whose envelope differs from the envelope that the board generates."""
    config = stimulus.config
    if config.modulation != "am":
        raise DeviceError(
            f"{stimulus.element}: key 'modulation' has value '{config.modulation}'; board '{board.name}' always "
            "modulates: set modulation am with its am_frequency_Hz (the sine represents the envelope of the board), "
            "or use board sonicsurface"
        )
    if config.am_waveform != "sine" or config.am_quantity == "duty":
        raise DeviceError(
            f"{stimulus.element}: am_waveform {config.am_waveform} of am_quantity {config.am_quantity}; board "
            f"'{board.name}' has its own envelope: set am_waveform sine and am_quantity amplitude, which represent "
            "it, or use board sonicsurface"
        )


def check_board(stimulus: StimulusSpec, board: Board) -> None:
    """Raise DeviceError for a stimulus that the board cannot play."""
    if board.exact:
        return
    config, element = resolved(stimulus.config, focus_table=stimulus.focus_table), stimulus.element
    table = stimulus.focus_table
    # The length of a path through sites is not available yet
    of_sites = config.path == "sites"
    rates = [config.control_rate_Hz] * (config.control_rate_Hz > 0.0) if of_sites else frame_rates(config)
    moving = config.path != "point" or stimulus.frame_moves
    gives = f"{board.name} gives {board.frame_rate}"
    if moving and not rates:
        raise DeviceError(
            f"{element}: a continuous path or a moving frame needs an unlimited frame rate; {gives}: set "
            "control_rate_Hz, or path_points and a rate, to fit, or use board ideal"
        )
    if stimulus.frame_moves and not config.control_rate_Hz:
        raise DeviceError(
            f"{element}: its frame moves, so the points of its path move between frames; {gives} frames/s: set "
            "control_rate_Hz, or use board ideal"
        )
    am = config.modulation == "am" and not board.modulates
    # Rectangles of full depth need only off and full, with a frame at each jump
    switched = am and config.am_waveform == "rectangle" and config.am_depth == 1.0
    modulated = (am and not switched) or config.burst_window == "hann" or (table is not None and table.has_levels)
    if (modulated or config.ramp_s > 0.0) and board.levels and not config.control_rate_Hz:
        raise DeviceError(
            f"{element}: a continuously changing level needs an unlimited frame rate; {gives}: set "
            "control_rate_Hz, or use board ideal"
        )
    several = len(config.foci_m) // 3 if table is None else table.foci
    if board.takes == "focus" and several > 1:
        key = "foci_m" if table is None else "path_file"
        raise DeviceError(
            f"{element}: key '{key}' has {several} foci at once, but board '{board.name}' plays one: use another board"
        )
    turns = None if of_sites or table is not None else turn_rate_Hz(config)
    needed = max(rates, default=0.0)
    turn = rates[0] / turns if turns else None
    if turns and turn is not None and turn < LEAST_POINTS:
        needed, turn = LEAST_POINTS * turns, float(LEAST_POINTS)
    if switched:
        # The shortest time between two jumps is the shorter part of the period
        duty = config.am_waveform_duty or 1.0
        needed = max(needed, (config.am_frequency_Hz or 0.0) / min(duty, 1.0 - duty))
    needs_levels = config.arp_peak_Pa is not None or config.drive_amplitude not in (None, 0.0, 1.0)
    needs_levels = needs_levels or (am and config.am_normalisation != "peak")
    modulation_Hz = (config.am_frequency_Hz or 0.0) if am and not switched else 0.0
    check(
        board,
        frame_rate_Hz=needed,
        points_per_turn=turn,
        modulated=modulated,
        element=stimulus.name,
        modulation_Hz=modulation_Hz,
        instead=partial(boards_for, max(needed, 2.0 * modulation_Hz), modulated, several_foci=several > 1),
    )
    if not board.levels and (config.ramp_s > 0 or needs_levels):
        raise DeviceError(
            f"{element}: a ramp or a level between off and full needs continuous amplitude; {board.name} has only "
            "on and off: remove ramp_s, arp_peak_Pa, drive_amplitude and am_normalisation, or use key dither or "
            "board ideal"
        )


def check_clear(posed: PosedScene) -> None:
    """Raise SceneError if the surface of a body or of an obstacle reaches into the board of an array.

    Raise it also for a body that has moved from the place for which echoes from a rigid array face are computed.
    """
    if posed.arrays.wall_m is not None:
        _check_echo(posed, posed.arrays.wall_m)
    # Boxes decide most poses without computing vertices
    hulls = []
    for body in posed.bodies:
        if body.model.surface is not None:
            hulls.append(body.hull)
    for skin in posed.skins:
        if skin.skin.obstacles:
            hulls.append(skin.obstacle_hull)
    clear = True
    for board, (place, turn) in zip(posed.arrays.boards, posed.arrays.frames, strict=True):
        for hull in hulls:
            above = np.minimum.reduce((hull - place) @ turn[:, 2]) - board.height
            clear = clear and board.nearest is None and bool(above >= CLEARANCE_M)
    for body in posed.bodies:
        if clear and body.model.surface is not None:
            continue
        points = body.vertices_in_array
        if body.model.surface is None:
            # The closed surface of a disc includes its base, which may lie at the board.
            points = points[: len(points) // 2]
        _check_clear(posed, f"body '{body.model.name}'", points, behind=False)
    for skin in posed.skins:
        if not clear and skin.obstacles is not None:
            _check_clear(posed, "one of the obstacles", skin.obstacles[0], behind=True)


def _check_echo(posed: PosedScene, wall_m: float) -> None:
    from palmfield.simulation.array_face import TILT_RAD

    height = float(posed.bodies[0].frame.position[2]) - posed.arrays.boards[0].height
    tilt = math.acos(max(-1.0, min(1.0, -float(posed.bodies[0].frame.rotation[2, 2]))))
    if abs(height - wall_m) > STILL_ECHO_M or tilt > TILT_RAD:
        raise SceneError(
            "plugin 'palmfield.array': key 'array_face' has value 'rigid', with echoes computed for a disc at "
            f"{1e3 * wall_m:.3f} mm, but the disc is now at {1e3 * height:.3f} mm and tilted by "
            f"{math.degrees(tilt):.3g} degrees; allowed: the pose of the scene; or use array_face absorbing"
        )


def _check_clear(posed: PosedScene, what: str, points: Float, *, behind: bool) -> None:
    """behind: whether the surface may lie completely behind the board."""
    arrays = posed.arrays
    for board, frame in zip(arrays.boards, arrays.frames, strict=True):
        own = points if frame is arrays.frames[0] else frame.inverse_points(points)
        above = board.clearance(own)
        if above >= CLEARANCE_M:
            continue
        mirrored = own * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * board.height]
        if not (behind and board.clearance(mirrored) > HOUSING_M):
            raise SceneError(
                f"plugin 'palmfield.skin': {what} is too close to the array (lowest point {1e3 * above:.1f} mm "
                f"above the board; allowed: at least {1e3 * CLEARANCE_M:g} mm); move it up"
            )
