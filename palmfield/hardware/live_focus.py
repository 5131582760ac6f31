"""Play foci received over a socket on a real board."""

import contextlib
import logging
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.reference import pressure64
from palmfield.config.stimulus import too_far
from palmfield.drive.frame_log import FrameLog
from palmfield.drive.limits import SoundLimits
from palmfield.drive.live_foci import FocusListener, LiveFocus
from palmfield.drive.player import Player
from palmfield.errors import DeviceError, PalmfieldError, SceneError
from palmfield.hardware.focus_board import FocusBoard, FocusSound, am_share, focus_board
from palmfield.hardware.play import Performance, Target, check_log, played_in_words
from palmfield.hardware.safety.exposure import Exposure, SoundMoment, at_head, check_head, with_band
from palmfield.motion.line_listener import STALE_S, By
from palmfield.types import Complex, Float

LOG = logging.getLogger(__name__)
LOOK_S = 0.05
AHEAD_S = 3e-3
"""Time before its due time at which a frame of a modulated focus is made [s]."""
MOST_STEPS = 8
"""Largest number of steps of a ramp."""


@dataclass(frozen=True)
class LiveInput:
    """Source of foci.

    port: port number; 0 for any free port
    on_listening: function that is called with the address
    offset_m: position of the focus in the frame at `position_m`, for input lines without focus_m
    """

    host: str = "127.0.0.1"
    port: int = 0
    by: By = "udp"
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    on_listening: Callable[[str, int], None] = lambda host, port: None


def play_live(
    live: LiveInput,
    board: str,
    target: Target,
    duration_s: float | None = None,
    *,
    sound: FocusSound | None = None,
    keys: Mapping[str, object] | None = None,
) -> Performance:
    """Play the newest received focus until Ctrl-C or for some time; return a report in words.

    board, sound, keys: as in `palmfield.hardware.play.play_focus`; the level in an input line multiplies the level of
    `sound` A focus sounds until a newer one arrives. It fades out STALE_S after its arrival, with the ramp of the
    driver. A focus that cannot be played is counted, reported and skipped. The previous focus then continues. Raises
    SceneError and DeviceError as `play_focus`. Raises DeviceError also for an address at which it cannot listen, and if
    a focus may be louder at the head than key head_limit_dB allows.
    """
    target.check()
    if target.port is None:
        raise DeviceError("live foci need a port (--port) and cannot be recorded (--record); use --log to keep a log")
    made = focus_board(board, sound or FocusSound(), keys or {})
    limits = SoundLimits.of(made.driver)
    if made.driver.head_m is not None:
        for line in check_head(_most_at_head(made), made.driver):
            LOG.warning(f"for any focus position the level can reach {line}")
    if target.log is not None:
        FrameLog(target.log, made.head).close()
    console = Console(stderr=True)
    with (
        FocusListener(np.array(live.offset_m), live.host, live.port, live.by) as listener,
        Player(
            made.board, target.port, log=target.log, stale_s=STALE_S, ramp_s=limits.ramp_s, tells_frames=True,
            on_time_s=limits.on_time_s or 0.0, duty=limits.duty,
            on_trouble=lambda text: console.print(f"palmfield: {text}"),
        ) as player,
    ):  # fmt: skip
        live.on_listening(listener.host, listener.port)
        session = _Live(made, limits, listener, player)
        with contextlib.suppress(KeyboardInterrupt):
            session.follow(math.inf if duration_s is None else time.monotonic() + duration_s)
        silent = player.silent
        player.close()
    report = player.played
    done = played_in_words(report, made.board, target.port)
    check_log(player, target.log, f"{done}; ")
    notes = [*made.notes, *([words] if (words := limits.in_words(made.board)) else []), listener.report()]
    if waits := [on_line - session.came_s[number] for number, on_line in report.on_line if number in session.came_s]:
        median, most = 1e3 * float(np.median(waits)), 1e3 * float(np.percentile(waits, 95))
        notes.append(
            f"delay from the arrival of a focus to its last byte on the line: median {median:.1f} ms, 95 % "
            f"{most:.1f} ms"
        )
    if silent and not silent.startswith("no frame"):
        notes.append(f"the board was silenced: {silent}")
    return Performance(done, report.warning if made.sound.am_frequency_Hz > 0.0 else "").saying(
        *notes, *listener.reported
    )


