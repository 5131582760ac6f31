"""Contents of each scripted scenario: its panels over time, and one physical check with its value."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import trimesh
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.tri import Triangulation
from scipy.ndimage import uniform_filter1d

from palmfield.acoustics.reference import pressure64
from palmfield.metrics import wake_along_path
from palmfield.outputs.frames import in_world, pose_at, to_local
from palmfield.outputs.motion import normal_component
from palmfield.outputs.schema import instances
from palmfield.outputs.style import COLOURS
from palmfield.session.simulation import Simulation
from palmfield.simulation.backend import StepTrace
from palmfield.simulation.emission import array_drives
from palmfield.skin.materials.dispersion import describe
from palmfield.types import Float

SCENES = Path(__file__).resolve().parents[1] / "mjcf" / "scenes"
PATH_NEIGHBOURHOOD_M = 0.005
WAKE_SHARE = 0.1
WAKE_KEYS = {"skin.element_m": 0.0045, "skin.max_frequency_Hz": 500}
SPEEDS_M_S = (1.0, 4.0, 11.0)
# Held by friction, the ball has come to rest between the fingers by then.
GRIP_FROM_S = 0.12
EQUAL = (1.0, 1.0, 1.0)
MAP_FIRST = (1.8, 1.0, 1.0)


@dataclass(frozen=True)
class Run:
    """A finished run of a scene with one array, one stimulus and one skin.

    tree: its result; sim: the loaded simulation; wakes: results of `stroke_velocities` by speed [m/s], for the stroke
    """

    tree: xr.DataTree
    sim: Simulation
    wakes: dict[float, dict[str, Float]]

    def only(self, kind: str) -> xr.Dataset:
        """Return the only group of a kind, with the times of the run."""
        [one] = instances(self.tree, kind).values()
        return one

    @cached_property
    def skin(self) -> xr.Dataset:
        """Return the group of the skin, with the times of the run."""
        return self.only("skin")

    @cached_property
    def body(self) -> xr.Dataset:
        """Return the positions of the skin's body and its bones."""
        return self.only("body")

    @cached_property
    def focus(self) -> Float:
        """Return the focus in the world [m], shape (time, 3); nan in silence."""
        stimulus = self.only("stimulus")
        return np.where(stimulus["sounding"].values[:, None], stimulus["foci"].values[:, 0], np.nan)

    @cached_property
    def arp(self) -> Float:
        """Return the ARP on the skin [Pa], shape (time, vertex)."""
        return self.skin["arp"].values

    @cached_property
    def normal_displacement(self) -> Float:
        """Return the displacement of the skin along its outward normal [m], shape (time, vertex)."""
        return normal_component(self.skin).values

    @property
    def times(self) -> Float:
        """Return the ends of the substeps of the skin [s]."""
        return self.skin["time"].values

    @property
    def step_times(self) -> Float:
        """Return the starts of the MuJoCo steps [s]."""
        return self.body["step_time"].values


class Story(NamedTuple):
    """A scenario in words.

    text: a paragraph on the motion; panels: their heights; tell: draws them, returns the check
    """

    text: str
    panels: tuple[float, ...]
    write: Callable[[Run, list[Axes]], str]


