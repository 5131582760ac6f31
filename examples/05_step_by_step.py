"""MuJoCo's own stepping, with a key changed by Python and the skin read after each step."""

import palmfield

sim = palmfield.Simulation("mjcf/scenes/phantom_am200.xml", keys={"stimulus.am_frequency_Hz": 100}, accuracy=0.2)
deepest = 0.0
for _ in range(10):
    sim.step()
    deepest = min(deepest, float(sim.skin().normal_displacement.min()))
print(f"after {1e3 * sim.time:.1f} ms the skin is pushed in by {-1e6 * deepest:.2f} um")
print(f"force along z: {1e3 * sim.forces[0][2]:.2f} mN")
