"""Write the bodies of a run to USD: poses, surface, skeletons of articulated hands, and the force of the sound."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdSkel, Vt

from palmfield.hand.triangles import face_normals
from palmfield.outputs.covered import smooth_normals, sunk
from palmfield.outputs.frames import IDENTITY, nearest
from palmfield.outputs.schema import has_records
from palmfield.outputs.usd.clock import Clock, rows_at
from palmfield.outputs.usd.prims import Moves, about, add_mesh, add_primvar, describe_rounding, floats, vector, vectors
from palmfield.outputs.usd.quantise import rounding
from palmfield.outputs.usd.samples import Samples
from palmfield.outputs.usd.skins import LOUDEST, SkinWriter, add_afferents
from palmfield.types import Float, Float32, Int

SKIN_COLOUR = (0.70, 0.47, 0.36)
"""Colour of bodies and their skins without a coloured quantity."""
FORCE_ROUNDING = "up or down to 1/1000 of the range at the moment, so that the sum over areas does not change"
FORCE_PART = 1000
"""Range of the pressures on faces divided by their rounding step. The sum must equal the force, even a small one."""


class BodyWriter:
    """Writes one body, frame by frame.

    skins: writers of its skins, by their names in the result
    """

    def __init__(
        self,
        stage: Usd.Stage,
        path: str,
        body: xr.Dataset | None,
        forces: xr.Dataset | None,
        surfaces: list[xr.Dataset],
        skins: dict[str, xr.Dataset],
        colour: tuple[float, ...],
    ):
        """Add the prims of the body.

        body, forces: groups of any of its skins
        surfaces: surfaces of the skins that have one
        skins: skins by name
        colour: colour of the body, and of its skins without colours over time
        """
        boned = body is not None and has_records(body, "bone_pose")
        moves = body is not None and has_records(body, "pose")
        self._poses: Float = body["pose"].values if body is not None and moves else IDENTITY[None]
        timed = next(
            (one for one in (body, forces, *surfaces) if one is not None and has_records(one, "step_time")), None
        )
        self._step_times: Float = np.zeros(0) if timed is None else timed["step_time"].values
        prim = (UsdSkel.Root if boned else UsdGeom.Xform).Define(stage, path)
        self._moves = Moves(prim)
        meshes: list[tuple[UsdGeom.Mesh, xr.Dataset, Int | slice]] = []
        self._pressed: tuple[xr.Dataset, Any, Samples] | None = None
        if surfaces:
            meshes += self._add_surface(stage, path, surfaces, list(skins.values()), colour)
        UsdGeom.Scope.Define(stage, f"{path}/Skins")
        self.skins: dict[str, SkinWriter] = {}
        for name, identifier in identifiers(skins).items():
            writer = SkinWriter(stage, f"{path}/Skins/{identifier}", skins[name], colour)
            add_afferents(stage, f"{path}/Afferents/{identifier}", skins[name])
            self.skins[name] = writer
            meshes.append((writer.mesh, skins[name], writer.order))
        self._bones: tuple[BoneMoves, Float] | None = None
        if body is not None and boned:
            skeleton, animation = add_skeleton(stage, path, body)
            self._bones = BoneMoves(animation), body["bone_pose"].values
            for mesh, ds, order in meshes:
                if "bone_index" in ds:
                    bind(mesh, skeleton, ds["bone_index"].values[order], ds["bone_weight"].values[order])
        self._forces = self._add_forces(prim.GetPrim(), forces)

    def _add_surface(
        self,
        stage: Usd.Stage,
        path: str,
        surfaces: list[xr.Dataset],
        skins: list[xr.Dataset],
        colour: tuple[float, ...],
    ) -> list[tuple[UsdGeom.Mesh, xr.Dataset, slice]]:
        """Add the closed surface of the body with the ARP. For drawing, add a copy that is lowered below the skins."""
        first, everything = surfaces[0], slice(None)
        points, faces = first["rest_position"].values, first["face"].values
        mesh = add_mesh(stage, f"{path}/Surface", points, faces, colour)
        holds = "surface of the body in the computation; Drawn is the same surface, lowered below the skins"
        about(mesh.GetPrim(), holds=holds)
        for name, sign in LOUDEST.items():
            # Skins on one body share its surface; each has its own loudest moment
            values = [surface[name].values for surface in surfaces if has_records(surface, name)]
            if values:
                add_primvar(mesh.GetPrim(), name, "Pa", sign, {}).Set(floats(np.maximum.reduce(values)))
        if has_records(first, "face_arp"):
            low, high = float(first["face_arp"].min()), float(first["face_arp"].max())
            rounded = rounding(low, high, face_normals(points, faces)[1], FORCE_PART)
            details = describe_rounding(rounded) | {"quantisation": FORCE_ROUNDING}
            sign = "mean over the step; positive values push into the surface"
            primvar = add_primvar(mesh.GetPrim(), "arp", "Pa", sign, details, "uniform")
            self._pressed = first, rounded, Samples(primvar.GetAttr(), floats)
        mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
        # Normals of the true surface, because the edge of the lowered part would darken the body next to the skin
        normals = smooth_normals(points, faces)
        drawn = add_mesh(stage, f"{path}/Drawn", sunk(first, skins)["rest_position"].values, faces, colour, normals)
        return [(mesh, first, everything), (drawn, first, everything)]

    def _add_forces(self, prim: Usd.Prim, forces: xr.Dataset | None) -> list[tuple[Float, Samples]]:
        if forces is None or not has_records(forces, "force"):
            return []
        added = []
        for name, unit, sign in (
            ("force", "N", "of the sound on the body, world axes, mean over the MuJoCo step"),
            ("torque", "N m", "about the origin of the body, world axes, mean over the MuJoCo step"),
        ):
            attribute = prim.CreateAttribute(f"palmfield:{name}", Sdf.ValueTypeNames.Vector3d, custom=True)
            about(attribute, units=unit, sign=sign)
            added.append((forces[name].values, Samples(attribute, vector)))
        return added

    def write(self, clock: Clock, frames: slice) -> None:
        """Write frames, which must be later than earlier ones; skins are written separately."""
        codes, times = clock.codes[frames].tolist(), clock.times_s[frames]
        now = [nearest(self._step_times, time_s) if len(self._poses) > 1 else 0 for time_s in times.tolist()]
        self._moves.extend(codes, self._poses[now])
        if self._bones is not None:
            self._bones[0].extend(codes, self._bones[1][now])
        if not self._forces and self._pressed is None:
            return
        steps = steps_of(self._step_times, times)
        for values, samples in self._forces:
            samples.extend(codes, values[steps])
        if self._pressed is not None:
            surface, rounded, samples = self._pressed
            found, each = np.unique(steps, return_inverse=True)
            pressed = rows_at(surface["face_arp"], "step_time", found)
            # Rounding relative to the range at this time, so that small forces are as accurate as large ones
            own = [rounding(float(row.min()), float(row.max()), rounded.weights, FORCE_PART) for row in pressed]
            samples.extend(codes, np.stack([one.of(row) for one, row in zip(own, pressed, strict=True)])[each])

    def stand(self) -> None:
        """Write the pose of the body for a run without times."""
        self._moves.extend([0.0], self._poses[:1])


def steps_of(step_times: Float, times_s: Float) -> Int:
    """Return the MuJoCo steps that contain, or end at, times [s], shape (n,).

    At the start of the run it is the first step.
    """
    return np.maximum(0, np.searchsorted(step_times, times_s - 1e-9) - 1).astype(np.int32)


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return unique names that USD allows for prims and joints. The keys are the original names."""
    result: dict[str, str] = {}
    for name in names:
        # USD would remove a digit at the beginning
        base = Tf.MakeValidIdentifier(f"_{name}" if name[:1].isdigit() else name)
        used = set(result.values())
        result[name] = next(n for k in range(len(used) + 1) if (n := f"{base}_{k}" if k else base) not in used)
    return result


