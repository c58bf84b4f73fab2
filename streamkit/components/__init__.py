"""What can be plugged in: the abstract bases, the hook, the registry of what is installed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
