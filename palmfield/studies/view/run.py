"""Run a scene for a page: step it at the requested speed, change keys, record, and send the data to show."""

import logging
import math
import re
import secrets
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from palmfield.config import FILE_KEYS
from palmfield.errors import OutputError, PalmfieldError, SceneError
from palmfield.interrupts import handling
from palmfield.motion.live_hand import Live, LiveHand
from palmfield.outputs.store import Store, open_result, write_json
from palmfield.outputs.summary import summary
from palmfield.session.changed_stimuli import change_stimuli
from palmfield.session.recorded_run import ending, initial_block, recorder_of, result_attributes
from palmfield.session.simulation import Simulation
from palmfield.session.worlds import stimulus_texts
from palmfield.studies.view import messages
from palmfield.studies.view.gate import is_loopback
from palmfield.studies.view.hands import NO_HAND, Hands
from palmfield.studies.view.link import Link, need_viser
from palmfield.studies.view.messages import Replay
from palmfield.studies.view.periods import Blocks, Periods, replay, steps_watched
from palmfield.studies.view.scene_reading import MomentReader, scene_shown
from palmfield.studies.view.sliders import stimulus_sliders, turned, value_of

LOG = logging.getLogger("palmfield.studies")
RATE_Hz, GPU_RATE_Hz = 15.0, 30.0
"""Default pictures per second."""
QUIET_s = 0.3
"""Time from the last change of a slider until the scene is rebuilt [s]."""
IDLE_s = 0.02
SPEED_OVER_s = 0.5
UNWATCHED = 9
"""Number of steps that are not recorded for each recorded step, if the simulation runs at full speed."""
NEXT_KEY = re.compile(r";\s*(?=[\w.]+\s*=)")
"""Separator of several keys in one text: a semicolon before INSTANCE.key=."""
NOT_FROM_A_PAGE = {"function", "hand", *FILE_KEYS}
"""Keys with which a user of the page could read files and run code."""
WARN_AGAIN_s = 2.0
"""Time between two errors of the same step of a tracked hand [s]."""
BEHIND_s = 0.2
"""Largest delay behind real time that is made up later [s]."""
KEYS_FILE = "keys.json"


@dataclass(frozen=True)
class SceneSource:
    """Arguments with which a scene is opened and rebuilt."""

    scene: Path
    device: str | None
    accuracy: float | None
    board: str | None

    def open(self, keys: Mapping[str, object]) -> Simulation:
        """Open the scene and build its steppers. Raises the errors of `palmfield.Simulation`."""
        sim = Simulation(self.scene, device=self.device, accuracy=self.accuracy, board=self.board, keys=keys)
        for lazy in sim.runtime.model.begin:
            _ = lazy.value
        return sim


