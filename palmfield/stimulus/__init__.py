"""What a focus does over time and on the skin, without scenes: schedules, shapes, paths along the surface, bursts.

from palmfield.stimulus import circle, drawn
path = drawn(hand.surface, hand.landmarks["palm_centre"], [1.0, 0.0, 0.0], circle(0.03))
positions, normals = path.at(speed_m_s * times, hand.surface.vertices, hand.surface.faces)
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.stimulus.bursts import burst, onsets
    from palmfield.stimulus.curves import (
        PlanePath,
        circle,
        line,
        lissajous,
        polyline,
        square,
        z_shape,
        zigzag,
        zigzagged,
    )
    from palmfield.stimulus.focal_points import FocalPoints, SurfaceCourse
    from palmfield.stimulus.schedule import (
        Frame,
        Moments,
        frame_at,
        frames_at,
        main_frequencies,
        plane_path,
        substep_moments,
    )
    from palmfield.stimulus.surface_path import SurfacePath, drawn, through, zigzag_through

_WHERE = {
    **dict.fromkeys(("burst", "onsets"), "bursts"),
    **dict.fromkeys(
        ("PlanePath", "circle", "line", "lissajous", "polyline", "square", "z_shape", "zigzag", "zigzagged"), "curves"
    ),
    **dict.fromkeys(("FocalPoints", "SurfaceCourse"), "focal_points"),
    **dict.fromkeys(
        ("Frame", "Moments", "frame_at", "frames_at", "main_frequencies", "plane_path", "substep_moments"), "schedule"
    ),
    **dict.fromkeys(("SurfacePath", "drawn", "through", "zigzag_through"), "surface_path"),
}
__all__ = [
    "FocalPoints",
    "Frame",
    "Moments",
    "PlanePath",
    "SurfaceCourse",
    "SurfacePath",
    "burst",
    "circle",
    "drawn",
    "frame_at",
    "frames_at",
    "line",
    "lissajous",
    "main_frequencies",
    "onsets",
    "plane_path",
    "polyline",
    "square",
    "substep_moments",
    "through",
    "z_shape",
    "zigzag",
    "zigzag_through",
    "zigzagged",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
