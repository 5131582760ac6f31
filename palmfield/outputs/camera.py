"""Choose the camera for the picture of a scene."""

from typing import NamedTuple

import numpy as np

from palmfield.outputs.frames import axes
from palmfield.types import Float

FIELD_OF_VIEW_DEG = 24.0
SLANT_DEG = 35.0
AZIMUTH_DEG = 205.0
MARGIN = 0.05


class Camera(NamedTuple):
    """A pinhole camera: position of the eye [m], unit axes in the world, and projection to the picture.

    focal: distance of the picture plane [pixels]; centre: principal point, (column, row)
    """

    eye: Float
    forward: Float
    right: Float
    up: Float
    focal: float
    centre: Float

    def project(self, points: Float) -> Float:
        """Return column and row [pixels] of world points [m], shape (n, 3) -> (n, 2)."""
        local = points - self.eye
        plane = np.column_stack([local @ self.right, -(local @ self.up)])
        return self.centre + self.focal * plane / (local @ self.forward)[:, None]


def look_along_emission(
    points: Float, array_pose: Float, window: tuple[float, float, float, float], azimuth_deg: float = AZIMUTH_DEG
) -> Camera:
    """Return a camera that looks at the insonified sides, with all points in a window of the picture.

    points: [m] in the world, shape (n, 3); array_pose: shape (7,); window: left, top, width, height [pixels]
    azimuth_deg: azimuth of the view, about the z axis of the array
    The camera looks obliquely along +z of the array, so that array and target appear next to each other. The world z
    axis points up in the picture.
    """
    x, y, z = axes(array_pose)
    azimuth, slant = np.radians(azimuth_deg), np.radians(SLANT_DEG)
    forward = np.cos(slant) * (np.cos(azimuth) * x + np.sin(azimuth) * y) + np.sin(slant) * z
    # If the camera looks straight up or down, the y axis of the board replaces the z axis of the world as the upward
    # direction
    vertical = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.95 else y
    right = np.cross(forward, vertical)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    left, top, width, height = window
    focal = 0.5 * height / np.tan(np.radians(FIELD_OF_VIEW_DEG) / 2)
    limits = (0.5 - MARGIN) * np.array([width, height]) / focal
    middle, distance = points.mean(axis=0), 1.0
    # Each iteration moves back until the widest point touches the margin, then centres the visible points
    for _ in range(20):
        local = points - middle
        across, depth = np.column_stack([local @ right, local @ up]), local @ forward
        distance = float((np.abs(across) / limits - depth[:, None]).max())
        projected = across / (distance + depth)[:, None]
        offset = 0.5 * (projected.min(axis=0) + projected.max(axis=0)) * distance
        middle = middle + offset[0] * right + offset[1] * up
    centre = np.array([left + 0.5 * width, top + 0.5 * height])
    return Camera(middle - distance * forward, forward, right, up, focal, centre)
