"""A scene from MJCF: plan it, run it, read its result as labelled arrays."""

import sys

import palmfield
from palmfield.outputs.motion import normal_component

scene = palmfield.load("mjcf/scenes/phantom_step.xml", accuracy=0.2)
print(palmfield.plan(scene))
result = palmfield.run(scene, sys.argv[1] if len(sys.argv) > 1 else None, duration_s=0.01)
motion = normal_component(result.dataset["skin/skin"].to_dataset(inherit=True))
print(f"{motion.sizes['time']} times, {motion.sizes['vertex']} vertices; deepest {1e6 * float(motion.min()):.2f} um")