def approach(run: Run, axes: list[Axes]) -> str:
    """Draw the ARP at the palm and |p|^2 of the free field at the same place, each a mean over a period of the AM."""
    times, places = _middle_of_skin(run)
    levels = _at_middle(run, times, 200.0)
    model = run.sim.runtime.model
    arrays = model.arrays
    drive = array_drives(model, arrays)[0].unit_drive(model.stimuli[0].first_focus).amplitudes
    at = to_local(places, pose_at(run.only("array"), 0.0))
    free = np.abs(pressure64(at, arrays.array, drive, arrays.air)[0]) ** 2
    inner = _whole_periods(times, 200.0)
    expected = free * levels[inner].max() / free[inner].max()
    off = float(np.abs(levels - expected)[inner].max() / levels[inner].max())
    axes[0].plot(1e3 * times, 1e3 * places[:, 2], color=COLOURS[2])
    axes[0].axhline(200.0, color="#888888", lw=0.8, ls="--", label="height of the focus")
    axes[0].set(ylabel="palm height [mm]", title="Height of the palm's middle")
    axes[0].legend(loc="upper center")
    axes[1].plot(1e3 * times[inner], levels[inner], color=COLOURS[0], label="run")
    axes[1].plot(1e3 * times[inner], expected[inner], "--", color=COLOURS[1], label="|p|² of the free field, scaled")
    axes[1].set(ylabel="ARP [Pa]", title="ARP there, mean over a period of 5 ms")
    axes[1].legend(loc="lower center")
    _displacement(axes[2], run)
    return (
        "The ARP at the middle of the palm agrees with |p|² of the free field there (float64 sum over the "
        f"transducers, scaled to the same maximum) within {100 * off:.1f} % of the maximum, at heights of "
        f"{1e3 * places[inner, 2].min():.0f} to {1e3 * places[inner, 2].max():.0f} mm."
    )


def hover(run: Run, axes: list[Axes]) -> str:
    """Draw the position of the palm at its strongest sensation, relative to the centre of the circle."""
    times, places = _middle_of_skin(run)
    levels = _at_middle(run, times, 100.0)
    inner = _whole_periods(times, 100.0)
    over = inner & (times < 0.3)
    x, weight = places[over, 0], levels[over] * np.gradient(places[over, 0])
    middle = float((weight * x).sum() / weight.sum())
    axes[0].plot(1e3 * times, 1e3 * places[:, 0], color=COLOURS[2])
    axes[0].axhspan(20.0, 40.0, color="#dddddd", label="circle of the focus")
    axes[0].set(ylabel="palm x [mm]", title="Sideways position of the palm's middle")
    axes[0].legend(loc="lower right")
    axes[1].plot(1e3 * times[inner], levels[inner], color=COLOURS[0])
    axes[1].set(ylabel="ARP [Pa]", title="ARP there, mean over a turn of 10 ms")
    _displacement(axes[2], run)
    return (
        "During the first crossing, the mean ARP at the middle of the palm has its centroid at x = "
        f"{1e3 * middle:.1f} mm; the centre of the circle is at 30 mm. This ARP is largest near the rim of the "
        "circle (radius 10 mm), because the focus is always on the rim."
    )


def tap(run: Run, axes: list[Axes]) -> str:
    """Draw the height of the fingertip pulp, which carries the focus, at the first burst."""
    times, places = _middle_of_skin(run)
    focus = run.focus
    loud = run.arp.max(axis=1)
    sounds = np.flatnonzero(loud > 0.0)
    at = sounds[0] if len(sounds) else 0
    axes[0].plot(1e3 * times, 1e3 * places[:, 2], color=COLOURS[2])
    axes[0].axhline(200.0, color="#888888", lw=0.8, ls="--", label="height of the button")
    axes[0].set(ylabel="pulp height [mm]", title="Height of the index finger's pulp")
    axes[0].legend(loc="lower left")
    axes[1].plot(1e3 * run.times, loud, color=COLOURS[0])
    axes[1].set(ylabel="ARP [Pa]", title="Largest ARP on the pulp")
    _displacement(axes[2], run)
    return (
        f"At the first burst, at {1e3 * run.times[at]:.2f} ms, the pulp is at a height of {1e3 * focus[at, 2]:.2f} mm "
        "(button: 200 mm)."
    )


