"""What the studies over a grid of values and seeds share: streams interrupted safely, and the files of the result."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
