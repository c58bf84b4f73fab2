"""The calibration study: whether the intervals of a fit hold the truth as often as they should."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
