"""streamkit: weigh a galaxy with a tidal stream.

Every public name, and nothing else. Each is imported on first use, so that importing streamkit does not import numba,
emcee or astropy.
"""

import lazy_loader

from streamkit.distribution import VERSION

__version__ = VERSION

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
