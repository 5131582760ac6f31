"""What device and boundary elements cannot follow: refused before anything runs."""

from typing import TYPE_CHECKING

import numpy as np

from palmfield.drive.device import check
from palmfield.errors import DeviceError, SceneError
from palmfield.stimulus.schedule import frame_rates, turn_rate_Hz

if TYPE_CHECKING:
    from palmfield.rig import Rig


def check_body_sound(rig: "Rig") -> None:
    """Refuse what boundary elements can't follow in sensible time: they solve once for a focus and a pose."""
    if rig.skin.body_sound != "scattering":
        return
    name = "plugin 'palmfield.skin': key 'body_sound' has value 'scattering'; allowed:"
    if rig.stimulus.path != "point":
        raise SceneError(f"{name} with path 'point' only, as each focus takes a solution of its own; use shadows")
    if rig.skin.arp_law != "default":
        raise SceneError(f"{name} with arp_law 'default' only; it has the total field")
    if rig.response.on and np.ptp(np.abs(rig.response.pole.rate)) > 0.0:
        raise SceneError(f"{name} with transducers that change together; set key 'response' of the array to off")


def check_device(rig: "Rig") -> None:
    """Refuse a stimulus that the device cannot play (DeviceError) and a device on another array (SceneError)."""
    stimulus, device = rig.stimulus, rig.device
    if device.name == "ideal":
        return
    rates = frame_rates(stimulus)
    moving = stimulus.path != "point" or rig.setting.aim_moves
    if moving and not rates:
        raise DeviceError(
            f"plugin 'palmfield.stimulus': a path without steps, or a frame that moves, needs any number of frames/s; "
            f"{device.name} gives {device.max_frame_rate_Hz:.1f}: set control_rate_Hz, or path_points and a rate, "
            "so that they fit, or use device ideal"
        )
    turns = turn_rate_Hz(stimulus)
    turn = rates[0] / turns if turns else None
    wants_level = stimulus.arp_peak_Pa is not None or stimulus.drive_amplitude not in (None, 0.0, 1.0)
    modulated = stimulus.modulation == "am" or stimulus.burst_window == "hann"
    rate = max(rates) if rates else 0.0
    if modulated and not rates:
        rate = 10 * (stimulus.am_frequency_Hz or 0.0)
    check(device, frame_rate_Hz=rate, points_per_turn=turn, modulated=modulated, element="palmfield.stimulus")
    if stimulus.ramp_s > 0 or wants_level:
        raise DeviceError(
            f"plugin 'palmfield.stimulus': a ramp or a level between off and full needs continuous amplitude; "
            f"{device.name} gives on or off: drop ramp_s, arp_peak_Pa and drive_amplitude, or use device ideal"
        )
    if len(rig.boards) > 1:
        raise SceneError(
            f"plugin 'palmfield.driver': device '{device.name}' drives one array; the scene has "
            f"{len(rig.boards)} of 'palmfield.array': use device ideal"
        )
    layout = rig.boards[0].config.layout
    if layout != device.name:
        raise SceneError(
            f"plugin 'palmfield.driver': device '{device.name}' drives the layout '{device.name}' only; "
            f"plugin 'palmfield.array' has layout '{layout}': set it to '{device.name}'"
        )
