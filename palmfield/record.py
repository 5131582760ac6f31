"""What a running simulation writes: blocks of labelled arrays for the store."""

from typing import Any

import numpy as np
import xarray as xr

from palmfield.chain import Sound
from palmfield.engine.modules import SkinModule
from palmfield.hand.triangles import vertex_normals
from palmfield.outputs.v1_schema import dataset
from palmfield.outputs.v1_store import Store
from palmfield.posed import Bound
from palmfield.skin.mesh.surface import output_triangles
from palmfield.types import Complex, Float, Float32


class Recorder:
    """Watches a skin module and passes what happens on to a store."""

    def __init__(self, skin: SkinModule, store: Store):
        self.skin, self.chain, self.store = skin, skin.chain, store
        self.nodes, self.normals = self.chain.surface_nodes()
        self._last: tuple[Sound | None, Float32] = (None, np.zeros(len(self.nodes), dtype=np.float32))
        self._loudest: tuple[float, Sound | None] = (0.0, None)
        self._loudest_Pa = 0.0
        self._playing: Complex | None = None
        self._blocks: dict[str, list[Any]] = {}

    def _add(self, **values: Any) -> None:
        for name, value in values.items():
            self._blocks.setdefault(name, []).append(value)

    def start(self) -> None:
        """Note the state before the first step."""
        sound, factor = self.skin.now()
        motion = self.chain.skin.read(self.skin.world.state(self.skin.instance), self.chain.surface_operator)
        t = self.skin.world.time
        pose = self.skin.pose()
        self.observe(t, motion, sound, factor, self.chain.drive(t, self.skin.aim(pose), pose))

    def observe(self, t: float, motion: Float, sound: Sound | None, factor: float, drive: Complex) -> None:
        """One skin step has ended at time t [s] (called by the chain)."""
        arp = np.zeros(len(self.nodes), dtype=np.float32)
        focus = np.full(3, np.nan)
        if sound is not None:
            if self._last[0] is not sound:
                place = self.chain.rig.posed(sound.pose).nodes
                self._last = (sound, self.chain.arp_at(*place, sound.pose, sound.drive)[0])
            arp = np.float32(factor) * self._last[1]
            position, turn = self.skin.world.pose("site", self.skin.sites[0])
            focus = position + turn @ sound.first
            if arp.max() > self._loudest_Pa:
                self._loudest_Pa, self._loudest = float(arp.max()), (factor, sound)
        self._add(
            time=t,
            normal_displacement=motion[0].astype(np.float32),
            normal_velocity=motion[1].astype(np.float32),
            arp=arp,
            focus=focus,
        )
        self._drive(t, drive)

    def _drive(self, t: float, drive: Complex) -> None:
        if self._playing is not None and np.array_equal(self._playing, drive):
            return
        self._playing = drive
        self._add(
            frame_time=t,
            drive_amplitude=np.abs(drive).astype(np.float32),
            drive_phase=np.angle(drive).astype(np.float32),
        )

    def step(self) -> None:
        """One MuJoCo step has ended: note body and force at its beginning, and hand the block over."""
        world = self.skin.world
        position, turn = world.pose("body", self.skin.body)
        if self.chain.rig.hand is not None:
            self._add(bone_pose=self._bone_poses())
        self._add(
            step_time=world.time - world.model.timestep,
            body_pose=np.concatenate([position, quaternion(turn)]),
            arp_force=self.skin.applied,
        )
        block = {name: np.asarray(values) for name, values in self._blocks.items()}
        self._blocks = {}
        self.store.append(dataset(**block))

    def _bone_poses(self) -> Float:
        pose = self.skin.pose()
        count = len(self.skin.bones)
        return np.array(
            [np.concatenate([at, quaternion(turn)]) for at, turn in zip(*(x[:count] for x in pose.bones), strict=True)]
        )

    @property
    def loudest(self) -> tuple[Sound | None, float]:
        """The sound with the highest ARP on the skin so far, and its ARP factor."""
        return self._loudest[1], self._loudest[0]

    def surfaces(self) -> xr.Dataset:
        """ARP and pressure on the whole surface and on the skin at the loudest moment."""
        factor, sound = self._loudest
        rig = self.chain.rig
        posed = rig.posed(rig.reference_pose if sound is None else sound.pose)
        rows: dict[str, Any] = {}
        for prefix, points, normals in (
            ("surface", posed.vertices, vertex_normals(posed.vertices, rig.closed_surface[1])),
            ("skin", *posed.nodes),
        ):
            arp, pressure = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
            if sound is not None:
                arp, pressure = self.chain.arp_at(points, normals, sound.pose, sound.drive)
            rows[f"{prefix}_pressure"] = (np.sqrt(factor) * pressure).astype(np.float32)
            rows[f"{prefix}_arp"] = (factor * arp).astype(np.float32)
        beside = posed.beside
        if beside is not None:
            rows["obstacle_vertices"], rows["obstacle_faces"] = beside
        return dataset(**{k: v for k, v in rows.items() if k != "skin_arp"})


def static_data(skin: SkinModule) -> xr.Dataset:
    """What is known before the first step."""
    rig, chain = skin.rig, skin.chain
    vertices, faces = chain.rig.closed_surface
    nodes, _ = chain.surface_nodes()
    base = rig.mesh.nodes[-len(nodes) :]
    position, turn = skin.world.pose("site", skin.sites[0])
    bones: dict[str, Any] = {}
    if rig.hand is not None:
        for mesh, points in (("skin", nodes), ("surface", vertices)):
            bound = Bound.to(rig.hand, points)
            bones |= {f"{mesh}_bone": bound.bones, f"{mesh}_share": bound.shares.astype(np.float32)}
        bones["bone_rest"] = np.array([bone.origin for bone in rig.hand.bones])
    return dataset(
        **bones,
        skin_position=nodes,
        skin_faces=output_triangles(rig.mesh).astype(np.int32),
        skin_depth=np.linalg.norm(nodes - base, axis=1),
        surface_vertices=vertices,
        surface_faces=faces,
        transducer_position=rig.array.positions,
        array_pose=np.concatenate([position, quaternion(turn)]),
    )


def quaternion(turn: Float) -> Float:
    """Unit quaternion (w, x, y, z) of a rotation matrix, shape (3, 3)."""
    import mujoco

    out = np.empty(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(turn).ravel())
    return out
