"""Geoms of MuJoCo as triangle meshes."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from palmfield.types import Float, Int

if TYPE_CHECKING:
    import trimesh


class Obstacle(NamedTuple):
    """Geoms of a body that cast shadows, in the frame of that body.

    geoms: kind, size [m] as in MJCF, position [m] and quaternion (w, x, y, z) of each geom. Kind "mesh" has vertices
        [m] and faces instead of the size.
    """

    geoms: tuple[tuple[str, tuple[Any, ...], tuple[float, ...], tuple[float, ...]], ...]

    def mesh(self) -> tuple[Float, Int]:
        """Return vertices [m], shape (n, 3), and faces, shape (m, 3), of all geoms together."""
        # Imported here, because every process that loads the plugins imports this module and few need trimesh
        from trimesh.transformations import quaternion_matrix
        from trimesh.util import append_faces

        parts = []
        for kind, size, position, quaternion in self.geoms:
            part = _geom_mesh(kind, size)
            part.apply_transform(quaternion_matrix(quaternion))
            part.apply_translation(position)
            parts.append(part)
        vertices, faces = append_faces([part.vertices for part in parts], [part.faces for part in parts])
        # Plain arrays, because each view of trimesh's array class runs Python code in every step
        return np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32)


def _geom_mesh(kind: str, size: tuple[Any, ...]) -> "trimesh.Trimesh":
    import trimesh

    if kind == "mesh":
        return trimesh.Trimesh(np.reshape(size[0], (-1, 3)), np.reshape(size[1], (-1, 3)), process=False)
    if kind == "box":
        return trimesh.creation.box(2.0 * np.array(size))
    if kind == "capsule":
        return trimesh.creation.capsule(height=2.0 * size[1], radius=size[0], count=(16, 16))
    if kind == "cylinder":
        return trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=32)
    ball = trimesh.creation.icosphere(subdivisions=3)
    return ball.apply_scale(np.array(size) if kind == "ellipsoid" else size[0])
