"""The calibration study: a test whether the intervals of a fit contain the truth as often as stated."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