class ShownScene:
    """A scene that is stepped and changed. The caller passes messages of the page to `receive` and calls `go_on`.

    send: function that gets the messages for the page
    sim: the present simulation
    keys: keys that were changed in the scene
    """

    def __init__(
        self,
        source: SceneSource,
        keys: Mapping[str, object],
        out: Path,
        send: Callable[[messages.FromSimulation], None],
        live: Live | None = None,
    ) -> None:
        """out: folder with a folder for each recording; live: source of a tracked hand.

        Raises the errors of `palmfield.Simulation` and `Hands`.
        """
        self.source, self.keys, self.out, self.send = source, dict(keys), out, send
        self.playing, self.most_pace = True, 1.0
        self._turns: dict[messages.Place, float] = {}
        self._turned_at = 0.0
        self._set: dict[str, object] = {}
        self._requested: set[str] = set()
        self._periods: Periods | None = None
        self._recording: Recording | None = None
        self.sim = source.open(keys)
        self._hands = Hands(self.sim, live)
        self._warned: float = -math.inf
        self.sliders: dict[messages.Place, messages.Slider] = {}
        self._attach()

    def _attach(self) -> None:
        self._reader = MomentReader(self.sim)
        listed = (*stimulus_sliders(self.sim.runtime.spec.stimuli), *self._hands.sliders)
        # An existing slider keeps its range, which was computed from its first value
        self.sliders = {one.place: self.sliders.get(one.place, one) for one in listed}
        self._texts = stimulus_texts(self.sim.runtime)
        self._begin_clock()
        self._watch_soon()

    def _watch_soon(self) -> None:
        """Discard the recorded periods, and record again."""
        self._unwatched: float = math.inf
        self._waited = False

    def _begin_clock(self) -> None:
        """Set the start of real time to now."""
        self._clock = time.monotonic(), self.sim.time
        self._measured, self._speed = self._clock, 0.0

    def show(self) -> None:
        """Send the scene to the page, once it is available and after each rebuild."""
        no_pose = "" if self._hands.sliders else NO_HAND
        self.send(
            scene_shown(self.sim, str(self.source.scene), self._reader.pose(), tuple(self.sliders.values()), no_pose)
        )
        self.send(self._values())

    def _values(self) -> messages.Values:
        stimuli = self.sim.runtime.spec.stimuli
        values = {place: value_of(one, stimuli) for place, one in self.sliders.items() if place[0] == "key"}
        return messages.Values(values | self._hands.values)

    # -- messages of the page ------------------------------------------------------------------------------------------

    def receive(self, message: messages.FromPage) -> None:
        """Process a request of the page; errors are shown in the page."""
        if isinstance(message, messages.Request):
            self._requested.add(message.what)
        elif isinstance(message, messages.Turn):
            self._turn(message)
        elif isinstance(message, messages.Pace):
            self.most_pace = message.most if message.most > 0.0 else 1.0
            self._begin_clock()
        elif isinstance(message, messages.SetKey):
            self._guarded(lambda: self._set_text(message.text))
        elif isinstance(message, messages.Press):
            self._guarded(lambda: self._press(message.what))

    def _turn(self, turn: messages.Turn) -> None:
        if turn.place not in self.sliders:
            return
        if turn.place[0] == "pose":
            self._guarded(lambda: self._hands.turn(turn.place, turn.value))
            return
        self._turns[turn.place] = turn.value
        self._turned_at = time.monotonic()

    def _set_text(self, text: str) -> None:
        keys: dict[str, object] = {}
        # Keys that depend on each other must be set together
        for part in NEXT_KEY.split(text):
            name, equals, value = part.partition("=")
            if not equals or not name.strip():
                raise SceneError(
                    f"'{part}' is not a setting; write INSTANCE.key=VALUE, for example stimulus.ramp_s=0.05"
                )
            if name.strip().rpartition(".")[2] in NOT_FROM_A_PAGE:
                raise SceneError(
                    f"key '{name.strip()}' names code or files of this machine, which the page cannot set; end the "
                    "view, and give it to `palmfield view` with --set"
                )
            keys[name.strip()] = value.strip()
        self._set |= keys
        self._turned_at = time.monotonic()

    def _press(self, what: str) -> None:
        if what in ("play", "pause"):
            self.playing = what == "play"
            self._begin_clock()
        elif what == "reset":
            self._reset()
        elif what == "record" and self._recording is None:
            self._stop_watching()
            folder = next_folder(self.out)
            self._recording = Recording(self.sim, folder, str(self.source.scene), self.keys)
            self.send(messages.Notice("info", f"recording to {folder}"))
        elif what == "stop recording":
            self.stop_recording("stopped in the live view")

    def _guarded(self, do: Callable[[], object]) -> bool:
        """Call a function, and report its errors to the page; return whether it succeeded."""
        try:
            do()
        except PalmfieldError as error:
            LOG.warning("%s", error)
            self.send(messages.Notice("error", str(error)))
            return False
        except Exception as error:
            # A programming error must not end the view: the scene is unchanged, and keys can be set back
            LOG.exception("internal error of the live view")
            self.send(messages.Notice("error", f"internal error of palmfield: {type(error).__name__}: {error}"))
            return False
        return True

    # -- stepping ------------------------------------------------------------------------------------------------------

    def go_on(self) -> float:
        """Run the next step if it is due, and answer requests. Return the time to wait until the next step [s]."""
        if (self._turns or self._set) and self._due():
            self._change()
        wait_s = IDLE_s
        if self.playing:
            wait_s = self._ahead_s()
            self._waited = self._waited or wait_s > 0.0
            if wait_s <= 0.0:
                self.playing = self._follow() if self.followed else self._guarded(self._step)
        if self._requested:
            self._answer()
        return min(max(wait_s, 0.0), IDLE_s)

    def _ahead_s(self) -> float:
        """Return how long the simulation must wait for real time [s]. If it is too late, restart the clock."""
        if math.isinf(self.most_pace):
            return 0.0
        began_s, from_s = self._clock
        ahead = (self.sim.time - from_s) / self.most_pace - (time.monotonic() - began_s)
        if ahead < -BEHIND_s:
            self._clock = time.monotonic(), self.sim.time
        return ahead

    @property
    def followed(self) -> LiveHand | None:
        """The tracked hand, if there is one."""
        return self._hands.followed

    def _follow(self) -> bool:
        """Step with a tracked hand; return whether to go on, which is false if the hand cannot be followed."""
        if self.followed is None or not self._guarded(self.followed.check):
            return False
        try:
            self._step()
        except SceneError as error:
            # A hand that reaches into the array leaves it again
            if time.monotonic() - self._warned > WARN_AGAIN_s:
                self._warned = time.monotonic()
                self.send(messages.Notice("error", str(error)))
        return True

    def _step(self) -> None:
        if self._recording is None and self._periods is None and "replay" in self._requested and self._may_watch():
            self._periods = Periods(self.sim)
        self.sim.step()
        self._unwatched += 1
        if self._recording is not None:
            if not self._guarded(self._recording.step):
                self.stop_recording("writing failed")
        elif self._periods is not None and not self._guarded(self._watch):
            # A failed report must not stop the scene
            self._stop_watching()
            self._replay_sent()
        now = time.monotonic()
        if now - self._measured[0] > SPEED_OVER_s:
            self._speed = (self.sim.time - self._measured[1]) / (now - self._measured[0])
            self._measured = now, self.sim.time

    def _watch(self) -> None:
        assert self._periods is not None
        periods = self._periods.step()
        if periods is not None:
            self._periods = None
            self._replay_sent()
            self.send(periods)

    def _replay_sent(self) -> None:
        self._unwatched, self._waited = 0, False
        self._requested.discard("replay")

    @property
    def watching(self) -> bool:
        """Whether steps are recorded for a replay. The simulation must then be stepped only by this object."""
        return self._periods is not None

    def _may_watch(self) -> bool:
        """Whether steps may be recorded now.

        This is true if time is left, if enough steps were not recorded, or if there is no replay yet.
        """
        return self._waited or self._unwatched >= UNWATCHED * steps_watched(self.sim)

    def _answer(self) -> None:
        moment = self._requested & {"moment", "full moment"}
        if moment:
            self._requested -= moment
            folder = "" if self._recording is None else str(self._recording.out)
            speed = self._speed if self.playing else 0.0
            full = "full moment" in moment
            self._guarded(
                lambda: self.send(
                    self._reader.moment(
                        full=full, speed=speed, playing=self.playing, recording=folder, hand_age_s=self._hands.age_s
                    )
                )
            )  # fmt: skip
        if "replay" in self._requested and self._recording is not None and not self._guarded(self._replay_recorded):
            self._requested.discard("replay")

    def _replay_recorded(self) -> None:
        periods = None if self._recording is None else self._recording.last_periods()
        if periods is not None:
            self._requested.discard("replay")
            self.send(periods)

    def _stop_watching(self) -> None:
        if self._periods is not None:
            self._periods.stop()
            self._periods = None

    # -- changes -------------------------------------------------------------------------------------------------------

    def _due(self) -> bool:
        """Return whether changes are applied now: at once if that is fast, otherwise QUIET_s after the last change."""
        return time.monotonic() - self._turned_at > QUIET_s or (self._quick() and not self._set)

    def _quick(self) -> bool:
        return all(skin.choice.solver.of_class for skin in self.sim.runtime.model.skins)

    def _change(self) -> None:
        turns, keys = self._turns, self._set
        self._turns, self._set = {}, {}
        texts: dict[str, object] = dict(turned(self.sliders, turns, self.sim.runtime.spec.stimuli))
        texts |= keys
        recorded = self._recording is not None
        self._guarded(lambda: self._change_to(texts, only_stimuli=not keys))
        if recorded and self._recording is None:
            self._guarded(lambda: self._press("record"))
        self.send(self._values())

    def _change_to(self, texts: Mapping[str, object], *, only_stimuli: bool) -> None:
        changes = ", ".join(f"{name} = {value}" for name, value in texts.items())
        if only_stimuli:
            own = {name: dict(keys) for name, keys in self._texts.items()}
            for name, value in texts.items():
                instance, _, key = name.rpartition(".")
                own[instance][key] = str(value)
            self._stop_watching()
            if self._recording is not None and self._quick():
                self.stop_recording(f"then {changes}")
            if change_stimuli(self.sim, own):
                self.keys |= texts
                self._texts = own
                self._watch_soon()
                self.send(messages.Notice("info", f"{changes}: the scene is unchanged"))
                return
        self.send(messages.Notice("busy", f"rebuilding with {changes}; the page still shows the previous scene"))
        started = time.monotonic()
        keys = self.keys | {name: value or None for name, value in texts.items()}
        new = self.source.open(keys)
        # Only after the rebuild, so that an invalid value has no effect
        self.stop_recording(f"then {changes}")
        self._stop_watching()
        self.sim, self.keys = new, keys
        self._hands.attach(new)
        new.reset()
        self._attach()
        self.show()
        self.send(messages.Notice("info", f"{changes}: rebuilt in {time.monotonic() - started:.1f} s, from time 0"))

    def _reset(self) -> None:
        self.stop_recording("reset in the live view")
        self._stop_watching()
        self.sim.reset()
        self._begin_clock()
        self._watch_soon()
        self.send(messages.Notice("info", "back to time 0"))

    def stop_recording(self, reason: str) -> None:
        """Finish a recording if there is one, and report its folder."""
        if self._recording is None:
            return
        recording, self._recording = self._recording, None
        if self._guarded(lambda: recording.finish(reason)):
            LOG.info("wrote %s: `palmfield plot %s` draws it", recording.out, recording.out)
            self.send(messages.Notice("info", f"wrote {recording.out}: `palmfield plot {recording.out}` draws it"))


