"""Accuracy of the numbers of a run: numerical errors, omitted effects, uncertain inputs, and the felt level.

`palmfield.run` is public there, a run with all that.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