def follow(run: Run, axes: list[Axes]) -> str:
    """Draw the distance of the focus from the skin, which is moved by bones."""
    times, places = _middle_of_skin(run)
    focus = _focus_at(run, times)
    gap = _gap(run, times, focus)
    axes[0].plot(*(1e3 * places[:, :2].T), color=COLOURS[1], lw=4, alpha=0.5, label="middle of the pulp's skin")
    axes[0].plot(*(1e3 * focus[:, :2].T), color=COLOURS[0], label="focus")
    axes[0].set(xlabel="x [mm]", ylabel="y [mm]", title="Paths seen from above", aspect="equal", anchor="W")
    axes[0].legend(loc="lower center")
    axes[1].plot(1e3 * times, 1e3 * gap, color=COLOURS[2])
    axes[1].set(ylabel="distance [mm]", title="Focus to the nearest skin", ylim=(0.0, 1.0))
    inner = _whole_periods(times, 200.0)
    axes[2].plot(1e3 * times[inner], _at_middle(run, times, 200.0)[inner], color=COLOURS[0])
    axes[2].set(
        xlabel="time [ms]", ylabel="ARP [Pa]", title="ARP at the pulp, mean over a period of 5 ms", ylim=(0.0, None)
    )
    way = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    return (
        f"The focus is at most {1e3 * np.nanmax(gap):.2f} mm from the skin while the pulp moves by {1e3 * way:.0f} mm."
    )


def trace(run: Run, axes: list[Axes]) -> str:
    """Draw the path on the rotated palm: its speed along the skin, and the distance of the focus from it."""
    times = run.times[1:]
    focus = np.array([to_local(f[None], pose_at(run.body, t))[0] for t, f in zip(times, run.focus[1:], strict=True)])
    speed = np.linalg.norm(np.diff(focus, axis=0), axis=1) / np.diff(times)
    gap = _gap(run, times[::5], run.focus[1::5])
    rest, faces = run.skin["rest_position"].values, run.skin["face"].values
    most = 1e6 * np.abs(run.normal_displacement).max(axis=0)
    drawn = axes[0].tripcolor(
        Triangulation(1e3 * rest[:, 0], 1e3 * rest[:, 1], faces), most, shading="gouraud", cmap="magma_r"
    )
    bar = axes[0].inset_axes((1.06, 0.0, 0.05, 1.0))
    axes[0].figure.colorbar(drawn, cax=bar, label="largest |u| [µm]")
    axes[0].plot(*(1e3 * focus[:, :2].T), color="#0ea5e9", lw=1.0)
    axes[0].set(xlabel="hand x [mm]", ylabel="hand y [mm]", aspect="equal", title="Path on the palm", anchor="W")
    axes[0].grid(visible=False)
    roll = np.degrees([2.0 * np.arctan2(p[5], p[3]) for p in run.body["pose"].values])
    axes[1].plot(1e3 * run.step_times, roll, color=COLOURS[2])
    axes[1].set(ylabel="roll [°]", title="Turn of the hand about its fingers' direction", xlabel="time [ms]")
    _displacement(axes[2], run)
    return (
        f"In the frame of the hand, the speed of the focus is {np.median(speed):.2f} m/s (median; key: 4 m/s). The "
        f"focus stays within {1e3 * np.nanmax(gap):.2f} mm of the skin while the hand rolls by {np.ptp(roll):.1f}°."
    )


def two_hands(run: Run, axes: list[Axes]) -> str:
    """Compare the ARP in the shadow with the ARP before and after it."""
    times, _ = _middle_of_skin(run)
    levels = _at_middle(run, times, 200.0)
    inner = _whole_periods(times, 200.0)
    free, least = levels[inner][0], levels[inner].min()
    axes[0].plot(1e3 * times[inner], levels[inner], color=COLOURS[0])
    axes[0].set(ylabel="ARP [Pa]", title="ARP at the right palm, mean over a period of 5 ms")
    _displacement(axes[1], run)
    return (
        f"The ARP at the middle of the palm is {free:.2f} Pa without a shadow, as low as {least:.2g} Pa in the "
        f"shadow (with rays, no sound is diffracted), and {levels[inner][-1]:.2f} Pa after the hand has passed."
    )