def add_skeleton(stage: Usd.Stage, root: str, body: xr.Dataset) -> tuple[UsdSkel.Skeleton, UsdSkel.Animation]:
    """Add a skeleton, and an animation without motion, under a UsdSkel root.

    The frame of the root is that of the body.
    """
    skeleton = UsdSkel.Skeleton.Define(stage, f"{root}/Skeleton")
    count = body.sizes["bone"]
    labels = [str(n) for n in body["bone"].values] if "bone" in body.coords else [f"bone_{k:02d}" for k in range(count)]
    names = list(identifiers(labels).values())
    skeleton.CreateJointsAttr(names)
    rest = [Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*origin)) for origin in body["bone_rest"].values.tolist()]
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray(rest))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray(rest))
    animation = UsdSkel.Animation.Define(stage, f"{root}/Skeleton/Motion")
    animation.CreateJointsAttr(names)
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0, 1.0, 1.0)] * count))
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    return skeleton, animation


class BoneMoves:
    """Translations and rotations of the bones of a skeleton over time."""

    def __init__(self, animation: UsdSkel.Animation):
        self._moves = Samples(animation.CreateTranslationsAttr(), vectors)
        self._turns = Samples(
            animation.CreateRotationsAttr(), lambda turns: Vt.QuatfArray([Gf.Quatf(*turn) for turn in turns.tolist()])
        )

    def extend(self, codes: Sequence[float], poses: Float) -> None:
        """Add poses of all bones in the body frame, shape (n, bones, 7), at rising time codes."""
        self._moves.extend(codes, poses[..., :3])
        self._turns.extend(codes, poses[..., 3:])


def bind(mesh: UsdGeom.Mesh, skeleton: UsdSkel.Skeleton, bones: Int, weights: Float32) -> None:
    """Let a mesh follow the skeleton by linear blending; bones, weights: shape (n, 4)."""
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    influences = bones.shape[1]
    binding.CreateJointIndicesPrimvar(False, influences).Set(Vt.IntArray.FromNumpy(bones.ravel()))
    binding.CreateJointWeightsPrimvar(False, influences).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
