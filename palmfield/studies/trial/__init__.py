"""Hardware in the loop: estimated position of a hand, output of a board for it, and sound at the true position."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
