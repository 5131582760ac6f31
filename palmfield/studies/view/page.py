"""The page in the browser, made with viser, and its messages to the simulation."""

import html
import math
import secrets
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from threading import Lock
from typing import Any

import numpy as np
import viser
from matplotlib import colormaps
from numpy.typing import NDArray

from palmfield.studies.view import messages
from palmfield.studies.view.gate import ALIVE, LOCAL, Gate, only_for_gate
from palmfield.studies.view.glb import GlbMesh, linear
from palmfield.transforms import facing
from palmfield.types import Complex, Float32

SILENT = (150, 150, 150)
NICE = (1.0, 2.0, 5.0, 10.0)
NOTHING = 1e-6
"""Smallest value (um or Pa) that gets a full colour. Smaller values are residues after a sound or motion has ended."""
PORT = 8080
"""First port that is tried if none is requested."""
LIFT_m = 3e-4
"""Distance at which a skin is drawn above its body [m]. Without it, the two surfaces would flicker."""
DISPLAYED_m = 3e-3
"""Displayed size of the largest motion at the default magnification [m]."""
REPLAYS = ("motion, slowed down", "ARP, slowed down")
STILL = ("RMS of the motion",)
NOWS = ("motion now", "ARP now")
SHOWN = (*REPLAYS, *STILL, *NOWS)
PACES = {
    "real time": 1.0, "1/10 of real time": 0.1, "1/100 of real time": 0.01, "as fast as possible": math.inf,
}  # fmt: skip
NOW_WORDS = "the state at each picture (motion faster than the picture rate is visible only at a slower pace)"
TURNS_IN_s = 2.0
"""Approximate duration of a slowed-down replay [s]."""
DISC_SIDES = 12
HEAD = """
<script>
// Before viser's own: a reader who likes dark pages gets one
if (matchMedia("(prefers-color-scheme: dark)").matches) window.__VISER_EMBED_CONFIG__ = {darkMode: true};
addEventListener("load", () => {
  document.title = "palmfield view";
  const gone = document.createElement("div");
  gone.id = "palmfield-gone";
  gone.setAttribute("role", "alert");
  gone.textContent = "The view has ended or does not answer. This is the last picture. " +
    "Start the command again, and open the address that it prints.";
  gone.style.cssText = "display:none;position:fixed;inset:auto 0 0 0;z-index:99999;padding:0.8em 1em;" +
    "background:#b00020;color:#fff;font:1rem sans-serif;text-align:center";
  document.body.append(gone);
  setInterval(async () => {
    try {
      const answer = await fetch("ALIVE", {cache: "no-store", signal: AbortSignal.timeout(5000)});
      if (gone.style.display === "block" && answer.ok) location.reload();
      gone.style.display = answer.ok ? "none" : "block";
    } catch {
      gone.style.display = "block";
    }
  }, 2000);
});
</script>
<style>
/* The controls lie over the middle of a narrow page; here they take its lower part */
@media (max-width: 36em) {
  div[style*="position: fixed"][style*="width: 20em"] { width: 100% !important; max-height: 45% !important }
  div[style="width: 20em;"] { width: 100% !important }
}
</style>
""".replace("ALIVE", ALIVE)
"""HTML that is added to viser's page. It shows a clear message when the server has ended."""
AGAIN_s = 5.0
"""Time after which data are requested again [s], because the simulation may not have been ready."""


def _table(name: str, low: float = 0.0, high: float = 1.0) -> NDArray[np.uint8]:
    return np.asarray(np.round(255.0 * colormaps[name](np.linspace(low, high, 256))), np.uint8)


MOTION, PRESSURE, PHASE = _table("RdBu_r", 0.02, 0.98), _table("magma_r", 0.03, 0.85), _table("twilight")


AT_REST = (int(MOTION[128, 0]), int(MOTION[128, 1]), int(MOTION[128, 2]))


"""Colour of bodies and of skin that does not move."""


@dataclass(frozen=True)
class Scale:
    """A colour scale.

    table: 256 colours, shape (256, 4)
    low, high: ends of the scale, in `unit`
    factor: factor from SI to `unit`
    """

    title: str
    table: NDArray[np.uint8]
    low: float
    high: float
    unit: str
    factor: float

    def colours(self, values: Float32) -> NDArray[np.uint8]:
        """Return the colours of values in the SI unit, (n,) -> (n, 4)."""
        width = max(self.high - self.low, 1e-30)
        place = (self.factor * np.asarray(values) - self.low) / width
        return self.table[np.clip(np.round(255.0 * place), 0, 255).astype(np.uint8)]

    @property
    def legend(self) -> str:
        """Return a bar with its ends, as HTML."""
        return _bar(self.title, self.table, f"{self.low:g}", f"{self.high:g} {self.unit}")


