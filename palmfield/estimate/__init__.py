"""Estimate the accuracy of a run: numerical errors, omitted effects, uncertain inputs; and the sensation level.

Public: `palmfield.run`, a run with these estimates.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
