"""Write the MuJoCo scene to USD: bodies with recorded motion, geoms, and rigid bodies and joints of UsdPhysics."""

import json
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt
from scipy.spatial.transform import Rotation
from trimesh.creation import icosphere

from palmfield.outputs.frames import nearest
from palmfield.outputs.schema import has_records
from palmfield.outputs.style import linear_rgb
from palmfield.outputs.usd.bodies import identifiers
from palmfield.outputs.usd.clock import Clock
from palmfield.outputs.usd.prims import Moves, about, add_mesh, vectors
from palmfield.types import Float

ROOT = "/Scene/MuJoCo"
EARTH = "[0.0, 0.0, -9.81]"
MOTION, RECORDED, SIMULATED = "motion", "recorded", "simulated"
"""Variant set, and its two variants: bodies that follow the recorded run, and bodies that a physics engine moves."""
SQUARE = 1e-3
"""Largest cosine of the angle between two joint axes that count as perpendicular."""
DEGREES = 180.0 / np.pi
D6_MOVES = ("transX", "transY", "transZ")
D6_TURNS = ("rotX", "rotY", "rotZ")


class PhysicsWriter:
    """Writes poses of MuJoCo bodies, frame by frame.

    Bodies are siblings under /Scene/MuJoCo/Bodies, in world coordinates, as UsdPhysics requires for moving bodies.
    Geoms of bodies with other prims (hands with skin, arrays) have the purpose guide. Not included are equality
    constraints, tendons, actuators, contact pairs and excludes, and joints of one body with axes that are not
    perpendicular; customData of the prim lists them.
    """

    def __init__(self, stage: Usd.Stage, group: xr.Dataset):
        """group: /mujoco/scene of the result"""
        self._stage = stage
        attributes, moves = group.attrs, has_records(group, "pose")
        self._step_times: Float = group["step_time"].values if moves else np.zeros(0)
        # Load them, because they are small and read thousands of times
        scene: dict[str, NDArray[Any]] = {str(name): one.values for name, one in group.data_vars.items()}
        self._scene = scene
        self._poses: Float | None = scene["pose"] if moves else None
        root = UsdGeom.Xform.Define(stage, ROOT).GetPrim()
        physics = UsdPhysics.Scene.Define(stage, f"{ROOT}/PhysicsScene")
        gravity = np.asarray(json.loads(str(attributes.get("gravity", EARTH))), float)
        size = float(np.linalg.norm(gravity))
        physics.CreateGravityDirectionAttr(Gf.Vec3f(*(gravity / size if size > 0 else gravity).tolist()))
        physics.CreateGravityMagnitudeAttr(size)
        for scope in ("Bodies", "Joints", "Materials"):
            UsdGeom.Scope.Define(stage, f"{ROOT}/{scope}")
        names = [str(name) for name in scene["body_name"]]
        shown = set(json.loads(str(attributes.get("shown_better", "[]"))))
        unlike = [name if name not in names[:k] else f"{name}_{k}" for k, name in enumerate(names)]
        self._paths = {k: f"{ROOT}/Bodies/{name}" for k, name in enumerate(identifiers(unlike).values())}
        self._moves: dict[int, Moves] = {}
        for number, name in enumerate(names):
            if number > 0:
                self._add_body(number)
            else:
                UsdGeom.Xform.Define(stage, self._paths[0])
            about(stage.GetPrimAtPath(self._paths[number]), mujoco_name=name)
        self._materials: dict[float, UsdShade.Material] = {}
        for number in range(len(scene.get("geom_name", ()))):
            self._add_geom(number, names[int(scene["geom_body"][number])] in shown)
        left_out = self._add_joints()
        about(root, left_out="; ".join(left_out))
        self._add_variants(root)

    def write(self, clock: Clock, frames: slice) -> None:
        """Write frames, which must be later than earlier ones."""
        if self._poses is None:
            return
        codes = clock.codes[frames].tolist()
        poses = self._poses[[nearest(self._step_times, time_s) for time_s in clock.times_s[frames].tolist()]]
        for number, moves in self._moves.items():
            moves.extend(codes, poses[:, number])

    def stand(self) -> None:
        """Write poses of the bodies with all joints in the reference position, for a run without steps."""
        scene = self._scene
        poses = np.zeros((len(scene["body_name"]), 7))
        poses[0, 3] = 1.0
        for number in range(1, len(poses)):
            outer, own = poses[scene["body_parent"][number]], scene["body_frame"][number]
            turn = _rotation(outer[3:])
            poses[number, :3] = outer[:3] + turn.apply(own[:3])
            poses[number, 3:] = np.roll((turn * _rotation(own[3:])).as_quat(), 1)
            self._moves[number].extend([0.0], poses[number : number + 1])

    def _add_body(self, number: int) -> None:
        scene = self._scene
        prim = UsdGeom.Xform.Define(self._stage, self._paths[number])
        self._moves[number] = Moves(prim)
        if bool(scene["body_held"][number]) and not bool(scene["body_placed"][number]):
            return
        UsdPhysics.RigidBodyAPI.Apply(prim.GetPrim())
        mass = float(scene["body_mass"][number])
        if mass > 0.0:
            api = UsdPhysics.MassAPI.Apply(prim.GetPrim())
            frame = scene["body_inertial_frame"][number]
            api.CreateMassAttr(mass)
            api.CreateDiagonalInertiaAttr(Gf.Vec3f(*scene["body_inertia"][number].tolist()))
            api.CreateCenterOfMassAttr(Gf.Vec3f(*frame[:3].tolist()))
            api.CreatePrincipalAxesAttr(Gf.Quatf(*frame[3:].tolist()))

    def _add_geom(self, number: int, shown_better: bool) -> None:
        scene = self._scene
        body = int(scene["geom_body"][number])
        name = Sdf.Path(self._paths[body]).AppendChild(f"geom_{number}")
        size, kind = scene["geom_size"][number], str(scene["geom_type"][number])
        made = self._shape(str(name), kind, size, int(scene["geom_mesh"][number]))
        if made is None:
            return
        prim, extra = made
        frame = scene["geom_frame"][number]
        prim.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*frame[:3].tolist()))
        prim.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*frame[3:].tolist()))
        if extra is not None:
            prim.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*extra.tolist()))
        colour = scene["geom_rgba"][number]
        prim.CreateDisplayColorAttr(vectors(linear_rgb(colour[None, :3])))
        if colour[3] < 1.0:
            prim.CreateDisplayOpacityAttr(Vt.FloatArray([float(colour[3])]))
        if shown_better or colour[3] == 0.0:
            prim.CreatePurposeAttr(UsdGeom.Tokens.guide)
        about(prim.GetPrim(), mujoco_name=str(scene["geom_name"][number]))
        if bool(scene["geom_collides"][number]):
            UsdPhysics.CollisionAPI.Apply(prim.GetPrim())
            if kind in ("mesh", "ellipsoid"):
                # In MuJoCo, meshes collide by their convex hulls
                UsdPhysics.MeshCollisionAPI.Apply(prim.GetPrim()).CreateApproximationAttr("convexHull")
            friction = float(scene["geom_friction"][number])
            binding = UsdShade.MaterialBindingAPI.Apply(prim.GetPrim())
            binding.Bind(self._material(friction), UsdShade.Tokens.weakerThanDescendants, "physics")

    def _shape(self, path: str, kind: str, size: Float, mesh: int) -> tuple[UsdGeom.Gprim, Float | None] | None:
        """Return the prim of a geom, and its scale along its axes."""
        stage = self._stage
        made: Any
        if kind == "sphere":
            made = UsdGeom.Sphere.Define(stage, path)
            made.CreateRadiusAttr(float(size[0]))
        elif kind in ("capsule", "cylinder"):
            made = (UsdGeom.Capsule if kind == "capsule" else UsdGeom.Cylinder).Define(stage, path)
            made.CreateAxisAttr(UsdGeom.Tokens.z)
            made.CreateRadiusAttr(float(size[0]))
            made.CreateHeightAttr(2.0 * float(size[1]))
        elif kind == "box":
            made = UsdGeom.Cube.Define(stage, path)
            made.CreateSizeAttr(2.0)
            made.CreateExtentAttr(vectors([[-1, -1, -1], [1, 1, 1]]))
            return made, size
        elif kind == "plane":
            made = UsdGeom.Plane.Define(stage, path)
            made.CreateAxisAttr(UsdGeom.Tokens.z)
            # In MuJoCo 0 means infinite; planes in USD are finite
            made.CreateWidthAttr(2.0 * float(size[0]) or 10.0)
            made.CreateLengthAttr(2.0 * float(size[1]) or 10.0)
        elif kind == "ellipsoid":
            ball = icosphere(subdivisions=2)
            return add_mesh(stage, path, np.asarray(ball.vertices) * size, ball.faces, None), None
        elif kind == "mesh" and mesh >= 0:
            own = self._scene["mesh_vertex_owner"] == mesh
            corners = self._scene["mesh_face"][self._scene["mesh_face_owner"] == mesh]
            return add_mesh(stage, path, self._scene["mesh_vertex"][own], corners, None), None
        else:
            return None
        boundable = UsdGeom.Boundable(made)
        made.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(boundable, Usd.TimeCode.Default()))
        return made, None

    def _material(self, friction: float) -> UsdShade.Material:
        if friction not in self._materials:
            made = UsdShade.Material.Define(self._stage, f"{ROOT}/Materials/Friction_{len(self._materials)}")
            api = UsdPhysics.MaterialAPI.Apply(made.GetPrim())
            api.CreateStaticFrictionAttr(friction)
            api.CreateDynamicFrictionAttr(friction)
            self._materials[friction] = made
        return self._materials[friction]

    # -- joints ----------------------------------------------------------------------------------------------------

    def _add_joints(self) -> list[str]:
        """Add joints of all bodies; return those that UsdPhysics cannot represent."""
        scene, omitted = self._scene, []
        owners = scene["joint_body"] if "joint_body" in scene else np.zeros(0, np.int32)
        for body in range(1, len(scene["body_name"])):
            if bool(scene["body_held"][body]) or bool(scene["body_placed"][body]):
                continue
            own = np.flatnonzero(owners == body).tolist()
            kinds = [str(scene["joint_type"][k]) for k in own]
            if kinds == ["free"]:
                continue
            if not own:
                self._attach(UsdPhysics.FixedJoint, body, np.zeros(3), Rotation.identity(), [])
            elif len(own) == 1 and kinds[0] == "ball":
                anchor = scene["joint_position"][own[0]]
                self._attach(UsdPhysics.SphericalJoint, body, anchor, Rotation.identity(), own)
            elif len(own) == 1:
                self._add_single(body, own[0], kinds[0])
            elif not self._add_several(body, own, kinds):
                omitted.append(", ".join(str(scene["joint_name"][k]) for k in own))
        return omitted

    def _add_single(self, body: int, joint: int, kind: str) -> None:
        scene = self._scene
        turn = _onto_x(scene["joint_axis"][joint])
        schema = UsdPhysics.RevoluteJoint if kind == "hinge" else UsdPhysics.PrismaticJoint
        made = self._attach(schema, body, scene["joint_position"][joint], turn, [joint])
        made.CreateAxisAttr(UsdGeom.Tokens.x)
        ends = self._ends(joint)
        if ends is not None:
            made.CreateLowerLimitAttr(ends[0])
            made.CreateUpperLimitAttr(ends[1])

    def _add_several(self, body: int, joints: list[int], kinds: list[str]) -> bool:
        """Add one joint with six degrees of freedom for slides and hinges with perpendicular axes.

        Return whether it succeeded.
        """
        scene = self._scene
        axes = scene["joint_axis"][joints]
        anchors = scene["joint_position"][joints]
        hinges = [k for k, kind in enumerate(kinds) if kind == "hinge"]
        if set(kinds) - {"hinge", "slide"} or (hinges and np.ptp(anchors[hinges], axis=0).max() > 1e-9):
            return False
        frame: list[Float] = []
        places = []
        for axis in axes:
            along = [abs(float(axis @ other)) for other in frame]
            same = next((k for k, cosine in enumerate(along) if cosine > 1.0 - SQUARE), None)
            if same is None and any(cosine > SQUARE for cosine in along):
                return False
            if same is None:
                frame.append(axis)
            elif float(axis @ frame[same]) < 0.0:
                return False
            places.append(len(frame) - 1 if same is None else same)
        degrees = [
            (D6_TURNS if kind == "hinge" else D6_MOVES)[place] for kind, place in zip(kinds, places, strict=True)
        ]
        if len(set(degrees)) < len(degrees):
            return False
        x = frame[0]
        y = frame[1] - (frame[1] @ x) * x if len(frame) > 1 else np.cross(_across(x), x)
        y /= np.linalg.norm(y)
        z = np.cross(x, y)
        if len(frame) == 3 and float(frame[2] @ z) < 0.0:
            return False
        turn = Rotation.from_matrix(np.column_stack([x, y, z]))
        anchor = anchors[hinges[0]] if hinges else np.zeros(3)
        made = self._attach(UsdPhysics.Joint, body, anchor, turn, joints)
        free = dict(zip(degrees, joints, strict=True))
        for degree in (*D6_MOVES, *D6_TURNS):
            ends = self._ends(free[degree]) if degree in free else (1.0, -1.0)  # low above high: locked
            if ends is not None:
                limit = UsdPhysics.LimitAPI.Apply(made.GetPrim(), degree)
                limit.CreateLowAttr(ends[0])
                limit.CreateHighAttr(ends[1])
        return True

    def _ends(self, joint: int) -> tuple[float, float] | None:
        """Return the limits of a joint relative to its reference, in degrees for hinges.

        Returns None for a joint without limits.
        """
        scene = self._scene
        if not bool(scene["joint_limited"][joint]):
            return None
        ends = scene["joint_range"][joint] - scene["joint_reference"][joint]
        if str(scene["joint_type"][joint]) == "hinge":
            ends = DEGREES * ends
        return float(ends[0]), float(ends[1])

    def _attach(self, schema: Any, body: int, anchor: Float, turn: Rotation, joints: list[int]) -> Any:
        """Add a joint between a body and its parent. anchor, turn: position and rotation of its frame in the body"""
        scene = self._scene
        names = [str(scene["joint_name"][k]) for k in joints]
        prim_name = Sdf.Path(self._paths[body]).name
        made = schema.Define(self._stage, f"{ROOT}/Joints/{prim_name}")
        frame = scene["body_frame"][body]
        to_parent = _rotation(frame[3:])
        parent = int(scene["body_parent"][body])
        if parent > 0:
            made.CreateBody0Rel().SetTargets([self._paths[parent]])
        made.CreateBody1Rel().SetTargets([self._paths[body]])
        made.CreateLocalPos0Attr(Gf.Vec3f(*(frame[:3] + to_parent.apply(anchor)).tolist()))
        made.CreateLocalRot0Attr(_quaternion(to_parent * turn))
        made.CreateLocalPos1Attr(Gf.Vec3f(*np.asarray(anchor).tolist()))
        made.CreateLocalRot1Attr(_quaternion(turn))
        if names:
            about(made.GetPrim(), mujoco_names=names)
        return made

    def _add_variants(self, root: Usd.Prim) -> None:
        variants = root.GetVariantSets().AddVariantSet(MOTION)
        bodies = [
            path for path in self._paths.values() if self._stage.GetPrimAtPath(path).HasAPI(UsdPhysics.RigidBodyAPI)
        ]
        placed = self._scene["body_placed"]
        for name in (SIMULATED, RECORDED):
            variants.AddVariant(name)
            variants.SetVariantSelection(name)
            with variants.GetVariantEditContext():
                for number, path in self._paths.items():
                    if path in bodies:
                        api = UsdPhysics.RigidBodyAPI(self._stage.GetPrimAtPath(path))
                        api.CreateKinematicEnabledAttr(name == RECORDED or bool(placed[number]))


def _across(axis: Float) -> Float:
    """Return an arbitrary unit vector that is perpendicular to an axis."""
    other = np.eye(3)[int(np.abs(axis).argmin())]
    found = np.cross(axis, other)
    return found / np.linalg.norm(found)


def _onto_x(axis: Float) -> Rotation:
    """Return the rotation that maps x to an axis."""
    x = axis / np.linalg.norm(axis)
    y = _across(x)
    return Rotation.from_matrix(np.column_stack([x, y, np.cross(x, y)]))


def _rotation(quaternion: Float) -> Rotation:
    return Rotation.from_quat(np.roll(quaternion, -1))


def _quaternion(turn: Rotation) -> Gf.Quatf:
    return Gf.Quatf(*np.roll(turn.as_quat(), 1).tolist())
