"""What a scene needs to be modelled, what is left out, what that costs in error and time: before anything runs.

`palmfield.plan` is public there.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
