"""Convert the points of a stimulus to positions in the frame of the first array, for a fixed pose."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from palmfield.transforms import Transform
from palmfield.types import Float, Int

if TYPE_CHECKING:  # not imported at run time, because most stimuli have no path on a surface and no file
    from palmfield.stimulus.focus_table import FocusTable
    from palmfield.stimulus.surface_path import SurfacePath

NO_OFFSETS: Float = np.zeros((0, 3))


class SurfaceCourse(NamedTuple):
    """A path along a surface in its present pose.

    vertices: vertices of the surface [m], shape (v, 3), in the frame of the body; faces: shape (f, 3)
    body: body frame relative to the first array
    """

    path: "SurfacePath"
    vertices: Float
    faces: Int
    body: Transform

    def positions(self, arcs: Float) -> Float:
        """Return positions [m], array frame, shape (k, 3), at arc lengths from the start of the path [m], (k,)."""
        return self.body.points(self.path.positions(arcs, self.vertices, self.faces))


class FocalPoints(NamedTuple):
    """Positions of the points of a stimulus while body, arrays and frame of the stimulus do not move.

    frame: frame of the stimulus relative to the first array
    offsets: offsets of simultaneous foci from the point of the stimulus [m], shape (m, 3); (0, 3) for a single focus.
        They are zero for a table, which contains the positions
    on_surface: surface of the path; None for points in `frame`
    arp: ARP of simultaneous foci relative to the loudest, shape (m,); () if they are equal
    table: foci over time; its points are the time since the start of the table [s], then 0, 0
    """

    frame: Transform
    offsets: Float = NO_OFFSETS
    on_surface: SurfaceCourse | None = None
    table: "FocusTable | None" = None
    arp: tuple[float, ...] = ()

    def at(self, point: Float) -> Float:
        """Return the focus [m], shape (3,), or several foci, shape (m, 3), for a point of the stimulus, shape (3,).

        point: `palmfield.stimulus.schedule.Frame.focus`
        """
        if self.table is not None:
            foci = self.frame.points(self.table.positions_at(point[:1])[0])
            return foci if len(foci) > 1 else foci[0]
        if len(self.offsets):
            return self.frame.points(point + self.offsets)
        return self.along(point[None])[0]

    def along(self, points: Float) -> Float:
        """Return the focus, or the centre of several foci, for many points of the stimulus, shapes (k, 3) [m]."""
        if self.on_surface is not None:
            path, vertices, faces, body = self.on_surface
            return body.points(path.positions(points[:, 0], vertices, faces))
        if self.table is not None:
            return self.frame.points(self.table.positions_at(points[:, 0]).mean(axis=1))
        return self.frame.points(points)

    def loudness(self, point: Float) -> Float | None:
        """Return the pressures of several foci relative to the loudest, shape (m,); None if they are equal."""
        if self.table is None or self.table.foci == 1:
            return np.sqrt(np.array(self.arp) / max(self.arp)) if self.arp else None
        pressures = np.sqrt(self.table.arp_of_each(point[:1])[0])
        most = pressures.max()
        return pressures / most if most > 0.0 else None
