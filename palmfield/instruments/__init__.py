"""Virtual instruments: what a laboratory's device would read of a result, a Motion or a field.

from palmfield.instruments import Vibrometer, of_motion, vibrometer_record
head = Vibrometer(incidence_deg=45, distance_m=0.5, highpass_Hz=50, highpass_order=2)
record = vibrometer_record(of_motion(motion, body), head)  # an xarray.DataArray over time and point
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.instruments.force import Plate, PlateForce, Scale, mesh_force, plate_force, scale_reading
    from palmfield.instruments.microphone import Microphone, microphone_scan, through_band
    from palmfield.instruments.scan_grids import disc_grid, line_grid, rectangle_grid
    from palmfield.instruments.settings import read_settings
    from palmfield.instruments.signal_chain import highpass, integrated, lowpass, sampled
    from palmfield.instruments.surface_motion import SurfaceMotion, of_motion, of_skin
    from palmfield.instruments.vibrometer import Vibrometer, lines_of_sight, vibrometer_record

_WHERE = {
    **dict.fromkeys(("Plate", "PlateForce", "Scale", "mesh_force", "plate_force", "scale_reading"), "force"),
    **dict.fromkeys(("Microphone", "microphone_scan", "through_band"), "microphone"),
    **dict.fromkeys(("disc_grid", "line_grid", "rectangle_grid"), "scan_grids"),
    "read_settings": "settings",
    **dict.fromkeys(("highpass", "integrated", "lowpass", "sampled"), "signal_chain"),
    **dict.fromkeys(("SurfaceMotion", "of_motion", "of_skin"), "surface_motion"),
    **dict.fromkeys(("Vibrometer", "lines_of_sight", "vibrometer_record"), "vibrometer"),
}
__all__ = [
    "Microphone",
    "Plate",
    "PlateForce",
    "Scale",
    "SurfaceMotion",
    "Vibrometer",
    "disc_grid",
    "highpass",
    "integrated",
    "line_grid",
    "lines_of_sight",
    "lowpass",
    "mesh_force",
    "microphone_scan",
    "of_motion",
    "of_skin",
    "plate_force",
    "read_settings",
    "rectangle_grid",
    "sampled",
    "scale_reading",
    "through_band",
    "vibrometer_record",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
