"""A focus that runs round a circle on silicone, 70 times a second: how the surface moves."""

import numpy as np

from palmfield.skin import Sheet, Slab, Spot, preset, solve

body = Slab((Sheet(preset("ecoflex_00-10"), 0.02),), shape="disc", side="fixed", radius_m=0.06)
times = np.linspace(0.0, 0.1, 1001)
turn = 2.0 * np.pi * 70.0 * times
load = Spot(
    fwhm_m=0.0103,
    times_s=times,
    peak_Pa=np.full_like(times, 12.0),
    centre_m=0.01 * np.column_stack([np.cos(turn), np.sin(turn)]),
)
motion = solve(body, load, times[1:], at=[[0.0, 0.0], [0.01, 0.0]], accuracy=0.05)
up_um = 1e6 * motion.displacement_m[:, :, 2]
print(f"solver {motion.solver}, error {100 * motion.error:.1f} %")
for where, course in zip(("middle", "on the circle"), up_um.T, strict=True):
    print(f"{where}: {course.min():.2f} to {course.max():.2f} um")
