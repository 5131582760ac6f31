"""Set the appearance of a USD scene: a material that reads the colours of prims, lights and a camera."""

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from palmfield.outputs.camera import Camera
from palmfield.types import Float

PICTURE = (960, 720)
"""Width and height of the picture of the camera [pixels]."""
LEGEND_SHARE = 0.80
"""Fraction of the picture width that the scene uses. The legend uses the rest."""
APERTURE = 36.0


def add_material(stage: Usd.Stage) -> None:
    """Add a UsdPreviewSurface for the whole scene. Its colour is the primvar displayColor."""
    material = UsdShade.Material.Define(stage, "/Scene/Looks/DisplayColour")
    surface = UsdShade.Shader.Define(stage, "/Scene/Looks/DisplayColour/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    reader = UsdShade.Shader.Define(stage, "/Scene/Looks/DisplayColour/Colour")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    reader.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(Gf.Vec3f(0.5, 0.5, 0.5))
    colour = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(colour)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.7)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(stage.GetDefaultPrim()).Bind(material)


def add_lights(stage: Usd.Stage, camera: Camera) -> None:
    """Add uniform light from all directions, and a lamp at the camera."""
    UsdGeom.Scope.Define(stage, "/Scene/Lights")
    dome = UsdLux.DomeLight.Define(stage, "/Scene/Lights/Dome")
    dome.CreateIntensityAttr(0.5)
    # Blender ignores a dome light without a colour
    dome.CreateColorAttr(Gf.Vec3f(1.0, 1.0, 1.0))
    key = UsdLux.DistantLight.Define(stage, "/Scene/Lights/Key")
    # Normalised, so that brightness does not depend on the angle of the lamp; without it renderers differ
    key.CreateNormalizeAttr(True)
    key.CreateIntensityAttr(0.35)
    key.CreateColorAttr(Gf.Vec3f(1.0, 1.0, 1.0))
    key.CreateAngleAttr(5.0)
    side = camera.forward - 0.5 * camera.right - 0.4 * camera.up
    key.AddTransformOp().Set(_matrix(side / np.linalg.norm(side), camera.up, np.zeros(3)))


def add_camera(stage: Usd.Stage, camera: Camera, reach_m: float) -> None:
    """Add the camera of the pictures of the run. reach_m: largest distance of visible objects [m]"""
    UsdGeom.Scope.Define(stage, "/Scene/Cameras")
    usd_camera = UsdGeom.Camera.Define(stage, "/Scene/Cameras/Main")
    width, height = PICTURE
    usd_camera.AddTransformOp().Set(_matrix(camera.forward, camera.up, camera.eye))
    usd_camera.CreateHorizontalApertureAttr(APERTURE)
    usd_camera.CreateVerticalApertureAttr(APERTURE * height / width)
    usd_camera.CreateFocalLengthAttr(APERTURE * camera.focal / width)
    usd_camera.CreateHorizontalApertureOffsetAttr(APERTURE * (0.5 * width - float(camera.centre[0])) / width)
    usd_camera.CreateVerticalApertureOffsetAttr(APERTURE * (float(camera.centre[1]) - 0.5 * height) / width)
    usd_camera.CreateClippingRangeAttr(Gf.Vec2f(0.01, 10.0 * reach_m))


def _matrix(forward: Float, up: Float, place: Float) -> Gf.Matrix4d:
    """Return the matrix of an object that looks along its -z axis with y up, as cameras and lights do in USD."""
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rows = np.eye(4)
    rows[0, :3], rows[1, :3], rows[2, :3], rows[3, :3] = right, np.cross(right, forward), -forward, place
    return Gf.Matrix4d(rows.tolist())
