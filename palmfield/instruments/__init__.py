"""Virtual instruments: what a laboratory's device would read of a result, a Motion or a field.

from palmfield.instruments import Vibrometer, of_motion, vibrometer_record
head = Vibrometer(incidence_deg=45, distance_m=0.5, highpass_Hz=50, highpass_order=2)
record = vibrometer_record(of_motion(motion, body), head)  # an xarray.DataArray over time and point
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.instruments.displacement_meter import DisplacementMeter, displacement_reading
    from palmfield.instruments.force import Plate, PlateForce, Scale, mesh_force, plate_force, scale_reading
    from palmfield.instruments.guided_mode import GuidedMode, Wave, guided_mode_fit, line_amplitudes
    from palmfield.instruments.mechanical_analyser import (
        Analyser,
        analyser_reading,
        apparent_modulus,
        shear_from_reading,
    )
    from palmfield.instruments.microphone import Microphone, microphone_scan, through_band
    from palmfield.instruments.scan import Scan, of_record
    from palmfield.instruments.scan_grids import disc_grid, line_grid, rectangle_grid
    from palmfield.instruments.settings import read_settings
    from palmfield.instruments.signal_chain import highpass, integrated, lowpass, sampled
    from palmfield.instruments.surface_motion import SurfaceMotion, of_motion, of_skin
    from palmfield.instruments.vibrometer import Vibrometer, lines_of_sight, vibrometer_record

_WHERE = {
    **dict.fromkeys(
        (
            "DisplacementMeter",
            "displacement_reading",
        ),
        "displacement_meter",
    ),
    **dict.fromkeys(
        (
            "Plate",
            "PlateForce",
            "Scale",
            "mesh_force",
            "plate_force",
            "scale_reading",
        ),
        "force",
    ),
    **dict.fromkeys(
        (
            "GuidedMode",
            "Wave",
            "guided_mode_fit",
            "line_amplitudes",
        ),
        "guided_mode",
    ),
    **dict.fromkeys(
        (
            "Analyser",
            "analyser_reading",
            "apparent_modulus",
            "shear_from_reading",
        ),
        "mechanical_analyser",
    ),
    **dict.fromkeys(
        (
            "Microphone",
            "microphone_scan",
            "through_band",
        ),
        "microphone",
    ),
    **dict.fromkeys(
        (
            "Scan",
            "of_record",
        ),
        "scan",
    ),
    **dict.fromkeys(
        (
            "disc_grid",
            "line_grid",
            "rectangle_grid",
        ),
        "scan_grids",
    ),
    **dict.fromkeys(("read_settings",), "settings"),
    **dict.fromkeys(
        (
            "highpass",
            "integrated",
            "lowpass",
            "sampled",
        ),
        "signal_chain",
    ),
    **dict.fromkeys(
        (
            "SurfaceMotion",
            "of_motion",
            "of_skin",
        ),
        "surface_motion",
    ),
    **dict.fromkeys(
        (
            "Vibrometer",
            "lines_of_sight",
            "vibrometer_record",
        ),
        "vibrometer",
    ),
}
__all__ = [
    "Analyser",
    "DisplacementMeter",
    "GuidedMode",
    "Microphone",
    "Plate",
    "PlateForce",
    "Scale",
    "Scan",
    "SurfaceMotion",
    "Vibrometer",
    "Wave",
    "analyser_reading",
    "apparent_modulus",
    "disc_grid",
    "displacement_reading",
    "guided_mode_fit",
    "highpass",
    "integrated",
    "line_amplitudes",
    "line_grid",
    "lines_of_sight",
    "lowpass",
    "mesh_force",
    "microphone_scan",
    "of_motion",
    "of_record",
    "of_skin",
    "plate_force",
    "read_settings",
    "rectangle_grid",
    "sampled",
    "scale_reading",
    "shear_from_reading",
    "through_band",
    "vibrometer_record",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
