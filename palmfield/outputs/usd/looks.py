"""Set the appearance of a USD scene: colours of quantities, a material that reads them, lights and a camera."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from palmfield.outputs.camera import Camera
from palmfield.outputs.style import linear_rgb, signed_colours
from palmfield.outputs.usd.prims import about, vectors
from palmfield.types import Float, Int

PICTURE = (960, 720)
"""Width and height of the picture of the camera [pixels]."""
LEGEND_SHARE = 0.80
"""Fraction of the picture width that the scene uses. The legend uses the rest."""
APERTURE = 36.0
COLOURS = 256


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


class Palette(NamedTuple):
    """Colour palette of a quantity.

    low, high: mapped range, in the unit of the primvar
    colours: sRGB, shape (256, 3)
    map: name of the colour map
    """

    low: float
    high: float
    colours: Float
    map: str

    @property
    def at_rest(self) -> tuple[float, ...]:
        """Return the colour of zero in linear RGB.

        If the range excludes zero, return the colour of the end closest to zero.
        """
        return tuple(linear_rgb(self.colours[int(self.numbers(np.zeros(1))[0])]).tolist())

    def numbers(self, values: NDArray[np.floating]) -> Int:
        """Return the index of the colour of each value, clipped to the range."""
        share = (np.asarray(values, np.float64) - self.low) / (self.high - self.low)
        return np.rint(np.clip(share, 0.0, 1.0) * (COLOURS - 1)).astype(np.int32)


def palette_of(low: float, high: float, two_sided: bool, limits: tuple[float, float] | None) -> Palette:
    """Return the palette of a quantity with values from low to high.

    two_sided: whether values have both signs. If so, blue is below zero and red above, symmetric unless limits are set.
    If not, colours go from pale (zero) to dark.
    """
    if limits is None:
        top = max(abs(low), abs(high)) or 1.0
        limits = (-top, top) if two_sided else (min(low, 0.0), max(high, 0.0) if high > min(low, 0.0) else 1.0)
    if two_sided:
        return Palette(*limits, signed_colours(*limits, cut_off=0.03)[:, :3], "RdBu_r")
    return Palette(*limits, np.asarray(colormaps["magma_r"](np.linspace(0.04, 0.90, COLOURS)))[:, :3], "magma_r")


def cyclic_palette(period: float) -> Palette:
    """Return the palette of phases from 0 to a period."""
    return Palette(0.0, period, np.asarray(colormaps["twilight"](np.linspace(0.0, 1.0, COLOURS)))[:, :3], "twilight")


def paint(prim: UsdGeom.Gprim, palette: Palette, interpolation: str, **facts: Any) -> UsdGeom.Primvar:
    """Add a palette with its description to a prim. The indices of the primvar select the colours."""
    colour = prim.CreateDisplayColorPrimvar(interpolation)
    colour.Set(vectors(linear_rgb(palette.colours)))
    about(colour.GetAttr(), low=palette.low, high=palette.high, map=palette.map, **facts)
    return colour


def indices_of(colour: UsdGeom.Primvar) -> Any:
    """Return the attribute with the indices of a painted primvar."""
    return colour.CreateIndicesAttr()
