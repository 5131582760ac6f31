"""A step on silicone, as a vibrometer at 45 degrees with a high-pass of 50 Hz would tell it."""

import numpy as np

from palmfield.instruments import Vibrometer, vibrometer_record
from palmfield.instruments.surface_motion import of_motion
from palmfield.skin import Sheet, Slab, Spot, preset, solve

body = Slab((Sheet(preset("ecoflex_00-10"), 0.02),))
times = np.linspace(0.0, 0.1, 401)
load = Spot(fwhm_m=0.0103, times_s=times, peak_Pa=np.full_like(times, 12.0))
motion = solve(body, load, times[1:], at=[[0.0, 0.0]], accuracy=0.05)
surface = of_motion(motion, body)
for name, settings in (
    ("along the normal, no filter", Vibrometer(sampling_rate_Hz=8000)),
    ("at 45 degrees, high-pass", Vibrometer(incidence_deg=45, highpass_Hz=50, sampling_rate_Hz=8000)),
):
    record = vibrometer_record(surface, settings)
    print(f"{name}: {1e6 * float(record.min()):.2f} to {1e6 * float(record.max()):.2f} um")