def motion_scale(title: str, largest_m: float) -> Scale:
    """Return the scale for signed values along the normal."""
    top = rounded_up(1e6 * largest_m)
    return Scale(title, MOTION, -top, top, "um", 1e6)


def size_scale(title: str, largest: float, unit: str, factor: float) -> Scale:
    """Return the scale for values of 0 or more."""
    return Scale(title, PRESSURE, 0.0, rounded_up(factor * largest), unit, factor)


def rounded_up(value: float) -> float:
    """Return the next larger of 1, 2, 5, 10, 20, ...; 1 for values up to NOTHING."""
    if not np.isfinite(value) or value < NOTHING:
        return 1.0
    ten = 10.0 ** np.floor(np.log10(value))
    return float(f"{ten * min(step for step in NICE if step * ten >= value * (1 - 1e-9)):.3g}")


def phase_colours(drive: Complex) -> NDArray[np.uint8]:
    """Return colours of transducers by their phase, shape (N, 4). They are greyer if the amplitude is lower."""
    size = np.abs(drive)
    share = (size / size.max() if size.max() > 0.0 else size)[:, None]
    turn = np.mod(np.angle(drive) / (2.0 * np.pi), 1.0)
    colour = PHASE[np.round(255.0 * turn).astype(np.uint8)][:, :3]
    shown = np.full((len(drive), 4), 255, np.uint8)
    shown[:, :3] = np.round(share * colour + (1.0 - share) * np.array(SILENT))
    return shown


def phase_legend() -> str:
    """Return the legend of phases as HTML."""
    return _bar("phase of each transducer's drive", PHASE, "0", "360 deg")


def _bar(title: str, table: NDArray[np.uint8], low: str, high: str) -> str:
    stops = ",".join("#{:02x}{:02x}{:02x}".format(*colour[:3]) for colour in table[::17])
    return (
        f'<div style="margin:0.2em 0.8em;font-size:0.8em"><div>{title}</div>'
        f'<div style="height:0.7em;background:linear-gradient(to right,{stops})"></div>'
        f'<div style="display:flex;justify-content:space-between"><span>{low}</span><span>{high}</span></div></div>'
    )


class SkinNode:
    """A skin in the page. It has three meshes. One is visible while the browser reads the others."""

    def __init__(self, server: viser.ViserServer, name: str, faces: np.ndarray, pose: tuple[Float32, Float32]) -> None:
        self.faces, self.pose = faces, pose
        self._mesh = GlbMesh(faces, len(pose[0]))
        self._nodes: list[viser.GlbHandle] = []
        for part in "abc":
            data = self._file(np.zeros(len(pose[0]), np.float32), 0.0, np.full((len(pose[0]), 4), 200, np.uint8))
            self._nodes.append(server.scene.add_glb(f"/skins/{name}/{part}", data, visible=part == "a"))
        self._visible = 0

    def show(self, displacement: Float32, magnify: float, colours: np.ndarray) -> None:
        """Show another state, which becomes visible two pictures later.

        displacement: along the outward normal [m], (S,)
        """
        last, self._visible = self._visible, (self._visible + 1) % len(self._nodes)
        self._nodes[self._visible].visible = True
        self._nodes[last].visible = False
        self._nodes[last].glb_data = self._file(displacement, magnify, colours)

    def _file(self, displacement: Float32, magnify: float, colours: np.ndarray) -> bytes:
        places, normals = self.pose
        return self._mesh.file(places + (LIFT_m + magnify * displacement)[:, None] * normals, colours)

    def remove(self) -> None:
        for node in self._nodes:
            node.remove()


