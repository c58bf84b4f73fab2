"""Components: the abstract bases, the hook of plugins, and the registry of installed components."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
