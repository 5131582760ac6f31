"""Plan a scene before the run: modelled and ignored effects, expected error and time.

Public: `palmfield.plan`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