class Page:
    """The page, in its own process. address: address for the browser"""

    def __init__(self, talk: Connection, place: messages.Address) -> None:
        """Open the page. Raises OutputError if it cannot listen at its address."""
        self._talk, self._lock, self._place = talk, Lock(), place
        # viser does not check its clients, so it serves only the gate at the loopback address
        secret = secrets.token_urlsafe(24)
        with only_for_gate(secret, HEAD):
            self._server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        gate = Gate(place.host, place.port, PORT, self._server.get_port(), place.token, secret)
        host = "localhost" if place.host in LOCAL else place.host
        if host in ("0.0.0.0", "::"):
            # Listen at all addresses of this machine, because clients may use its name
            host = socket.gethostname()
        host = f"[{host}]" if ":" in host else host
        self.address = f"http://{host}:{gate.port}/" + (f"?token={place.token}" if place.token else "")
        # viser's button would make a public address that bypasses the gate
        self._server.gui.configure_theme(show_share_button=False, control_width="medium", dark_mode=False)
        # Controls next to the scene, not over it
        self._server.gui.main_panel.dock_right()
        self._server.scene.set_up_direction("+z")
        # A palm faces down, where the default lights of viser do not reach
        self._server.scene.configure_default_lights(enabled=False)
        self._server.scene.add_light_ambient("/light/all", intensity=1.3)
        for number, lit_from in enumerate(((0.3, 0.5, 1.0), (1.0, 1.2, -0.6))):
            self._server.scene.add_light_directional(f"/light/{number}", intensity=1.1, position=lit_from)
        self._scene: messages.SceneShown | None = None
        self._moment: messages.Moment | None = None
        self._replay: messages.Replay | None = None
        self._moment_requested_s = self._replay_requested_s = -math.inf
        self._picture = 0
        self._skins: list[SkinNode] = []
        self._bodies: list[viser.MeshHandle] = []
        self._sliders: dict[messages.Place, Any] = {}
        self._folders: dict[str, Any] = {}
        self._slow = 1.0
        self._magnified = 1.0
        self._phases: np.ndarray | None = None
        self._shown_legend = ""

    # -- to and from the simulation ------------------------------------------------------------------------------------

    def _send(self, message: messages.FromPage) -> None:
        with self._lock:
            self._talk.send(message)

    def run(self) -> None:
        """Process messages and draw until the simulation has ended."""
        period_s = 1.0 / self._place.rate_Hz
        due = time.monotonic()
        while True:
            wait = due - time.monotonic()
            try:
                if self._talk.poll(max(wait, 0.0)):
                    message: messages.FromSimulation = self._talk.recv()
                    if isinstance(message, messages.End):
                        return
                    self._receive(message)
                    continue
                if self._scene is not None and self._server.get_clients():
                    self._draw()
            except (EOFError, OSError):
                # The simulation has been killed
                return
            due = max(due + period_s, time.monotonic())

    def _receive(self, message: messages.FromSimulation) -> None:
        if isinstance(message, messages.SceneShown):
            self._begin(message)
        elif isinstance(message, messages.Moment):
            self._moment_requested_s = -math.inf
            self._receive_moment(message)
        elif isinstance(message, messages.Replay):
            self._replay_requested_s = -math.inf
            self._receive_replay(message)
        elif isinstance(message, messages.Notice):
            self._show_notice(message)
        elif isinstance(message, messages.Values):
            for place, value in message.values.items():
                if place in self._sliders:
                    self._put(self._sliders[place], value)

    def _put(self, handle: Any, value: float) -> None:
        """Set a slider to the value of the scene. This value may be outside the range of the slider."""
        handle.min, handle.max = min(handle.min, value), max(handle.max, value)
        if handle.value != value:
            handle.value = value

    # -- contents of the page ------------------------------------------------------------------------------------------

    def _begin(self, scene: messages.SceneShown) -> None:
        """Show a scene: the first scene or a rebuilt scene."""
        first = self._scene is None
        self._scene, self._replay, self._moment = scene, None, None
        self._moment_requested_s = self._replay_requested_s = -math.inf
        self._picture, self._phases = 0, None
        api = self._server.scene
        for skin in self._skins:
            skin.remove()
        for body in self._bodies:
            body.remove()
        pose = scene.pose
        self._bodies = [
            api.add_mesh_simple(f"/bodies/{number}", vertices, faces, color=AT_REST, side="double")
            for number, (vertices, faces) in enumerate(zip(pose.bodies, scene.body_faces, strict=True))
        ]
        self._skins = [
            SkinNode(self._server, name, faces, own)
            for name, faces, own in zip(scene.skins, scene.skin_faces, pose.skins, strict=True)
        ]
        vertices, faces = disc(0.9 * max(scene.transducer_radius, 2e-3))
        self._array = api.add_batched_meshes_simple(
            "/array", vertices, faces, batched_wxyzs=facing(scene.transducer_directions),
            batched_positions=pose.transducers, batched_colors=np.full((len(pose.transducers), 3), 150, np.uint8),
            side="double", lod="off",
        )  # fmt: skip
        self._foci = api.add_point_cloud(
            "/foci", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), point_size=1.5e-3, point_shape="circle"
        )
        if first:
            self._look(pose, scene.transducer_directions)
            self._controls(scene)
        else:
            self._add_sliders(scene)

    def _look(self, pose: messages.Pose, directions: Float32) -> None:
        """Place the camera at the side of the sound path, so that skin and array are visible."""
        array = pose.transducers.mean(axis=0)
        skin = np.concatenate([points for points, _ in pose.skins]).mean(axis=0)
        axis = directions.mean(axis=0)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
        sideways = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.9 else (1.0, 0.0, 0.0))
        sideways = sideways / np.linalg.norm(sideways)
        ahead = np.cross(sideways, axis)
        far = max(float(np.linalg.norm(skin - array)), 0.1)
        middle = array + 0.62 * (skin - array)
        camera = self._server.initial_camera
        camera.position = tuple(middle + far * (0.85 * sideways + 0.9 * ahead - 0.38 * axis))
        camera.look_at = tuple(middle)

    def _controls(self, scene: messages.SceneShown) -> None:
        gui = self._server.gui
        self._status = gui.add_html("")
        self._notice = gui.add_html("")
        self._play = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._on_press(self._play, self._play_pressed)
        self._on_press(
            gui.add_button("Reset", icon=viser.Icon.PLAYER_SKIP_BACK), lambda: self._send(messages.Press("reset"))
        )
        self._record = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD)
        self._on_press(self._record, self._record_pressed)
        with gui.add_folder("Display"):
            self._shown = gui.add_dropdown("on the skin", SHOWN, initial_value=SHOWN[0])
            self._magnify = gui.add_slider(
                "magnify", -2.0, 2.0, 0.1, 0.0, hint="powers of ten relative to the current factor"
            )
            self._pace = gui.add_dropdown("pace limit", tuple(PACES), initial_value="real time")
            self._legend = gui.add_html("")
            gui.add_html(phase_legend())
        with gui.add_folder("Level above threshold"):
            self._meter = gui.add_html("")
        self._pace.on_update(lambda event: self._send(messages.Pace(PACES[self._pace.value])) if event.client else None)
        with gui.add_folder("Any key", expand_by_default=False):
            text = gui.add_text("INSTANCE.key=VALUE", "", hint="separate several by ;")
            self._on_press(gui.add_button("Set"), lambda: self._send(messages.SetKey(text.value)))
        self._add_sliders(scene)

    def _add_sliders(self, scene: messages.SceneShown) -> None:
        """Replace the sliders by those of a scene. If they are the same, nothing changes."""
        if self._sliders and set(self._sliders) == {slider.place for slider in scene.sliders}:
            return
        for folder in self._folders.values():
            folder.remove()
        self._folders, self._sliders = {}, {}
        gui = self._server.gui
        for slider in scene.sliders:
            if slider.folder not in self._folders:
                self._folders[slider.folder] = gui.add_folder(slider.folder)
            with self._folders[slider.folder]:
                self._add_slider(slider)
        if scene.no_pose:
            self._folders["Hand"] = gui.add_folder("Hand")
            with self._folders["Hand"]:
                gui.add_html(_small(html.escape(scene.no_pose)))

    def _add_slider(self, slider: messages.Slider) -> None:
        label = f"{slider.label} [{slider.unit}]" if slider.unit else slider.label
        low, high = min(slider.low, slider.value), max(slider.high, slider.value)
        handle = self._server.gui.add_slider(label, low, high, slider.step, slider.value)
        # Changes by the simulation have no client, and are not sent back
        handle.on_update(
            lambda event: self._send(messages.Turn(slider.place, float(handle.value))) if event.client else None
        )
        self._sliders[slider.place] = handle

    @staticmethod
    def _on_press(button: Any, do: Callable[[], None]) -> None:
        button.on_click(lambda _: do())

    def _play_pressed(self) -> None:
        self._send(messages.Press("pause" if self._moment is not None and self._moment.playing else "play"))

    def _record_pressed(self) -> None:
        going = self._moment is not None and self._moment.recording
        self._send(messages.Press("stop recording" if going else "record"))

    # -- messages from the simulation ----------------------------------------------------------------------------------

    def _show_notice(self, notice: messages.Notice) -> None:
        colour, mark = {
            "info": ("inherit", ""), "busy": ("light-dark(#8a5a00, #ffc46b)", "&#8987; "),
            "error": ("light-dark(#b00020, #ff8a94)", "&#9888; "),
        }[notice.kind]  # fmt: skip
        self._notice.content = (
            f'<div style="margin:0.3em 0.8em;font-size:0.8em;color:{colour};overflow-wrap:anywhere">{mark}'
            f"{html.escape(notice.text)}</div>"
        )

    def _receive_moment(self, moment: messages.Moment) -> None:
        self._moment = moment
        if moment.pose is not None:
            for body, vertices in zip(self._bodies, moment.pose.bodies, strict=True):
                body.vertices = vertices
            for node, own in zip(self._skins, moment.pose.skins, strict=True):
                node.pose = own
            self._array.batched_positions = moment.pose.transducers
        # viser takes the colours of such meshes as linear in light
        colours = linear(phase_colours(moment.drive))[:, :3]
        if self._phases is None or not np.array_equal(colours, self._phases):
            self._phases = self._array.batched_colors = colours
        self._foci.points = moment.foci
        self._foci.colors = np.tile(np.array([[0, 120, 90]], np.uint8), (len(moment.foci), 1))
        label = "Pause" if moment.playing else "Play"
        if self._play.label != label:
            self._play.label = label
            self._play.icon = viser.Icon.PLAYER_PAUSE if moment.playing else viser.Icon.PLAYER_PLAY
        label = "Stop recording" if moment.recording else "Record"
        if self._record.label != label:
            self._record.label = label
            self._record.color = "red" if moment.recording else None

    def _receive_replay(self, replay: messages.Replay) -> None:
        self._replay, self._picture = replay, 0
        rows = []
        for name, skin in zip(self._scene.skins if self._scene else (), replay.skins, strict=True):
            rows.append(f"<div><b>{html.escape(name)}</b></div>" if len(replay.skins) > 1 else "")
            for level in skin.levels:
                rows.append(_meter_row(level.observer, level.level_dB, level.why, level.lines))
        self._meter.content = f'<div style="margin:0 0.8em;font-size:0.8em">{"".join(rows)}</div>'

    # -- pictures ------------------------------------------------------------------------------------------------------

    def _draw(self) -> None:
        """Draw one picture, and request the data for the next."""
        shown = self._shown.value
        now = time.monotonic()
        if now - self._moment_requested_s > AGAIN_s:
            self._moment_requested_s = now
            self._send(messages.Request("full moment" if shown in NOWS else "moment"))
        through = self._replay is None or self._picture >= len(self._replay.times) * self._repeats()
        if now - self._replay_requested_s > AGAIN_s and through:
            self._replay_requested_s = now
            self._send(messages.Request("replay"))
        states, scale, words = self._state(shown)
        if not states:
            return
        largest = max(float(np.abs(one).max(initial=0.0)) for one, _ in states)
        if shown in NOWS or self._picture == 0:
            self._magnified = magnified(largest if self._replay is None or shown in NOWS else self._largest())
        magnify = self._magnified * 10.0**self._magnify.value
        with self._server.atomic():
            for node, (displacement, values) in zip(self._skins, states, strict=True):
                node.show(displacement, magnify, scale.colours(values))
        self._picture += 1
        if scale.legend != self._shown_legend:
            self._shown_legend = self._legend.content = scale.legend
        self._describe(words, magnify)

    def _repeats(self) -> int:
        """Return how many pictures show each state of a replay. A replay with few states must not be too fast."""
        assert self._replay is not None
        return max(1, round(TURNS_IN_s * self._place.rate_Hz / max(len(self._replay.times), 1)))

    def _largest(self) -> float:
        assert self._replay is not None
        return max(float(np.abs(skin.displacement).max(initial=0.0)) for skin in self._replay.skins)

    def _state(self, shown: str) -> tuple[list[tuple[Float32, Float32]], Scale, str]:
        """Return displacement and coloured quantity of each skin, with their scale and a description."""
        nothing = Scale("", PRESSURE, 0.0, 1.0, "", 1.0)
        moment, replay = self._moment, self._replay
        if shown in NOWS:
            if moment is None or not moment.displacement:
                return [], nothing, ""
            scale, values = self._now_scale(shown, moment)
            return list(zip(moment.displacement, values, strict=True)), scale, NOW_WORDS
        if replay is None:
            return [], nothing, ""
        repeats = self._repeats()
        place = (self._picture // repeats) % len(replay.times)
        pictures = len(replay.times) * repeats
        self._slow = pictures / self._place.rate_Hz / max(replay.length_s, 1e-9)
        motion = [skin.displacement[place] for skin in replay.skins]
        if shown in STILL:
            still = [skin.rms for skin in replay.skins]
            scale = size_scale("RMS of the normal displacement", _most(still), "um", 1e6)
            return list(zip(motion, still, strict=True)), scale, f"over {replay.what}"
        words = f"{replay.what}, {self._slow:,.{0 if self._slow >= 100.0 else 1}f} times slower"
        if shown == REPLAYS[1]:
            scale = size_scale("radiation pressure (ARP)", _most([skin.arp for skin in replay.skins]), "Pa", 1.0)
            return [(u, skin.arp[place]) for u, skin in zip(motion, replay.skins, strict=True)], scale, words
        scale = motion_scale("normal displacement, outward positive", self._largest())
        return [(one, one) for one in motion], scale, words

    def _now_scale(self, shown: str, moment: messages.Moment) -> tuple[Scale, tuple[Float32, ...]]:
        if shown == NOWS[1]:
            top = max(_most(moment.arp), _most([skin.arp for skin in self._replay.skins]) if self._replay else 0.0)
            return size_scale("radiation pressure (ARP)", top, "Pa", 1.0), moment.arp
        top = max(_most(moment.displacement), self._largest() if self._replay else 0.0)
        return motion_scale("normal displacement, outward positive", top), moment.displacement

    def _describe(self, words: str, magnify: float) -> None:
        moment, scene = self._moment, self._scene
        if moment is None or scene is None:
            return
        pace = "paused" if not moment.playing else f"{moment.speed:.2g} x real time"
        recording = f"<br><b>recording</b> to {html.escape(moment.recording)}" if moment.recording else ""
        solvers = ", ".join(sorted(set(moment.solvers)))
        age_s = moment.hand_age_s
        hand = "" if age_s is None else f"<br>tracked hand: pose of {1e3 * age_s:.0f} ms ago"
        if age_s is not None and math.isnan(age_s):
            hand = "<br><b>the hand is not tracked</b>"
        self._status.content = _small(
            f"<b>{moment.time_s:.3f} s</b>, {pace}; {html.escape(scene.device)}, skin by {html.escape(solvers)}<br>"
            f"shown: {html.escape(words)}; motion magnified {magnify:,.0f} times{hand}{recording}"
        )


def _most(values: Any) -> float:
    return max((float(np.abs(one).max(initial=0.0)) for one in values), default=0.0)


def magnified(largest_m: float) -> float:
    """Return a round factor that magnifies the largest motion to about SEEN_m; 1 without motion."""
    return 1.0 if largest_m < 1e-6 * NOTHING else rounded_up(0.4 * DISPLAYED_m / largest_m)


def _small(text: str) -> str:
    return f'<div style="margin:0.3em 0.8em;font-size:0.8em;overflow-wrap:anywhere">{text}</div>'


def _meter_row(name: str, level_dB: float | None, why: str, lines: str) -> str:
    """Return a bar from 0 to 60 dB above threshold, or the reason why there is no level."""
    title = html.escape(f"{name}: {why}", quote=True)
    if level_dB is None:
        why = html.escape(why.removeprefix("refused: "))
        return f'<div title="{title}" style="opacity:0.75">{name}: none, {why}</div>'
    share = min(max(level_dB / 60.0, 0.0), 1.0)
    return (
        f'<div title="{title}">{name}: <b>{level_dB:.0f} dB SL</b>, {html.escape(lines)}'
        f'<div style="height:0.45em;background:#8884;margin-bottom:0.25em"><div style="height:100%;'
        f'width:{100.0 * share:.0f}%;background:#0f766e"></div></div></div>'
    )


def disc(radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a flat disc about the z axis."""
    angles = 2.0 * np.pi * np.arange(DISC_SIDES) / DISC_SIDES
    rim = radius_m * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(DISC_SIDES)])
    ring = np.arange(1, DISC_SIDES + 1)
    faces = np.column_stack([np.zeros(DISC_SIDES, int), ring, np.roll(ring, -1)])
    return np.vstack([np.zeros(3), rim]).astype(np.float32), faces.astype(np.uint32)
