"""Run a scene while the user sees it in the browser and changes its keys."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
