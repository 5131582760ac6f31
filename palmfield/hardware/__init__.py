"""A scene or a focus on a real board: what is sent, whether that is safe, and what bytes make a board do."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
