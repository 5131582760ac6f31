"""Play a scene or a focus on a real board: frames, safety, and decoding of bytes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
