"""The command line, one file a command. Its door serves packages that bring a command of their own."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