def grasp(run: Run, axes: list[Axes]) -> str:
    """Compare the vertical contact force on the ball with its weight, also in a repeated motion without sound."""
    times, ball, hand, force = _carried(run.sim, len(run.step_times))
    model = run.sim.model
    weight = float(model.body_mass[model.body("ball").id] * -model.opt.gravity[2])
    axes[0].plot(1e3 * times, 1e3 * ball, color=COLOURS[1], label="ball")
    axes[0].plot(1e3 * times, 1e3 * hand, color=COLOURS[2], label="hand")
    axes[0].set(ylabel="height [mm]", title="Heights of ball and hand")
    axes[0].legend(loc="upper left")
    axes[1].plot(1e3 * times, 1e3 * force, color=COLOURS[0])
    axes[1].axhline(1e3 * weight, color="#888888", lw=0.8, ls="--", label="weight of the ball")
    axes[1].set(ylabel="force [mN]", title="Vertical contact force on the ball")
    axes[1].legend(loc="upper right")
    of_run, _ = _middle_of_skin(run)
    inner = _whole_periods(of_run, 200.0)
    axes[2].plot(1e3 * of_run[inner], _at_middle(run, of_run, 200.0)[inner], color=COLOURS[0])
    axes[2].set(xlabel="time [ms]", ylabel="ARP [Pa]", title="ARP at the palm, mean over a period of 5 ms")
    held = times > GRIP_FROM_S
    if not held.any():
        return "The run is too short for the check."
    # Over a stretch, contact and weight together change the ball's momentum.
    rise = float(model.body_mass[model.body("ball").id] * np.gradient(np.gradient(ball, times), times)[held].mean())
    return (
        f"The mean vertical contact force on the ball after {1e3 * GRIP_FROM_S:.0f} ms is "
        f"{force[held].mean() / weight:.3f} of its weight ({rise / weight:.3f} of it accelerates the ball upwards). "
        f"The ball moves by {1e3 * np.ptp((ball - hand)[held]):.2f} mm relative to the hand."
    )


def stroke(run: Run, axes: list[Axes]) -> str:
    """Draw wake lengths at each speed."""
    found = []
    for (speed, seen), colour in zip(run.wakes.items(), COLOURS, strict=True):
        lengths, behind, envelope = wake_lengths(seen)
        found.append((speed, np.median(lengths), lengths.min(), lengths.max()))
        axes[0].plot(1e3 * behind, envelope, color=colour, label=f"{speed:g} m/s")
        spread = np.abs(np.array([[lengths.min()], [lengths.max()]]) - np.median(lengths))
        axes[1].errorbar(speed, 1e3 * np.median(lengths), 1e3 * spread, color=colour, fmt="o", capsize=4)
    axes[0].axhline(WAKE_SHARE, color="#888888", lw=0.8, ls="--")
    axes[0].set(
        xlabel="distance behind the focus [mm]",
        ylabel="|v| / largest",
        title="Envelope of the velocity at 75 % of the way",
    )
    axes[0].legend(loc="upper right")
    axes[1].set(
        xlabel="speed of the focus [m/s]", ylabel="wake [mm]", title="Wake length: median and range", ylim=(0.0, None)
    )
    _displacement(axes[2], run)
    material = run.sim.runtime.model.skins[0].layer.sheets[0].material
    slow, fast = (describe(material, f).shear_speed_m_s for f in (50.0, 500.0))
    figures = "; ".join(f"{1e3 * m:.0f} mm ({1e3 * a:.0f} to {1e3 * b:.0f}) at {v:g} m/s" for v, m, a, b in found)
    return (
        "The wake is the part of the path behind the focus on which the skin still moves: its normal velocity is above "
        "10 % of the largest value behind the focus. The median length of the wake (smallest to largest) is "
        f"{figures}. Shear waves in this material travel at {slow:.1f} m/s at 50 Hz and {fast:.1f} m/s at 500 Hz."
    )


