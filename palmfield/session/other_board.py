"""Change the keys of a scene so that another board plays it: the board, its layout, and its frame rate."""

from collections.abc import Mapping, Sequence

import numpy as np

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import LAYOUTS, layout
from palmfield.acoustics.focus import focus as focusing
from palmfield.acoustics.reference import pressure64
from palmfield.config.driver import SAFETY_KEYS
from palmfield.drive.board import Board, control_rate_Hz
from palmfield.drive.boards import board_named
from palmfield.errors import SceneError
from palmfield.session.scene_text import Instance
from palmfield.types import Air

AIR = Air()
ARRAY, STIMULUS, DRIVER = "palmfield.array", "palmfield.stimulus", "palmfield.driver"
OF_ONE_LAYOUT = (
    "sites", "transducers", "calibration", "p0_Pa_m", "p0_low_Pa_m", "p0_high_Pa_m", "directivity", "piston_radius_m",
    "dead", "inverted", "quality",
)  # fmt: skip
"""Keys that are valid only for the transducers of one layout."""
OF_ONE_BOARD = ("board", "compensate", "duty_exponent", *SAFETY_KEYS)
"""Keys of palmfield.driver that every board has."""


def exchange_board(scene: str, plugins: Sequence[Instance], name: str, timestep_s: float) -> list[str]:
    """Replace the board of a scene; return the changes, in words.

    Arrays get the layout of the new board, and lose the calibration of the old transducers. Stimuli without steps get
    the frame rate of the board. Raises DeviceError for an unknown board, SceneError for a scene without
    palmfield.driver.
    """
    board = board_named(name)
    drivers = [plugin for plugin in plugins if plugin.plugin == DRIVER]
    if not drivers:
        raise SceneError(f"{scene} has no plugin '{DRIVER}', so board '{name}' has nothing to replace; add the plugin")
    notes = []
    for driver in drivers:
        before = driver.keys.get("board", "ideal")
        if before == name:
            continue
        driver.keys["board"] = name
        for key in [key for key in driver.keys if key not in OF_ONE_BOARD and key not in board.keys]:
            notes.append(f"driver: key '{key}' does not apply to board '{name}' and was removed")
            del driver.keys[key]
    focus = next(
        (plugin.keys["focus_m"] for plugin in plugins if plugin.plugin == STIMULUS and _in_array(plugin)), None
    )
    for array in plugins:
        if array.plugin == ARRAY:
            notes += _exchange_layout(array, board, focus)
    for stimulus in plugins:
        if stimulus.plugin == STIMULUS and _without_steps(stimulus.keys, board) and not board.exact:
            rate_Hz = control_rate_Hz(board, timestep_s)
            stimulus.keys["control_rate_Hz"] = repr(rate_Hz)
            notes.append(f"{stimulus.name}: control_rate_Hz {rate_Hz:.4g}, the frame rate of the board")
    return notes


def _in_array(stimulus: Instance) -> bool:
    """Return whether the focus of a stimulus is in the frame of the array."""
    return stimulus.keys.get("frame", "array") == "array" and len(stimulus.keys.get("focus_m", "").split()) == 3


def _exchange_layout(array: Instance, board: Board, focus: str | None) -> list[str]:
    before = array.keys.get("layout", "uhev1")
    if not board.layouts or before in board.layouts:
        return []
    after = board.layouts[0]
    array.keys["layout"] = after
    dropped = [key for key in OF_ONE_LAYOUT if array.keys.pop(key, None) is not None]
    text = f"{array.name}: layout {after} ({_size(after, focus)})"
    if before in LAYOUTS:
        text += f" instead of {before} ({_size(before, focus)})"
    return [text + (f"; removed keys of the old layout: {', '.join(dropped)}" if dropped else "")]


def _size(name: str, focus: str | None) -> str:
    """Describe a layout: number of transducers, aperture, p0, and the ARP at full drive at a focus.

    Without `focus`, the usual focus of the layout is used.
    """
    made = layout(name)
    wide, high = 1e3 * np.ptp(made.positions, axis=0)[:2]
    place = np.array(LAYOUTS[name].focus_m if focus is None else [float(x) for x in focus.split()])
    where = "its usual focus" if focus is None else "the focus"
    text = f"{len(made)} transducers over {wide:.0f} x {high:.0f} mm, p0 {made.p0_Pa_m:g} Pa m"
    try:
        drive = focusing(made, AIR, place)
    except SceneError:
        return text
    peak = abs(pressure64(place[None], made, drive, AIR)[0][0])
    return f"{text}, {peak**2 / (density(AIR) * sound_speed(AIR) ** 2):.0f} Pa ARP at {where}"


def _without_steps(keys: Mapping[str, str], board: Board) -> bool:
    """Return whether a stimulus may change over time and defines no rate of steps."""
    if float(keys.get("control_rate_Hz", "0") or 0.0) > 0.0:
        return False
    path = keys.get("path", "point") != "point" and not float(keys.get("path_points", "0") or 0.0)
    level = keys.get("modulation", "none") != "none" and not board.modulates
    level = level or keys.get("burst_window", "none") == "hann"
    ramp = float(keys.get("ramp_s", "0") or 0.0) > 0.0
    return path or level or ramp or keys.get("frame", "array") != "array" or keys.get("path_on", "plane") == "skin"
