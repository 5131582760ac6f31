"""Add shapes to a picture: fill MuJoCo's list of shapes (mjvScene) as arrays, never beyond its end."""

import ctypes
from functools import cached_property
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from palmfield.mujoco_host.mujoco_view import ModelView
from palmfield.mujoco_host.structs import mirror
from palmfield.types import Float, Int

GLOW = 0.6
"""Share of the colour of a shape that is shown without light.

Colours represent numbers, so they must show in shadow.
"""
LABEL = 100
SPARE = 200
"""Number of shapes, in addition to the geoms, that MuJoCo itself needs: joints, contacts, lights, selection."""


class Drawing:
    """A scene that MuJoCo is about to draw.

    If a shape does not fit in the list, this shape and all later ones are omitted.

    MuJoCo calls plugins before it adds the shapes of the model; room for these is reserved. Positions are in the world
    [m]. Colours are red, green, blue and opacity, from 0 to 1.
    """

    def __init__(self, model: ModelView, scene: int, options: int):
        self._scene = mirror("mjvScene").from_address(scene)
        raw = model.raw
        self._reserve = raw.ngeom + raw.nsite + raw.nskin + raw.nflex + SPARE
        self._options = mirror("mjvOption").from_address(options)

    def shows(self, kind: Literal["geom", "site"], group: int) -> bool:
        """Return whether the viewer shows a group of geoms or sites."""
        return bool(getattr(self._options, f"{kind}group")[group])

    @property
    def room(self) -> int:
        """Number of shapes that can still be added."""
        return max(0, int(self._scene.maxgeom - self._scene.ngeom - self._reserve))

    def spheres(self, centres: Float, radius: Float | float, colours: Float) -> None:
        """Add spheres. centres: shape (n, 3); radius: [m], one or (n,); colours: shape (n, 4) or (4,)"""
        shapes = self._new(mujoco.mjtGeom.mjGEOM_SPHERE, len(centres), colours)
        count = len(shapes)
        shapes["pos"], shapes["mat"] = centres[:count], np.eye(3).ravel()
        shapes["size"] = np.broadcast_to(radius, len(centres))[:count, None]

    def discs(self, centres: Float, axes: Float, radius: Float | float, thickness: float, colours: Float) -> None:
        """Add flat cylinders. centres, axes: shape (n, 3); radius, thickness [m]; colours: shape (n, 4)"""
        shapes = self._new(mujoco.mjtGeom.mjGEOM_CYLINDER, len(centres), colours)
        count = len(shapes)
        across = np.where(np.abs(axes[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        first = np.cross(across, axes)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        turns = np.stack([first, np.cross(axes, first), axes], axis=2)
        shapes["pos"], shapes["mat"] = centres[:count], turns[:count].reshape(-1, 9)
        shapes["size"][:, :2] = np.broadcast_to(radius, len(centres))[:count, None]
        shapes["size"][:, 2] = 0.5 * thickness

    def triangles(self, vertices: Float, faces: Int, colours: Float) -> None:
        """Add triangles. vertices: shape (v, 3); faces: shape (n, 3); colours: shape (n, 4)"""
        shapes = self._new(mujoco.mjtGeom.mjGEOM_TRIANGLE, len(faces), colours)
        corners = vertices[faces[: len(shapes)]]
        # The corners of a MuJoCo triangle are 0, x and y of its frame, whose axes may be oblique
        sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=1)
        normals = np.cross(sides[:, 0], sides[:, 1])
        frame = np.concatenate([sides, normals[:, None]], axis=1)
        lengths = np.maximum(np.linalg.norm(frame, axis=2), 1e-12)
        shapes["pos"], shapes["size"] = corners[:, 0], lengths
        shapes["mat"] = (frame / lengths[..., None]).transpose(0, 2, 1).reshape(-1, 9)

    def label(self, place: Float, text: str) -> None:
        """Add a text at a place, shape (3,)."""
        shapes = self._new(mujoco.mjtGeom.mjGEOM_LABEL, 1, np.ones(4))
        shapes["pos"], shapes["mat"], shapes["label"] = place, np.eye(3).ravel(), text.encode()[: LABEL - 1]

    def _new(self, kind: mujoco.mjtGeom, count: int, colours: Float) -> NDArray[Any]:
        """Reserve as many shapes as there is room for, and set their common values."""
        count = min(count, self.room)
        first = self._scene.ngeom
        shapes = self._shapes[first : first + count]
        self._scene.ngeom = first + count
        shapes[:] = np.zeros((), shapes.dtype)
        shapes["type"], shapes["category"] = int(kind), int(mujoco.mjtCatBit.mjCAT_DECOR)
        shapes["dataid"] = shapes["objid"] = shapes["matid"] = shapes["texid"] = shapes["segid"] = -1
        shapes["objtype"] = int(mujoco.mjtObj.mjOBJ_UNKNOWN)
        shapes["rgba"] = colours if colours.ndim == 1 else colours[:count]
        shapes["emission"], shapes["texrepeat"] = GLOW, 1.0
        return shapes

    @cached_property
    def _shapes(self) -> NDArray[Any]:
        """All shapes of the scene, used or not."""
        kind: Any = mirror("mjvGeom")
        whole = (kind * int(self._scene.maxgeom)).from_address(self._scene.geoms)
        size = ctypes.sizeof(kind)
        return np.frombuffer(whole, _dtype(kind, size))


def _dtype(kind: Any, size: int) -> np.dtype[Any]:
    """Return the NumPy type of a field of mjvGeom; a label is bytes."""
    names, formats, offsets = [], [], []
    for name, field in kind._fields_:
        text = name == "label"
        names.append(name)
        formats.append(f"S{LABEL}" if text else np.dtype(field))
        offsets.append(getattr(kind, name).offset)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
