"""Why nothing is felt: check a bench from the board to the observer, in the order in which a person should look.

Boards do not answer, so what they do with their bytes is computed by their virtual twins. A microphone or the skin must
confirm it.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from palmfield import terminal
from palmfield.acoustics.reference import pressure64
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.board import TWIN_DELAY_S, Board
from palmfield.drive.boards import BOARDS, playable_board
from palmfield.drive.transport import open_serial
from palmfield.errors import DeviceError, PalmfieldError, SceneError
from palmfield.estimate.estimated_run import run
from palmfield.hardware.focus_board import FocusSound, focus_board
from palmfield.outputs.summary import level_dB_SPL
from palmfield.planning import advice
from palmfield.planning.obstructions import obstructions
from palmfield.planning.visibility import hidden_patches
from palmfield.session.open_scene import Source
from palmfield.session.preview import Preview, preview
from palmfield.session.simulation import Simulation
from palmfield.simulation.emission import Emission
from palmfield.simulation.frames import Frames
from palmfield.simulation.model import array_instances
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import frames_at, main_frequencies
from palmfield.types import Complex, Float

Verdict = Literal["ok", "look here", "unseen"]
FELT_Hz = 4.0, 600.0
"""Frequencies at which people feel motion of some micrometres."""
BEST_Hz = 100.0, 300.0
MOMENTS = 256
"""Number of moments among which the loudest one of a stimulus is selected."""
DISTANCES_m = np.arange(0.04, 0.61, 0.02)
"""Distances of foci with which that of a scene is compared."""
WEAK, FAR = 0.5, 0.35
"""Shares of a full drive, and of the pressure nearer to the array, below which they are reported; the ARP goes with the
square."""
AGREES = 0.1
"""Relative error of a microphone in a reading."""
TRIED_m = (0.0, 0.0, 0.15)
"""Focus of a board without a scene."""


@dataclass(frozen=True)
class Finding:
    """Result of one check. what: the checked part; verdict: `unseen` if only a measurement can tell; text: reason, and
    what to do"""

    what: str
    verdict: Verdict
    text: str


@dataclass(frozen=True)
class Why:
    """The findings, in the order in which to look; scene: name of the scene or board."""

    scene: str
    findings: tuple[Finding, ...]

    @property
    def first(self) -> Finding:
        """The finding to begin with: the first fault, else the first part that only a measurement can check."""
        faults = [one for one in self.findings if one.verdict == "look here"]
        return [*faults, *(one for one in self.findings if one.verdict == "unseen"), self.findings[-1]][0]

    def as_dict(self) -> dict[str, Any]:
        """Return the findings for JSON."""
        return {"scene": self.scene, "first": self.first.what, "findings": [asdict(one) for one in self.findings]}

    def __str__(self) -> str:
        rows = [(one.what, one.verdict, one.text) for one in self.findings]
        begin = f"Why is nothing felt? {self.scene}"
        end = f"Begin with: {self.first.what}. {self.first.text}"
        return terminal.printed(begin, terminal.table(rows, ("check", "verdict", "why")), end, most=130)


class Sound(NamedTuple):
    """The sound of a bench at its loudest moment.

    board: the board; data: bytes of that frame, empty for a board without bytes; target: commanded drive, shape (N,)
    pressure: function from a drive (N,) to the complex pressure at the focus [Pa]; p0: lower and upper end of the
    range of p0, relative to its value
    """

    board: Board
    data: bytes
    target: Complex
    pressure: Callable[[Complex], complex]
    p0: tuple[float, float]


def why(
    scene: Source | None,
    *,
    board: str | None = None,
    port: str | None = None,
    keys: Mapping[str, object] | None = None,
    measured_Pa: float | None = None,
    felt: bool = True,
) -> Why:
    """Check why nothing is felt: board, firmware, polarity, level, focus, modulation, distance and threshold.

    scene: as in `palmfield.run`, None checks only a board with one focus; board, keys: as in `palmfield.Simulation`
    port: serial port or URL of the board, which is opened and closed; no byte is sent
    measured_Pa: peak pressure that a microphone reads at the focus while it sounds steadily at its loudest level [Pa]
    felt: whether to run the scene for its level above threshold, which takes seconds
    A board that cannot play the scene is a finding. Raises SceneError for an invalid scene or reading, and DeviceError
    for an unknown board.
    """
    if measured_Pa is not None and not 0.0 <= measured_Pa < 1e5:
        raise SceneError(f"--measured has value {measured_Pa:g} Pa; allowed: 0 to 1e5 Pa, peak")
    if scene is None:
        if board is None:
            raise SceneError("neither a scene nor a board is given; give SCENE.xml, or --board with a name")
        if keys:
            raise SceneError(f"--set {next(iter(keys))} has no effect without a scene; give SCENE.xml")
        sound = _of_board(board)
        return Why(board, (*_hardware(sound, port, measured_Pa), _tried(board, port)))
    if board is not None:
        playable_board(board)
    try:
        view = preview(scene, board=board, keys=keys)
    except DeviceError as error:
        return Why(str(scene), (_fault("board", str(error)),))
    model, posed = view.runtime.model, view.runtime.posed
    number = model.sounding
    time_s = _loudest_s(view, number)
    try:
        sound = _of_scene(view, posed, number, time_s)
    except PalmfieldError as error:
        return Why(view.name, (_fault("board", str(error)),))
    findings = [*_hardware(sound, port, measured_Pa), _level(view, sound), _focus(view), _modulation(view, number)]
    findings.append(_distance(view, posed, number, sound))
    if felt:
        findings += _threshold(scene, board, keys)
    return Why(view.name, tuple(findings))


def _fault(what: str, text: str) -> Finding:
    return Finding(what, "look here", text)


def _judged(what: str, faults: Iterable[str], fine: str) -> Finding:
    """Return the faults of a part in one finding, or that it is fine."""
    text = "; ".join(dict.fromkeys(faults))
    return _fault(what, text) if text else Finding(what, "ok", fine)


# -- the sound ---------------------------------------------------------------------------------------------------------


def _loudest_s(view: Preview, number: int) -> float:
    """Return the time of the loudest moment of a stimulus in the run [s]."""
    times = float(view.data.time) + view.duration_s * (np.arange(MOMENTS) + 0.5) / MOMENTS
    return float(times[frames_at(view.runtime.model.configs[number], times)[1].argmax()])


def _of_scene(view: Preview, posed: PosedScene, number: int, time_s: float) -> Sound:
    """Return the sound of a scene. Raises SceneError and DeviceError for drives that are impossible."""
    model = view.runtime.model
    frames = Frames(model, Emission(model))
    board = model.board
    data = b"" if board.exact else frames.at(posed, time_s)
    target = frames.target(posed, time_s)
    place = frames_at(model.configs[number], np.array([time_s]))[0][0]
    focus = np.atleast_2d(posed.focal_points(model.stimuli[number], number).at(place))[:1]
    p0 = array_instances(view.runtime.spec)[0].p0
    band = p0.low / p0.value, p0.high / p0.value
    return Sound(board, data, target, lambda drive: complex(posed.arrays.pressure64(focus, drive)[0]), band)


def _of_board(name: str) -> Sound:
    """Return the sound of one focus on the axis. Raises DeviceError for an unknown board."""
    made = focus_board(name, FocusSound(), {})
    place = np.array(TRIED_m)
    unit, air = made.unit(place), made.sound.air
    data = made.frame(place, unit, 1.0)
    band = made.p0.low / made.p0.value, made.p0.high / made.p0.value
    return Sound(
        made.board, data, unit, lambda drive: complex(pressure64(place[None], made.array, drive, air)[0][0]), band
    )


# -- the hardware ------------------------------------------------------------------------------------------------------


def _hardware(sound: Sound, port: str | None, measured_Pa: float | None) -> list[Finding]:
    """Check board, firmware, and polarity."""
    board = sound.board
    if board.exact:
        text = (
            f"board '{board.name}' is no device, so the scene plays nowhere: give your board by --board "
            f"({', '.join(one.name for one in BOARDS.values() if not one.exact)})"
        )
        return [_fault("board", text), *_reading(sound, abs(sound.pressure(sound.target)), measured_Pa)]
    played = board.decode(board.start + sound.data)[-1]
    expected_Pa = abs(sound.pressure(played))
    return [_port(board, port), _firmware(sound, expected_Pa), *_reading(sound, expected_Pa, measured_Pa)]


def _port(board: Board, port: str | None) -> Finding:
    if port is None:
        return Finding("board", "unseen", f"board '{board.name}': give its port by --port, to check that it opens")
    try:
        open_serial(port, board.line.baud if board.line is not None else None).close()
    except DeviceError as error:
        return _fault("board", str(error))
    text = f"{port} opens for board '{board.name}', {board.line}; that something listens there cannot be seen"
    return Finding("board", "ok", text)


def _firmware(sound: Sound, expected_Pa: float) -> Finding:
    """Compute what other boards would make of the bytes, because no board reports its firmware."""
    own = sound.board
    shares = []
    for other in BOARDS.values():
        if other.exact or other.name == own.name or other.takes != own.takes or expected_Pa == 0.0:
            continue
        try:
            twin = other.sized(own.transducers).wired_twin()
        except DeviceError:
            continue
        twin.feed(own.start + sound.data)
        twin.until(twin.time_s + TWIN_DELAY_S)
        share = abs(sound.pressure(twin.emitted)) / expected_Pa
        envelope = ", with an envelope of its own" if other.modulates else ""
        shares.append(f"{100 * share:.0f} % with that of {other.name}{envelope}")
    text = "boards do not report their firmware"
    if shares:
        text += f"; of the pressure at the focus is left: {', '.join(shares)}"
    return Finding("firmware", "unseen", f"{text}; a modulated sound is also heard as a faint hum")


def _reading(sound: Sound, expected_Pa: float, measured_Pa: float | None) -> list[Finding]:
    """Compare the reading of a microphone with the expected pressure; without it, state what it should be."""
    low, high = sound.p0
    level = level_dB_SPL(expected_Pa)
    if level is None:
        return []
    text = (
        f"a microphone at the focus should read {expected_Pa:.0f} Pa peak ({level:.0f} dB SPL; {low * expected_Pa:.0f} "
        f"to {high * expected_Pa:.0f} Pa by the range of p0) at the loudest moment"
    )
    if measured_Pa is None:
        wrong = "k of N reversed transducers leave 1 - 2k/N of it: measure it, and give --measured"
        return [Finding("polarity", "unseen", f"{text}; {wrong}")]
    share = measured_Pa / expected_Pa
    if share < low * (1.0 - AGREES):
        least, most = max(50.0 * (1.0 - share / low), 0.0), 50.0 * (1.0 - share)
        return [
            _fault(
                "polarity",
                f"{text}, but reads {measured_Pa:.0f} Pa, as if {least:.0f} to {most:.0f} % of the transducers were "
                "reversed, or twice as many dead: `palmfield calibrate` finds which",
            )
        ]
    if share > high * (1.0 + AGREES):
        return [_fault("polarity", f"{text}, but reads {measured_Pa:.0f} Pa: check the microphone, or set p0_Pa_m")]
    return [Finding("polarity", "ok", f"{text}, and reads {measured_Pa:.0f} Pa")]


def _tried(board: str, port: str | None) -> Finding:
    """Return what to play next on a board without a scene."""
    focus = " ".join(f"{value:g}" for value in TRIED_m)
    text = (
        f"palmfield drive --focus {focus} --board {board} --port {port or 'PORT'} --am-frequency 200: hold the palm "
        f"{1e3 * TRIED_m[2]:.0f} mm above the middle; for a scene, `palmfield why SCENE.xml --board {board}`"
    )
    return Finding("focus", "unseen", text)


# -- the stimulus ------------------------------------------------------------------------------------------------------


def _level(view: Preview, sound: Sound) -> Finding:
    faults = []
    for stimulus in view.runtime.model.stimuli:
        faults += advice.silence(view, stimulus) + advice.hardly_begun(stimulus, view.duration_s)
    most = float(np.abs(sound.target).max(initial=0.0))
    if 0.0 < most < WEAK:
        faults.append(
            f"the loudest transducer reaches {100 * most:.0f} % of full drive, so the ARP is about "
            f"{100 * most**2:.0f} % of what the array can do: set drive_amplitude, or the pressure of the focus, higher"
        )
    return _judged("level", faults, f"the loudest transducer reaches {100 * most:.0f} % of full drive")


def _focus(view: Preview) -> Finding:
    model = view.runtime.model
    faults = [text for number in range(len(model.skins)) for text in advice.far_focus(view, number)]
    faults += hidden_patches(view) + obstructions(view)
    for stimulus in model.stimuli:
        faults += advice.path_off_the_skin(model, stimulus)
    return _judged("focus", faults, "a focus is on the skin, and the array sees it")


def _modulation(view: Preview, number: int) -> Finding:
    stimulus = view.runtime.model.stimuli[number]
    config = stimulus.config
    faults = [*advice.keys_without_effect(stimulus), *advice.ticks_too_long(stimulus)]
    frequencies = [one for one in main_frequencies(config) if one > 0.0]
    if not frequencies:
        faults.append(
            f"stimulus '{stimulus.spec.name}' is steady, and skin hardly feels a steady push of some pascals: set "
            "modulation to am with am_frequency_Hz 200, or a path"
        )
    elif not any(FELT_Hz[0] <= one <= FELT_Hz[1] for one in frequencies):
        faults.append(
            f"its frequencies are {', '.join(f'{one:g}' for one in frequencies)} Hz; people feel {FELT_Hz[0]:g} to "
            f"{FELT_Hz[1]:g} Hz, best {BEST_Hz[0]:g} to {BEST_Hz[1]:g}"
        )
    if config.modulation == "am" and config.am_depth is not None and config.am_depth < WEAK:
        faults.append(f"am_depth is {config.am_depth:g}, so little of the sound changes: set it to 1")
    fine = f"frequencies {', '.join(f'{one:g}' for one in frequencies[:6])} Hz"
    if frequencies and not any(BEST_Hz[0] <= one <= BEST_Hz[1] for one in frequencies):
        fine += f"; people feel {BEST_Hz[0]:g} to {BEST_Hz[1]:g} Hz best"
    return _judged("modulation", faults, fine)


def _distance(view: Preview, posed: PosedScene, number: int, sound: Sound) -> Finding:
    """Compare a focus at the distance of the hand with foci at other distances in the same direction."""
    model = view.runtime.model
    full = replace(BOARDS["ideal"], compensate=model.board.compensate)
    drive = ArrayDrive(posed.arrays, model.stimuli[number].transducers, None, None, full)
    middle = posed.arrays.array.positions[model.stimuli[number].transducers].mean(axis=0)
    way = model.stimuli[number].first_focus - middle
    distance_m = float(np.linalg.norm(way))

    def pressure(place: Float) -> float:
        return float(np.abs(posed.arrays.pressure64(place[None], drive.unit_drive(place).amplitudes)[0]))

    pressures = np.array([pressure(middle + one / distance_m * way) for one in DISTANCES_m])
    here, most = pressure(middle + way), int(pressures.argmax())
    share = here / float(pressures[most])
    text = (
        f"at {1e3 * distance_m:.0f} mm a focus at full drive has {here:.0f} Pa, {100 * share:.0f} % of one at "
        f"{1e3 * DISTANCES_m[most]:.0f} mm"
    )
    if share < FAR:
        return _fault("distance", f"{text}, so {100 * share**2:.0f} % of its ARP: bring the hand nearer to the array")
    return Finding("distance", "ok", text)


def _threshold(scene: Source, board: str | None, keys: Mapping[str, object] | None) -> list[Finding]:
    """Run the scene for its level above threshold."""
    try:
        result = run(Simulation(scene, board=board, keys=keys), None, plots=(), usd=False)
    except PalmfieldError as error:
        return [_fault("threshold", f"the scene does not run: {error}")]
    findings = []
    for skin in result.summary["skins"]:
        answer = skin["verdict"]
        what = "threshold" if len(result.summary["skins"]) == 1 else f"threshold, {skin['name']}"
        text = f"felt: {answer['felt']}, because {answer['because']}"
        if answer.get("level_dB_SL", 0.0) < 0.0 or answer["felt"] == "no":
            findings.append(_fault(what, f"{text}: raise the level, or use more transducers"))
        else:
            findings.append(Finding(what, "ok" if answer["felt"] == "yes" else "unseen", text))
    return findings