def stroke_velocities(speed_m_s: float) -> dict[str, Float]:
    """Step the scenario stroke_palm at one speed to 90 % of its first pass, on the mesh of WAKE_KEYS.

    Returns arc: distance travelled by the focus at each time from 60 % of the pass on [m], shape (n,); velocity: of the
    skin's nodes along their normals [m/s], shape (n, s); places: arc lengths of points on the path [m], shape (k,);
    near: which nodes lie within PATH_NEIGHBOURHOOD_M of each, shape (k, s); unknowns: of the skin, shape ()
    """
    sim = Simulation(SCENES / "stroke_palm.xml", keys={"stimulus.path_speed_m_s": speed_m_s, **WAKE_KEYS})
    work, model = sim.runtime.work, sim.runtime.model
    path, surface, layer = model.stimuli[0].path, model.bodies[0].surface, model.skins[0].layer
    assert path is not None and surface is not None
    way = path.length_m
    places = np.arange(0.0, way, 0.001)
    on_skin, _ = path.at(places, surface.vertices, surface.faces)
    rows: list[tuple[float, Float]] = []

    def note(trace: StepTrace) -> None:
        [(_, [seen])] = trace.motion[0]
        rows.extend((t * speed_m_s, motion[1].copy()) for t, motion in zip(trace.times, seen, strict=True))

    work.observe, sim.steps.observer = (layer.surface_operator,), note
    while sim.time * speed_m_s < 0.9 * way:
        sim.step()
    rows = [row for row in rows if 0.6 * way <= row[0] <= 0.9 * way]
    return {
        "arc": np.array([row[0] for row in rows]),
        "velocity": np.array([row[1] for row in rows]),
        "places": places,
        "near": np.linalg.norm(on_skin[:, None] - sim.skin().rest_position[None], axis=2) < PATH_NEIGHBOURHOOD_M,
        "unknowns": np.array(layer.system.ndof),
    }


def wake_lengths(record: dict[str, Float]) -> tuple[Float, Float, Float]:
    """Return the wake lengths [m] at each time of `stroke_velocities`, and the envelope nearest to 75 % of the pass.

    The wake is that of `palmfield.metrics.wake_along_path`, of nodes within PATH_NEIGHBOURHOOD_M. Returns lengths (n,),
    distances behind the focus [m], and the envelope there relative to its maximum.
    """
    wakes = [
        wake_along_path(arc, velocity, record["places"], record["near"], WAKE_SHARE)
        for arc, velocity in zip(record["arc"], record["velocity"], strict=True)
    ]
    middle = int(np.abs(record["arc"] - 0.5 * (record["arc"][0] + record["arc"][-1])).argmin())
    return np.array([length for length, _, _ in wakes]), *wakes[middle][1:]


def _middle_of_skin(run: Run) -> tuple[Float, Float]:
    """Return times of the MuJoCo steps [s], shape (n,), and the middle of the skin in the world [m], shape (n, 3)."""
    vertex = _middle(run)
    return run.step_times, np.array([in_world(run.skin, run.body, t)[vertex] for t in run.step_times])


def _middle(run: Run) -> int:
    """Return the surface vertex nearest to the middle of the skin layer."""
    rest = run.skin["rest_position"].values
    return int(np.linalg.norm(rest - 0.5 * (rest.min(axis=0) + rest.max(axis=0)), axis=1).argmin())


def _at_middle(run: Run, times: Float, rate_Hz: float) -> Float:
    """Return the ARP at the middle of the skin [Pa] at times [s], as a mean over one period around each time."""
    own = run.times
    count = round(1.0 / (rate_Hz * (own[1] - own[0])))
    return np.interp(times, own, uniform_filter1d(run.arp[:, _middle(run)].astype(np.float64), count))


def _whole_periods(times: Float, rate_Hz: float) -> Any:
    """Return the times around which a whole period lies within the run."""
    return (times - times[0] >= 0.5 / rate_Hz) & (times[-1] - times >= 0.5 / rate_Hz)


