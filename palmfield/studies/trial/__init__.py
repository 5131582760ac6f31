"""Hardware in the loop: where a hand is believed to be, what a board makes of it, and what the hand really gets."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
