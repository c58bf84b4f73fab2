"""streamkit: weigh a galaxy with a tidal stream.

The one door: every public name, and nothing else. Each is loaded on first use, so that what needs numba, emcee or
astropy costs nothing to those who do not ask for it.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