def view(
    scene: str | Path,
    out: str | Path | None = None,
    *,
    device: str | None = None,
    accuracy: float | None = None,
    board: str | None = None,
    keys: Mapping[str, object] | None = None,
    modes: bool = False,
    host: str = "127.0.0.1",
    port: int | None = None,
    rate_Hz: float | None = None,
    pace: float = 1.0,
    live: Live | None = None,
    on_ready: Callable[[str], None] | None = None,
) -> None:
    """Run a scene and show it in the browser; after Ctrl-C, SIGTERM or SIGHUP, finish recordings and return.

    out: folder of recordings, out/view_SCENE by default
    device, accuracy, board, keys: as in `palmfield.Simulation`
    modes: whether all skins use modal models. They are valid for any sound, so a slider takes effect at once. Building
        them takes one to two minutes for each skin, once
    host: address at which the page is served, by default only on this machine. For any other address, clients need the
        token in the address of the page, which is sent over the network as plain text
    port: port, by default the first free port from 8080 on
    rate_Hz: pictures per second, default 15, on a GPU 30
    pace: largest simulated time per real time; inf for no limit
    live: source of a tracked hand, which the only articulated hand of the scene follows in place of its script
    on_ready: called with the address of the page
    Raises SceneError or DeviceError like `palmfield.Simulation`, and OutputError if the page is not available or its
    process ends before the view.
    """
    need_viser()
    path = Path(scene)
    if rate_Hz is not None and not 1.0 <= rate_Hz <= 60.0:
        raise SceneError(f"--rate has value {rate_Hz:g}; allowed: 1 to 60 pictures per second")
    if not pace > 0.0:
        raise SceneError(f"--pace has value {pace:g}; allowed: above 0, inf for the highest speed")
    changed = dict(keys or {})
    if modes:
        changed.setdefault("palmfield.skin.solver", "modal")
    unsent: list[messages.FromSimulation] = []
    folder = Path("out") / f"view_{path.stem}" if out is None else Path(out)
    shown = ShownScene(SceneSource(path, device, accuracy, board), changed, folder, unsent.append, live)
    shown.receive(messages.Pace(pace))
    on_gpu = shown.sim.runtime.spec.device != "cpu"
    rate = rate_Hz or (GPU_RATE_Hz if on_gpu else RATE_Hz)
    token = "" if is_loopback(host) else secrets.token_urlsafe(24)
    end = Ending()
    with (
        shown.followed or nullcontext(),
        handling(dict.fromkeys(("SIGINT", "SIGTERM", "SIGHUP"), end.note)),
        Link(messages.Address(host, port, token, rate)) as link,
    ):
        shown.send = link.send
        shown.show()
        if on_ready is not None:
            on_ready(link.address)
        try:
            run_for(shown, link, end)
        finally:
            shown.stop_recording("the live view has ended")
        if link.closed and not end.requested:
            raise OutputError("the page process has ended, and so has the view; the recordings are complete")