def _focus_at(run: Run, times: Float) -> Float:
    return run.focus[[int(np.abs(run.times - t).argmin()) for t in times]]


def _gap(run: Run, times: Float, focus: Float) -> Float:
    """Return the distance [m] of foci in the world, shape (n, 3), from the skin at those times; nan without a focus."""
    gaps = np.full(len(times), np.nan)
    for i in np.flatnonzero(np.isfinite(focus[:, 0])):
        mesh = trimesh.Trimesh(in_world(run.skin, run.body, times[i]), run.skin["face"].values, process=False)
        gaps[i] = trimesh.proximity.closest_point_naive(mesh, focus[i : i + 1])[1][0]
    return gaps


def _displacement(axes: Axes, run: Run) -> None:
    """Draw the displacement of the vertex with the largest displacement."""
    motion = run.normal_displacement
    vertex = int(np.abs(motion).max(axis=0).argmax())
    axes.plot(1e3 * run.times, 1e6 * motion[:, vertex], color=COLOURS[1], lw=0.9)
    axes.set(xlabel="time [ms]", ylabel="u [µm]", title="Normal displacement where the skin moves most (-: in)")


def _carried(sim: Simulation, count: int) -> tuple[Float, Float, Float, Float]:
    """Return times [s], heights of ball and hand [m], and vertical contact force on the ball [N], of a silent run."""
    assert sim.path is not None
    silent = Simulation(sim.path, keys={"stimulus.drive_amplitude": 0})
    model, data = silent.model, silent.data
    ball = model.body("ball").id
    rows = []
    wrench = np.zeros(6)
    for _ in range(count):
        silent.step()
        force = 0.0
        for number, contact in enumerate(data.contact):
            bodies = model.geom_bodyid[[contact.geom1, contact.geom2]]
            if ball in bodies:
                mujoco.mj_contactForce(model, data, number, wrench)
                force += (1.0 if bodies[1] == ball else -1.0) * float(contact.frame.reshape(3, 3)[:, 2] @ wrench[:3])
        rows.append((data.time, data.body("ball").xpos[2], data.body("hand").xpos[2], force))
    times, at, hand, force = np.array(rows).T
    return times, at, hand, force


STORIES = {
    "approach_withdraw": Story(
        "A flat hand comes down through a fixed focus at 200 mm, modulated at 200 Hz, and withdraws.", EQUAL, approach),
    "hover_explore": Story(
        "A hand at a height of 200 mm moves over a focus and spreads its fingers. The focus moves on a circle whose "
        "centre is 30 mm to one side. The sound does not depend on the hand.", EQUAL, hover),
    "tap_button": Story(
        "A pointing finger goes down. When its pulp passes 200 mm, five bursts of 4 ms imitate a button.", EQUAL, tap),
    "follow_fingertip": Story(
        "A pointing finger draws half a circle in the air and bends. The focus is defined in the frame of the pulp, so "
        "it follows the finger.",
        MAP_FIRST, follow),
    "stroke_palm": Story(
        "A focus strokes the skin of a hand at rest, from the thenar to the pulp of the index finger and back, as in "
        "the study of Reardon et al. The same stroke on a thin reference layer takes less time "
        "([stroke](bench/stroke.md)).",
        EQUAL, stroke),
    "trace_shape": Story(
        "A focus writes a Z on the palm of a rolling hand. The path rotates with the skin.",
        MAP_FIRST, trace),
    "two_hands": Story(
        "A left hand passes between the array and a right hand, and casts a shadow on its focus.",
        (1.0, 1.0), two_hands),
    "grasp_object": Story(
        "Thumb, index and middle finger hold a ball of 32 mm and 20 g by friction and lift it. The focus is on the "
        "palm, and the ball casts a shadow.", EQUAL, grasp),
}  # fmt: skip
