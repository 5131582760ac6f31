"""Read the data of a simulation that the page shows."""

import numpy as np

from palmfield.outputs.covered import Under, under
from palmfield.session.simulation import Simulation
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.studies.view.messages import Moment, Pose, SceneShown, Slider
from palmfield.types import Float32

SILENT = np.zeros((0, 3), np.float32)


def _under(model: HapticModel, body: int) -> Under:
    """Return the vertices of a body (by its number) that its skins cover. Skins are numbered as in the model."""
    skins = np.array(model.carried(body))
    vertices, _ = model.skins[skins[0]].closed_surface
    found = under(vertices, [(model.skins[n].nodes[0], model.skins[n].faces, model.skins[n].nodes[1]) for n in skins])
    return found._replace(skin=skins[found.skin])


def scene_shown(sim: Simulation, name: str, pose: Pose, sliders: tuple[Slider, ...], no_pose: str) -> SceneShown:
    """Return the data that stay constant while the scene is stepped.

    pose: first pose; sliders, no_pose: as in SceneShown
    """
    model, posed = sim.runtime.model, sim.runtime.posed
    surfaces = [model.skins[number].closed_surface for number in model.first_skins]
    return SceneShown(
        name=name,
        device=model.spec.device,
        body_faces=tuple(np.asarray(faces, np.int32) for _, faces in surfaces),
        skins=sim.skins,
        skin_faces=tuple(np.asarray(skin.faces, np.int32) for skin in model.skins),
        pose=pose,
        transducer_directions=_in_world(posed.array_frame.vectors(posed.arrays.array.normals)),
        transducer_radius=model.arrays.array.piston_radius_m,
        sliders=sliders,
        no_pose=no_pose,
        timestep_s=model.spec.timestep_s,
    )


def _in_world(array: np.ndarray) -> Float32:
    return np.array(array, np.float32)


class MomentReader:
    """Reads moments and poses of a simulation. It stores the number of the pose that was shown last."""

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        model = sim.runtime.model
        self._under = [_under(model, number) for number in range(len(model.bodies))]
        self._shown: PosedScene | None = None

    def pose(self) -> Pose:
        """Return the present positions of bodies, skins and transducers. Bodies are lowered below their skins."""
        posed = self._shown = self._sim.runtime.posed
        frame = posed.array_frame
        skins = []
        for skin in posed.skins:
            points, normals = frame.surface(*skin.nodes)
            skins.append((_in_world(points), _in_world(normals)))
        bodies = []
        for body, (vertex, owner, node, depth) in zip(posed.bodies, self._under, strict=True):
            vertices = _in_world(frame.points(body.vertices_in_array))
            for number in np.unique(owner):
                own = owner == number
                vertices[vertex[own]] -= np.float32(depth[own, None]) * skins[number][1][node[own]]
            bodies.append(vertices)
        return Pose(tuple(bodies), tuple(skins), _in_world(frame.points(posed.arrays.array.positions)))

    def moment(
        self, *, full: bool, speed: float, playing: bool, recording: str, hand_age_s: float | None = None
    ) -> Moment:
        """Return the present state. full: whether to include motion and ARP of the skins; others as in Moment"""
        sim, runtime = self._sim, self._sim.runtime
        posed = runtime.posed
        moved = posed is not self._shown
        now = np.array([sim.time])
        foci = runtime.work.emission.foci(posed, now)
        sounding = [part[0] for part, one in zip(foci, runtime.model.stimuli, strict=True) if not one.silent]
        skins = [sim.skin(name) for name in sim.skins]
        return Moment(
            time_s=sim.time,
            speed=speed,
            playing=playing,
            pose=self.pose() if moved else None,
            drive=sim.drive,
            foci=_in_world(posed.array_frame.points(np.concatenate(sounding))) if sounding else SILENT,
            solvers=tuple(skin.solver for skin in skins),
            recording=recording,
            displacement=tuple(_in_world(skin.normal_displacement) for skin in skins) if full else (),
            arp=tuple(_in_world(skin.arp) for skin in skins) if full else (),
            hand_age_s=hand_age_s,
        )