class Ending:
    """Ends a view between two steps after a signal. An exception cannot pass through a step of MuJoCo.

    requested: whether a signal has arrived
    """

    requested = False

    def note(self, number: int, frame: FrameType | None) -> None:
        """Set `requested` at the first signal; raise KeyboardInterrupt at the second."""
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True


def run_for(live: ShownScene, link: Link, end: Ending) -> None:
    """Step a scene and answer its page, until the page has ended or a signal requests the end."""
    wait_s = 0.0
    while not (link.closed or end.requested):
        for message in link.received(wait_s):
            live.receive(message)
        wait_s = live.go_on()


class Recording:
    """Writes each step to a folder until `finish` is called.

    If the process is killed, `palmfield recover` assembles the written data.
    out: the folder
    """

    def __init__(self, sim: Simulation, out: Path, scene: str, keys: Mapping[str, object]) -> None:
        """scene: file of the scene; keys: keys that differ from the file. Raises OutputError like `Store`."""
        self.out, self._sim = out, sim
        self._store = Store(out, initial_block(sim), result_attributes(sim))
        self._blocks = Blocks(steps_watched(sim), self._store)
        self._recorder = recorder_of(sim, self._blocks)
        # Each recording has one set of keys, so that this command reproduces it
        start: dict[str, Any] = {"scene": scene, "keys": dict(keys), "begun_s": sim.time}
        write_json(out / KEYS_FILE, start)
        self._recorder.start()
        self._blocks.kept.clear()

    def step(self) -> None:
        """Record a step. Raises OutputError if the disk is full."""
        self._recorder.step()

    def last_periods(self) -> Replay | None:
        """Return the data of the last periods; None in the first steps."""
        blocks = list(self._blocks.kept)
        return None if len(blocks) < (self._blocks.kept.maxlen or 0) else replay(self._sim, blocks, self._recorder)

    def finish(self, reason: str) -> Path:
        """Write result.nc and summary.json, and return the folder. Raises OutputError if the disk is full.

        reason: why the recording ended
        """
        self._recorder.stop()
        self._store.append(self._recorder.surfaces())
        path = self._store.finish({"reason": reason}, complete=True)
        with open_result(path) as tree:
            write_json(self.out / "summary.json", summary(tree, ending(tree)))
            lost = self._store.lost
        if lost is not None:
            raise lost
        return self.out


def next_folder(out: Path) -> Path:
    """Return the first of recording-001, recording-002, ... that does not exist. Raises OutputError after 999."""
    for number in range(1, 1000):
        folder = out / f"recording-{number:03d}"
        if not folder.exists():
            return folder
    raise OutputError(f"{out} contains 999 recordings; choose another folder with --out")
