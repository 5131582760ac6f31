"""Virtual instruments: simulated readings of a result, a Motion or a field.

from palmfield.instruments import Vibrometer, of_motion, vibrometer_record
head = Vibrometer(incidence_deg=45, distance_m=0.5, highpass_Hz=50, highpass_order=2)
record = vibrometer_record(of_motion(motion, body), head)  # an xarray.DataArray over time and point
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
