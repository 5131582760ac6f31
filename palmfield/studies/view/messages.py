"""Messages between the process of the simulation and that of the page.

The simulation sends SceneShown at its start and after each rebuild. It sends Notice and Values when needed. It sends
Moment and Replay only on request, so that it never waits for the page. All positions are in the world [m]. All messages
are pickled between two processes of one program.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palmfield.types import Complex, Float32, Int

Group = Literal["key", "pose"]
Place = tuple[Group, str, int | None]
"""Identifies a slider: its group, INSTANCE.key or INSTANCE.axis of a hand, and the index in a vector."""


class Address(NamedTuple):
    """Address of the page.

    host: address to listen at
    port: port, None for the first free port from 8080 on
    token: token that clients need, empty for none
    rate_Hz: pictures per second
    """

    host: str
    port: int | None
    token: str
    rate_Hz: float


# -- messages of the simulation ----------------------------------------------------------------------------------------


class Slider(NamedTuple):
    """A slider for one number.

    folder: heading of its group
    low, high, step, value: numbers in `unit`
    scale: factor from the SI unit to `unit`
    """

    place: Place
    folder: str
    label: str
    low: float
    high: float
    step: float
    value: float
    unit: str
    scale: float


class Pose(NamedTuple):
    """Present positions [m].

    bodies: vertices of each body, shape (v, 3)
    skins: surface nodes and outward normals of each skin, shapes (S, 3)
    transducers: positions, shape (N, 3)
    """

    bodies: tuple[Float32, ...]
    skins: tuple[tuple[Float32, Float32], ...]
    transducers: Float32


class SceneShown(NamedTuple):
    """Parts that are constant until the scene is rebuilt.

    body_faces: faces of the closed bodies, shape (m, 3) each
    skins: names of the skins
    skin_faces: their faces, shape (f, 3) each
    pose: the first pose
    transducer_directions: unit vectors, (N, 3); transducer_radius: [m]
    no_pose: why the hand has no sliders, empty if it has sliders
    timestep_s: time step of MuJoCo [s]
    """

    name: str
    device: str
    body_faces: tuple[Int, ...]
    skins: tuple[str, ...]
    skin_faces: tuple[Int, ...]
    pose: Pose
    transducer_directions: Float32
    transducer_radius: float
    sliders: tuple[Slider, ...]
    no_pose: str
    timestep_s: float


class Moment(NamedTuple):
    """Present state of the scene.

    time_s: simulated time [s]
    speed: simulated time per wall time, recently measured; 0 while paused
    pose: None if no part has moved since the last message
    drive: commanded drive of the transducers, shape (N,)
    foci: positions [m], shape (m, 3), empty in silence
    solvers: stepper of each skin
    recording: folder of the recording, or empty
    displacement, arp: displacement along the outward normal [m] and ARP [Pa] of each skin, (S,), if requested
    hand_age_s: age of the pose of a tracked hand [s], NaN while it is lost; None without a tracked hand
    """

    time_s: float
    speed: float
    playing: bool
    pose: Pose | None
    drive: Complex
    foci: Float32
    solvers: tuple[str, ...]
    recording: str
    displacement: tuple[Float32, ...] = ()
    arp: tuple[Float32, ...] = ()
    hand_age_s: float | None = None


class Level(NamedTuple):
    """Level of an observer for the last periods of a skin.

    level_dB: level above threshold, None if there is none
    why: reason why there is none
    lines: frequency lines of the motion or force to which the level belongs
    """

    observer: str
    level_dB: float | None
    why: str
    lines: str = ""


class SkinReplay(NamedTuple):
    """The last periods of a skin.

    displacement: along the outward normal [m], shape (k, S)
    arp: [Pa], shape (k, S)
    rms: rms of the displacement about its mean [m], shape (S,)
    levels: levels by observer
    """

    displacement: Float32
    arp: Float32
    rms: Float32
    levels: tuple[Level, ...]


class Replay(NamedTuple):
    """The last periods of all skins.

    times: [s], shape (k,); they begin at `begin_s` and have length `length_s` [s]
    what: description of this part of the run
    """

    times: NDArray[np.float64]
    length_s: float
    what: str
    skins: tuple[SkinReplay, ...]


class Notice(NamedTuple):
    """A sentence for the page. kind: `busy` stays until the next notice, `error` is red, `info` is plain text"""

    kind: Literal["info", "busy", "error"]
    text: str


class Values(NamedTuple):
    """Values of the sliders, in their units, by place."""

    values: dict[Place, float]


@dataclass(frozen=True)
class End:
    """End of the messages."""


FromSimulation = SceneShown | Moment | Replay | Notice | Values | End


# -- messages of the page ----------------------------------------------------------------------------------------------


class Ready(NamedTuple):
    """Message that the page is available. address: address for the browser; failed: reason if it is not available"""

    address: str
    failed: str = ""


class Request(NamedTuple):
    """Request for the next Moment, with or without motion and ARP, or for the next Replay."""

    what: Literal["moment", "full moment", "replay"]


class Turn(NamedTuple):
    """A slider is set to a value, in its unit."""

    place: Place
    value: float


class SetKey(NamedTuple):
    """A key to change as text, INSTANCE.key=VALUE."""

    text: str


class Press(NamedTuple):
    """A button was pressed."""

    what: Literal["play", "pause", "reset", "record", "stop recording"]


class Pace(NamedTuple):
    """Limit of simulated seconds per second; inf for no limit."""

    most: float


FromPage = Ready | Request | Turn | SetKey | Press | Pace
