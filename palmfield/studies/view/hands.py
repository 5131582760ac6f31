"""Add a shift and a rotation to hands that the script of a scene moves."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from palmfield.motion.live_hand import Live, LiveHand
from palmfield.motion.live_motion import LiveMotion
from palmfield.motion.pose import HandPose
from palmfield.motion.source import HandMotion
from palmfield.session.live_scene import scripts, the_articulated
from palmfield.session.simulation import Simulation
from palmfield.studies.view.messages import Place, Slider
from palmfield.types import Float

AXES = "xyz"
ASIDE_mm, TURN_deg = 60.0, 60.0
NO_HAND = "this scene has no palmfield.motion that moves a hand"


@dataclass(frozen=True)
class Offset:
    """Shift [m] of a hand and rotation about the axes of the hand (rotation vector [deg])."""

    shift: Float
    turn_deg: Float

    @staticmethod
    def none() -> "Offset":
        return Offset(np.zeros(3), np.zeros(3))

    def put(self, pose: HandPose) -> HandPose:
        """Return a scripted pose with this offset."""
        own = Rotation.from_quat(np.roll(pose.quaternion, -1))
        turned = own * Rotation.from_rotvec(self.turn_deg, degrees=True)
        return replace(pose, position=pose.position + self.shift, quaternion=np.roll(turned.as_quat(), 1))


class Hands:
    """The scripted hands of a scene. Their offsets are kept when the scene is rebuilt.

    sliders: sliders of all hands; offsets: offsets by instance of palmfield.motion
    followed: the tracked hand that leads the only articulated hand of the scene in place of its script, or None
    """

    def __init__(self, sim: Simulation, live: Live | None = None) -> None:
        """live: source of a tracked hand. Raises SceneError unless the scene moves exactly one articulated hand, and
        DeviceError for an address at which it cannot listen."""
        self.followed: LiveHand | None = None
        self._motion: LiveMotion | None = None
        if live is not None:
            name, module = the_articulated(scripts(sim.data), sim.name)
            hand, frame = module.motion.hand, sim.runtime.posed.array_frame
            assert hand is not None
            self.followed, self._led = live.follow(hand, frame), name
        self.offsets = {name: Offset.none() for name in scripts(sim.data)}
        self.sliders: tuple[Slider, ...] = tuple(
            Slider(
                ("pose", f"{name}.{kind}", axis), f"Hand: {name}", f"{kind} {AXES[axis]}", -most, most, 0.5, 0.0, *unit
            )
            for name in self.offsets
            for kind, most, unit in (("shift", ASIDE_mm, ("mm", 1e3)), ("turn", TURN_deg, ("deg", 1.0)))
            for axis in range(3)
        )
        self._scripts: dict[str, HandMotion] = {}
        self.attach(sim)

    def attach(self, sim: Simulation) -> None:
        """Let the offsets move the hands of another simulation of the scene."""
        self._modules = scripts(sim.data)
        self._scripts = {name: module.motion for name, module in self._modules.items()}
        if self.followed is not None:
            script, followed = self._scripts[self._led], self.followed
            assert script.hand is not None
            self._motion = LiveMotion(script.hand, lambda: followed.newest, script.at(sim.time))
            self._scripts[self._led] = HandMotion(script.hand, self._motion)
        for name in self.offsets:
            self._lead(name)

    def turn(self, place: Place, value: float) -> None:
        """Set a slider to a value, in its unit."""
        _, named, axis = place
        name, _, kind = named.rpartition(".")
        assert axis is not None
        old = self.offsets[name]
        parts = {"shift": old.shift.copy(), "turn": old.turn_deg.copy()}
        parts[kind][axis] = 1e-3 * value if kind == "shift" else value
        self.offsets[name] = Offset(parts["shift"], parts["turn"])
        self._lead(name)

    @property
    def values(self) -> dict[Place, float]:
        """Return the values of the sliders, in their units."""
        found = {}
        for slider in self.sliders:
            _, named, axis = slider.place
            name, _, kind = named.rpartition(".")
            offset = self.offsets[name]
            assert axis is not None
            found[slider.place] = float(1e3 * offset.shift[axis] if kind == "shift" else offset.turn_deg[axis])
        return found

    @property
    def age_s(self) -> float | None:
        """Return `LiveMotion.age_s`, NaN while the hand is lost, None without a tracked hand."""
        if self.followed is None or self._motion is None:
            return None
        return math.nan if self.followed.stale else self._motion.age_s

    def _lead(self, name: str) -> None:
        script, offset = self._scripts[name], self.offsets[name]
        self._modules[name].motion = HandMotion(script.hand, lambda time_s: offset.put(script.at(time_s)))
