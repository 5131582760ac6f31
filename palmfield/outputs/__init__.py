"""Results of a run: result.nc (schema 2), summary.json, pictures and a USD scene.

from palmfield.outputs import instances, normal_component, open_result
with open_result("out/palm") as result:
    for name, skin in instances(result, "skin").items():
        print(name, float(abs(normal_component(skin)).max()), "m")
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
