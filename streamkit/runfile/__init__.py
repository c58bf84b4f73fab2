"""The run file: read, validated with the installed components, bound to parameter values."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
