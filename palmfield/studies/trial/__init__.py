"""Hardware in the loop: estimated place of a hand, output of a board for it, and the sound at the true hand."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