class _Live:
    """Makes the frames of the newest focus. came_s: arrival time of each focus [s], stored at its first frame"""

    def __init__(self, made: FocusBoard, limits: SoundLimits, listener: FocusListener, player: Player) -> None:
        self.made, self.listener, self.player = made, listener, player
        self.came_s: dict[int, float] = {}
        self._sent = 0
        steps = limits.ramp_s * made.board.max_frame_rate_Hz if made.board.levels else 0.0
        self._steps = max(1, min(MOST_STEPS, math.floor(steps)))

    def follow(self, ends_s: float) -> None:
        """Play until `ends_s`, a time of time.monotonic() [s]."""
        board, am_Hz = self.made.board, self.made.sound.am_frequency_Hz
        period_s = 1.0 / board.max_frame_rate_Hz
        began_s = due_s = time.monotonic() + AHEAD_S + board.frame_time_s
        playing: tuple[LiveFocus, Complex, float] | None = None
        after, muted = 0, True
        while (now := time.monotonic()) < ends_s:
            self.player.check()
            waits = am_Hz <= 0.0 or playing is None
            received = self.listener.next(after, min(LOOK_S, ends_s - now) if waits else 0.0)
            now = time.monotonic()
            if received is not None:
                after = received.number
                if now - received.time_s > STALE_S:
                    self.listener.skip("stale", f"a focus was {now - received.time_s:.2g} s old when it was due")
                    received = None
            if received is not None:
                unit = self._unit(received.focus)
                playing = playing if unit is None else (received.focus, unit, received.time_s)
                if unit is not None and am_Hz <= 0.0:
                    self._send(received.focus, unit, 1.0, received.time_s, 0.0, first=True)
                    muted = False
            if playing is not None and now - playing[2] > STALE_S:
                playing = None
                if not muted:
                    self.player.mute()
                muted = True
            if am_Hz > 0.0 and playing is not None:
                due_s = max(due_s + period_s, now + board.frame_time_s)
                time.sleep(max(0.0, due_s - board.frame_time_s - AHEAD_S - now))
                share = am_share(due_s - began_s, am_Hz)
                self._send(playing[0], playing[1], share, playing[2], due_s, first=received is not None)
                muted = False

    def _unit(self, focus: LiveFocus) -> Complex | None:
        """Return the amplitudes for a focus at full level, shape (N,).

        If it cannot be played, report it and return None.
        """
        far = too_far((float(focus.place[0]), float(focus.place[1]), float(focus.place[2])))
        if far is not None:
            place = ", ".join(f"{1e3 * x:.4g}" for x in focus.place)
            self.listener.skip("place", f"focus at ({place}) mm, {far}")
            return None
        try:
            unit = self.made.unit(focus.place)
            # Levels between off and full, and positions outside the range of packets, may be impossible on the board
            self.made.frame(focus.place, unit, focus.level * self.made.sound.level)
        except PalmfieldError as error:
            self.listener.skip("place" if isinstance(error, SceneError) else "board", str(error))
            return None
        return unit

    def _send(self, focus: LiveFocus, unit: Complex, share: float, came_s: float, due_s: float, *, first: bool) -> None:
        level = focus.level * self.made.sound.level * share
        steps = [self.made.frame(focus.place, unit, level * step / self._steps) for step in range(1, self._steps)]
        steps.append(self.made.frame(focus.place, unit, level))
        if first:
            self.came_s[self._sent] = came_s
        self.player.send(steps, level, made_s=came_s, due_s=due_s)
        self._sent += 1


def _most_at_head(made: FocusBoard) -> Exposure:
    """Return the sound at the loudest point of a head, if the focus were at this point.

    Live foci are not known in advance.
    """
    array, air = made.array, made.sound.air
    wavenumber = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
    loud = replace(array, gain=None if array.gain is None else np.abs(array.gain).astype(complex))

    def in_phase(points: Float) -> Complex:
        """Return upper limits of the pressure at some points: the pressure if all transducers arrive in phase."""
        result = np.zeros(len(points), np.complex128)
        for number, point in enumerate(points):
            distances = np.linalg.norm(point - array.positions, axis=1)
            result[number] = pressure64(point[None], loud, np.exp(-1j * wavenumber * distances), air)[0][0]
        return made.sound.level * result

    return with_band(at_head([SoundMoment(in_phase, 1.0)], made.driver, array.positions), made.band)
