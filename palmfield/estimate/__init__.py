"""How far a run's numbers can be trusted: numerical errors, what was left out, what inputs leave open, what is felt.

`palmfield.run` is public there, a run with all that.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
